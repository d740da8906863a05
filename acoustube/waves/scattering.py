"""Scattering of duct modes by a lumen, over a band, from broadband runs on a short grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil, log, pi, sqrt
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.waves.grid.cells import CutCells, with_straight_ends
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.modes import bessel_zero
from acoustube.waves.modes.grid_modes import Phases, duct_modes, labels, mode_numbers, phases
from acoustube.waves.scheme.leapfrog import march
from acoustube.waves.scheme.problem import FADING, Setup, prepare

Complex = NDArray[np.complexfloating[Any, Any]]
Progress = Callable[[float], object]

SAME = 1e-4
"""Largest difference of the fractions of layers that count as straight."""
ALIKE = 0.02
"""Largest difference of the fractions of cells that count as the same, or as mirror images.

The diagonals of two triangles are not mirrored, which moves the wall by a hundredth of a cell.
"""
EDGE = 0.05
"""Spectrum of the source at the ends of the band, as a share of its peak."""
GAP = 6
"""Layers between a source and the nearer probes, and between these and the first changed layer."""
APART = 2
"""Layers between the two probes of a port: under half a wavelength on any grid that is allowed."""
INWARDS = (1, -1)
"""Direction of z into the lumen at each port."""
NARROWEST_CLICK = 20e3
"""Width in Hz of the source's spectrum at the least; its pulse then lasts 0.4 ms."""
SETTLED = 1e-3
"""Largest change of a coefficient over the last quarter of a run that counts as settled."""
QUIET = 1e-5
"""Pressure, as a share of the highest, below which a run ends."""
CHECKS = 2000
"""Steps between two checks whether the ringing is over."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalScattering:
    """Scattering of duct modes between two straight ends of one round bore.

    Attributes
    ----------
    frequency : ndarray
        In Hz, (n,).
    modes : tuple of str
        As ``00``, ``11c``, ``21s``; of the round bore with the area of the end at low z.
    s : ndarray
        Outgoing over incoming amplitude, normalised by the power, at the reference planes; time
        goes as exp(+j omega t). (n, port_out, mode_out, port_in, mode_in), ports 0 at low z and 1
        at high z; zero where a mode does not propagate.
    propagates : ndarray of bool
        (n, n_modes).
    cut_ons : ndarray
        In Hz, (n_modes,); of the grid where there is one.
    sound_speed : float
        In m/s.
    extent : tuple of float
        From where to where the tube is not straight, in m from the reference planes.
    """

    frequency: Array
    modes: tuple[str, ...]
    s: Complex
    propagates: NDArray[np.bool_]
    cut_ons: Array
    sound_speed: float
    extent: tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Scattering(ModalScattering):
    """Scattering of duct modes by a lumen between two straight ends, from a grid.

    Attributes
    ----------
    settled : ndarray of bool
        Which coefficients changed by less than `SETTLED` over the last quarter of the runs; of the
        shape of `s`.
    spacing : tuple of float
        Size of a grid cell in m.
    shape : tuple of int
        Cells of a run.
    steps : int
        Of the longest run.
    time_step : float
        In s.
    """

    settled: NDArray[np.bool_]
    spacing: tuple[float, float, float]
    shape: tuple[int, int, int]
    steps: int
    time_step: float


def scatter(
    cells: CutCells,
    air: Air,
    frequency: Array,
    *,
    reference: tuple[float, float] = (0.0, 0.0),
    lossy: bool = True,
    symmetric_only: bool = False,
    longest: float = 12e-3,
    absorber_thickness: float = 0.01,
    progress: Progress | None = None,
) -> Scattering:
    """Return how a lumen scatters the modes of its straight ends.

    Parameters
    ----------
    cells : CutCells
        The whole lumen, not its half.
    air : Air
    frequency : ndarray
        Rising frequencies in Hz.
    reference : tuple of float
        Heights z in m, in the coordinates of the cells, at which the amplitudes at low z and at
        high z are given, as if the ends went on straight to there.
    lossy : bool
        With the losses at the wall and in the air.
    symmetric_only : bool
        Of a lumen symmetric about x = 0, compute the modes that are so too: all that a plane wave
        meets there.
    longest : float
        Time in s after which a run ends even if it still rings.
    absorber_thickness : float
        In m. What the absorbers return is accounted for: they only have to end the ringing.
    progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    Scattering

    Raises
    ------
    ConfigError
        If the lumen has no straight ends, or ends of different sections, or the frequencies do not
        rise.

    Notes
    -----
    One run for each port and mode: a source in a layer of the straight end launches the mode both
    ways, the outer half of it into an absorber. What two layers of probes at each port hear,
    projected onto the modes of the section, is told apart into what travels inwards and outwards
    by the modes' wavenumbers, known in closed form on the grid. With the waves of all runs as the
    columns of A and B, B = S A: what the absorbers return is in A, and does no harm. A lumen
    symmetric about x = 0 is computed by halves, the symmetric and the antisymmetric modes apart; of
    one symmetric along z, on the grid too, one end is driven.
    """
    frequency = np.asarray(frequency, float)
    if frequency.ndim != 1 or not (frequency[0] > 0 and np.all(np.diff(frequency) > 0)):
        raise ConfigError("frequency must rise from a value over 0; give one row of Hz")
    core = straight_ends_cut(cells)
    parities: tuple[bool | None, ...] = (None,)
    if is_symmetric(core):
        parities = (False,) if symmetric_only else (False, True)
    band = float(frequency[0]), float(frequency[-1])
    parts = [_Part(core, air, frequency, band, odd, lossy, absorber_thickness) for odd in parities]
    # Below the cut-on of (1,1) there is no antisymmetric mode.
    parts = [part for part in parts if len(part.modes.squares)]
    n_runs = sum(len(part.driven) * len(part.modes.squares) for part in parts)
    done = 0
    blocks, earlier, steps = [], [], 0
    for part in parts:
        now, before, taken, done = part.run(reference, longest, progress, done, n_runs)
        blocks.append(now)
        earlier.append(before)
        steps = max(steps, taken)
    start = core.origin[2]
    extent = start - reference[0], start + core.length + core.spacing[2] / 2 - reference[1]
    return _joined(parts, blocks, earlier, frequency, air, steps, extent)


def _joined(
    parts: list[_Part],
    blocks: list[Complex],
    earlier: list[Complex],
    frequency: Array,
    air: Air,
    steps: int,
    extent: tuple[float, float],
) -> Scattering:
    """Put the parts of both symmetries together, in the order of the cut-ons."""
    names = [name for part in parts for name in part.names]
    cut_ons = np.concatenate([part.modes.cut_ons for part in parts])
    # That of the round bore: the cut-ons of a pair differ by rounding.
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
        settled=np.abs(s - before) < SETTLED,
        sound_speed=air.sound_speed,
        extent=extent,
        spacing=parts[0].setup.cells.spacing,
        shape=parts[0].setup.cells.shape,
        steps=steps,
        time_step=parts[0].setup.time_step,
    )


def _block_diagonal(blocks: list[Complex]) -> Complex:
    """Return the matrix of all modes; those of different symmetry do not meet."""
    sizes = [block.shape[2] for block in blocks]
    joined = np.zeros((len(blocks[0]), 2, sum(sizes), 2, sum(sizes)), complex)
    for block, end in zip(blocks, np.cumsum(sizes), strict=True):
        here = slice(end - block.shape[2], end)
        joined[:, :, here][..., here] = block
    return joined


def is_symmetric(cells: CutCells) -> bool:
    """Return whether a lumen is its own mirror image about x = 0."""
    mirrored = np.abs(cells.volume_fraction - cells.volume_fraction[::-1])
    return bool(cells.origin[0] < 0 and mirrored.max() < ALIKE)


def is_reversible(cells: CutCells) -> bool:
    """Return whether a lumen is its own mirror image along z."""
    mirrored = np.abs(cells.volume_fraction - cells.volume_fraction[..., ::-1])
    return bool(mirrored.max() < ALIKE)


def straight_ends_cut(cells: CutCells) -> CutCells:
    """Return the part of a lumen between its straight ends, with one layer of each.

    Raises
    ------
    ConfigError
        If an end is not straight over three layers, or the two differ.
    """
    volume = cells.volume_fraction
    last = int(np.floor(cells.length / cells.spacing[2] - 0.5 + 1e-6))
    ends = []
    for rim, inwards in ((1, 1), (last - 1, -1)):
        off = np.abs(volume - volume[..., [rim]]).max(axis=(0, 1)) > SAME
        inside = np.arange(rim, last if inwards > 0 else 0, inwards)
        changed = inside[off[inside]]
        straight = abs(int(changed[0]) - rim) if len(changed) else len(inside) // 2
        if straight < 3:
            where = "low" if inwards > 0 else "high"
            raise ConfigError(
                f"The lumen is not straight at its end of {where} z; let it end in at least "
                f"{3e3 * cells.spacing[2]:.2g} mm of straight tube."
            )
        ends.append(rim + inwards * (straight - 1))
    first, end = ends
    section = volume[..., first]
    if np.abs(section - volume[..., end]).max() > ALIKE:
        raise ConfigError(
            "The lumen's two ends differ in section, and their modes cannot be told by the same "
            "names; let both ends have the same section."
        )
    if np.abs(section - section[::-1]).max() > ALIKE:
        raise ConfigError(
            "The lumen's ends are not symmetric about x = 0, by which their modes are named; move "
            "or turn it so that they are."
        )
    layers = slice(first, end + 1)
    dz = cells.spacing[2]
    return replace(
        cells,
        origin=(*cells.origin[:2], cells.origin[2] + first * dz),
        length=(end - first + 0.5) * dz,
        volume_fraction=volume[..., layers],
        open_x=cells.open_x[..., layers],
        open_y=cells.open_y[..., layers],
        open_z=cells.open_z[..., first : end + 2],
    )


class _Part:
    """The modes of one symmetry about x = 0, or all of them."""

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
        lead = 2 * GAP + 2 + (ceil(FADING / dz) if lossy else 0)
        lengthened = with_straight_ends(cells, lead, lead)
        n = lengthened.shape[2]
        lengthened = replace(lengthened, length=(n - 0.5) * dz)
        setup = prepare(
            lengthened, air, probes=(), source_end="absorbing", far_end="absorbing",
            absorber_thickness=absorber_thickness, lossy_band=band if lossy else None,
        )  # fmt: skip
        self.setup = (
            _antisymmetric(setup, middle, lead, air) if odd and middle is not None else setup
        )
        ahead = setup.source_layer
        out = ahead + lead - 2 * GAP - 2
        self.sources = out, ahead + n - 1 - (lead - 2 * GAP - 2)
        self.probes = tuple(
            (source + inwards * GAP, source + inwards * (GAP + APART))
            for source, inwards in zip(self.sources, INWARDS, strict=True)
        )
        self.driven = (0,) if is_reversible(core) else (0, 1)
        volume = np.asarray(self.setup.cells.volume_fraction)
        self.frequency, self.air, self.spacing = frequency, air, dz
        self.modes = duct_modes(
            self.setup.scheme, volume, out, band[1],
            whole=odd is None, odd=bool(odd),
        )  # fmt: skip
        area = volume[:, :, out].sum() * cells.spacing[0] * cells.spacing[1]
        radius = sqrt(area * (1 if odd is None else 2) / pi)
        self.names = labels(self.modes, radius, air.sound_speed)
        self.travels = frequency[:, None] > self.modes.cut_ons
        self.phases = phases(self.modes, self.setup.scheme, dz, frequency, air.sound_speed)

    def height(self, layer: int) -> float:
        """Return the height z in m of the centres of a layer."""
        return self.setup.cells.origin[2] + (layer + 0.5) * self.spacing

    def run(
        self,
        reference: tuple[float, float],
        longest: float,
        progress: Progress | None,
        done: int,
        n_runs: int,
    ) -> tuple[Complex, Complex, int, int]:
        """Return S over the part's modes, at the end and earlier, the steps and the runs done."""
        m = len(self.modes.squares)
        raw = np.zeros((2, len(self.frequency), 2, 2, m, 2, m), complex)
        steps = 0
        for port in self.driven:
            for mode in range(m):

                def show(share: float, done: int = done) -> None:
                    if progress is not None:
                        progress((done + share) / n_runs)

                heard, taken = _heard(self, port, mode, longest, show)
                raw[..., port, mode] = heard
                steps, done = max(steps, taken), done + 1
                show(0.0, done)
        if self.driven == (0,):
            raw[..., 1, :] = raw[:, :, ::-1, :, :, 0]
        now, before = (_coefficients(self, heard, reference) for heard in raw)
        return now, before, steps, done


def _half(cells: CutCells) -> tuple[CutCells, Array]:
    """Return the half x > 0 of a lumen, and how open the plane x = 0 is."""
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
    """Return a half with zero pressure in the plane x = 0, half a cell before the first centres."""
    n = setup.cells.shape[2]
    ahead = setup.source_layer + lead
    layers = np.clip(np.arange(n) - ahead, 0, middle.shape[1] - 1)
    inside = setup.cells.volume_fraction[0] > 0
    speed = (air.sound_speed / setup.cells.spacing[0]) ** 2
    faces = 2 * speed * middle[:, layers] * inside
    operator = setup.scheme.operator
    opened = jnp.asarray(faces, operator.area_x.dtype)
    scheme = setup.scheme._replace(
        operator=operator._replace(area_x=operator.area_x.at[0].set(opened))
    )
    if scheme.losses is not None:
        drag, beside = scheme.losses.drag, operator.area_x[1]
        share = jnp.where(beside > 0, drag.area_x[1] / jnp.where(beside > 0, beside, 1.0), 0.0)
        drag = drag._replace(area_x=drag.area_x.at[0].set(opened * share))
        scheme = scheme._replace(losses=scheme.losses._replace(drag=drag))
    return replace(setup, scheme=scheme)


def _click(setup: Setup, band: tuple[float, float], n: int) -> Array:
    """Return the source, whose spectrum falls to `EDGE` at the ends of the band.

    A narrow band is widened: its pulse would take longer than the run.
    """
    middle, width = (band[0] + band[1]) / 2, max(band[1] - band[0], NARROWEST_CLICK)
    low, high = middle - width / 2, middle + width / 2
    width = sqrt(2 * log(1 / EDGE)) / (pi * (high - low))
    time = np.arange(n) * setup.time_step - 5 * width
    return np.exp(-0.5 * (time / width) ** 2) * np.sin(pi * (low + high) * time)


def _heard(
    part: _Part, port: int, mode: int, longest: float, progress: Progress
) -> tuple[Complex, int]:
    """Return the spectra of a whole run and of three quarters of it.

    Returns
    -------
    spectra : ndarray
        (2, n_frequencies, port, layer, n_modes).
    steps : int
    """
    modes, setup = part.modes, part.setup
    m = len(modes.squares)
    layers = np.repeat(np.ravel(part.probes), m)
    weights = np.tile(modes.weights, (4, 1, 1)).transpose(1, 2, 0)
    dtype = setup.state.change.dtype
    scheme = setup.scheme._replace(
        source=jnp.asarray(modes.shapes[mode], dtype),
        probe_layers=jnp.asarray(layers, jnp.int32),
        probe_weights=jnp.asarray(weights, dtype),
    )
    driven = replace(setup, scheme=scheme, source_layer=part.sources[port])
    band = float(part.frequency[0]), float(part.frequency[-1])
    most = CHECKS * ceil(longest / setup.time_step / CHECKS)
    click = _click(setup, band, most)
    state, records, loudest = setup.state, [], 0.0
    for begin in range(0, most, CHECKS):
        state, pressure = march(driven, state, click[begin : begin + CHECKS])
        records.append(pressure)
        progress((begin + CHECKS) / most)
        level = float(np.abs(pressure).max())
        loudest = max(loudest, level)
        if begin > 0 and level < QUIET * loudest:
            break
    heard = np.concatenate(records, axis=1)
    n = heard.shape[1]
    omega = 2 * pi * part.frequency * setup.time_step
    both = np.stack([_spectrum(heard, omega, end) for end in (n, 3 * n // 4)])
    return both.reshape(2, len(part.frequency), 2, 2, m), n


def _spectrum(signals: Array, omega: Array, end: int) -> Complex:
    """Return the spectra (n_frequencies, n_signals) of signals (n_signals, n) up to a sample.

    Their last third is faded out: what still rings at a cut-on would spread over all frequencies if
    it were cut.
    """
    fade = np.clip((end - np.arange(end)) / (end / 3), 0.0, 1.0)
    faded = signals[:, :end] * (0.5 - 0.5 * np.cos(pi * fade))
    total = np.zeros((len(omega), len(signals)), complex)
    for begin in range(0, end, CHECKS):
        times = np.arange(begin, min(begin + CHECKS, end))
        total += np.exp(-1j * np.outer(omega, times)) @ faded[:, begin : begin + CHECKS].T
    return total


def _coefficients(part: _Part, heard: Complex, reference: tuple[float, float]) -> Complex:
    """Return S from what the probes hear in each run.

    Parameters
    ----------
    part : _Part
    heard : ndarray
        (n_frequencies, port, layer, mode, port driven, mode driven).
    reference : tuple of float
        In m.

    Returns
    -------
    ndarray
        (n_frequencies, port_out, mode_out, port_in, mode_in); zero where a mode does not propagate.
    """
    way: Phases = part.phases
    n, m = way.theta.shape
    apart = np.exp(-1j * APART * way.theta)[:, :, None, None]
    root = np.sqrt(np.where(part.travels, way.power, 0.0))[:, :, None, None]
    inwards, outwards = np.zeros((2, n, 2, m, 2, m), complex)
    for port in (0, 1):
        outer, inner = heard[:, port, 0], heard[:, port, 1]
        # outer = a + b and inner = a q + b / q, with a inwards and b outwards at the outer probes.
        a = (inner - outer / apart) / (apart - 1 / apart)
        b = (outer * apart - inner) / (apart - 1 / apart)
        path = INWARDS[port] * (reference[port] - part.height(part.probes[port][0])) / part.spacing
        to_plane = np.exp(-1j * path * np.where(part.travels, way.theta, 0.0))[:, :, None, None]
        inwards[:, port], outwards[:, port] = a * to_plane * root, b / to_plane * root
    return _quotient(outwards.reshape(n, 2 * m, -1), inwards.reshape(n, 2 * m, -1), part).reshape(
        n, 2, m, 2, m
    )


def _quotient(out: Complex, into: Complex, part: _Part) -> Complex:
    """Return S of out = S into, over the modes that propagate and the runs that drive these."""
    found = np.zeros_like(out)
    travels = np.tile(part.travels, (1, 2))
    for pattern in np.unique(travels, axis=0):
        rows, there = np.flatnonzero((travels == pattern).all(axis=1)), np.flatnonzero(pattern)
        block = np.ix_(rows, there, there)
        # S into = out, by its transpose.
        solved = np.linalg.solve(into[block].swapaxes(1, 2), out[block].swapaxes(1, 2))
        found[block] = solved.swapaxes(1, 2)
    return found
