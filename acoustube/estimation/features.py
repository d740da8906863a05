"""Features of cycles for the estimators: the strongest peak, or the whole echo.

The two features of the strongest peak are those of "Wearable, Fabric-Embedded Acoustic Waveguides
for Meter-Scale Contact Localization and Force Sensing" (the sleeve paper).

The features of the whole echo are those at the press, not at the sensor: the attenuation of the
plane mode on the path there and back, in that bore and air, is compensated at each frequency. An
estimator trained on presses at one distance can therefore be applied at another. The press's echo
is selected by its level over the background: the clutter of the tube's irregularities, attenuated
as echoes are, and a constant noise.

The thresholds were chosen by hand on simulated cycles of the default rangefinder. They are part of
the definition of the features: changing one requires a new format of model files.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.signal.windows import tukey

from acoustube.air import TEMPERATURES, air_at
from acoustube.base.checks import CELSIUS, Reals, check_argument, check_fields, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Choice, Number
from acoustube.base.types import Array
from acoustube.base.units import KHZ, MS
from acoustube.signals import (
    Echoes,
    Processing,
    Ranging,
    blind_time,
    find_echoes,
    locate,
    remove_offset,
    sampling_rate,
    speed_of_sound,
    without_aliased_template,
)
from acoustube.signals.peaks import strongest_echo
from acoustube.waves.modes import axial_wavenumber

PEAK_FEATURES = ("amplitude", "distance")
"""Features of the strongest peak: amplitude relative to the send pulse, and distance in m."""
LABELS = (
    "true_distance", "depth", "force", "diameter", "press", "tube", "session", "shape",
    "lumen_area",
)  # fmt: skip
"""Names of labels of cycles: targets of the estimators, and groups of cycles."""
CYCLES_PER_CHUNK = 250
"""Number of cycles whose features are computed at once, in arrays of 8 MB of double precision."""
THREADS = 2
BORE_RADII = Reals(1e-4, 1.0, "m")

WINDOW_BEFORE, WINDOW_AFTER = 0.8e-3, 1.6e-3
"""Window in s around the strongest echo: an echo lasts 0.5 ms, and trapped sound arrives later."""
TAPER_FRACTION = 0.2
"""Fraction of the window over which its taper rises, and over which it falls."""
SPECTRUM_HALF_WIDTH, SPECTRUM_STEP = 3.5e3, 500.0
"""Half the width of the band around the carrier, and the frequency step, in Hz: the transducer's
bandwidth is 3 kHz, and the window resolves 400 Hz."""
ENVELOPE_DELAYS = np.delete(np.arange(-6, 13), 6) * 1e-4
"""Delays in s of the envelope's samples relative to the strongest echo; zero is left out."""
LEAST_AMPLITUDE = 1e-6
"""Lower bound of amplitudes, relative to the send pulse: under a hundredth of an ADC count."""
FIRST_ECHO_RATIO, FIRST_ECHO_REACH = 0.5, 0.25
"""Smallest amplitude of a press's first echo relative to its strongest one, and largest distance in
m by which the first is nearer to the sensor."""
NOISE_MAXIMUM = 3.0
"""Assumed ratio of the maximum of the noise to its median: lower peaks are not echoes."""
LEAST_PROMINENCE = 0.5
"""Smallest prominence of an echo, relative to the background."""
N_OTHER_ECHOES = 2
"""Number of further echoes among the features."""
SAME_PRESS_DISTANCE = 0.1
"""Distance in m within which two echoes belong to the same press."""
ABSENT_LEVEL = -40.0
"""Level in dB assigned to an absent echo."""
TEMPERATURE_STEP = 2.0
"""Step in K of the temperatures at which the attenuation is computed."""
DECIBEL = 20 / np.log(10)
"""Decibels per neper."""


@dataclass(frozen=True, kw_only=True)
class FeatureSettings:
    """Settings of the features of cycles.

    Attributes
    ----------
    kind : str
        ``paper``: :data:`PEAK_FEATURES`, those of the sleeve paper. ``echo``: those of
        :func:`echo_features`.
    processing : Processing
        As for :func:`acoustube.signals.locate`.
    radius : float
        Radius of the bore in m, for the attenuation; overridden by that of a recording.
    """

    kind: str = "paper"
    processing: Processing = field(default_factory=Processing)
    radius: float = 3.95e-3

    def __post_init__(self) -> None:
        """Validate kind, processing and radius."""
        radius, kinds = Number(1e-4, 1.0, "m", "of the bore"), Choice(("paper", "echo"))
        check_fields(self, kind=kinds, processing=Processing, radius=radius)


@checked(cycles=xr.Dataset, settings=FeatureSettings)
def feature_table(
    cycles: xr.Dataset, settings: FeatureSettings, progress: Callable[[float], None] | None = None
) -> xr.Dataset:
    """Return the feature table of recorded cycles, with their labels.

    Parameters
    ----------
    cycles : xarray.Dataset
        ``signal`` (cycle, time) and ``temperature`` (cycle) in degC, as from
        :func:`acoustube.recordings.read`; any of :data:`LABELS` (cycle).
    settings : FeatureSettings
    progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    xarray.Dataset
        ``features`` (cycle, feature) with their names as coordinate ``feature``, nan for a cycle
        without an echo; the labels (cycle); the attribute ``sampling_rate`` in Hz.

    Raises
    ------
    ValueError
        As for :func:`acoustube.signals.process`, or if a variable is missing.
    """
    if missing := {"time", "signal", "temperature"} - {str(name) for name in cycles.variables}:
        raise ConfigError(f"the cycles have no {min(missing)}; give a dataset of recordings")
    time, signal = cycles["time"].values, cycles["signal"].values
    temperatures, count = cycles["temperature"].values, cycles.sizes["cycle"]
    processing = without_aliased_template(settings.processing, sampling_rate(time))
    radii = _radii(cycles, settings.radius)

    def piece(start: int) -> Array:
        part = slice(start, start + CYCLES_PER_CHUNK)
        if settings.kind == "paper":
            ranging = locate(time, signal[part], processing, temperature=temperatures[part])
            return np.stack([ranging.amplitude, ranging.distance], axis=-1)
        return echo_features(time, signal[part], temperatures[part], processing, radii[part])

    starts, rows = range(0, count, CYCLES_PER_CHUNK), []
    with ThreadPoolExecutor(THREADS) as pool:
        for start, found in zip(starts, pool.map(piece, starts), strict=True):
            rows.append(found)
            if progress is not None:
                progress(min(1.0, (start + CYCLES_PER_CHUNK) / count))
    known = {
        name: ("cycle", cycles[name].values, cycles[name].attrs)
        for name in LABELS
        if name in cycles and cycles[name].dims == ("cycle",)
    }
    return xr.Dataset(
        {"features": (("cycle", "feature"), np.concatenate(rows))} | known,
        {"feature": list(names(settings))},
        {"sampling_rate": sampling_rate(time)},
    )


def names(settings: FeatureSettings) -> tuple[str, ...]:
    """Return the names of the features that :func:`feature_table` computes with settings."""
    return PEAK_FEATURES if settings.kind == "paper" else echo_names(settings.processing.frequency)


def _radii(cycles: xr.Dataset, default: float) -> Array:
    """Return the bore's radius of each cycle in m: a label, the recording's, or the default."""
    if "bore_radius" in cycles:
        given = cycles["bore_radius"].values
    elif "inner_diameter" in cycles and cycles["inner_diameter"].attrs.get("units") == "m":
        given = cycles["inner_diameter"].values / 2
    else:
        given = np.full(cycles.sizes["cycle"], cycles.attrs.get("bore_radius", default))
    check_argument("bore_radius", given, BORE_RADII)
    return np.asarray(given, float)


def echo_names(carrier: float) -> tuple[str, ...]:
    """Return the names of :func:`echo_features` for a carrier in Hz."""
    return (
        "distance", "level", "over_background", "over_noise", "clutter", "first_lead",
        "first_level",
        *(f"other_{i + 1}_{what}" for what in ("level", "distance") for i in range(N_OTHER_ECHOES)),
        *(f"spectrum_{KHZ * f:.1f}_khz" for f in frequencies(carrier)),
        *(f"envelope_{MS * t:+.1f}_ms" for t in ENVELOPE_DELAYS),
    )  # fmt: skip


def frequencies(carrier: float) -> Array:
    """Return the frequencies of the spectrum in Hz around a carrier."""
    return carrier + np.arange(
        -SPECTRUM_HALF_WIDTH, SPECTRUM_HALF_WIDTH + SPECTRUM_STEP / 2, SPECTRUM_STEP
    )


@checked(settings=Processing, temperature=CELSIUS, radius=BORE_RADII)
def echo_features(
    time: Array,
    signal: Any,
    temperature: Array,
    settings: Processing,
    radius: float | Array = 3.95e-3,
) -> Array:
    """Return the features of the whole echo.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times in s.
    signal : array of shape (cycle, time)
    temperature : array of shape (cycle,)
        Temperature of the air in degC.
    settings : Processing
        Its gain and prominence are not used.
    radius : float or array of shape (cycle,)
        Radius of the bore in m.

    Returns
    -------
    array of shape (cycle, feature)
        nan for a cycle without an echo. The echo is the highest relative to the background. Levels
        are in dB and, except ``over_noise``, corrected for attenuation there and back. In order:

        * its ``distance`` in m, and its ``level`` relative to the send pulse;
        * its levels ``over_background`` and ``over_noise``, and the level of the tube's ``clutter``
          relative to the send pulse;
        * ``first_lead``, by how many m the press's first echo is nearer, and its ``first_level``;
        * levels of the next :data:`N_OTHER_ECHOES`, then their distances minus the echo's in m;
        * levels of the spectrum around the echo at :func:`frequencies`, relative to the send pulse;
        * levels of the envelope at :data:`ENVELOPE_DELAYS`, relative to the echo.

        Levels of the first and the next echoes are their ``over_background`` minus the echo's.

    Notes
    -----
    With the plane mode's attenuation a, the envelope e at distance l has the level e exp(2 a l) at
    the reflector. The noise n is the median of e after the search window, or within it if hardly
    any sample comes after it. The clutter k is the median level of the window's samples whose e
    exceeds 3 n, or of those at its start if none does. The background is hypot(k exp(-2 a l), 3 n).
    It replaces a time gain fitted to closures: it follows from the physics and the cycle itself.
    """
    ranging = locate(
        time, signal, replace(settings, gain=None, prominence=1.0), temperature=temperature
    )
    radii = np.broadcast_to(np.asarray(radius, float), np.shape(temperature))
    attenuation = _attenuation(
        np.append(settings.frequency, frequencies(settings.frequency)), temperature, radii
    )
    speed = speed_of_sound(temperature)[:, None]
    send = ranging.send_time[:, None]
    place = speed / 2 * (time - send)
    gain = np.exp(2 * attenuation[:, :1] / DECIBEL * np.maximum(place, 0.0))
    clutter, noise = _levels(ranging.envelope, place, gain, settings)
    over = ranging.envelope / np.hypot(clutter / gain, NOISE_MAXIMUM * noise)
    start = send[:, 0] + np.maximum(
        blind_time(settings.pulse_cycles / settings.frequency, settings.cutoff),
        2 * settings.nearest / speed[:, 0],
    )
    echoes = find_echoes(
        time, over, start=start, stop=send[:, 0] + 2 * settings.farthest / speed[:, 0],
        prominence=LEAST_PROMINENCE,
    )  # fmt: skip
    back, height, _ = strongest_echo(echoes)
    distance = speed[:, 0] / 2 * (back - send[:, 0])
    amplitude = _sampled(ranging.envelope, time, back[:, None])[:, 0]
    path_loss = attenuation * 2 * distance[:, None]
    waveform = _sampled(ranging.envelope, time, back[:, None] + ENVELOPE_DELAYS)
    return np.concatenate(
        [
            np.stack(
                [
                    distance,
                    _decibel(amplitude) + path_loss[:, 0],
                    _decibel(height),
                    _decibel(amplitude) - _decibel(noise[:, 0]),
                    np.where(np.isfinite(back), _decibel(clutter[:, 0]), np.nan),
                ],
                axis=-1,
            ),
            _companions(echoes, back, height, speed),
            _spectrum(time, signal, ranging, back, settings) + path_loss[:, 1:],
            _decibel(waveform) - _decibel(amplitude)[:, None]
            + attenuation[:, :1] * speed * ENVELOPE_DELAYS,
        ],
        axis=-1,
    )  # fmt: skip


def _levels(
    envelope: Array, place: Array, gain: Array, settings: Processing
) -> tuple[Array, Array]:
    """Return the levels of clutter and noise, relative to the send pulse, (cycle, 1)."""
    inside = (place >= settings.nearest) & (place <= settings.farthest)
    past = place > settings.farthest
    quiet = np.where(past.sum(axis=-1, keepdims=True) > envelope.shape[-1] // 20, past, inside)
    noise = _median(envelope, quiet)
    audible = inside & (envelope > NOISE_MAXIMUM * noise)
    # Where no clutter exceeds the noise, the noise at the tube's start is its upper bound.
    audible |= inside & ~audible.any(axis=-1, keepdims=True) & (place < 2 * settings.nearest)
    return _median(envelope * gain, audible), noise


def _median(values: Array, where: NDArray[np.bool_]) -> Array:
    with np.errstate(invalid="ignore"):
        found = np.ma.median(np.ma.masked_array(values, ~where), axis=-1, keepdims=True)
    return np.maximum(np.ma.filled(found, LEAST_AMPLITUDE), LEAST_AMPLITUDE)


def _attenuation(frequency: Array, temperatures: Array, radii: Array) -> Array:
    """Return the plane mode's attenuation in dB/m for each cycle, (cycle, frequency).

    It is interpolated linearly, with an error under 0.1 %, between fixed temperatures, multiples of
    :data:`TEMPERATURE_STEP`, so that a cycle's features do not depend on other cycles.
    """
    attenuation = np.empty((len(temperatures), len(frequency)))
    place = np.asarray(temperatures) / TEMPERATURE_STEP
    below = np.floor(place).astype(int)
    below -= np.asarray(temperatures) == TEMPERATURES[1]  # above which nothing is known
    fraction = (place - below)[:, None]
    for radius in np.unique(radii):
        of_bore = radii == radius
        first = below[of_bore].min()
        steps = np.arange(first, below[of_bore].max() + 2)
        table = np.array(
            [
                -axial_wavenumber(0, 0, frequency, radius, air_at(float(TEMPERATURE_STEP * i))).imag
                for i in steps
            ]
        )  # (temperature, frequency)
        row = below[of_bore] - first
        attenuation[of_bore] = (1 - fraction[of_bore]) * table[row] + fraction[of_bore] * table[
            row + 1
        ]
    return DECIBEL * attenuation


def _decibel(fraction: Array) -> Array:
    return np.asarray(DECIBEL * np.log(np.maximum(fraction, LEAST_AMPLITUDE)))


def _sampled(envelope: Array, time: Array, at: Array) -> Array:
    """Return envelopes at times (cycle, n) in s, interpolated linearly; nan at nan."""
    place = np.clip((at - time[0]) * sampling_rate(time), 0, time.size - 1.001)
    index = np.nan_to_num(place).astype(int)
    fraction = place - index
    left, right = (np.take_along_axis(envelope, index + i, axis=-1) for i in (0, 1))
    return np.asarray((1 - fraction) * left + fraction * right)


def _companions(echoes: Echoes, back: Array, height: Array, speed: Array) -> Array:
    """Return the features from ``first_lead`` to the other echoes' distances, (cycle, feature)."""
    if echoes.times.shape[-1] == 0:
        return np.full((len(back), 2 + 2 * N_OTHER_ECHOES), np.nan)
    after = speed / 2 * (echoes.times - back[:, None])  # in m
    level = _decibel(echoes.amplitudes) - _decibel(height)[:, None]
    first = (after > -FIRST_ECHO_REACH) & (level >= DECIBEL * np.log(FIRST_ECHO_RATIO))
    index = np.argmax(first, axis=-1)[:, None]
    lead, first_level = (np.take_along_axis(a, index, axis=-1) for a in (-after, level))
    level = np.where(np.abs(after) > SAME_PRESS_DISTANCE, level, np.nan)
    level = np.concatenate([level, np.full((len(back), N_OTHER_ECHOES), np.nan)], axis=-1)
    after = np.concatenate([after, np.zeros((len(back), N_OTHER_ECHOES))], axis=-1)
    next_ones = np.argsort(-np.nan_to_num(level, nan=-np.inf), axis=-1)[:, :N_OTHER_ECHOES]
    levels, places = (np.take_along_axis(a, next_ones, axis=-1) for a in (level, after))
    there = np.isfinite(levels)
    found = np.concatenate(
        [lead, first_level, np.where(there, levels, ABSENT_LEVEL), np.where(there, places, 0.0)],
        axis=-1,
    )
    return np.where(np.isfinite(back)[:, None], found, np.nan)


def _spectrum(
    time: Array, signal: Any, ranging: Ranging, back: Array, settings: Processing
) -> Array:
    """Return spectra around echoes at times `back` in s, in dB relative to the send pulse."""
    rate = sampling_rate(time)
    plain = np.asarray(signal, float)
    if settings.offset_cutoff is not None:
        plain = remove_offset(plain, rate, settings.offset_cutoff)
    since = np.arange(round(-WINDOW_BEFORE * rate), round(WINDOW_AFTER * rate) + 1)
    index = np.round((np.nan_to_num(back) - time[0]) * rate).astype(int)[:, None] + since
    inside = (index >= 0) & (index < time.size)
    window = np.take_along_axis(plain, np.clip(index, 0, time.size - 1), axis=-1) * inside
    turns = np.exp(-2j * np.pi * np.outer(since / rate, frequencies(settings.frequency)))
    amplitude = np.abs((window * tukey(since.size, 2 * TAPER_FRACTION)) @ turns)
    scale = ranging.send_amplitude[:, None] * settings.pulse_cycles / settings.frequency * rate / 2
    return np.where(np.isfinite(back)[:, None], _decibel(amplitude / scale), np.nan)
