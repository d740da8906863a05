"""Echoes of closures of a tube in a rangefinder's band, with derivatives by all parameters.

References
----------
* Plane mode of a narrow duct: :func:`acoustube.waves.modes.axial_wavenumber`.
* Rangefinder: :func:`acoustube.ranging.response`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import exp, pi
from typing import NamedTuple

import numpy as np

from acoustube.air import TEMPERATURES, Air, air_at
from acoustube.base.types import Array
from acoustube.inversion.twin.recorded import Band
from acoustube.ranging.analogue import anti_alias
from acoustube.waves.modes import axial_wavenumber
from acoustube.waves.scattering import Complex

SHARED = (
    "log_radius", "temperature_offset", "temperature_gradient", "log_loss", "log_resonance",
    "log_quality", "log_drive_frequency", "drive_cycles", "log_gain", "trigger", "face_real",
    "face_imag", "level_1", "level_2", "level_3", "phase_2", "phase_3",
)  # fmt: skip
"""Parameters of the sensor. Names with ``log_`` are natural logarithms: of the bore's radius over
`NOMINAL_RADIUS`, of resonance and drive frequency over `NOMINAL_FREQUENCY`, of the quality factor,
of the gain in counts, and of the losses over those of a smooth wall. The temperature's offset is in
K and its gradient along the tube in K/m, the trigger's delay in s, the drive's length in periods.
``face`` is the reflection coefficient of the face. ``level_k`` and ``phase_k`` are the real and the
imaginary part of the coefficient of x^k in the logarithm of the send pulse's spectrum, with x from
-1 to 1 over the band."""
LOCAL = ("displacement", "log_level", "phase")
"""Parameters of each closure: its distance in m beyond the stated one, logarithm of the level of
its echo, and phase of its echo in rad."""
CORRECTIONS = tuple(SHARED.index(name) for name in SHARED if name[-1] in "123")
"""Indices of the coefficients ``level_k`` and ``phase_k`` in :data:`SHARED`."""
NOMINAL_RADIUS, NOMINAL_FREQUENCY = 3.95e-3, 42e3
"""Radius of the bore in m and frequency in Hz to which the logarithms are relative."""
WARMER = 1.0
"""Step in K of the finite differences by temperature."""
RADIUS_STEP = 1e-4
"""Step of the finite differences by the logarithm of the radius."""
NODES = 12
"""Number of frequencies at which wavenumbers are computed."""


class Echoes(NamedTuple):
    """Echoes of closures in the baseband, and their derivatives.

    Attributes
    ----------
    value : ndarray
        Baseband in counts, (n, n_t).
    by_shared : ndarray
        Derivatives by the parameters of the sensor, (n, n_shared, n_t).
    by_local : ndarray
        Derivatives by the parameters of the closure, (n, n_local, n_t).
    """

    value: Complex
    by_shared: Complex
    by_local: Complex


class Waves(NamedTuple):
    """Axial wavenumber in 1/m at a temperature, its derivatives, and its lossless part, (n_f,).

    `curvature` is the second derivative by temperature, `mixed` that by temperature and log radius.
    Derivatives by temperature are per K.
    """

    value: Complex
    by_log_radius: Complex
    by_temperature: Complex
    curvature: Complex
    mixed: Complex
    lossless: Complex


@dataclass(frozen=True, eq=False)
class EchoModel:
    """Forward model of the echoes of closures.

    Attributes
    ----------
    band : Band
    places, temperatures : ndarray
        Stated distances in m, and reported temperatures in degC, (n,).
    middle : float
        Distance in m at which the temperature along the tube has its mean.
    filtered : bool
        Whether the recorder's anti-alias filter is included.
    humidity : float or None
        Relative humidity in per cent for the speed of sound in moist air; None for dry air.
    """

    band: Band
    places: Array
    temperatures: Array
    middle: float
    filtered: bool = True
    humidity: float | None = None

    def __call__(self, shared: Array, local: Array) -> Echoes:
        """Return the echoes for parameters `shared`, (n_shared,), and `local`, (n, n_local)."""
        return Echoes(*self._basebands(shared, local, slopes=True))

    def value(self, shared: Array, local: Array) -> Complex:
        """Return the echoes without their derivatives, (n, n_t), in a third of the time."""
        return self._basebands(shared, local, slopes=False)[0]

    def _basebands(self, shared: Array, local: Array, *, slopes: bool) -> tuple[Complex, ...]:
        band = self.band
        parts = self._spectra(band.frequency, shared, local, slopes)
        if band.folded:
            images = self._spectra(band.image, shared, local, slopes)
            parts = tuple(a + b.conj() for a, b in zip(parts, images, strict=True))
        return tuple(band.baseband(part) for part in parts)

    def _spectra(
        self, f: Array, shared: Array, local: Array, slopes: bool = True
    ) -> tuple[Complex, ...]:
        """Return spectra of the echoes in counts s, (n, n_f), at frequencies `f` in Hz, (n_f,).

        With `slopes` they are followed by their derivatives, (n, n_shared, n_f) and
        (n, n_local, n_f).
        """
        p = dict(zip(SHARED, shared.tolist(), strict=True))
        drive, by_drive, by_cycles = square_burst(
            f, NOMINAL_FREQUENCY * exp(p["log_drive_frequency"]), p["drive_cycles"]
        )
        resonance, quality = NOMINAL_FREQUENCY * exp(p["log_resonance"]), exp(p["log_quality"])
        off = f / resonance - resonance / f
        tuned = 1 / (1 + 1j * quality * off)
        x = (f - self.band.carrier) / (self.band.frequency[-1] - self.band.carrier)
        level = p["level_1"] * x + p["level_2"] * x**2 + p["level_3"] * x**3
        phase = p["phase_2"] * x**2 + p["phase_3"] * x**3
        late = exp(p["log_gain"]) * np.exp(level + 1j * phase - 2j * pi * f * p["trigger"])
        common = late * tuned**2 * (anti_alias(f, self.band.rate) if self.filtered else 1.0)
        path, by_path = self._path(f, p, local[:, 0])
        face = p["face_real"] + 1j * p["face_imag"]
        there = np.exp(-1j * path)
        bounced = 1 / (1 - face * there)
        closures = np.exp(local[:, 1] + 1j * local[:, 2])[:, None]
        rest = closures * there * bounced
        value = common * drive * rest
        if not slopes:
            return (value,)
        # Derivatives of the logarithm, except those by the drive, whose spectrum has zeros.
        moved = -1j * bounced
        by_shared = np.zeros((len(self.places), len(SHARED), len(f)), complex)
        of_log: dict[str, Complex | Array | complex] = {
            "log_resonance": 2 * tuned * 1j * quality * (f / resonance + resonance / f),
            "log_quality": -2 * tuned * 1j * quality * off,
            "log_gain": 1.0, "trigger": -2j * pi * f,
            "face_real": there * bounced, "face_imag": 1j * there * bounced,
            "level_1": x, "level_2": x**2, "level_3": x**3,
            "phase_2": 1j * x**2, "phase_3": 1j * x**3,
        }  # fmt: skip
        of_log |= {name: moved * slope for name, slope in by_path.items() if name in p}
        for name, slope in of_log.items():
            by_shared[:, SHARED.index(name)] = value * slope
        by_shared[:, SHARED.index("log_drive_frequency")] = common * by_drive * rest
        by_shared[:, SHARED.index("drive_cycles")] = common * by_cycles * rest
        by_local = np.stack([value * moved * by_path["displacement"], value, 1j * value], axis=1)
        return value, by_shared, by_local

    def _path(
        self, f: Array, p: dict[str, float], displacement: Array
    ) -> tuple[Complex, dict[str, Complex]]:
        """Return phases (n, n_f) in rad to closures and back, and derivatives by each parameter."""
        air = float(np.mean(self.temperatures)) + p["temperature_offset"]
        waves = wavenumbers(f, NOMINAL_RADIUS * exp(p["log_radius"]), air, self.humidity)
        loss = exp(p["log_loss"])
        heated = (self.temperatures - self.temperatures.mean())[:, None]
        # Taylor series about the mean temperature, of the wavenumber and of its lossless part.
        whole = waves.value + heated * waves.by_temperature + heated**2 / 2 * waves.curvature
        warmer = waves.by_temperature + heated * waves.curvature
        ratio = 1 / (air + 273.15)
        lossless = waves.lossless * (1 - heated * ratio / 2 + 3 / 8 * (heated * ratio) ** 2)
        lossless_warmer = waves.lossless * ratio * (-1 / 2 + 3 / 4 * heated * ratio)
        k = lossless + loss * (whole - lossless)
        slope = lossless_warmer + loss * (warmer - lossless_warmer)
        narrower = waves.by_log_radius + heated * waves.mixed
        way = (self.places + displacement)[:, None]
        lever = way**2 / 2 - self.middle * way
        gradient = p["temperature_gradient"]
        return 2 * (k * way + gradient * slope * lever), {
            "log_radius": 2 * loss * (narrower * way + gradient * waves.mixed * lever),
            "temperature_offset": 2 * (slope * way + gradient * waves.curvature * lever),
            "temperature_gradient": 2 * slope * lever,
            "log_loss": 2
            * loss
            * ((whole - lossless) * way + gradient * (warmer - lossless_warmer) * lever),
            "displacement": 2 * (k + gradient * slope * (way - self.middle)),
        }


def square_burst(
    frequency: Array, carrier: float, cycles: float
) -> tuple[Complex, Complex, Complex]:
    """Return the spectrum in s of a square burst of unit amplitude, and its derivatives.

    Parameters
    ----------
    frequency : ndarray
        In Hz, not zero, (n,).
    carrier, cycles : float
        Frequency of the burst in Hz, and its length in periods.

    Returns
    -------
    value, by_log_carrier, by_cycles : ndarray
        Spectrum, as :meth:`acoustube.ranging.Burst.spectrum`, and its derivatives by the logarithm
        of the carrier and by the number of periods, (n,).
    """
    omega, end = 2 * pi * frequency, cycles / carrier
    edges = np.arange(int(np.ceil(2 * cycles))) / (2 * carrier)
    steps = np.where(np.arange(len(edges)) % 2, -2.0, 2.0)
    steps[0] = 1.0
    edges, steps = np.append(edges, end), np.append(steps, -np.sign(steps[-1]))
    # All edges but the last are half periods apart: powers are ten times faster than exponentials.
    turns = np.empty((len(omega), len(edges)), complex)
    turns[:, :-1] = np.exp(-0.5j / carrier * omega)[:, None]
    turns[:, 0] = 1.0
    np.cumprod(turns[:, :-1], axis=1, out=turns[:, :-1])
    turns[:, -1] = np.exp(-1j * end * omega)
    return (
        turns @ steps / (1j * omega),
        np.asarray(turns @ (steps * edges), complex),
        -steps[-1] / carrier * turns[:, -1],
    )


def wavenumbers(
    frequency: Array, radius: float, temperature: float, humidity: float | None = None
) -> Waves:
    """Return the plane mode's wavenumber and its derivatives, by central differences.

    Parameters
    ----------
    frequency : ndarray
        Frequencies in Hz, (n,).
    radius : float
        Radius of the bore in m.
    temperature : float
        Temperature of the air in degC. It is limited to the range of :func:`acoustube.air.air_at`
        less 1 K at both ends.
    humidity : float, optional
        Relative humidity of moist air in per cent; dry air by default.

    Notes
    -----
    They are computed at Chebyshev points and interpolated by a polynomial of 12 terms, which
    converges to 1e-12 in a band from 0.8 to 1.2 of the carrier frequency.
    """
    low, high = float(frequency.min()), float(frequency.max())
    nodes = _at_nodes(low, high, radius, temperature, humidity)
    along = (2 * frequency - low - high) / (high - low)
    return Waves(*(np.polynomial.chebyshev.chebvander(along, NODES - 1) @ nodes).T)


@lru_cache(maxsize=32)
def _at_nodes(
    low: float, high: float, radius: float, temperature: float, humidity: float | None
) -> Complex:
    """Return Chebyshev coefficients of the fields of :class:`Waves` over a band, (n_nodes, 6)."""
    points = np.polynomial.chebyshev.chebpts1(NODES)
    frequency = (low + high + points * (high - low)) / 2
    coldest, warmest = TEMPERATURES

    def air(warmer: float) -> Air:
        there = min(max(temperature, coldest + WARMER), warmest - WARMER) + warmer
        return air_at(there) if humidity is None else air_at(there, humidity=humidity, moist=True)

    by_air = []
    for warmer in (0.0, -WARMER, WARMER):
        there = air(warmer)
        by_air.append([
            axial_wavenumber(0, 0, frequency, radius * exp(d), there)
            for d in (-RADIUS_STEP, 0.0, RADIUS_STEP)
        ])  # fmt: skip
    across = [(wide - narrow) / (2 * RADIUS_STEP) for narrow, _, wide in by_air]
    here, low_k, high_k = (one[1] for one in by_air)
    values = np.stack([
        here, across[0], (high_k - low_k) / (2 * WARMER), (high_k - 2 * here + low_k) / WARMER**2,
        (across[2] - across[1]) / (2 * WARMER), 2 * pi * frequency / air(0.0).sound_speed,
    ], axis=1)  # fmt: skip
    vander = np.polynomial.chebyshev.chebvander(points, NODES - 1)
    return np.asarray(np.linalg.solve(vander, values))
