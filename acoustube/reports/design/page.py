"""HTML page of a design: Pareto front, recommended sensors, their maps, limits and robustness."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from string import Template

import numpy as np

from acoustube.base.units import CM, MM, PERCENT
from acoustube.base.version import __version__
from acoustube.runs.config.goal import DesignGoal
from acoustube.runs.design.choice import Recommended

HEADINGS = {
    "bore_mm": "bore (mm)", "wall_mm": "wall (mm)", "hardness_shore_a": "hardness (Shore A)",
    "carrier_khz": "carrier (kHz)", "cycles": "cycles",
    "bandwidth_khz": "chirp (kHz)", "transducer": "transducer", "quality_factor": "quality factor",
    "rate_khz": "rate (kHz)", "bits": "bits", "ends": "ends", "reach_m": "reach (m)",
    "force_percent": "force, rms (%)", "force_median_percent": "force, median (%)",
    "resolution_cm": "resolution (cm)", "place_mm": "place (mm)",
    "nearest_cm": "nearest (cm)", "audible_db": "audible (dB)",
    "wrong_half_wave_percent": "wrong half wave (%)", "detected_percent": "detected (%)",
}  # fmt: skip
"""Headings of the columns of the table of sensors, by the keys of ``Candidate.row``."""


def page_of(
    goal: str,
    sensors: Sequence[Recommended],
    pictures: Mapping[str, bytes],
    notes: Sequence[str],
    design: DesignGoal,
) -> str:
    """Return the page of a design as self-contained HTML.

    Parameters
    ----------
    goal : str
        The goal as TOML.
    sensors : sequence of Recommended
        One or more.
    pictures : mapping of str to bytes
        PNG files: the maps of each sensor by its name NAME, its drawing by ``NAME drawing``, and
        the front by ``front``.
    notes : sequence of str
        Sentences on the validity of the results.
    design : DesignGoal
    """
    rows = "".join(
        f"<tr><th scope=row>{escape(one.name)}</th>"
        + "".join(f"<td>{value}</td>" for value in one.candidate.row.values()) + "</tr>"
        for one in sensors
    )  # fmt: skip
    template = Template(files("acoustube.reports.design").joinpath("page.html").read_text("utf-8"))
    return template.substitute(
        headings="".join(f"<th>{escape(HEADINGS[name])}</th>" for name in sensors[0].candidate.row),
        rows=rows, front=_image(pictures["front"], "front of the candidates"),
        sensors="".join(
            _sensor(one, pictures[one.name], pictures[f"{one.name} drawing"], design)
            for one in sensors
        ),
        notes="".join(f"<li>{escape(note)}</li>" for note in notes),
        goal=escape(goal), version=escape(__version__),
    )  # fmt: skip


def _pairs(one: Recommended, separation: float) -> str:
    """Return a sensor's results for two presses at once as HTML; empty if not computed."""
    if one.pairs is None:
        return ""
    detected, force = PERCENT * one.pairs.detection, PERCENT * np.median(one.pairs.force, axis=0)
    place = MM * np.median(one.pairs.place, axis=0)
    rows = "".join(
        f"<tr><th scope=row>{name}</th><td>{place[i]:.2f}</td><td>{force[i]:.1f}</td></tr>"
        for i, name in enumerate(("first", "second"))
    )
    return (
        f"<h3>Two presses {CM * separation:g} cm apart</h3><p>In {len(detected)} pairs the second "
        f"is detected with a probability of {np.mean(detected):.1f} % on average, "
        f"{np.min(detected):.1f} % at least.</p><table><tr><th>press</th>"
        f"<th>place, median (mm)</th><th>force, median (%)</th></tr>{rows}</table>"
    )


def _ranges(one: Recommended) -> str:
    """Return an HTML table of the ranges within which properties of a sensor's parts may vary."""
    rows = "".join(
        f"<tr><th scope=row>{escape(name)}</th><td>{low:.4g}</td><td>{high:.4g}</td></tr>"
        for name, (low, high) in one.ranges.items()
    )
    return (
        "<h3>Parts</h3><p>Each property is varied alone, with a calibration of its own. Within its "
        "range the error of force, with penalties for a missed goal, grows by a tenth at most.</p>"
        "<table>"
        f"<tr><th>part</th><th>from</th><th>to</th></tr>{rows}</table>"
    )


def _sensor(one: Recommended, picture: bytes, drawn: bytes, design: DesignGoal) -> str:
    """Return the part of the page on one sensor, as HTML; `picture` are its maps as PNG."""
    limits = "".join(
        f"<li>{escape(name)}: {PERCENT * share:.0f} %</li>"
        for name, share in sorted(one.limits.items(), key=lambda item: -item[1])
    )
    changed = "".join(
        f"<tr><th scope=row>{escape(name)}</th><td>{reach:.2f}</td><td>{PERCENT * force:.1f}</td>"
        f"<td>{CM * resolution:.1f}</td><td>{MM * place:.2f}</td></tr>"
        for name, (reach, force, resolution, place) in one.robustness.items()
    )
    table = "" if not changed else (
        "<h3>Robustness</h3><table><tr><th>made or used with</th><th>reach (m)</th>"
        "<th>force (%)</th><th>resolution (cm)</th><th>place (mm)</th></tr>" + changed + "</table>"
    )  # fmt: skip
    short = one.candidate.shortfalls(design)
    missed = f"<p>Misses the goal: {escape(', '.join(short))}.</p>" if short else ""
    return (
        f"<h2>{escape(one.name)}: {escape(one.words)}</h2>{missed}"
        f"{_image(drawn, f'drawing of {one.name}')}{_image(picture, f'maps of {one.name}')}"
        f"{_pairs(one, design.goal.separation)}{_ranges(one)}"
        f"<h3>Mean square error of force, by cause</h3><ul>{limits}</ul>{table}"
    )


def _image(picture: bytes, words: str) -> str:
    data = base64.b64encode(picture).decode()
    return f'<figure><img alt="{escape(words)}" src="data:image/png;base64,{data}"></figure>'
