"""Scattering of duct modes by a lumen over a band, from broadband FDTD runs on a short grid."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from acoustube.air import Air
from acoustube.base.checks import (
    DURATION,
    FLAG,
    LENGTH,
    PLACE,
    Optional,
    Reals,
    check_fields,
    checked,
)
from acoustube.base.errors import ConfigError
from acoustube.waves.grid.cells import CutCells
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.grid.straight_part import is_symmetric, straight_ends_cut
from acoustube.waves.modes import bessel_zero
from acoustube.waves.modes.grid_modes import mode_numbers
from acoustube.waves.port_waves import Complex, PortProblem, Progress

SETTLED_CHANGE = 1e-3
"""Largest change of a coefficient over the last quarter of a run for it to count as settled."""


@dataclass(frozen=True, eq=False)
class PlaneWave:
    """The plane wave in a bend, from its first reference plane to the second.

    Attributes
    ----------
    length : ndarray
        Lengths of the parts of the bend in m, (n_parts,).
    wavenumber : ndarray
        Wavenumber in each part in 1/m, at the frequencies of the scattering, (n_parts, n).
    """

    length: Array
    wavenumber: Complex


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalScattering:
    """Scattering of duct modes between two straight ends of the same section.

    Attributes
    ----------
    frequency : ndarray
        In Hz, (n,).
    modes : tuple of str
        Names as ``00``, ``11c``, ``21s``, of the modes of a round bore with the area of the end at
        low z.
    s : ndarray
        Outgoing over incoming amplitude, power-normalised, at the reference planes, for time
        dependence exp(+j omega t). (n, port_out, mode_out, port_in, mode_in), ports 0 at low z and
        1 at high z; zero where a mode does not propagate.
    propagates : ndarray of bool
        Whether each mode propagates at each frequency, (n, n_modes).
    cut_ons : ndarray
        Cut-on frequencies in Hz, (n_modes,); those of the grid if the matrix is from a grid.
    sound_speed : float
        In m/s.
    extent : tuple of float
        Start and end of the part that is not straight, in m along z from the position at which the
        scatterer is placed (`PlacedScatterer`).
    planes : tuple of float
        Reference planes of the ports, in m from this position: (0, 0) for a press, the two ends for
        a bend.
    inside : PlaneWave or None
        Plane wave in each part of a bend, for the clutter there and for interpolation over
        frequency; None for a press.
    evanescent : ndarray or None
        Coefficients of `s` with modes that are evanescent, of the shape of `s`, zero where both
        modes propagate; power-normalised, with the complex root of an evanescent mode's axial
        wavenumber. None where they are not known, as for a press.
    """

    frequency: Array
    modes: tuple[str, ...]
    s: Complex
    propagates: NDArray[np.bool_]
    cut_ons: Array
    sound_speed: float
    extent: tuple[float, float]
    planes: tuple[float, float] = (0.0, 0.0)
    inside: PlaneWave | None = None
    evanescent: Complex | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Scattering(ModalScattering):
    """Scattering of duct modes by a lumen between two straight ends, from a grid.

    Attributes
    ----------
    settled : ndarray of bool
        Whether a coefficient changed by less than `SETTLED_CHANGE` over the last quarter of the
        runs; of the shape of `s`.
    spacing : tuple of float
        Size of a grid cell (dx, dy, dz) in m.
    shape : tuple of int
        Number of cells of a run (nx, ny, nz).
    steps : int
        Number of time steps of the longest run.
    time_step : float
        In s.
    """

    settled: NDArray[np.bool_]
    spacing: tuple[float, float, float]
    shape: tuple[int, int, int]
    steps: int
    time_step: float


@dataclass(frozen=True)
class PlacedScatterer:
    """A press, or a bend, and its position along the tube.

    Attributes
    ----------
    scattering : ModalScattering
        Scattering of the press or bend. A press from a file of ``acoustube scatter`` has both
        reference planes at z = 0 of its surface; this plane is placed at `position`.
    position : float
        Distance from the source end in m.

    Raises
    ------
    ConfigError
        If the position is not finite.
    """

    scattering: ModalScattering
    position: float

    def __post_init__(self) -> None:
        """Validate the position."""
        check_fields(self, position=PLACE)

    def from_other_end(self, length: float) -> PlacedScatterer:
        """Return the scatterer mirrored: as seen from the other end of a tube `length` m long."""
        s = self.scattering
        inside = s.inside
        if inside is not None:
            inside = PlaneWave(inside.length[::-1], inside.wavenumber[::-1])
        # Those of these arrays that there are: some are of a subclass, or may be None.
        names = "s", "evanescent", "settled", "derivative"
        by_port = {name: getattr(s, name, None) for name in names}
        mirrored = replace(
            s, inside=inside, extent=(-s.extent[1], -s.extent[0]),
            planes=(-s.planes[1], -s.planes[0]),
            **{name: a[:, ::-1, :, ::-1] for name, a in by_port.items() if a is not None},
        )  # fmt: skip
        return PlacedScatterer(mirrored, length - self.position)


@checked(
    cells=CutCells,
    air=Air,
    frequency=Reals(1e-3, 1e12, "Hz", ndim=1),
    reference=Reals(-1e6, 1e6, "m", ndim=1, last=2),
    lossy=FLAG,
    symmetric=Optional(FLAG),
    symmetric_only=FLAG,
    longest=DURATION,
    absorber_thickness=LENGTH,
)
def scatter(
    cells: CutCells,
    air: Air,
    frequency: Array,
    *,
    reference: tuple[float, float] = (0.0, 0.0),
    lossy: bool = True,
    symmetric: bool | None = None,
    symmetric_only: bool = False,
    longest: float = 12e-3,
    absorber_thickness: float = 0.01,
    progress: Progress | None = None,
) -> Scattering:
    """Return the scattering matrix of a lumen between the modes of its straight ends.

    Parameters
    ----------
    cells : CutCells
        The whole lumen, not its half.
    air : Air
    frequency : ndarray
        Rising frequencies in Hz, (n,).
    reference : tuple of float
        Reference planes of the ports at low z and at high z: coordinates z in m, in the system of
        the cells. The ends are continued straight to these planes.
    lossy : bool
        With viscothermal losses at the wall and absorption in the air.
    symmetric : bool, optional
        Whether the lumen is symmetric about x = 0, if this is known. By default it is symmetric if
        cells and their mirror images differ by less than a fiftieth of a cell.
    symmetric_only : bool
        For a lumen symmetric about x = 0, compute the symmetric modes only: a plane wave couples
        to no others.
    longest : float
        Time in s after which a run ends even if the pressure has not decayed.
    absorber_thickness : float
        In m. The absorbers only have to end the ringing: their reflections cancel, see Notes.
    progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    Scattering

    Raises
    ------
    ConfigError
        If the lumen has no straight ends, or ends of different sections or not symmetric about
        x = 0, or the frequencies do not increase.
    SimulationError
        If the pressure is no longer finite.

    Notes
    -----
    There is one run for each port and mode. A source in a layer of the straight end launches the
    mode in both directions; the outward wave enters an absorber. The pressures in two layers of
    probes at each port, projected onto the modes of the section, are separated into ingoing and
    outgoing waves by the modes' wavenumbers, known in closed form on the grid (see
    :mod:`acoustube.waves.port_waves`). With the ingoing waves of all runs as the columns of A and
    the outgoing ones as those of B, B = S A: the absorbers' reflections are part of A and therefore
    cancel. A lumen symmetric about x = 0 is computed by halves, the symmetric and the antisymmetric
    modes separately. A lumen symmetric along z, also on the grid, is driven from one end only.
    """
    frequency = np.asarray(frequency, float)
    if not np.all(np.diff(frequency) > 0):
        raise ConfigError("frequency must be positive and increasing; give a 1-D array in Hz")
    core = straight_ends_cut(cells)
    parities: tuple[bool | None, ...] = (None,)
    if is_symmetric(core) if symmetric is None else symmetric:
        parities = (False,) if symmetric_only else (False, True)
    band = float(frequency[0]), float(frequency[-1])
    parts = [
        PortProblem(core, air, frequency, band, odd, lossy, absorber_thickness) for odd in parities
    ]
    # Below the cut-on of (1,1) there is no antisymmetric mode.
    parts = [part for part in parts if part.n_modes]
    n_runs, done = sum(part.n_runs for part in parts), 0
    blocks, earlier, steps = [], [], 0
    for part in parts:

        def report(finished: float, done: int = done) -> None:
            if progress is not None:
                progress((done + finished) / n_runs)

        now, before, taken = part.run(reference, longest, report)
        blocks.append(now)
        earlier.append(before)
        steps, done = max(steps, taken), done + part.n_runs
    start = core.origin[2]
    extent = start - reference[0], start + core.length + core.spacing[2] / 2 - reference[1]
    return _combine(parts, blocks, earlier, frequency, air, steps, extent)


def _combine(
    parts: list[PortProblem],
    blocks: list[Complex],
    earlier: list[Complex],
    frequency: Array,
    air: Air,
    steps: int,
    extent: tuple[float, float],
) -> Scattering:
    """Combine the scattering of both symmetries, in the order of the cut-ons."""
    names = [name for part in parts for name in part.names]
    cut_ons = np.concatenate([part.modes.cut_ons for part in parts])
    # In the order of the round bore's cut-ons: on the grid those of a pair differ by rounding.
    order = sorted(
        range(len(names)), key=lambda i: (bessel_zero(*mode_numbers(names[i])), names[i])
    )
    s, before = (_block_diagonal(values)[:, :, order][..., order] for values in (blocks, earlier))
    return Scattering(
        frequency=np.asarray(frequency),
        modes=tuple(names[i] for i in order),
        s=s,
        propagates=frequency[:, None] > cut_ons[order],
        cut_ons=cut_ons[order],
        settled=np.abs(s - before) < SETTLED_CHANGE,
        sound_speed=air.sound_speed,
        extent=extent,
        spacing=parts[0].setup.cells.spacing,
        shape=parts[0].setup.cells.shape,
        steps=steps,
        time_step=parts[0].setup.time_step,
    )


def _block_diagonal(blocks: list[Complex]) -> Complex:
    """Return the matrix of all modes; those of different symmetry do not couple."""
    sizes = [block.shape[2] for block in blocks]
    joined = np.zeros((len(blocks[0]), 2, sum(sizes), 2, sum(sizes)), complex)
    for block, end in zip(blocks, np.cumsum(sizes), strict=True):
        here = slice(end - block.shape[2], end)
        joined[:, :, here][..., here] = block
    return joined
