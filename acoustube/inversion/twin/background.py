"""Ring-down, far end, clutter and noise of a sensor whose response to an echo is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import exp, pi

import numpy as np
from numpy.typing import NDArray

from acoustube.base.checks import LENGTH, Optional, Several, checked
from acoustube.base.types import Array
from acoustube.inversion.folded import RING_DOWN_OVERSAMPLING
from acoustube.inversion.twin.estimate import DITHERED, Twin
from acoustube.inversion.twin.fit import SPEED
from acoustube.inversion.twin.model import (
    LOCAL,
    NOMINAL_FREQUENCY,
    NOMINAL_RADIUS,
    SHARED,
    square_burst,
    wavenumbers,
)
from acoustube.inversion.twin.recorded import QUIET_SHARE, Band, Group, Means
from acoustube.ranging.analogue import MEASURED_SPACING
from acoustube.waves.scattering import Complex

SPACING = MEASURED_SPACING
"""Spacing in m of the reflectors that represent the clutter."""
DENSITIES = np.geomspace(1e-8, 1e-2, 25)
"""Grid in 1/m of the power that the clutter reflects per length. Its estimate is the mean over this
grid, weighted by the likelihood."""
RING_SHARE = 1.5e-3
"""Duration in s, from the first data that are used, over which the ring-down's level is fitted."""
DETECTED = 6.0
"""Level of the far end's echo above which it is detected, in standard deviations of noise and
clutter."""
AROUND_END = 0.04
"""Length in m before the far end in which no clutter is estimated. Echoes from within twice this
length of the far end do not count for the level of noise and clutter."""
AROUND, FINEST = 0.5, 2e-3
"""Length in m of tube, at either side of the part in which the far end is sought, whose echoes also
count for the level of noise and clutter. Least length in m of that part, if the length of the tube
is stated."""
ROUNDING, HIDDEN = 1 / 12, 0.1
"""Variance of the rounding error in counts squared. Standard deviation in counts of an estimate of
noise that is below :data:`acoustube.inversion.twin.estimate.DITHERED`: the scatter of rounded
samples then depends on where the offset lies between two counts."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Estimate of a quantity, with its standard deviation.

    Attributes
    ----------
    value, deviation : float
        Estimate and standard deviation, in the unit of the quantity.
    """

    value: float
    deviation: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Background:
    """Ring-down, far end, clutter and noise of cycles, in counts unless stated otherwise.

    Attributes
    ----------
    send : Measured
        Amplitude at which the rangefinder receives its own drive, in steady state at resonance.
    far_reflection : Measured
        Reflection coefficient of the far end; 0 where no echo of it is received.
    length : Measured or None
        Distance of the far end in m; None where no echo of it is received.
    places, reflectivity : ndarray
        Clutter: distances of reflectors in m, and their reflection coefficients, (n_z,).
    clutter : Measured
        Power that the clutter reflects per length, in 1/m.
    noise : Measured
        Standard deviation of the noise of a sample, without rounding.
    offset, drift : Measured
        Mean of the cycles' offsets, and their standard deviation from cycle to cycle.
    jitter : Measured
        Standard deviation of the time of the trigger in s.
    wander : Measured
        Relative standard deviation of the gain from cycle to cycle.
    explained : ndarray
        Part of the baseband of the untouched cycles that ring-down, far end and clutter explain,
        (n_t,).
    recorded : ndarray
        Baseband of the untouched cycles, (n_t,).
    """

    send: Measured
    far_reflection: Measured
    length: Measured | None
    places: Array
    reflectivity: Array
    clutter: Measured
    noise: Measured
    offset: Measured
    drift: Measured
    jitter: Measured
    wander: Measured
    explained: Complex
    recorded: Complex


@checked(twin=Twin, untouched=Group, closed=Several(Group), length=Optional(LENGTH))
def fit_background(
    twin: Twin, untouched: Group, closed: Sequence[Group], length: float | None = None
) -> Background:
    """Return ring-down, far end, clutter and noise of the sensor of a twin.

    Parameters
    ----------
    twin : Twin
        Fit of the same recordings.
    untouched : Group
        Cycles without contact.
    closed : sequence of Group
        Cycles of the closures.
    length : float, optional
        Length of the tube in m, near which the far end is sought.

    Notes
    -----
    The level of the ring-down is fitted by least squares. The far end is then estimated from the
    correlation with its modelled echo, and the clutter by a Wiener filter: its reflectors along the
    tube have a Gaussian prior, with the posterior mean of their power per length.
    """
    band = twin.band
    received = band.baseband(twin.untouched.spectrum)
    used = (band.time >= band.first) & (band.time <= band.last)
    ring = band.baseband(ring_down(twin))
    early = used & (band.time < band.first + RING_SHARE)
    power = float(np.sum(np.abs(ring[early]) ** 2))
    level = complex(np.sum(received[early] * ring[early].conj()) / power) if power > 0 else 0j
    left = received - level * ring
    reach = 0.5 * SPEED * band.last - 0.1
    far, end = _far_end(twin, left, used, length, reach, untouched.temperature)
    last = end.value if end is not None else min(length or reach, reach)
    if end is not None:
        left = left - far.value * _templates(twin, np.array([end.value]), untouched.temperature)[0]
    places = np.arange(0.5 * SPACING, max(last - AROUND_END, 0.1), SPACING)
    reflectors, density, explained = _clutter(twin, left, used, places, untouched.temperature)
    noise = float(np.mean(np.abs(left - explained)[early] ** 2))
    clutter_share = np.sqrt(noise / max(power, 1e-300))
    known = level * ring + explained
    if end is not None:
        known = known + received - level * ring - left
    return Background(
        send=Measured(value=abs(level), deviation=float(clutter_share) + 0.01 * abs(level)),
        far_reflection=far, length=end, places=places, reflectivity=reflectors, clutter=density,
        explained=np.where(used, known, 0), recorded=np.where(used, received, 0),
        **_variations(untouched, closed, [twin.untouched, *twin.means], band.carrier),
    )  # fmt: skip


def ring_down(twin: Twin) -> Complex:
    """Return the spectrum (n_f,) in s of a ring-down of amplitude 1, faded in as cycles are."""
    band: Band = twin.band
    shared = dict(zip(SHARED, twin.point.shared.tolist(), strict=True))
    n = 2 * band.n_samples
    oversampled = RING_DOWN_OVERSAMPLING if band.folded else 1
    f = np.arange(1, oversampled * n // 2) * band.rate / n
    resonance, quality = (
        NOMINAL_FREQUENCY * exp(shared["log_resonance"]),
        exp(shared["log_quality"]),
    )
    tuned = 1 / (1 + 1j * quality * (f / resonance - resonance / f))
    carrier = NOMINAL_FREQUENCY * exp(shared["log_drive_frequency"])
    spectrum = square_burst(f, carrier, shared["drive_cycles"])[0] * tuned
    spectrum = spectrum * np.exp(-2j * pi * f * (shared["trigger"] - band.start))
    full = np.concatenate([[0], spectrum, [0]])
    samples = np.fft.irfft(full, oversampled * n)[::oversampled][: band.n_samples]
    return band.spectra(samples * oversampled * band.rate)


def _templates(twin: Twin, places: Array, temperature: float) -> Complex:
    """Return the basebands in counts of complete reflections at places (n,) in m, (n, n_t).

    Repetitions of these echoes by the face are left out. The reported temperature is in degC.
    """
    band, model = twin.band, twin.model
    shared = twin.point.shared.copy()
    for name in ("face_real", "face_imag"):
        shared[SHARED.index(name)] = 0.0
    zero = replace(model, places=np.zeros(1), temperatures=np.array([temperature]))
    radius = NOMINAL_RADIUS * exp(shared[SHARED.index("log_radius")])
    air = temperature + shared[SHARED.index("temperature_offset")]
    gradient = shared[SHARED.index("temperature_gradient")]
    total: Complex = np.zeros((len(places), len(band.frequency)), complex)
    for f, image in ((band.frequency, False), (band.image, True))[: 1 + band.folded]:
        pulse = zero._spectra(f, shared, np.zeros((1, len(LOCAL))), slopes=False)[0][0]
        waves = wavenumbers(f, radius, air, model.humidity)
        lever = places**2 / 2 - model.middle * places
        phase = np.outer(places, waves.value) + gradient * np.outer(lever, waves.by_temperature)
        echo = pulse * np.exp(-2j * phase)
        total = total + (echo.conj() if image else echo)
    return band.baseband(total)


def _far_end(
    twin: Twin,
    left: Complex,
    used: NDArray[np.bool_],
    length: float | None,
    reach: float,
    temperature: float,
) -> tuple[Measured, Measured | None]:
    """Return the far end's reflection coefficient, and its distance in m if its echo is detected.

    The echo is sought in `left`, the baseband without the ring-down, (n_t,): within 3 % of a stated
    `length` in m, or else between the farthest closure and `reach` in m.
    """
    heard = 0.5 * SPEED * twin.band.first
    farthest = float(twin.model.places.max())
    low, high = (0.97 * length, 1.03 * length) if length else (farthest + 0.02, reach)
    low, high = max(low, heard), min(high, reach)
    if not high > low + (FINEST if length else 0.05):
        return Measured(value=0.0, deviation=1.0), None
    # Most of the places are away from the far end: they give the level of the noise.
    places = np.arange(max(low - AROUND, heard), min(high + AROUND, reach), 0.5e-3)
    shapes = np.where(used, _templates(twin, places, temperature), 0)
    energy = np.maximum(np.sum(np.abs(shapes) ** 2, axis=1), 1e-300)
    level = shapes.conj() @ np.where(used, left, 0) / energy
    sought = np.flatnonzero((places >= low) & (places <= high))
    best = int(sought[np.argmax((np.abs(level) * np.sqrt(energy))[sought])])
    away = np.abs(places - places[best]) > 2 * AROUND_END
    others = np.abs(level[away]) if away.sum() > 20 else np.abs(level)
    spread = max(
        float(np.median(others)) / 1.18, float(np.sqrt(twin.untouched.variance / energy[best]))
    )
    if abs(level[best]) < DETECTED * spread or best in sought[[0, -1]]:
        return Measured(value=0.0, deviation=spread), None
    wave = 2 * pi * twin.band.carrier / SPEED
    place = places[best] - float(np.angle(level[best])) / (2 * wave)
    sure = np.hypot(0.002, 0.00175 * place * twin.deviation("temperature_offset"))
    far = Measured(value=min(float(abs(level[best])), 1.0), deviation=float(spread))
    return far, Measured(value=float(place), deviation=float(sure))


def _clutter(
    twin: Twin, left: Complex, used: NDArray[np.bool_], places: Array, temperature: float
) -> tuple[Array, Measured, Complex]:
    """Return the clutter: reflection coefficients (n_z,), power in 1/m, and baseband (n_t,).

    `left` is the baseband of the untouched cycles without ring-down and far end, in counts, (n_t,).
    """
    shapes = _templates(twin, places, temperature).T
    inside = shapes[used]
    # Reflectors are real: the real and the imaginary part of the baseband are both data.
    design = np.concatenate([inside.real, inside.imag]) * np.sqrt(SPACING)
    target = np.concatenate([left[used].real, left[used].imag])
    values, vectors = np.linalg.eigh(design @ design.T)
    rotated, values = vectors.T @ target, np.maximum(values, 0)
    noise = twin.untouched.variance / 2
    scores = np.array([
        -0.5 * np.sum(rotated**2 / (d * values + noise) + np.log(d * values + noise))
        for d in DENSITIES
    ])  # fmt: skip
    share = np.exp(scores - scores.max())
    share /= share.sum()
    density = float(share @ DENSITIES)
    # The grid is coarse relative to the posterior, since there are many degrees of freedom.
    deviation = max(float(np.sqrt(share @ (DENSITIES - density) ** 2)), 0.15 * density)
    strength = density * design.T @ (vectors @ (rotated / (density * values + noise)))
    reflectors = strength * np.sqrt(SPACING)
    return reflectors, Measured(value=density, deviation=deviation), shapes @ reflectors


def _variations(
    untouched: Group, closed: Sequence[Group], means: Sequence[Means], carrier: float
) -> dict[str, Measured]:
    """Return noise, offset, drift, jitter and wander, as described in :class:`Background`."""
    groups = [untouched, *closed]
    variances, levels, count = [], [], 0
    for group in groups:
        quiet = np.asarray(group.cycles[:, -int(QUIET_SHARE * group.cycles.shape[1]) :], float)
        variances.append(quiet.var(axis=1).mean())
        levels.append(quiet.mean(axis=1))
        count += quiet.size
    variance = float(np.median(variances))
    counts = np.issubdtype(untouched.cycles.dtype, np.integer)
    if counts:
        variance = max(variance - ROUNDING, 0.1 * variance)
    noise = float(np.sqrt(variance))
    hidden = HIDDEN if counts and noise < DITHERED else 0.0
    offsets = np.concatenate(levels)
    n = len(offsets)
    drift = float(offsets.std()) if n > 1 else 0.0
    error = drift / np.sqrt(max(n, 1))
    return {
        "noise": Measured(
            value=noise, deviation=float(np.hypot(noise * np.hypot(count**-0.5, 0.1), hidden))
        ),
        "offset": Measured(value=float(offsets.mean()), deviation=float(error)),
        "drift": Measured(value=drift, deviation=float(drift / np.sqrt(2 * max(n - 1, 1)))),
        "jitter": _scatter([m.delays for m in means], means, 2 * pi * carrier),
        "wander": _scatter([m.gains for m in means], means, 1.0),
    }


def _scatter(values: Sequence[Array], means: Sequence[Means], scale: float) -> Measured:
    """Return the standard deviation of delays or gains within groups, less that due to noise.

    `scale` is 1 for gains, and for delays in s the phase per delay in rad/s. Without a group of
    more than two values the result is 0 with an infinite standard deviation.
    """
    known = [(v, m.wobble / scale**2) for v, m in zip(values, means, strict=True) if len(v) > 2]
    if not known:
        return Measured(value=0.0, deviation=float("inf"))
    freedom = sum(len(v) - 1 for v, _ in known)
    total = sum(float(np.sum((v - v.mean()) ** 2)) for v, _ in known) / freedom
    noise = sum(w * (len(v) - 1) for v, w in known) / freedom
    value = float(np.sqrt(max(total - noise, 0.0)))
    # The standard deviation of the variance is proportional to the total variance, with the noise.
    spread = total * float(np.sqrt(2 / freedom))
    deviation = float(np.sqrt(spread))
    if value > 0:
        deviation = min(deviation, spread / (2 * value))
    return Measured(value=value, deviation=max(deviation, 1e-12))
