"""Figures of recorded cycles and of calibrations. Each draws on given matplotlib axes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from acoustube.base.report import counted
from acoustube.base.sampling import sampling_rate
from acoustube.base.units import CM, MM
from acoustube.reports.figures.run import ENVELOPE, PRESS, RETURN, SEND, SIGNAL, label_amplitude
from acoustube.signals import Calibration, Processing, Ranging, distance, rectify, remove_offset

MOST_ROWS = 1000
"""Largest number of cycles in a waterfall plot; of more cycles, evenly spaced ones are drawn."""


def draw_cycle(
    axes: Axes, time: ArrayLike, cycle: ArrayLike, ranging: Ranging, temperature: float
) -> None:
    """Draw the rectified signal, its envelope, the send pulse and all echoes over distance.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    time, cycle : array of shape (time,)
        Sampling times in s, and the recorded signal in any unit.
    ranging : Ranging
        Result of processing the cycle.
    temperature : float
        Temperature of the air in degC.
    """
    time = np.asarray(time, float)
    place = CM * distance(time - ranging.send_time, temperature)
    plain = rectify(remove_offset(cycle, sampling_rate(time)))
    ahead = place < CM * Processing().nearest
    loudest = max(float(plain[~ahead].max(initial=0.0)), 1e-300)
    echoes = ranging.echoes
    top = float(np.max(ranging.envelope[~ahead], initial=0.0)) or 1.0
    axes.plot(place, plain / loudest * top, color=SIGNAL, lw=0.6, label="signal, rectified, scaled")
    axes.plot(place, ranging.envelope, color=ENVELOPE, lw=1.2, label="envelope")
    at = CM * distance(echoes.times - ranging.send_time, temperature)
    axes.plot(at, echoes.amplitudes, "o", color=PRESS, ms=3, label=counted(len(at), "peak"))
    if ranging.detected:
        axes.plot(
            CM * float(ranging.distance), float(ranging.amplitude), "v", color=RETURN,
            label=f"highest, {CM * float(ranging.distance):.1f} cm",
        )  # fmt: skip
    axes.axvline(0.0, color=SEND, lw=1, label="send pulse")
    axes.set_ylim(0, 1.15 * top)
    axes.set_xlim(float(place[0]), float(place[-1]))
    axes.set_xlabel("distance (cm)")
    label_amplitude(axes)
    axes.legend(loc="upper right", fontsize="small")


def draw_waterfall(
    axes: Axes, time: ArrayLike, envelopes: ArrayLike, send_time: float, temperature: float
) -> None:
    """Draw envelopes as an image over distance and cycle, in dB relative to the send pulse.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    time : array of shape (time,)
        Sampling times in s.
    envelopes : array of shape (cycle, time)
        Envelopes as fractions of the send pulse.
    send_time : float
        Time of the send pulse in s.
    temperature : float
        Temperature of the air in degC.
    """
    envelopes, time = np.asarray(envelopes, float), np.asarray(time, float)
    rows = np.unique(np.linspace(0, len(envelopes) - 1, min(len(envelopes), MOST_ROWS)).astype(int))
    place = CM * distance(time - send_time, temperature)
    level = 20 * np.log10(np.maximum(envelopes[rows], 1e-4))
    image = axes.imshow(
        level, aspect="auto", origin="lower", cmap="viridis", vmin=-60, vmax=0,
        interpolation="nearest", extent=(place[0], place[-1], -0.5, len(envelopes) - 0.5),
    )  # fmt: skip
    axes.figure.colorbar(image, ax=axes, label="dB relative to the send pulse")
    axes.set(xlabel="distance (cm)", ylabel="cycle")


def calibration_figure(calibration: Calibration) -> Figure:
    """Draw a calibration as in the sleeve paper's Fig. 3: amplitudes, distances and their fits."""
    sheet = Figure(figsize=(10, 4.2), layout="constrained")
    left, right = sheet.subplots(1, 2)
    draw_fall(left, calibration)
    draw_line(right, calibration)
    return sheet


def draw_fall(axes: Axes, calibration: Calibration) -> None:
    """Draw echo amplitudes of closures by distance, their arctan fit, and the time gain's tanh."""
    places = calibration.true_distance
    along = np.linspace(0, 1.1 * places.max(), 300)
    axes.plot(CM * places, calibration.amplitude, ".", color=SIGNAL, label="closures")
    axes.plot(
        CM * along, calibration.fitted_amplitude(along), color=ENVELOPE,
        label=f"arctan, RMSE {calibration.amplitude_rmse:.3g}",
    )  # fmt: skip
    gain = calibration.processing.gain
    if gain is not None:
        near, far = gain.c4 - gain.c1, gain.c4 + gain.c1
        axes.plot(
            CM * along, gain.level(along), color=SEND, ls="--",
            label=f"tanh, {near:.3g} to {far:.3g}",
        )  # fmt: skip
    axes.set(ylim=(0, None), xlabel="true distance (cm)")
    label_amplitude(axes)
    axes.legend(fontsize="small")


def draw_line(axes: Axes, calibration: Calibration) -> None:
    """Draw estimated over true distance of closures of the tube, and the line fitted to them."""
    places = calibration.true_distance
    slope, deviation = calibration.slope
    axes.plot(CM * places, CM * calibration.estimated_distance, ".", color=SIGNAL)
    ends = np.array([0.0, places.max()])
    axes.plot(
        CM * ends, CM * slope * ends, color=ENVELOPE,
        label=f"slope {slope:.4f} ± {deviation:.4f}, RMSE {MM * calibration.distance_rmse:.3g} mm",
    )  # fmt: skip
    axes.plot(CM * ends, CM * ends, color=PRESS, lw=0.8, ls=":", label="identity")
    axes.set(xlabel="true distance (cm)", ylabel="estimated distance (cm)")
    axes.legend(fontsize="small")
