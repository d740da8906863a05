"""Waves at the two ports of a lumen on a grid: launching, recording and separation.

Two-plane modal decomposition: the pressures in two layers of probes at a port, projected onto the
modes of the section, are separated into ingoing and outgoing waves by the modes' axial phases, as
in the measurement of multi-ports [1]_, of ducts with higher-order modes [2]_. Here the phases are
those of the grid, so that the separation has no error of discretisation.

References
----------
.. [1] Åbom, M. (1991). Measurement of the scattering-matrix of acoustical two-ports. Mechanical
   Systems and Signal Processing 5, 89-104. doi:10.1016/0888-3270(91)90017-Y
.. [2] Åbom, M. (1989). Modal decomposition in ducts based on transfer function measurements between
   microphone pairs. Journal of Sound and Vibration 135, 95-114.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import ceil, log, pi, sqrt
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from acoustube.air import Air
from acoustube.waves.grid.cells import CutCells, with_straight_ends
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.grid.straight_part import SKEWED_TOLERANCE, SYMMETRY_TOLERANCE, is_reversible
from acoustube.waves.modes.grid_modes import duct_modes, labels, phases
from acoustube.waves.scheme.leapfrog import march
from acoustube.waves.scheme.operator import on_device
from acoustube.waves.scheme.problem import LOSS_TAPER, Setup, prepare

Complex = NDArray[np.complexfloating[Any, Any]]
Progress = Callable[[float], object]

SOURCE_BAND_EDGE = 0.05
"""Spectrum of the source pulse at the ends of the band, relative to its peak."""
SOURCE_PROBE_CELLS = 6
"""Number of layers from a source to the nearer probes, and from the farther probes to the lumen
between its straight ends."""
PROBE_SEPARATION_CELLS = 2
"""Number of layers from one probe layer of a port to the next, less than half a wavelength on any
allowed grid."""
INWARD_DIRECTION = (1, -1)
"""Sign of the z direction that points into the lumen at each port."""
NARROWEST_SOURCE_BAND = 20e3
"""Smallest bandwidth of the source pulse in Hz; the pulse then lasts 0.4 ms."""
RINGDOWN_LEVEL = 1e-5
"""Highest pressure at the probes over the last steps, relative to the highest so far, below which
the run ends."""
RINGDOWN_CHECK_STEPS = 2000
"""Number of time steps between two checks of the ringdown."""


class PortProblem:
    """Scattering problem of the modes of one symmetry about x = 0, or of all modes.

    Parameters
    ----------
    core : CutCells
        The lumen between its straight ends, see `straight_ends_cut`.
    air : Air
    frequency : ndarray
        In Hz, (n,).
    band : tuple of float
        Range in Hz over which the losses are fitted. Only the modes that cut on below its upper end
        are computed.
    odd : bool or None
        Whether the modes are antisymmetric about x = 0; None for all modes at once.
    lossy : bool
        With viscothermal losses at the wall and absorption in the air.
    absorber_thickness : float
        Thickness of the absorbing layers in m.
    """

    def __init__(
        self,
        core: CutCells,
        air: Air,
        frequency: Array,
        band: tuple[float, float],
        odd: bool | None,
        lossy: bool,
        absorber_thickness: float,
    ) -> None:
        cells, middle = (core, None) if odd is None else _half(core)
        dz = cells.spacing[2]
        margin = ceil(LOSS_TAPER / dz) if lossy else 0
        lead = 2 * SOURCE_PROBE_CELLS + 2 + margin
        lengthened = with_straight_ends(cells, lead, lead)
        n = lengthened.shape[2]
        lengthened = replace(lengthened, length=(n - 0.5) * dz)
        low, high = band
        if low == high:  # the losses are fitted over a band
            low, high = 0.8 * low, 1.25 * high
        setup = prepare(
            lengthened, air, probes=(), source_end="absorbing", far_end="absorbing",
            absorber_thickness=absorber_thickness, lossy_band=(low, high) if lossy else None,
        )  # fmt: skip
        if odd and middle is not None:
            setup = _antisymmetric(setup, middle, lead, air)
        self.setup, self.frequency, self.spacing = setup, frequency, dz
        ahead = setup.source_layer
        self.sources = ahead + margin, ahead + n - 1 - margin
        self.probes = tuple(
            (
                source + inwards * SOURCE_PROBE_CELLS,
                source + inwards * (SOURCE_PROBE_CELLS + PROBE_SEPARATION_CELLS),
            )
            for source, inwards in zip(self.sources, INWARD_DIRECTION, strict=True)
        )
        tolerance = SKEWED_TOLERANCE if odd is None else SYMMETRY_TOLERANCE
        self.driven = (0,) if is_reversible(core, tolerance) else (0, 1)
        self._find_modes(air, band[1], odd)

    def _find_modes(self, air: Air, highest: float, odd: bool | None) -> None:
        """Set the modes of the straight ends, their names and their axial phases."""
        cells, scheme = self.setup.cells, self.setup.scheme
        volume, layer = np.asarray(cells.volume_fraction), self.sources[0]
        self.modes = duct_modes(scheme, volume, layer, highest, whole=odd is None, odd=bool(odd))
        area = volume[:, :, layer].sum() * cells.spacing[0] * cells.spacing[1]
        radius = sqrt(area * (1 if odd is None else 2) / pi)
        self.names = labels(self.modes, radius, air.sound_speed)
        self.propagates = self.frequency[:, None] > self.modes.cut_ons
        self.phases = phases(self.modes, scheme, self.spacing, self.frequency, air.sound_speed)

    @property
    def n_modes(self) -> int:
        """Number of modes in the band."""
        return len(self.modes.squares)

    @property
    def n_runs(self) -> int:
        """Number of runs: one for each driven port and mode."""
        return len(self.driven) * self.n_modes

    def height(self, layer: int) -> float:
        """Return the z coordinate in m of the centres of a layer."""
        return self.setup.cells.origin[2] + (layer + 0.5) * self.spacing

    def run(
        self, reference: tuple[float, float], longest: float, progress: Progress
    ) -> tuple[Complex, Complex, int]:
        """Return the scattering matrix from runs that drive each port with each mode.

        Parameters
        ----------
        reference : tuple of float
            Coordinates z of the reference planes in m.
        longest : float
            Time in s after which a run ends at the latest.
        progress : callable
            Called with the number of finished runs plus the finished fraction of the current one.

        Returns
        -------
        now, before : ndarray
            Scattering matrix from the whole runs, and from their first three quarters,
            (n, port_out, mode_out, port_in, mode_in).
        steps : int
            Number of time steps of the longest run.
        """
        m = self.n_modes
        pressure = np.zeros((2, len(self.frequency), 2, 2, m, 2, m), complex)
        steps = done = 0
        for port in self.driven:
            for mode in range(m):

                def report(fraction: float, done: int = done) -> None:
                    progress(done + fraction)

                pressure[..., port, mode], taken = _modal_spectra(self, port, mode, longest, report)
                steps, done = max(steps, taken), done + 1
                progress(done)
        if self.driven == (0,):
            pressure[..., 1, :] = pressure[:, :, ::-1, :, :, 0]
        now, before = (_scattering_matrix(self, spectra, reference) for spectra in pressure)
        return now, before, steps


def _half(cells: CutCells) -> tuple[CutCells, Array]:
    """Return the half x > 0 of a lumen, and the open fractions of the faces in x = 0."""
    n = cells.shape[0] // 2
    open_x = cells.open_x[n:].copy()
    middle = open_x[0].copy()
    open_x[0] = 0.0
    half = replace(
        cells,
        origin=(0.0, *cells.origin[1:]),
        volume_fraction=cells.volume_fraction[n:],
        open_x=open_x,
        open_y=cells.open_y[n:],
        open_z=cells.open_z[n:],
    )
    return half, middle


def _antisymmetric(setup: Setup, middle: Array, lead: int, air: Air) -> Setup:
    """Return a half's setup with zero pressure on x = 0, half a cell from the first centres."""
    n = setup.cells.shape[2]
    ahead = setup.source_layer + lead
    layers = np.clip(np.arange(n) - ahead, 0, middle.shape[1] - 1)
    inside = setup.cells.volume_fraction[0] > 0
    speed = (air.sound_speed / setup.cells.spacing[0]) ** 2
    faces = 2 * speed * middle[:, layers] * inside
    operator = setup.scheme.operator
    opened = on_device(faces, operator.area_x.dtype)
    scheme = setup.scheme._replace(
        operator=operator._replace(area_x=operator.area_x.at[0].set(opened))
    )
    if scheme.losses is not None:
        drag, inner = scheme.losses.drag, operator.area_x[1]
        weight = jnp.where(inner > 0, drag.area_x[1] / jnp.where(inner > 0, inner, 1.0), 0.0)
        drag = drag._replace(area_x=drag.area_x.at[0].set(opened * weight))
        scheme = scheme._replace(losses=scheme.losses._replace(drag=drag))
    return replace(setup, scheme=scheme)


def _source_pulse(setup: Setup, band: tuple[float, float], n: int) -> Array:
    """Return the source pulse, whose spectrum falls to `SOURCE_BAND_EDGE` at the band's ends.

    A narrow band is widened, because its pulse would last longer than the run.
    """
    middle, width = (band[0] + band[1]) / 2, max(band[1] - band[0], NARROWEST_SOURCE_BAND)
    low, high = middle - width / 2, middle + width / 2
    width = sqrt(2 * log(1 / SOURCE_BAND_EDGE)) / (pi * (high - low))
    time = np.arange(n) * setup.time_step - 5 * width
    return np.exp(-0.5 * (time / width) ** 2) * np.sin(pi * (low + high) * time)


def _modal_spectra(
    problem: PortProblem, port: int, mode: int, longest: float, progress: Progress
) -> tuple[Complex, int]:
    """Return the modal pressure spectra at the probes for one driven port and mode.

    Returns
    -------
    spectra : ndarray
        Spectra of the whole run and of its first three quarters, (2, n, port, layer, mode).
    steps : int
        Number of time steps of the run.
    """
    record = _ringdown(problem, port, mode, longest, progress)
    n = record.shape[1]
    omega = 2 * pi * problem.frequency * problem.setup.time_step
    both = np.stack([_spectrum(record, omega, end) for end in (n, 3 * n // 4)])
    return both.reshape(2, len(problem.frequency), 2, 2, problem.n_modes), n


def _ringdown(
    problem: PortProblem, port: int, mode: int, longest: float, progress: Progress
) -> Array:
    """Return the modal pressures at all probes until the ringdown ends, (4 n_modes, n_steps)."""
    modes, setup = problem.modes, problem.setup
    layers = np.repeat(np.ravel(problem.probes), problem.n_modes)
    weights = np.tile(modes.weights, (4, 1, 1)).transpose(1, 2, 0)
    dtype = setup.state.change.dtype
    scheme = setup.scheme._replace(
        source=on_device(modes.shapes[mode], dtype),
        probe_layers=on_device(layers, np.int32),
        probe_weights=on_device(weights, dtype),
    )
    driven = replace(setup, scheme=scheme, source_layer=problem.sources[port])
    band = float(problem.frequency[0]), float(problem.frequency[-1])
    most = RINGDOWN_CHECK_STEPS * ceil(longest / setup.time_step / RINGDOWN_CHECK_STEPS)
    pulse = _source_pulse(setup, band, most)
    state, records, highest = setup.state, [], 0.0
    for begin in range(0, most, RINGDOWN_CHECK_STEPS):
        state, pressure = march(driven, state, pulse[begin : begin + RINGDOWN_CHECK_STEPS])
        records.append(pressure)
        progress((begin + RINGDOWN_CHECK_STEPS) / most)
        level = float(np.abs(pressure).max())
        highest = max(highest, level)
        if begin > 0 and level < RINGDOWN_LEVEL * highest:
            break
    return np.concatenate(records, axis=1)


def _spectrum(signals: Array, omega: Array, end: int) -> Complex:
    """Return the spectra (n_frequencies, n_signals) of signals (n_signals, n) up to a sample.

    Their last third is faded out: ringing at a cut-on, if truncated, would leak into all
    frequencies.
    """
    fade = np.clip((end - np.arange(end)) / (end / 3), 0.0, 1.0)
    faded = signals[:, :end] * (0.5 - 0.5 * np.cos(pi * fade))
    total = np.zeros((len(omega), len(signals)), complex)
    for begin in range(0, end, RINGDOWN_CHECK_STEPS):
        times = np.arange(begin, min(begin + RINGDOWN_CHECK_STEPS, end))
        total += (
            np.exp(-1j * np.outer(omega, times)) @ faded[:, begin : begin + RINGDOWN_CHECK_STEPS].T
        )
    return total


def _scattering_matrix(
    problem: PortProblem, spectra: Complex, reference: tuple[float, float]
) -> Complex:
    """Return the scattering matrix from the modal pressure spectra at the probes in each run.

    Parameters
    ----------
    problem : PortProblem
    spectra : ndarray
        (n_frequencies, port, layer, mode, port driven, mode driven).
    reference : tuple of float
        Coordinates z of the reference planes in m.

    Returns
    -------
    ndarray
        (n_frequencies, port_out, mode_out, port_in, mode_in); zero where a mode does not propagate.
    """
    theta, propagates = problem.phases.theta, problem.propagates
    n, m = theta.shape
    q = np.exp(-1j * PROBE_SEPARATION_CELLS * theta)[:, :, None, None]
    root = np.sqrt(np.where(propagates, problem.phases.power, 0.0))[:, :, None, None]
    ingoing, outgoing = np.zeros((2, n, 2, m, 2, m), complex)
    for port in (0, 1):
        outer, inner = spectra[:, port, 0], spectra[:, port, 1]
        # outer = a + b, inner = a q + b / q: a the ingoing, b the outgoing wave at outer probes.
        a = (inner - outer / q) / (q - 1 / q)
        b = (outer * q - inner) / (q - 1 / q)
        offset = reference[port] - problem.height(problem.probes[port][0])
        layers = INWARD_DIRECTION[port] * offset / problem.spacing
        to_plane = np.exp(-1j * layers * np.where(propagates, theta, 0.0))[:, :, None, None]
        ingoing[:, port], outgoing[:, port] = a * to_plane * root, b / to_plane * root
    s = _solve_scattering(
        outgoing.reshape(n, 2 * m, -1), ingoing.reshape(n, 2 * m, -1), np.tile(propagates, (1, 2))
    )
    return s.reshape(n, 2, m, 2, m)


def _solve_scattering(outgoing: Complex, ingoing: Complex, propagates: NDArray[Any]) -> Complex:
    """Solve outgoing = S ingoing for the modes that propagate, from the runs that drive them."""
    found = np.zeros_like(outgoing)
    for pattern in np.unique(propagates, axis=0):
        rows, there = np.flatnonzero((propagates == pattern).all(axis=1)), np.flatnonzero(pattern)
        block = np.ix_(rows, there, there)
        # As the transposed equation, ingoing^T S^T = outgoing^T.
        solved = np.linalg.solve(ingoing[block].swapaxes(1, 2), outgoing[block].swapaxes(1, 2))
        found[block] = solved.swapaxes(1, 2)
    return found
