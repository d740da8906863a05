"""Page of a design: front, recommended sensors, their maps, limits and robustness."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from string import Template

from acoustube.base.units import CM, MM, PERCENT
from acoustube.base.version import __version__
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
"""Names of the columns of a table of sensors."""


def page_of(
    goal: str, sensors: Sequence[Recommended], pictures: Mapping[str, bytes], notes: Sequence[str]
) -> str:
    """Return the page as HTML that needs no other file.

    Parameters
    ----------
    goal : str
        The goal as TOML.
    sensors : sequence of Recommended
    pictures : mapping of str to bytes
        PNG by the name of the sensor, and ``front``.
    notes : sequence of str
        Sentences on the validity of the results.
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
        sensors="".join(_sensor(one, pictures[one.name]) for one in sensors),
        notes="".join(f"<li>{escape(note)}</li>" for note in notes),
        goal=escape(goal), version=escape(__version__),
    )  # fmt: skip


def _sensor(one: Recommended, picture: bytes) -> str:
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
    return (
        f"<h2>{escape(one.name)}: {escape(one.words)}</h2>{_image(picture, f'maps of {one.name}')}"
        f"<h3>Mean square error of force, by cause</h3><ul>{limits}</ul>{table}"
    )


def _image(picture: bytes, words: str) -> str:
    data = base64.b64encode(picture).decode()
    return f'<figure><img alt="{escape(words)}" src="data:image/png;base64,{data}"></figure>'
