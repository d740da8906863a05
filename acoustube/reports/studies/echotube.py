"""EchoTube's measurements: reach and dead zone of tubes of five bores, and two presses.

References
----------
EchoTube, ISS 2019. doi:10.1145/3343055.3359712. Numbers read off its figures, to a few per cent.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from acoustube import signals
from acoustube.air import air_at
from acoustube.base.report import Reporter
from acoustube.base.units import CM
from acoustube.ranging import Rangefinder, blockage, record
from acoustube.reports.figures.run import ENVELOPE, RETURN, SEND
from acoustube.reports.studies.calibration import BAND
from acoustube.reports.studies.flat import DEPTHS, FEW_DEPTHS
from acoustube.reports.studies.presses import matrices, swept
from acoustube.reports.studies.report import Row, Scale, Study
from acoustube.signals import Processing
from acoustube.waves import PlacedScatterer
from acoustube.waves.modes import axial_wavenumber

BORES = (4.0, 6.0, 8.0, 10.0, 20.0)
"""Bores in mm."""
REACHES = {4.0: 75.0, 6.0: 178.0, 8.0: 245.0, 10.0: 315.0}
"""Published largest located distances in cm, by bore in mm; the middle where a range is given."""
WIDEST_REACH = 390.0
"""Published largest located distance in cm in the widest bore, where the tube ended."""
DEAD_ZONES = {4.0: 15.0, 6.0: 15.0, 8.0: 15.0, 10.0: 20.0, 20.0: 45.0}
"""Published dead zones in cm, by bore in mm."""
REFERENCE_BORE = 8.0
"""Bore in mm whose published reach gives the dynamic range for all bores."""
CARRIER, TEMPERATURE = 42e3, 20.0
LOCATED_ERROR = 0.02
"""Error of the distance in m below which a closure counts as located."""
DISTANCES = np.arange(0.05, 0.60, 0.01)
SEARCH_START = 0.10
"""Least distance in m at which a closure is searched for; nearer, the send pulse would be found."""
NEARER, GAPS = 0.6, (0.2, 0.3, 0.4, 0.5)
"""Distance of the nearer of two presses, and distances from it to the other, in m."""
PRESSED, FEW_PRESSED = (7.5e-3, 8e-3), (6e-3, 8e-3)
"""Depths in m of the nearer press, which must transmit sound, and of the farther one, which closes
the lumen; FEW_PRESSED are those of a quick study."""
PEAK_TOLERANCE = 0.1
"""Largest distance in m between a press and a peak that counts as its echo."""
DECIBEL = 20 / np.log(10)
"""Level in dB of an amplitude ratio of e (1 neper)."""


def study(scale: Scale, work: Path, report: Reporter) -> Study:
    """Compare reach, dead zone and pairs of presses with the measured ones."""
    dynamic = 2 * attenuation(REFERENCE_BORE) * REACHES[REFERENCE_BORE] / CM
    pairs = two_presses(scale, work, report)
    return Study(
        title="EchoTube: reach and dead zone by bore, and two presses",
        text=TEXT,
        rows=[*_reach_rows(dynamic), *_dead_zone_rows(), *_pair_rows(pairs)],
        figures={
            "Farthest place by bore: measured; by the plane wave's loss with the dynamic range of "
            "the 8 mm tube; and with what a transducer of 8 mm transmits into a narrower "
            "tube, and receives from it.": _reach_figure(dynamic),
            "Envelopes of two presses, the nearer at 60 cm, the other 20 to 50 cm beyond (dotted "
            "lines): what the sensor records (50 cycles averaged).": _pair_figure(pairs),
        },
    )


TEXT = """\
EchoTube is a rubber tube with the same kind of 42 kHz rangefinder, pressed by hand or closed. A
closure reflects all, so the reach depends on the losses there and back and on the dynamic range of
the sensor, which is taken from the bore of 8 mm alone.

In the widest bore, closures were located as far as the tube went, beyond 390 cm.

In the dead zone a closure has no peak distinct from the ringing of the transducer, with the default
rangefinder: a property of the transducer, whatever the bore.

Two presses are 25 mm rods on the sleeve paper's tube, the nearer 7.5 mm deep, so that sound passes,
the farther until the lumen is closed; 50 cycles are averaged, as a sensor at rest would."""


def attenuation(bore_mm: float) -> float:
    """Return the plane wave's attenuation at 42 kHz in dB/m, at the wall and in the air."""
    air = air_at(TEMPERATURE)
    wave = axial_wavenumber(0, 0, np.array([CARRIER]), 0.5e-3 * bore_mm, air)
    return float(-DECIBEL * wave.imag[0])


def reach(bore_mm: float, dynamic: float, *, coupled: bool) -> float:
    """Return the largest distance in m at which a closure is detected.

    Parameters
    ----------
    bore_mm : float
        Bore in mm.
    dynamic : float
        Largest attenuation in dB, there and back, at which a closure is detected.
    coupled : bool
        Whether the amplitude that enters, and that leaves, a bore narrower than
        :data:`REFERENCE_BORE` is reduced in proportion to its area.
    """
    narrower = min(bore_mm / REFERENCE_BORE, 1.0)
    lost = -2 * DECIBEL * np.log(narrower**2) if coupled else 0.0
    return max((dynamic - lost) / (2 * attenuation(bore_mm)), 0.0)


def dead_zone(bore_mm: float) -> float:
    """Return the distance in m from which on closures are located to within 2 cm; inf if none is.

    The rangefinder is the default one without noise and clutter. The constant shift of distances
    is removed, as by a calibration.
    """
    clear = dataclasses.replace(Rangefinder(), noise=0.0, clutter=0.0)
    cycles = [
        record([blockage(BAND, float(z))], clear, radius=0.5e-3 * bore_mm, length=2.5)
        for z in DISTANCES
    ]
    ranging = signals.locate(
        cycles[0]["time"].values,
        np.concatenate([part["signal"].values for part in cycles]),
        Processing(nearest=SEARCH_START, prominence=1e-3, template_cycles=None),
        temperature=TEMPERATURE,
    )
    found = ranging.distance
    shift = float(np.nanmedian((found - DISTANCES)[-20:]))
    located = np.abs(found - shift - DISTANCES) < LOCATED_ERROR
    wrong = np.flatnonzero(~located)
    return float(np.append(DISTANCES, np.inf)[wrong[-1] + 1 if wrong.size else 0])


def two_presses(scale: Scale, work: Path, report: Reporter) -> list[xr.Dataset]:
    """Return the cycles of pairs of presses, one dataset for each distance between them."""
    over = {"indenter_mm": ["25"], "depth_mm": [FEW_DEPTHS if scale.quick else DEPTHS]}
    swept(work / "press", {**over, "length_cm": ["250"]}, scale.level, scale, report)
    by_depth = {
        round(float(cases["depth"].values[0]), 6): matrix
        for cases, matrix in matrices(work / "press")
    }
    nearer, farther = (by_depth[depth] for depth in (FEW_PRESSED if scale.quick else PRESSED))
    return [
        record(
            [PlacedScatterer(nearer, NEARER), PlacedScatterer(farther, NEARER + gap)], n_cycles=50
        )
        for gap in GAPS
    ]


def averaged(cycles: xr.Dataset) -> signals.Ranging:
    """Return the distance and the echoes detected in the mean of cycles."""
    mean = cycles["signal"].values.astype(float).mean(axis=0)
    settings = Processing(prominence=5e-4, send_shift=_shift())
    return signals.locate(cycles["time"].values, mean, settings, temperature=TEMPERATURE)


def _shift() -> float:
    """Return the shift of the send time in s with which a closure at 1 m is located exactly."""
    cycle = record([blockage(BAND, 1.0)], dataclasses.replace(Rangefinder(), clutter=0.0))
    settings = Processing(prominence=1e-3)
    found = signals.locate(
        cycle["time"].values, cycle["signal"].values[0], settings, temperature=TEMPERATURE
    )
    return float(2 * (found.distance - 1.0) / signals.speed_of_sound(TEMPERATURE))


def both(ranging: signals.Ranging, places: Sequence[float]) -> list[float]:
    """Return the distance error in m of the highest peak within 10 cm of each press.

    It is nan for a press without such a peak.
    """
    delay = ranging.echoes.times - ranging.send_time
    distance = np.asarray(signals.distance(delay, TEMPERATURE))
    found = []
    for place in places:
        near = np.abs(distance - place) < PEAK_TOLERANCE
        if not near.any():
            found.append(float("nan"))
            continue
        best = int(np.argmax(np.where(near, ranging.echoes.amplitudes, -1.0)))
        found.append(float(distance[best] - place))
    return found


# ---------------------------------------------------------------------------------------------
# Numbers and figures


def _reach_rows(dynamic: float) -> list[Row]:
    rows = [
        Row(
            quantity="dynamic range that follows from the 8 mm tube's reach", unit="dB",
            ours=dynamic, why="There and back, by the loss at the wall and in the air.",
        )
    ]  # fmt: skip
    for coupled, words in ((False, "by loss"), (True, "by loss and area")):
        rows += [
            Row(
                quantity=f"{bore:g} mm: reach {words}", unit="cm", published=REACHES.get(bore),
                ours=CM * reach(bore, dynamic, coupled=coupled),
                why="By definition: the dynamic range follows from this reach."
                if bore == REFERENCE_BORE else
                "Sound enters and leaves a narrower bore in proportion to its area: an assumption."
                if coupled else
                "A transducer wider than the bore sends only part of its sound into it, and "
                "receives only part of what returns: left out here.",
            )
            for bore in BORES if not coupled or bore < REFERENCE_BORE
        ]  # fmt: skip
    return rows


def _dead_zone_rows() -> list[Row]:
    return [
        Row(
            quantity=f"{bore:g} mm: dead zone", unit="cm", published=DEAD_ZONES[bore],
            ours=CM * dead_zone(bore),
            why="The transducer rings for as long in any bore. Wider tubes carry higher modes at "
            "42 kHz, which the plane wave's model of a closure leaves out.",
        )
        for bore in BORES
    ]  # fmt: skip


def _pair_rows(pairs: Sequence[xr.Dataset]) -> list[Row]:
    rows = []
    for gap, cycles in zip(GAPS, pairs, strict=True):
        offsets = both(averaged(cycles), (NEARER, NEARER + gap))
        rows += [
            Row(
                quantity=f"two presses {CM * gap:g} cm apart: error of the {which}",
                unit="cm", ours=CM * offset,
                why="Published: 1 to 4 cm too far, pressed by hand. A closed lumen reflects at its "
                "place; next to a rod that nearly closes it sound is trapped, and returns late.",
            )
            for which, offset in zip(("nearer", "farther"), offsets, strict=True)
        ]  # fmt: skip
    return rows


def _reach_figure(dynamic: float) -> Figure:
    sheet = Figure(figsize=(7, 4.5), layout="constrained")
    axes = sheet.subplots()
    fine = np.linspace(3.5, 21.0, 80)
    for coupled, colour, words in (
        (False, ENVELOPE, "by loss"), (True, SEND, "by loss, and area below 8 mm"),
    ):  # fmt: skip
        curve = [CM * reach(float(bore), dynamic, coupled=coupled) for bore in fine]
        axes.plot(fine, curve, color=colour, label=words)
    axes.plot(list(REACHES), list(REACHES.values()), "o", color=RETURN, label="measured")
    axes.plot(BORES[-1], WIDEST_REACH, "^", color=RETURN, label="measured, at least")
    axes.set(xlabel="bore (mm)", ylabel="farthest place (cm)", ylim=(0, None))
    axes.legend(fontsize="small")
    return sheet


def _pair_figure(pairs: Sequence[xr.Dataset]) -> Figure:
    sheet = Figure(figsize=(9, 6), layout="constrained")
    axes = sheet.subplots(len(pairs), 1, sharex=True)
    for panel, gap, cycles in zip(axes, GAPS, pairs, strict=True):
        ranging = averaged(cycles)
        delay = cycles["time"].values - ranging.send_time
        panel.plot(CM * signals.distance(delay, TEMPERATURE), 100 * ranging.envelope,
                   color=ENVELOPE)  # fmt: skip
        for place in (NEARER, NEARER + gap):
            panel.axvline(CM * place, color=RETURN, lw=0.8, ls=":")
        panel.set(xlim=(20, 150), ylim=(0, 2), ylabel="%")
    axes[-1].set_xlabel("distance (cm)")
    return sheet
