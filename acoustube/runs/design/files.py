"""Files of a design: the Pareto front as a table, and sensors as settings of other commands."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import tomlkit

from acoustube.base.units import CM, KHZ
from acoustube.inversion.band import CHIRP_BAND
from acoustube.ranging import Burst, Chirp
from acoustube.runs.config import configured, to_toml
from acoustube.runs.config.checks import (
    coarsest_grid,
    shortest_for_middle,
    shortest_tube,
    usual_lowpass,
)
from acoustube.runs.config.goal import DesignGoal
from acoustube.runs.config.settings import WaveSettings
from acoustube.runs.design.candidates import Candidate
from acoustube.runs.sensor_file import OF_OTHERS, add_rangefinder

BAND_MARGIN = 0.04
"""Relative margin of a library's band, for recordings at other temperatures."""


def front_csv(front: Sequence[Candidate]) -> str:
    """Return the candidates of a Pareto front as a CSV table, in the order given."""
    text = io.StringIO()
    rows = [one.row for one in front]
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def sensor_toml(design: DesignGoal, candidate: Candidate) -> str:
    """Return a candidate's rangefinder and tube length as TOML text for ``--sensor``."""
    document = tomlkit.document()
    document.add(tomlkit.comment("The rangefinder of a designed sensor, for --sensor"))
    rangefinder = candidate.rangefinder
    if candidate.ends == 2:
        words = "A second, equal rangefinder is at the far end: acoustube invert --far"
        document.add(tomlkit.comment(words))
        rangefinder = replace(rangefinder, far_reflection=abs(rangefinder.face_reflection))
    if isinstance(candidate.rangefinder.drive, Chirp):
        low, high = library_band(candidate.rangefinder.drive)
        document.add(tomlkit.comment(f"Its library: acoustube library --band {low:g} {high:g}"))
    document.add(OF_OTHERS[0], round(CM * design.goal.reach_m, 6))
    add_rangefinder(document, rangefinder)
    document.remove("temperature_bias")  # by default that of the sleeve paper's thermometer
    return tomlkit.dumps(document)


def library_band(drive: Chirp) -> tuple[float, float]:
    """Return the band in kHz of a library for a chirp, in air within some 20 K of the library's."""
    half = (1 + BAND_MARGIN) * CHIRP_BAND * drive.bandwidth
    low, high = drive.frequency - half, drive.frequency + half
    return round(KHZ * low * (1 - BAND_MARGIN), 1), round(KHZ * high * (1 + BAND_MARGIN), 1)


def config_toml(design: DesignGoal, candidate: Candidate) -> str:
    """Return a candidate's tube, and a press of half its bore, as TOML text for ``--config``."""
    goal, spec, r = design.goal, candidate.tube, candidate.rangefinder
    assert isinstance(r.drive, Burst | Chirp)
    ground: dict[str, Any] = {"support": "held"}
    if goal.support == "arm":
        ground = {"support": "free", "layer_mm": goal.layer_mm, "layer_mpa": goal.layer_mpa}
    waves = WaveSettings(
        frequency_khz=round(KHZ * r.resonance, 4), temperature_c=goal.temperature_c,
        cycles=min(max(round(r.drive.duration * r.drive.frequency), 2), 100), method="spectral",
        losses="on",
    )  # fmt: skip
    outer = spec.bore + 2 * spec.wall
    length = max(
        CM * goal.reach_m, shortest_for_middle(outer, goal.tools_mm[0], waves),
        shortest_tube(waves, usual_lowpass(waves)),
    )  # fmt: skip
    config = configured(
        {}, inner_diameter_mm=spec.bore, wall_mm=spec.wall, shore_a=round(spec.shore, 3),
        length_cm=length, indenter_mm=goal.tools_mm[0], depth_mm=round(spec.bore / 2, 3),
        frequency_khz=waves.frequency_khz, cycles=waves.cycles,
        resolution=max(waves.resolution, coarsest_grid(spec.bore, waves)),
        temperature_c=goal.temperature_c, method=waves.method, losses=waves.losses, **ground,
    )  # fmt: skip
    return to_toml(config)
