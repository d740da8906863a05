"""What estimators are told of each cycle: the paper's two numbers, or the whole echo.

The whole echo is described as the press sent it back, not as it arrived: what the way there and
back takes is put back in at each frequency by the plane mode's attenuation in that bore and air. So
an estimator that has learned presses at one place can know them at another. Which echo is the
press's is decided against what a tube returns without one: irregularities all along it, which fade
as echoes do, and a noise that does not.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from acoustube.air import air_at
from acoustube.base.types import Array
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

PAPER = ("amplitude", "distance")
"""Names of the paper's inputs, the highest peak's, in 1 and m."""
LABELS = (
    "true_distance", "depth", "force", "diameter", "press", "tube", "session", "shape",
    "lumen_area",
)  # fmt: skip
"""What may be known of a cycle besides its signal: what is to be told, and what groups cycles."""
CHUNK = 250
"""Cycles that are described together: 8 MB of double precision per step."""
THREADS = 2

BEFORE, AFTER = 0.8e-3, 1.6e-3
"""Window in s around the highest peak: an echo lasts 0.5 ms, and what a press traps leaks later."""
TAPER = 0.2
"""Share of the window over which it rises, and falls."""
BAND, STEP = 3.5e3, 500.0
"""Half the width of the band around the carrier, and the step in it, in Hz: the transducer passes
3 kHz, and the window resolves 400 Hz."""
DELAYS = np.arange(-6, 13) * 1e-4
"""Of the envelope's samples after the highest peak, in s."""
FLOOR = 1e-6
"""Share of the send pulse below which nothing is told apart: under a hundredth of a count."""
FIRST, NEAR = 0.5, 0.25
"""Height of the first echo of a press, as a share of the highest, and how far before it in m."""
LOUDEST = 3.0
"""Highest of the noise in a window, in its medians: what is lower is no echo."""
OVER_BACKGROUND = 0.5
"""Least prominence of an echo over the background."""
OTHERS = 2
"""Echoes that are told besides the one that stands out most."""
APART = 0.1
"""Distance in m from that echo within which another is of the same press."""
LOWEST = -40.0
"""Level in dB that stands for an echo that is not there."""
WARMTH_STEP = 2.0
"""In K, between temperatures at which the attenuation is computed."""
DECIBEL = 20 / np.log(10)


@dataclass(frozen=True, kw_only=True)
class FeatureSettings:
    """How cycles become features.

    Attributes
    ----------
    kind : str
        ``paper``: :data:`PAPER`. ``echo``: see :func:`echo_features`.
    processing : Processing
        As for :func:`acoustube.signals.locate`.
    radius : float
        Of the bore in m, for the attenuation; that of a recording that tells it goes before.
    """

    kind: str = "paper"
    processing: Processing = field(default_factory=Processing)
    radius: float = 3.95e-3


def feature_table(
    cycles: xr.Dataset, how: FeatureSettings, progress: Callable[[float], None] | None = None
) -> xr.Dataset:
    """Return what estimators are told of cycles, beside what they are to tell.

    Parameters
    ----------
    cycles : xarray.Dataset
        ``signal`` (cycle, time) and ``temperature`` (cycle) in degC, as of
        :func:`acoustube.recordings.read`; :data:`LABELS` as far as they are known.
    how : FeatureSettings
    progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    xarray.Dataset
        ``features`` (cycle, feature), the coordinate ``feature`` holding their names: a row of nan
        for a cycle without an echo. And the labels (cycle).
    """
    time, signal = cycles["time"].values, cycles["signal"].values
    warmth, count = cycles["temperature"].values, cycles.sizes["cycle"]
    processing = without_aliased_template(how.processing, sampling_rate(time))
    radii = _radii(cycles, how.radius)

    def piece(start: int) -> Array:
        part = slice(start, start + CHUNK)
        if how.kind == "paper":
            ranging = locate(time, signal[part], processing, temperature=warmth[part])
            return np.stack([ranging.amplitude, ranging.distance], axis=-1)
        return echo_features(time, signal[part], warmth[part], processing, radii[part])

    starts, rows = range(0, count, CHUNK), []
    with ThreadPoolExecutor(THREADS) as pool:
        for start, found in zip(starts, pool.map(piece, starts), strict=True):
            rows.append(found)
            if progress is not None:
                progress(min(1.0, (start + CHUNK) / count))
    known = {
        name: ("cycle", cycles[name].values, cycles[name].attrs)
        for name in LABELS
        if name in cycles and cycles[name].dims == ("cycle",)
    }
    return xr.Dataset(
        {"features": (("cycle", "feature"), np.concatenate(rows))} | known,
        {"feature": list(names(how))},
        {"sampling_rate": sampling_rate(time)},
    )


def names(how: FeatureSettings) -> tuple[str, ...]:
    """Return the names of the features."""
    return PAPER if how.kind == "paper" else echo_names(how.processing.frequency)


def _radii(cycles: xr.Dataset, default: float) -> Array:
    """Return the bore's radius of each cycle in m: a label, the recording's own, or the default."""
    if "bore_radius" in cycles:
        return np.asarray(cycles["bore_radius"].values, float)
    return np.full(cycles.sizes["cycle"], float(cycles.attrs.get("bore_radius", default)))


def echo_names(carrier: float) -> tuple[str, ...]:
    """Return the names of :func:`echo_features` for a carrier in Hz."""
    return (
        "distance", "level", "over_background", "over_noise", "clutter", "first_lead",
        "first_level",
        *(f"other_{i}_{what}" for what in ("level", "distance") for i in range(1, OTHERS + 1)),
        *(f"spectrum_{1e-3 * f:.1f}_khz" for f in frequencies(carrier)),
        *(f"envelope_{1e3 * t:+.1f}_ms" for t in DELAYS if t != 0),
    )  # fmt: skip


def frequencies(carrier: float) -> Array:
    """Return the frequencies of the spectrum in Hz around a carrier."""
    return carrier + np.arange(-BAND, BAND + STEP / 2, STEP)


def echo_features(
    time: Array, signal: Any, temperature: Array, how: Processing, radius: float | Array = 3.95e-3
) -> Array:
    """Return the features of the whole echo.

    Parameters
    ----------
    time : array of shape (time,)
        In s.
    signal : array of shape (cycle, time)
    temperature : array of shape (cycle,)
        In degC.
    how : Processing
        Its gain and prominence are not used.
    radius : float or array of shape (cycle,)
        Of the bore in m.

    Returns
    -------
    array of shape (cycle, feature)
        Of the echo that stands out most from the background: ``distance`` in m; ``level`` in dB of
        the send pulse; how far it is ``over_background`` and ``over_noise``, and the tube's
        ``clutter``, in dB; ``first_lead`` in m and ``first_level`` in dB: how far before it the
        first echo of this press lies, and its level against it; levels over the background in dB,
        against that echo's, and distances from it in m, of the next :data:`OTHERS`; the spectrum
        around it at :func:`frequencies` in dB of the send pulse; and the envelope at
        :data:`DELAYS` in dB of the echo. Levels are corrected for the way there and back. nan for
        a cycle without an echo.

    Notes
    -----
    The envelope e without time gain is e exp(2 a l) on what is sent back at distance l, with the
    attenuation a. Its median k over the search window, where it is not noise, is the clutter; the
    median n past the window, or of the window if the record ends, the noise. The background is
    hypot(k exp(-2 a l), 3 n): a gain that follows from physics and from the cycle itself, in place
    of one that was fitted to closures.
    """
    ranging = locate(time, signal, replace(how, gain=None, prominence=1.0), temperature=temperature)
    radii = np.broadcast_to(np.asarray(radius, float), np.shape(temperature))
    lost = _attenuation(np.append(how.frequency, frequencies(how.frequency)), temperature, radii)
    speed = speed_of_sound(temperature)[:, None]
    send = ranging.send_time[:, None]
    place = speed / 2 * (time - send)
    gain = np.exp(2 * lost[:, :1] / DECIBEL * np.maximum(place, 0.0))
    clutter, noise = _levels(ranging.envelope, place, gain, how)
    over = ranging.envelope / np.hypot(clutter / gain, LOUDEST * noise)
    start = send[:, 0] + np.maximum(
        blind_time(how.pulse_cycles / how.frequency, how.cutoff), 2 * how.nearest / speed[:, 0]
    )
    echoes = find_echoes(
        time, over, start=start, stop=send[:, 0] + 2 * how.farthest / speed[:, 0],
        prominence=OVER_BACKGROUND,
    )  # fmt: skip
    back, height, _ = strongest_echo(echoes)
    distance = speed[:, 0] / 2 * (back - send[:, 0])
    amplitude = _sampled(ranging.envelope, time, back[:, None])[:, 0]
    way = lost * 2 * distance[:, None]
    course = _sampled(ranging.envelope, time, back[:, None] + DELAYS[DELAYS != 0])
    return np.concatenate(
        [
            np.stack(
                [
                    distance,
                    _decibel(amplitude) + way[:, 0],
                    _decibel(height),
                    _decibel(amplitude) - _decibel(noise[:, 0]),
                    np.where(np.isfinite(back), _decibel(clutter[:, 0]), np.nan),
                ],
                axis=-1,
            ),
            _companions(echoes, back, height, speed),
            _spectrum(time, signal, ranging, back, how) + way[:, 1:],
            _decibel(course) - _decibel(amplitude)[:, None]
            + lost[:, :1] * speed * DELAYS[DELAYS != 0],
        ],
        axis=-1,
    )  # fmt: skip


def _levels(envelope: Array, place: Array, gain: Array, how: Processing) -> tuple[Array, Array]:
    """Return the clutter as sent back, and the noise, as shares of the send pulse, (cycle, 1)."""
    inside = (place >= how.nearest) & (place <= how.farthest)
    past = place > how.farthest
    quiet = np.where(past.sum(axis=-1, keepdims=True) > envelope.shape[-1] // 20, past, inside)
    noise = _median(envelope, quiet)
    heard = inside & (envelope > 3 * noise)
    # A tube of which nothing is heard over the noise has a clutter of that size at its start.
    heard |= inside & ~heard.any(axis=-1, keepdims=True) & (place < 2 * how.nearest)
    return _median(envelope * gain, heard), noise


def _median(values: Array, where: NDArray[np.bool_]) -> Array:
    with np.errstate(invalid="ignore"):
        found = np.ma.median(np.ma.masked_array(values, ~where), axis=-1, keepdims=True)
    return np.maximum(np.ma.filled(found, FLOOR), FLOOR)


def _attenuation(frequency: Array, warmth: Array, radii: Array) -> Array:
    """Return the plane mode's attenuation in dB/m at frequencies, of each cycle (cycle, frequency).

    Between whole multiples of :data:`WARMTH_STEP` linear, where it bends by less than 0.1 %; fixed
    ones, so that a cycle's features do not depend on the others.
    """
    lost = np.empty((len(warmth), len(frequency)))
    place = np.asarray(warmth) / WARMTH_STEP
    below = np.floor(place).astype(int)
    share = (place - below)[:, None]
    for radius in np.unique(radii):
        of_bore = radii == radius
        first = below[of_bore].min()
        steps = np.arange(first, below[of_bore].max() + 2)
        table = np.array(
            [
                -axial_wavenumber(0, 0, frequency, radius, air_at(float(WARMTH_STEP * i))).imag
                for i in steps
            ]
        )  # (temperature, frequency)
        row = below[of_bore] - first
        lost[of_bore] = (1 - share[of_bore]) * table[row] + share[of_bore] * table[row + 1]
    return DECIBEL * lost


def _decibel(share: Array) -> Array:
    return np.asarray(DECIBEL * np.log(np.maximum(share, FLOOR)))


def _sampled(envelope: Array, time: Array, at: Array) -> Array:
    """Return envelopes at times (cycle, n) in s, linear between the samples; nan at nan."""
    place = np.clip((at - time[0]) * sampling_rate(time), 0, time.size - 1.001)
    index = np.nan_to_num(place).astype(int)
    share = place - index
    left, right = (np.take_along_axis(envelope, index + i, axis=-1) for i in (0, 1))
    return np.asarray((1 - share) * left + share * right)


def _companions(echoes: Echoes, back: Array, height: Array, speed: Array) -> Array:
    """Return lead and level of a press's first echo, and levels and distances of other echoes."""
    if echoes.times.shape[-1] == 0:
        return np.full((len(back), 2 + 2 * OTHERS), np.nan)
    after = speed / 2 * (echoes.times - back[:, None])  # in m
    level = _decibel(echoes.amplitudes) - _decibel(height)[:, None]
    first = (after > -NEAR) & (level >= DECIBEL * np.log(FIRST))
    index = np.argmax(first, axis=-1)[:, None]
    lead, first_level = (np.take_along_axis(a, index, axis=-1) for a in (-after, level))
    level = np.where(np.abs(after) > APART, level, np.nan)
    level = np.concatenate([level, np.full((len(back), OTHERS), np.nan)], axis=-1)
    after = np.concatenate([after, np.zeros((len(back), OTHERS))], axis=-1)
    next_ones = np.argsort(-np.nan_to_num(level, nan=-np.inf), axis=-1)[:, :OTHERS]
    levels, places = (np.take_along_axis(a, next_ones, axis=-1) for a in (level, after))
    there = np.isfinite(levels)
    found = np.concatenate(
        [lead, first_level, np.where(there, levels, LOWEST), np.where(there, places, 0.0)], axis=-1
    )
    return np.where(np.isfinite(back)[:, None], found, np.nan)


def _spectrum(time: Array, signal: Any, ranging: Ranging, back: Array, how: Processing) -> Array:
    """Return the spectrum of a window around an echo in dB of the send pulse."""
    rate = sampling_rate(time)
    plain = np.asarray(signal, float)
    if how.offset_cutoff is not None:
        plain = remove_offset(plain, rate, how.offset_cutoff)
    since = np.arange(round(-BEFORE * rate), round(AFTER * rate) + 1)
    index = np.round((np.nan_to_num(back) - time[0]) * rate).astype(int)[:, None] + since
    inside = (index >= 0) & (index < time.size)
    window = np.take_along_axis(plain, np.clip(index, 0, time.size - 1), axis=-1) * inside
    turns = np.exp(-2j * np.pi * np.outer(since / rate, frequencies(how.frequency)))
    amplitude = np.abs((window * _tapered(since.size)) @ turns)
    scale = ranging.send_amplitude[:, None] * how.pulse_cycles / how.frequency * rate / 2
    return np.where(np.isfinite(back)[:, None], _decibel(amplitude / scale), np.nan)


def _tapered(n: int) -> Array:
    """Return a window that is flat in its middle, with cosines at both ends."""
    place = np.minimum(np.arange(n), np.arange(n)[::-1]) / (TAPER * (n - 1))
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.minimum(place, 1.0)))
