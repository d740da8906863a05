"""The sleeve paper's simulations (section II-D, Fig. 2): three rods on a tube of 40 cm.

In addition: effects of losses and of the source end, sound trapped near a rod, the modes of the
reflection, and the same presses at 10 and 20 kHz.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr

from acoustube.base.report import Reporter
from acoustube.base.types import Array
from acoustube.base.units import CM, KHZ, MS
from acoustube.reports.studies.presses import swept
from acoustube.reports.studies.report import Level, Row, Scale, Study, Tables, compared_row
from acoustube.reports.studies.simulation_cases import (
    CARRIER,
    CUT_ON,
    PROBE,
    RODS,
    SOUND_SPEED,
    carried_power,
    chosen,
    of_rod,
    only,
)
from acoustube.reports.studies.simulation_figures import figures

DEPTHS, FEW_DEPTHS = "0.5:8:0.5", "3:6:3"
LOSSY = {"losses": ["on"], "frequency_khz": ["10", "20", "42"], "length_cm": ["40", "100"]}
"""Settings of the sweep with losses, also at lower carriers. Pulses of 11 cycles are 38 cm long at
10 kHz and need the longer tube. One scattering matrix of a press serves all these settings."""


def study(scale: Scale, work: Path, report: Reporter) -> Study:
    """Simulate presses of three rods, and estimate their distances from the echoes."""
    depths = [FEW_DEPTHS if scale.quick else DEPTHS]
    rods = {"indenter_mm": list(RODS), "depth_mm": depths}

    def at(name: str, level: Level, **over: list[str]) -> xr.Dataset:
        return swept(work / name, {**rods, **over}, level, scale, report)

    lossless = at("lossless", scale.level, losses=["off"])
    all_lossy = at("lossy", scale.level, **LOSSY)
    lossy = only(only(all_lossy, "carrier_frequency", CARRIER), "tube_length", 0.4)
    low = only(all_lossy, "tube_length", 1.0)
    coarser = None if scale.coarser is None else at("coarser", scale.coarser, losses=["off"])
    return Study(
        title="Simulation study: three rods on a straight tube (Fig. 2)",
        text=TEXT,
        rows=[
            *_error_rows(lossless, lossy, coarser),
            *_amplitude_rows(lossless, low, coarser),
            *_time_rows(lossless, coarser),
        ],
        figures=figures(lossless, lossy, low, carried_power(work / "lossless")),
    )


TEXT = f"""\
The sleeve paper's 40 cm tube is pressed in its middle by rods of 10, 25 and 35 mm until it is
closed. A pulse of 11 cycles at 42 kHz is launched at a pressure-driven end, which is a pressure
release after the pulse; the probe is a plane 2 cm away; the far end absorbs. The distance follows
from the envelope's highest peak, if it is over 0.1 % of the send pulse.

As published there are no losses. The same presses are computed with losses, and with an absorbing
source end, which is closer to a transducer.

The error of the distance is small where the direct echo is the highest peak. It is several
centimetres where the highest peak is sound that was trapped near the rod in the mode (2,1), whose
cut-on is below the carrier in the widened lumen and just above it in the round bore. A mean over
depths is a mixture of the two. With a pressure-release end the echo passes the probe twice,
{MS * 2 * PROBE / SOUND_SPEED:.3f} ms apart, which adds about {CM * PROBE:g} cm where the second
lobe is the higher.

The direct echo itself moves from beyond the press to before it as the press deepens, since the
reflection from its near flank prevails: time of flight does depend on depth, though the speed of
sound does not."""


def mean_error(cases: xr.Dataset | None, rod: str, end: str = "release") -> tuple[float, float]:
    """Return mean and standard deviation in cm of the absolute distance errors of a rod's presses.

    Presses that are not detected are left out. Both values are nan if `cases` is None.
    """
    if cases is None:
        return float("nan"), float("nan")
    size = CM * np.abs(of_rod(chosen(cases, end), rod)["error"].values)
    return float(np.nanmean(size)), float(np.nanstd(size))


def _error_rows(lossless: xr.Dataset, lossy: xr.Dataset, coarser: xr.Dataset | None) -> list[Row]:
    why = (
        "A mixture of small and large errors (see the text); the mean depends on the number of "
        "depths with each. The sleeve paper does not state its depths and least prominence."
    )
    rows = []
    for rod, published in RODS.items():
        ours, other = mean_error(lossless, rod), mean_error(coarser, rod)
        for i, what in enumerate(("mean absolute error", "its deviation")):
            rows.append(
                Row(
                    quantity=f"{rod} mm rod: {what} of the distance", unit="cm",
                    published=published[i], ours=ours[i], coarser=other[i], why=why,
                )
            )  # fmt: skip
    for words, cases, end in (
        ("with losses", lossy, "release"),
        ("absorbing source end", lossless, "absorbing"),
        ("absorbing source end, with losses", lossy, "absorbing"),
    ):
        rows += [
            Row(
                quantity=f"{rod} mm rod: mean absolute error, {words}", unit="cm",
                ours=mean_error(cases, rod, end)[0], why="Not published.",
            )
            for rod in RODS
        ]  # fmt: skip
    return rows


def _amplitude_rows(lossless: xr.Dataset, low: xr.Dataset, coarser: xr.Dataset | None) -> list[Row]:
    rows = [
        compared_row(
            _smallest_wins, Tables(lossless, coarser),
            quantity="depths where the 10 mm rod has the highest echo", unit="%", published=100.0,
            why="Published in words: the largest amplitudes occur for the 10 mm indenter.",
        )
    ]  # fmt: skip
    for frequency in (10e3, 20e3, 42e3):
        for rod in RODS:
            some = of_rod(only(low, "carrier_frequency", frequency), rod)
            rows.append(
                Row(
                    quantity=f"{rod} mm rod, {KHZ * frequency:g} kHz: steps of depth at which "
                    "the echo rises", unit="%",
                    ours=100 * rising(chosen(some, "absorbing")["amplitude"].values),
                    why="100 % is monotonic. The sleeve paper expects it below "
                    f"{KHZ * CUT_ON:.1f} kHz, where only the plane wave propagates; but at 20 kHz "
                    "the reflections of both flanks of a long press interfere.",
                )
            )  # fmt: skip
    return rows


def rising(amplitude: Array) -> float:
    """Return the fraction of depth steps where the amplitude does not fall; nan counts as zero."""
    return float(np.mean(np.diff(np.nan_to_num(amplitude)) >= 0))


def _smallest_wins(cases: xr.Dataset) -> float:
    there = chosen(cases, "release")
    heights = np.stack([np.nan_to_num(of_rod(there, rod)["amplitude"].values) for rod in RODS])
    detected = heights.max(axis=0) > 0
    return 100 * float(np.mean(heights.argmax(axis=0)[detected] == 0))


def _time_rows(lossless: xr.Dataset, coarser: xr.Dataset | None) -> list[Row]:
    """Return report rows: how the distance estimated from the direct echo changes with depth."""
    why = (
        "The wall is rigid for sound at 42 kHz, and the speed of sound is the same at all depths: "
        "it is the reflecting part of the press that moves. The sleeve paper suspects a speed that "
        "depends on depth, and finds little of it in its simulations too."
    )
    return [
        compared_row(
            partial(direct_range, rod=rod), Tables(lossless, coarser),
            quantity=f"{rod} mm rod: range over depth of the direct echo's distance",
            unit="cm", why=why,
        )
        for rod in RODS
    ]  # fmt: skip


def direct_range(cases: xr.Dataset, rod: str) -> float:
    """Return maximum less minimum in cm of those distance errors of a rod that are below 2 cm."""
    error = CM * of_rod(chosen(cases, "absorbing"), rod)["error"].values
    near = error[np.abs(error) < 2.0]
    return float(np.ptp(near)) if near.size else float("nan")
