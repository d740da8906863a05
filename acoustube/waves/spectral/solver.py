"""Scattering matrix S of a lumen over a band, adaptively refined to an error tolerance.

The discrete wave equation is solved at a few squared wavenumbers, the shifts. The solutions and
their k^2 derivatives span a space in which the whole band is then solved, a rational Krylov space
[1]_. Errors are estimated by the change of S in enriched spaces:

* errors of the degree across the tube, and of the elements along it: at each shift a correction by
  the residual is solved for in the functions that the basis lacks (the next two degrees; one more
  degree along each element), and these corrections are added to the reduced space;
* error of the shifts: shifts are added where S changes when the last Krylov block of every shift is
  added.

S is taken from the largest space. Its error estimate is `ERROR_SAFETY` times the sum of the
truncation error, extrapolated from these changes, and of the error of the shifts.

With losses S is taken from the span of the lossless fields of the basis, without corrections. Its
error estimate is the largest of the estimate without losses, `LOSSY_SAFETY` times the changes of S
in a smaller span and in a direct solution, and, in flat lumens, the change of S in a poorer basis.

References
----------
.. [1] Ruhe, A. (1984). Rational Krylov sequence methods for eigenvalue computation. Linear Algebra
   and its Applications 58, 391-405. doi:10.1016/0024-3795(84)90221-0
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d
from threadpoolctl import threadpool_limits

from acoustube.air import Air
from acoustube.base.checks import FLAG, Reals, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.waves.spectral.adaptation import adapted, discretised, truncation_ratio
from acoustube.waves.spectral.band import difference, swept
from acoustube.waves.spectral.derivatives import (
    changed_wavenumbers,
    changes_of,
    moved_scattering,
)
from acoustube.waves.spectral.discretisation import Discretisation
from acoustube.waves.spectral.ends import end_modes
from acoustube.waves.spectral.first_basis import ELEMENT_DEGREE, Basis, first_basis
from acoustube.waves.spectral.lossy import lossy_scattering, wall_projections
from acoustube.waves.spectral.lossy_derivatives import (
    changed_ends,
    moved_lossy_scattering,
    wall_changes,
)
from acoustube.waves.spectral.motion import Motion, Velocity, motion_of
from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.ports import Complex, axial_wavenumbers, of_both_ports
from acoustube.waves.spectral.reduction import Reduced
from acoustube.waves.spectral.result import ERROR_QUANTILE, SpectralScattering
from acoustube.waves.spectral.walls import Wall

ERROR_SAFETY, LOSSY_SAFETY = 2.0, 4.0
"""Factors from changes of S to its error estimate. `ERROR_SAFETY` is for changes without losses,
because the enriched spaces have errors too. `LOSSY_SAFETY` is for changes with losses, which are
known at a few frequencies only."""
POORER = 4, 2
"""Difference of degree across the tube, and along the elements, between the basis and the poorer
one for the error estimate of flat lumens with losses."""
LEAST_ERROR = 3e-6
"""Error of S by the quadrature over walls with knots (given by rings), including a safety factor.
It is added to the error estimate."""
ERROR_WINDOW = 3
"""Number of frequencies on either side over which the largest error is taken, because an estimated
error may pass through zero."""
FIRST_SHARE = 0.5
"""Initial bound, as a fraction of the tolerance, of each of two errors of S: that due to the
polynomial degree across the tube, and that due to the elements along it."""
END_DEVIATION = 2e-3
"""Largest deviation of the wall from its ends' circle, or of its ends from each other, relative to
`Wall.radius`."""
MAX_SOLUTIONS = 2
"""Largest number of bases in which the whole band is solved."""


@dataclass(frozen=True, eq=False)
class _Task:
    """Problem to solve; k is the wavenumber of sound without losses in 1/m, (n,)."""

    wall: Wall
    air: Air
    frequency: Array
    k: Array
    tolerance: float
    reference: tuple[float, float]
    lossy: bool
    motion: Motion | None


class _Part(NamedTuple):
    """S of the m modes of one symmetry about x = 0, its derivative `moved`, and its error.

    `s` and `moved` are (n, 2, m, 2, m), `error` is (n,). `zeros` are the modes' cut-on wavenumbers
    times the radius, (m,), and `heights` the coordinates z of both ports in m.
    """

    names: tuple[str, ...]
    zeros: Array
    s: Complex
    moved: Complex
    error: Array
    basis: Basis
    n_fields: int
    heights: tuple[float, float]


@checked(
    wall=Wall, air=Air, frequency=Reals(1e-3, 1e12, "Hz", ndim=1), tolerance=Number(1e-6, 0.1),
    reference=Reals(-1e6, 1e6, "m", ndim=1, last=2), lossy=FLAG, symmetric_only=FLAG,
)  # fmt: skip
def scatter_spectral(
    wall: Wall,
    air: Air,
    frequency: Array,
    *,
    tolerance: float = 1e-3,
    reference: tuple[float, float] = (0.0, 0.0),
    lossy: bool = True,
    symmetric_only: bool = False,
    velocity: Velocity | None = None,
) -> SpectralScattering:
    """Return the scattering matrix of the modes at the ends of a lumen, over a band.

    Parameters
    ----------
    wall : Wall
        From :func:`wall_of` or :func:`analytic_wall`.
    air : Air
    frequency : ndarray
        Rising frequencies in Hz, (n,).
    tolerance : float
        Largest error of a coefficient, from 1e-6 to 0.1.
    reference : tuple of float
        Reference planes of the ports at low z and at high z: coordinates z in m, in the system of
        the wall. The ends are continued straight to these planes.
    lossy : bool
        Whether to include the losses at the wall and in the air.
    symmetric_only : bool
        For a lumen symmetric about x = 0, compute the symmetric modes only.
    velocity : callable, optional
        Motion of the wall: takes z (n, 1) in m and t (n_points,) from 0 to 2 pi, and returns the
        displacements in x and y in m per unit of a parameter, by which S is then differentiated.

    Returns
    -------
    SpectralScattering

    Raises
    ------
    ConfigError
        If an argument is out of range or the frequencies do not rise, or an end's section overlaps
        itself or is too slender, or the ends differ or are not round as the wall states. Also if
        the motion lacks a symmetry of the wall, differs between the ends, makes round ends not
        round, or moves ends with equal cut-ons.
    numpy.linalg.LinAlgError
        If sections of the lumen overlap themselves.

    Notes
    -----
    Where a resonance is too narrow for every basis tried, `error` of the result exceeds
    `tolerance`. BLAS is limited to one thread in the whole process during the solution.
    """
    frequency = np.asarray(frequency, float)
    if not np.all(np.diff(frequency) > 0):
        raise ConfigError("frequency must be positive and increasing; give a 1-D array in Hz")
    _check_ends(wall)
    k = 2 * np.pi * frequency / air.sound_speed
    parities: tuple[bool | None, ...] = (None,)
    if wall.symmetric:
        parities = (False,) if symmetric_only else (False, True)
    # Below the cut-on of (1,1) there is no antisymmetric mode.
    parities = tuple(odd for odd in parities if len(end_modes(wall, k[-1] * wall.radius, odd)))
    motion = None if velocity is None else motion_of(wall, velocity)
    task = _Task(wall, air, frequency, k, tolerance, reference, lossy, motion)
    # Many small matrices: two threads, which wait for each other, take 1.4 to 1.9 times as long.
    with threadpool_limits(1, user_api="blas"):
        return _joined([_part(task, odd) for odd in parities], task)


def _check_ends(wall: Wall) -> None:
    """Check that the ends are equal and, if the wall states it, round with its radius."""
    x, y, *_ = wall.lines(np.array(wall.ends))
    largest = END_DEVIATION * wall.radius
    if wall.circular:
        distance = np.hypot(x, y)
        if np.abs(distance - wall.radius).max() > largest:
            raise ConfigError(
                f"is not that of the wall's ends, which are {distance.min():.4g} to "
                f"{distance.max():.4g} m from x = y = 0", setting="radius", value=wall.radius,
                advice="let both ends be circles of that radius about x = y = 0",
            )  # fmt: skip
    elif max(np.ptp(x, axis=0).max(), np.ptp(y, axis=0).max()) > largest:
        raise ConfigError(
            "the lumen's ends differ in section; let both be straight tube of the same section"
        )


def _joined(parts: list[_Part], task: _Task) -> SpectralScattering:
    """Combine the scattering matrices of both symmetries, in the order of the cut-ons."""
    frequency, reference = task.frequency, task.reference
    names = [name for part in parts for name in part.names]
    zeros = np.concatenate([part.zeros for part in parts])
    s, moved = np.zeros((2, len(frequency), 2, len(names), 2, len(names)), complex)
    end = 0
    for part in parts:
        here = slice(end, end := end + len(part.names))
        s[:, :, here, :, here], moved[:, :, here, :, here] = part.s, part.moved
    # The cut-ons of a pair differ by rounding.
    order = sorted(range(len(names)), key=lambda i: (round(float(zeros[i]), 9), names[i]))
    cut_ons = zeros[order] * task.air.sound_speed / (2 * np.pi * task.wall.radius)
    low, high = parts[0].heights
    return SpectralScattering(
        frequency=frequency,
        modes=tuple(names[i] for i in order),
        s=s[:, :, order][..., order],
        propagates=frequency[:, None] > cut_ons,
        cut_ons=cut_ons,
        sound_speed=task.air.sound_speed,
        extent=(low - reference[0], high - reference[1]),
        derivative=moved[:, :, order][..., order] if task.motion is not None else None,
        error=np.max([part.error for part in parts], axis=0),
        tolerance=task.tolerance,
        degree=max(part.basis.degree for part in parts),
        n_elements=max(len(part.basis.edges) - 1 for part in parts),
        n_shifts=max(len(part.basis.shifts) for part in parts),
        n_fields=max(part.n_fields for part in parts),
    )


def _part(task: _Task, odd: bool | None) -> _Part:
    """Return the scattering matrices of the modes of one symmetry about x = 0."""
    wall, k, tolerance = task.wall, task.k, task.tolerance
    moving = task.motion is not None
    basis = first_basis(wall, odd, k, lossy=task.lossy, moving=moving)
    wanted, known = FIRST_SHARE * tolerance, None
    for number in range(MAX_SOLUTIONS):
        found = adapted(wall, k, odd, basis, wanted, known, lossy=task.lossy)
        if known is not None and found.system is known.system:
            break  # The same basis has the same error.
        system, basis, responses = known = found
        spaces, s, (change, doubt), sizes = swept(system, basis, responses, k, tolerance)
        ratio = truncation_ratio(
            system, {float(at): responses[float(at)] for at in basis.shifts}, k
        )
        basis = replace(basis, shifts=np.array(sorted(responses)))
        error = _estimated(ERROR_SAFETY * (ratio * change + doubt), wall)
        typical = float(np.quantile(error, ERROR_QUANTILE))
        if task.lossy or typical <= tolerance or number == MAX_SOLUTIONS - 1:
            break
        # Resonances amplify errors that are small at the test shifts.
        wanted *= 0.5 * tolerance / typical
    if task.lossy:
        s, moved, kz, drift, lacking = _with_losses(task, system, spaces, sizes)
        # Errors of the basis without losses, for example at cut-ons, are also errors with losses.
        error = np.maximum(error, _estimated(LOSSY_SAFETY * lacking, wall))
        if basis.flat:
            poorer = _change_from_poorer_basis(task, odd, basis, s)
            error = np.maximum(error, _estimated(poorer, wall))
    else:
        moved, kz, drift = _without_losses(task, system, spaces)
    s, moved, names, zeros = _at_reference(s, moved, kz, drift, system, task)
    n_fields = max(space.fields.shape[-1] if task.lossy else space.size for space in spaces)
    return _Part(names, zeros, s, moved, error, basis, n_fields, system.heights)


def _change_from_poorer_basis(task: _Task, odd: bool | None, basis: Basis, s: Complex) -> Array:
    """Return the largest difference of S with losses from that in a poorer basis, (n,).

    Where walls are pressed together, fields with losses differ much from those without. Their
    errors due to the degree and to the elements differ too: they decrease slowly.
    """
    poorer = replace(basis, degree=basis.degree - POORER[0])
    order = ELEMENT_DEGREE - POORER[1]
    system = discretised(task.wall, task.k, odd, poorer, lossy=True, order=order)
    spaces, _, _, sizes = swept(system, poorer, {}, task.k, task.tolerance)
    less = _with_losses(replace(task, motion=None), system, spaces, sizes)[0]
    return difference(system, s, less, task.k)


def _without_losses(
    task: _Task, system: Discretisation, spaces: list[Reduced]
) -> tuple[Complex, Complex, Complex]:
    """Return the derivative of S, the axial wavenumbers of the ends' modes and their derivative."""
    kz = axial_wavenumbers(task.k, system.modes.zeros, system.radius)
    n, size = len(system.ports), len(system.ports) * len(system.modes)
    if task.motion is None:
        nothing = np.zeros((len(kz), size, size), complex)
        return of_both_ports([nothing] * len(spaces)), kz, np.zeros_like(kz)
    drift = changed_wavenumbers(system, task.motion, kz)
    changes = changes_of(system, task.wall, task.motion, float(task.k[-1]))
    moved = moved_scattering(
        system, spaces, changes, task.k, np.tile(kz, (1, n)), np.tile(drift, (1, n))
    )
    return of_both_ports(moved), kz, drift


def _with_losses(
    task: _Task, system: Discretisation, spaces: list[Reduced], sizes: list[int]
) -> tuple[Complex, Complex, Complex, Complex, Array]:
    """Return S, its derivative, the ends' axial wavenumbers and their derivative, and S's error.

    The error, (n,), is `lacking` of :func:`lossy_scattering`.
    """
    assert system.layers is not None
    # Without corrections, which were computed for the lossless fields.
    spaces = [space.first(space.fields.shape[-1]) for space in spaces]
    frequency, air = task.frequency, task.air
    series, walls = wall_projections(system, system.layers, spaces, frequency, air)
    sides, kz, lacking = lossy_scattering(
        system, spaces, walls, series, frequency, air, sizes, moving=task.motion is not None
    )
    s = of_both_ports([side.scattering for side in sides])
    if task.motion is None:
        return s, np.zeros_like(s), kz, np.zeros_like(kz), lacking
    changes = changes_of(system, task.wall, task.motion, float(task.k[-1]))
    ends = changed_ends(system, task.motion, sides[0].band.wavenumber, frequency, air)
    changed = wall_changes(system, task.motion, spaces, series, frequency, air)
    moved = moved_lossy_scattering(system, sides, spaces, changes, changed, ends)
    return s, of_both_ports(moved), kz, ends[0], lacking


def _estimated(error: Array, wall: Wall) -> Array:
    """Return the largest error within `ERROR_WINDOW` of each frequency, plus that of quadrature."""
    least = LEAST_ERROR if len(wall.knots) else 0.0
    return least + maximum_filter1d(error, 2 * ERROR_WINDOW + 1)


def _at_reference(
    s: Complex, moved: Complex, kz: Complex, drift: Complex, system: Discretisation, task: _Task
) -> tuple[Complex, Complex, tuple[str, ...], Array]:
    """Return S and its derivative at the reference planes, and the modes' names and cut-ons k R."""
    reach = task.k * system.radius
    n = int(np.sum(system.modes.zeros < reach[-1]))
    zeros = system.modes.zeros[:n]
    away = task.reference[0] - system.heights[0], system.heights[1] - task.reference[1]
    travels = reach[:, None] > zeros
    kz, drift = (np.where(travels, part[:, :n], 0.0) for part in (kz, drift))
    turn = np.stack([np.where(travels, np.exp(1j * kz * d), 0.0) for d in away], axis=1)
    s, moved = (
        turn[..., None, None] * part[:, :, :n, :, :n] * turn[:, None, None] for part in (s, moved)
    )
    # The phase between a port and its reference plane changes if the ends move.
    turned = np.stack([1j * drift * d for d in away], axis=1)
    moved = moved + turned[..., None, None] * s + s * turned[:, None, None]
    return s, moved, system.modes.names[:n], zeros
