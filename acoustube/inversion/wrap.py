"""Propagation along a wrapped tube by the modes of the bent tube, with joints at each press.

The scattering of a press is computed in a straight tube. In a wrapped tube, a part about the press
is taken as straight, the rest as bent. In a bend the straight tube's modes couple all along. The
bent tube's own modes do not (:mod:`acoustube.waves.bent_modes`): each propagates with its own
wavenumber, and modes are converted only where the tube becomes straight, at a press and at the
start of the wrap. The network of presses is therefore that of a straight tube, except for its modes
and the joints, which become part of the presses (:mod:`acoustube.inversion.joints`). Curvature and
torsion vary so slowly along the arm that the bent modes follow them (adiabatic approximation): the
phase is the integral of the wavenumber.

Three bent modes are kept, which become (0,0) and both (1,1) where the tube is straight. Modes
antisymmetric about the plane of the bend, which the torsion excites, pass a press unscattered: the
presses' matrices do not contain them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from acoustube.air import Air
from acoustube.base.checks import DISTANCE, Reals, check_alike, check_fields
from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.base.units import CM
from acoustube.inversion.joints import Joined
from acoustube.inversion.paths import BEFORE_END, Entry, Section, propagation_factor
from acoustube.inversion.tables import Matrices, padded
from acoustube.waves import Bent
from acoustube.waves.bent_modes import BentModes, bent_modes
from acoustube.waves.modes.grid_modes import wavenumbers
from acoustube.waves.scattering import Complex

MODES = 3
"""Number of modes of the bent tube that are kept."""
REACH = 0.03
"""Half length in m of the part about a press that is taken as straight: 29 mm from the middle of
a press by a 25 mm rod the lumen has 99 % of its area."""
NEARLY = 1e-3
"""Length in m by which a wrap may end beyond its tube, since stated lengths are rounded."""
STRETCH = 0.3
"""Approximate length in m over which the search for presses takes the joints as constant."""
CURVES = Reals(0, 1e6, "1/m", ndim=1)
TURNS = Reals(-1e6, 1e6, "1/m", ndim=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Wrap:
    """Curvature and torsion of a tube's centre line over its wrapped part.

    Attributes
    ----------
    place : ndarray
        Distances from the sensor in m, rising, (n,), two or more. The wrap extends from the first
        to the last; its modes are interpolated between them.
    curvature, torsion : ndarray
        Curvature and torsion of the centre line at these distances in 1/m, (n,), as in
        :class:`acoustube.waves.Bent`.
    ovality : float
        Relative decrease of the bore's radius in the plane of the bend, and increase across it.
    reach : float
        Half length in m of the straight part about a press.

    Raises
    ------
    ConfigError
        If a value is outside its range, the arrays differ in shape, or `place` does not hold two or
        more rising distances.
    """

    place: Array
    curvature: Array
    torsion: Array
    ovality: float = 0.0
    reach: float = REACH

    def __post_init__(self) -> None:
        """Check the values, and that places rise; lists become arrays."""
        check_fields(
            self, place=Reals(0, 1e3, "m", ndim=1), curvature=CURVES, torsion=TURNS,
            ovality=Reals(-1, 1, ndim=0), reach=DISTANCE,
        )  # fmt: skip
        for name in ("place", "curvature", "torsion"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), float))
        check_alike(place=self.place, curvature=self.curvature, torsion=self.torsion)
        if len(self.place) < 2 or not np.all(np.diff(self.place) > 0):
            raise ConfigError("place of a wrap must hold two or more rising distances; sort them")

    def from_other_end(self, length: float) -> Wrap:
        """Return the wrap with places measured from the other end of a tube of a length in m.

        Raises
        ------
        ConfigError
            If the wrap ends more than :data:`NEARLY` beyond the tube.
        """
        if self.stop > length + NEARLY:
            raise ConfigError(
                f"the wrap ends at {CM * self.stop:.5g} cm, beyond the tube's length of "
                f"{CM * length:.5g} cm; make length_cm {CM * self.stop:.5g} or more (length "
                f"{self.stop:.5g} m)"
            )
        return Wrap(
            place=np.maximum(length - self.place[::-1], 0.0), curvature=self.curvature[::-1],
            torsion=self.torsion[::-1], ovality=self.ovality, reach=self.reach,
        )  # fmt: skip

    @property
    def start(self) -> float:
        """Distance in m from the sensor at which the bend begins."""
        return float(self.place[0])

    @property
    def stop(self) -> float:
        """Distance in m from the sensor at which the bend ends."""
        return float(self.place[-1])


class WrappedPath:
    """Propagation along a wrapped tube.

    Parameters
    ----------
    wrap : Wrap
    air : Air
    frequency : ndarray
        Frequencies in Hz, evenly spaced, (n_f,). With a negative imaginary part, spectra are those
        of signals times a decaying exponential.
    radius : float
        Radius of the bore in m.
    modes : tuple of str
        Names of the m_s modes of the presses' matrices, the plane mode first.
    k, by_temperature : ndarray
        Axial wavenumbers of these modes in the straight tube in 1/m, and their derivatives in
        1/(m K), (n_f, m_s).
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
        frequency: Array | Complex,
        radius: float,
        modes: tuple[str, ...],
        k: Complex,
        by_temperature: Complex,
        heat: float,
    ) -> None:
        missing = ((0, 0), (0, MODES - k.shape[1]))
        self.wrap, self.k, self.by_temperature = (
            wrap, np.pad(k, missing), np.pad(by_temperature, missing),
        )  # fmt: skip
        self.frequency, self.speed = frequency, air.sound_speed
        own = tuple(f"{name[:-1]}s" for name in modes if name.endswith("c"))
        nodes = _bent(wrap, air, frequency, radius, (*modes, *own))
        beta = np.stack([one.wavenumber for one in nodes])
        slope = np.gradient(beta, frequency, axis=1, edge_order=2)
        warmer = -heat * frequency[:, None] * slope
        self.wavenumber = CubicSpline(wrap.place, beta)
        self.phase = self.wavenumber.antiderivative()
        self.warmer = CubicSpline(wrap.place, warmer).antiderivative()
        self.plane_wave = CubicSpline(wrap.place, np.stack([beta[..., 0], warmer[..., 0]], axis=1))
        joints = np.stack([_joint(one, len(modes)) for one in nodes])
        self.joints = CubicSpline(wrap.place, joints)
        # The antisymmetric modes pass a press unscattered, over twice the reach.
        self.own_k = (
            wavenumbers(own, frequency, radius, air, lossy=True)
            if own
            else np.zeros((len(frequency), 0), complex)
        )
        self.own_heat = (
            -heat * frequency[:, None] * np.gradient(self.own_k, frequency, axis=0, edge_order=2)
        )

    def span(self, nearest: float, length: float) -> tuple[float, float]:
        """Return the range of places in m where presses are sought: on the wrap.

        The parameters are those of :meth:`acoustube.inversion.paths.Path.span`.

        Raises
        ------
        ConfigError
            If the wrap has no place for a press beyond the nearest.
        """
        wrap = self.wrap
        low = max(nearest, wrap.start + wrap.reach)
        high = min(wrap.stop - wrap.reach, length - BEFORE_END)
        if not high > low:
            raise ConfigError(
                f"the wrap from {wrap.start:.3g} to {wrap.stop:.3g} m has no place for a press "
                f"beyond {low:.3g} m, the nearest that can be located, on a tube of {length:.3g} "
                "m; check lead and loops of the sleeve, and the length of the tube"
            )
        return low, high

    def entry(self, temperature: Array) -> Entry:
        """Return the propagation from face to wrap, at temperature deviations (n,) in K."""
        # Antisymmetric modes are included, since the face reflects them.
        k = np.concatenate([self.k, self.own_k], axis=1)
        by_temperature = np.concatenate([self.by_temperature, self.own_heat], axis=1)
        path = np.exp(-1j * (k + temperature[:, None, None] * by_temperature) * self.wrap.start)
        passed, _ = self.joint(self.wrap.start)
        matrix = passed.swapaxes(-1, -2) * path[..., None, :]
        return Entry(np.asarray(matrix), np.asarray(self.wrap.start * by_temperature, complex))

    def joint(self, place: float) -> tuple[Complex, Complex]:
        """Return transmission and reflection of the m bent modes at a joint, at a place in m.

        Returns
        -------
        passed : ndarray
            Transmission to m_s straight modes: three symmetric ones, of which some may be missing
            and zero, then the antisymmetric ones; (n_f, m_s, m).
        reflected : ndarray
            Reflection between the bent modes, (n_f, m, m).
        """
        parts = self.joints(place).reshape(len(self.k), -1, MODES)
        passed = np.concatenate([parts[:, :MODES], parts[:, 3 * MODES :]], axis=1)
        return passed, parts[:, 2 * MODES : 3 * MODES]

    def sections(self, places: Array, temperature: Array) -> list[Section]:
        """Return the sections before presses at places (n, n_presses) in m.

        `temperature` holds deviations in K, (n,). A section ends where the straight part about a
        press begins.
        """
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

    def joined(self, matrices: Matrices, place: Array, temperature: Array) -> Joined:
        """Return the scattering of presses, with their joints, between the modes of the bent tube.

        `matrices` are those of the presses in a straight tube, at places (n,) in m; `temperature`
        holds deviations in K, (n,).
        """
        reach, warm = self.wrap.reach, temperature[:, None, None]
        ports = self._inside(place - reach), self._inside(place + reach)
        joints, moved = (np.stack([self.joints(at, order) for at in ports]) for order in (0, 1))
        bent, heat = self.plane_wave(place).swapaxes(0, 1)
        return Joined(
            straight=Matrices(*(padded(part, MODES) for part in matrices)),
            joints=joints, moved=moved,
            way=np.exp(-1j * reach * (self.k + warm * self.by_temperature)),
            warm=-1j * reach * self.by_temperature,
            through=-np.exp(-2j * reach * (self.own_k + warm * self.own_heat)),
            through_warm=-2j * reach * self.own_heat,
            untouched=np.exp(-2j * reach * (bent + temperature[:, None] * heat)),
        )  # fmt: skip

    def phases(self, places: Array, temperature: float, *, behind: bool = False) -> Complex:
        """Return the modes' complex phases in rad from the wrap's start to presses, (n, n_f, m).

        Parameters
        ----------
        places : ndarray
            Middles of the presses in m, (n,).
        temperature : float
            Deviation of the temperature in K.
        behind : bool
            Whether the phases end behind the straight part about each press instead of before it.
        """
        reach = self.wrap.reach
        at = self._inside(places + (reach if behind else -reach))
        return np.asarray(self.phase(at) + temperature * self.warmer(at))

    def propagated(self, origin: float, places: Array, temperature: float, modes: int) -> Complex:
        """Return some modes' factors from behind a press at `origin` to places (n,).

        Their shape is (n, modes, n_f).
        """
        start = self.phases(np.array([origin]), temperature, behind=True)
        passed = self.phases(places, temperature) - start
        return propagation_factor(np.ascontiguousarray(passed.swapaxes(1, 2)[:, :modes]))

    def plane(self, places: Array) -> tuple[Complex, Complex]:
        """Return the plane wave's phases from the face in rad, and changes in rad/K, (n_f, n)."""
        inside = self._inside(places)
        straight = np.where(places < self.wrap.start, places, self.wrap.start + places - inside)
        value, warmer = (
            np.outer(wave[:, 0], straight) + table(inside)[..., 0].T
            for wave, table in ((self.k, self.phase), (self.by_temperature, self.warmer))
        )
        return value, warmer

    def place_at(self, time: Array) -> Array:
        """Return the distances in m of reflectors from the delays in s of plane-wave echoes."""
        farthest = 0.5 * self.speed * float(np.max(time))
        places = np.linspace(0.0, max(farthest, self.wrap.stop), 200)
        middle = len(self.frequency) // 2
        around = slice(middle - 1, middle + 2)
        phase = self.plane(places)[0][around].real
        delay = 2 * np.gradient(phase, self.frequency[around], axis=0)[1] / (2 * np.pi)
        return np.interp(time, delay, places)

    def _inside(self, places: Array) -> Array:
        """Return places clipped to the wrap."""
        return np.clip(places, self.wrap.start, self.wrap.stop)


def _bent(
    wrap: Wrap, air: Air, frequency: Array | Complex, radius: float, modes: tuple[str, ...]
) -> list[BentModes]:
    """Return the bent tube's modes at each place of a wrap, in the same order at all places."""
    found: list[BentModes] = []
    for curvature, torsion in zip(wrap.curvature, wrap.torsion, strict=True):
        part = Bent(length=1.0, curvature=float(curvature), torsion=float(torsion),
                    ovality=float(wrap.ovality))  # fmt: skip
        one = bent_modes(air, frequency, part, radius=radius, modes=modes, count=MODES)
        found.append(one.aligned(found[-1]) if found else one)
    return found


def _joint(bent: BentModes, m: int) -> Complex:
    """Return the coefficients of a joint between the bent tube and a press with m modes.

    Returns
    -------
    ndarray
        Transmission, reflection back to the press, reflection back into the bend, and transmission
        of the modes that the press's matrix lacks, one after the other, (n_f, n_parts).
    """
    n, missing = len(bent.wavenumber), (0, MODES - m)
    parts = (
        np.pad(bent.passed[:, :m], ((0, 0), missing, (0, 0))),
        np.pad(bent.returned[:, :m, :m], ((0, 0), missing, missing)),
        bent.reflected,
        bent.passed[:, m:],
    )
    return np.concatenate([part.reshape(n, -1) for part in parts], axis=1)
