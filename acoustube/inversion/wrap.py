"""Propagation along a wrapped tube by the modes of the bent tube, with joints at each press.

The scattering of a press is computed in a straight tube. In a wrapped one a part about the press is
taken as straight, the rest as bent. In a bend the straight tube's modes couple all along; the bent
tube's own modes do not (:mod:`acoustube.waves.bent_modes`): each propagates with its own
wavenumber, and sound is converted only where the tube becomes straight, at a press and at the start
of the wrap. So the network of presses is that of a straight tube, but for its modes and the joints,
which become part of the presses' matrices. Curvature and torsion vary along the arm, so slowly that
the bent modes follow them (the adiabatic approximation): the phase is the integral of the
wavenumber.

The bent modes kept are three, which become (0,0) and both (1,1) where the tube is straight. Modes
antisymmetric about the plane of the bend, which the torsion excites, pass a press as if it were not
there: the presses' matrices do not have them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from acoustube.air import Air
from acoustube.base.checks import DISTANCE, Reals, check_alike, check_fields
from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.inversion.paths import Entry, Section
from acoustube.inversion.tables import Matrices
from acoustube.waves import Bent
from acoustube.waves.bent_modes import BentModes, bent_modes
from acoustube.waves.modes import axial_wavenumber
from acoustube.waves.modes.grid_modes import mode_numbers
from acoustube.waves.scattering import Complex

MODES = 3
"""Modes of the bent tube that are kept."""
REACH = 0.03
"""Half length in m of the straight part about a press: 29 mm from a 25 mm rod the lumen has 99 % of
its area."""
STRETCH = 0.3
"""Length in m over which templates take the joints as constant."""
CURVES = Reals(0, 1e6, "1/m", ndim=1)
TURNS = Reals(-1e6, 1e6, "1/m", ndim=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Wrap:
    """Curvature of a tube's centre line, from where it begins to be wrapped to where it ends.

    Attributes
    ----------
    place : ndarray
        Rising distances from the sensor in m, (n,), two or more: the wrap is from the first to the
        last, and curvature and torsion are interpolated between.
    curvature, torsion : ndarray
        As of :class:`acoustube.waves.Bent`, in 1/m, (n,).
    ovality : float
        As of :class:`acoustube.waves.Bent`.
    reach : float
        Half length in m of the straight part about a press.
    """

    place: Array
    curvature: Array
    torsion: Array
    ovality: float = 0.0
    reach: float = REACH

    def __post_init__(self) -> None:
        """Check the values, and that places rise."""
        check_fields(
            self, place=Reals(0, 1e3, "m", ndim=1), curvature=CURVES, torsion=TURNS,
            ovality=Reals(-1, 1, ndim=0), reach=DISTANCE,
        )  # fmt: skip
        check_alike(place=self.place, curvature=self.curvature, torsion=self.torsion)
        if len(self.place) < 2 or not np.all(np.diff(self.place) > 0):
            raise ConfigError("place of a wrap must hold two or more rising distances; sort them")

    @property
    def start(self) -> float:
        """Distance in m from which on the tube is bent."""
        return float(self.place[0])

    @property
    def stop(self) -> float:
        """Distance in m up to which it is bent."""
        return float(self.place[-1])


class WrappedPath:
    """Propagation along a wrapped tube.

    Parameters
    ----------
    wrap : Wrap
    air : Air
    frequency : ndarray
        Even, in Hz, (n_f,).
    radius : float
        Of the bore in m.
    modes : tuple of str
        Of the presses' matrices, the plane mode first.
    k, by_temperature : ndarray
        Their wavenumbers in the straight tube and derivatives, (n_f, m_s).
    heat : float
        Relative change of the speed of sound per K.
    """

    stretch = STRETCH
    modes = MODES
    converts = True

    def __init__(
        self,
        wrap: Wrap,
        air: Air,
        frequency: Array,
        radius: float,
        modes: tuple[str, ...],
        k: Complex,
        by_temperature: Complex,
        heat: float,
    ) -> None:
        self.wrap, self.k, self.by_temperature = wrap, k, by_temperature
        self.frequency, self.speed = frequency, air.sound_speed
        own = tuple(f"{name[:-1]}s" for name in modes if name.endswith("c"))
        nodes = _bent(wrap, air, frequency, radius, (*modes, *own))
        m = len(modes)
        beta = np.stack([one.wavenumber for one in nodes])
        slope = np.gradient(beta, frequency, axis=1, edge_order=2)
        warmer = -heat * frequency[:, None] * slope
        passed = np.stack([one.passed for one in nodes])
        self.wavenumber, self.joint, self.passing = (
            CubicSpline(wrap.place, part) for part in (beta, passed[:, :, :m], passed[:, :, m:])
        )
        self.phase = self.wavenumber.antiderivative()
        self.warmer = CubicSpline(wrap.place, warmer).antiderivative()
        # The antisymmetric modes pass a press unscattered, over twice the reach.
        own_k = _wavenumbers(own, frequency, radius, air)
        self.own_k, self.own_heat = (
            own_k,
            -heat * frequency[:, None] * np.gradient(own_k, frequency, axis=0, edge_order=2),
        )
        self.reflected, self.returned = (
            CubicSpline(wrap.place, np.stack(part))
            for part in zip(
                *((one.reflected, one.returned[:, :m, :m]) for one in nodes), strict=True
            )
        )

    def span(self, nearest: float, length: float) -> tuple[float, float]:
        """Return the range of places in m where presses are sought: those on the wrap."""
        wrap = self.wrap
        low = max(nearest, wrap.start + wrap.reach)
        high = min(wrap.stop - wrap.reach, length - 0.02)
        if not high > low:
            raise ConfigError(
                f"the wrap from {wrap.start:.3g} to {wrap.stop:.3g} m has no place for a press "
                f"beyond {low:.3g} m, the nearest that can be located; check lead and loops"
            )
        return low, high

    def entry(self, temperature: Array) -> Entry:
        """Return the way to the start of the wrap."""
        k = self.k + temperature[:, None, None] * self.by_temperature
        path = np.exp(-1j * k * self.wrap.start)
        matrix = self.joint(self.wrap.start).swapaxes(-1, -2) * path[..., None, :]
        return Entry(np.asarray(matrix), self.wrap.start * self.by_temperature)

    def sections(self, places: Array, temperature: Array) -> list[Section]:
        """Return the propagation before each press, at places (n, n_presses) in m."""
        reach, found = self.wrap.reach, []
        start = np.full(len(places), self.wrap.start)
        for place in places.T:
            stop = self._inside(place - reach)
            warmer = self.warmer(stop) - self.warmer(start)
            phase = self.phase(stop) - self.phase(start) + temperature[:, None, None] * warmer
            begun, ended = (
                self.wavenumber(at) + temperature[:, None, None] * self.warmer(at, 1)
                for at in (start, stop)
            )
            found.append(Section(np.exp(-1j * phase), begun, ended, warmer))
            start = self._inside(place + reach)
        return found

    def joined(self, matrices: Matrices, place: Array, temperature: Array) -> Matrices:
        """Return the matrices of presses at places (n,) between the bent tube's modes."""
        reach = self.wrap.reach
        turn = np.exp(-1j * reach * (self.k + temperature[:, None, None] * self.by_temperature))
        ports = self._inside(place - reach), self._inside(place + reach)
        ends, moved = (
            [turn[..., None] * self.joint(at, order) for at in ports] for order in (0, 1)
        )
        warm = -1j * reach * self.by_temperature
        heated = [warm[..., None] * one for one in ends]
        # Sound that the press scatters, the joints reflect, and the press scatters once more.
        twice = turn[..., :, None] * turn[..., None, :]
        back, back_moved = (_blocks([twice * self.returned(at, i) for at in ports]) for i in (0, 1))
        back_heated = back * np.tile(warm, 2)[:, :, None] + back * np.tile(warm, 2)[:, None]
        s = _flat(matrices.value)
        before, after = back @ s, s @ back
        whole = s + s @ before
        value, by_depth, by_stretch = (
            _between(part, ends, ends)
            for part in (whole, *(
                d + d @ before + after @ d
                for d in (_flat(matrices.by_depth), _flat(matrices.by_stretch))
            ))
        )  # fmt: skip
        by_place = _between(whole, moved, ends) + _between(whole, ends, moved)
        by_place += _between(s @ back_moved @ s, ends, ends)
        by_temperature = _between(whole, heated, ends) + _between(whole, ends, heated)
        by_temperature += _between(s @ back_heated @ s, ends, ends)
        self._add_passing(value, by_place, by_temperature, ports, temperature)
        for port, at in enumerate(ports):
            value[:, :, port, :, port] += self.reflected(at)
            by_place[:, :, port, :, port] += self.reflected(at, 1)
        return Matrices(value, by_depth, by_stretch, by_place, by_temperature)

    def _add_passing(
        self, value: Complex, by_place: Complex, by_temperature: Complex,
        ports: tuple[Array, Array], temperature: Array,
    ) -> None:  # fmt: skip
        """Add the antisymmetric modes, which pass a press, to its matrices."""
        twice = 2 * self.wrap.reach
        k = self.own_k + temperature[:, None, None] * self.own_heat
        turn = -np.exp(-1j * twice * k)[..., None]
        heat = -1j * twice * self.own_heat[..., None]
        (first, last), (first_moved, last_moved) = (
            [self.passing(at, order) for at in ports] for order in (0, 1)
        )
        back = last.swapaxes(-1, -2)
        through = back @ (turn * first)
        moved = last_moved.swapaxes(-1, -2) @ (turn * first) + back @ (turn * first_moved)
        warmer = back @ (heat * turn * first)
        for part, there in ((value, through), (by_place, moved), (by_temperature, warmer)):
            part[:, :, 1, :, 0] += there
            part[:, :, 0, :, 1] += there.swapaxes(-1, -2)

    def phases(self, places: Array, temperature: float, *, behind: bool = False) -> Complex:
        """Return the phases up to presses at places (n,), or to behind them, (n, n_f, m)."""
        reach = self.wrap.reach
        at = self._inside(places + (reach if behind else -reach))
        return np.asarray(self.phase(at) + temperature * self.warmer(at))

    def plane(self, places: Array) -> tuple[Complex, Complex]:
        """Return the plane wave's phases at places (n,), and per K, (n_f, n)."""
        inside = self._inside(places)
        straight = np.where(places < self.wrap.start, places, self.wrap.start + places - inside)
        value, warmer = (
            np.outer(wave[:, 0], straight) + table(inside)[..., 0].T
            for wave, table in ((self.k, self.phase), (self.by_temperature, self.warmer))
        )
        return value, warmer

    def place_at(self, time: Array) -> Array:
        """Return the distances in m from which the plane wave is back after times in s."""
        farthest = 0.5 * self.speed * float(np.max(time))
        places = np.linspace(0.0, max(farthest, self.wrap.stop), 200)
        middle = len(self.frequency) // 2
        around = slice(middle - 1, middle + 2)
        phase = self.plane(places)[0][around].real
        delay = 2 * np.gradient(phase, self.frequency[around], axis=0)[1] / (2 * np.pi)
        return np.interp(time, delay, places)

    def _inside(self, places: Array) -> Array:
        """Return places within the wrap."""
        return np.clip(places, self.wrap.start, self.wrap.stop)


def _bent(
    wrap: Wrap, air: Air, frequency: Array, radius: float, modes: tuple[str, ...]
) -> list[BentModes]:
    """Return the bent modes at the nodes of a wrap, one after the other, in the same order."""
    found: list[BentModes] = []
    for curvature, torsion in zip(wrap.curvature, wrap.torsion, strict=True):
        part = Bent(length=1.0, curvature=float(curvature), torsion=float(torsion),
                    ovality=float(wrap.ovality))  # fmt: skip
        one = bent_modes(air, frequency, part, radius=radius, modes=modes, count=MODES)
        found.append(one.aligned(found[-1]) if found else one)
    return found


def _wavenumbers(names: tuple[str, ...], frequency: Array, radius: float, air: Air) -> Complex:
    """Return wavenumbers of modes in the straight tube, (n_f, m)."""
    if not names:
        return np.zeros((len(frequency), 0), complex)
    numbers = [mode_numbers(name) for name in names]
    return np.stack([axial_wavenumber(*one, frequency, radius, air) for one in numbers], -1)


def _flat(s: Complex) -> Complex:
    """Return matrices (n, n_f, 2, m, 2, m) as (n, n_f, 2 m, 2 m)."""
    m = s.shape[3]
    return s.reshape(*s.shape[:2], 2 * m, 2 * m)


def _blocks(ports: list[Complex]) -> Complex:
    """Return the block-diagonal matrix (n, n_f, 2 m, 2 m) of one for each port."""
    n, n_f, m, _ = ports[0].shape
    found = np.zeros((n, n_f, 2, m, 2, m), complex)
    for port, one in enumerate(ports):
        found[:, :, port, :, port] = one
    return _flat(found)


def _between(s: Complex, left: list[Complex], right: list[Complex]) -> Complex:
    """Return matrices (n, n_f, 2, m, 2, m) between other modes, with the joints on either side."""
    n, n_f, m_s, m = left[0].shape
    blocks = s.reshape(n, n_f, 2, m_s, 2, m_s)
    found = np.zeros((n, n_f, 2, m, 2, m), complex)
    for out in (0, 1):
        for into in (0, 1):
            block = blocks[:, :, out, :, into]
            found[:, :, out, :, into] = left[out].swapaxes(-1, -2) @ (block @ right[into])
    return found
