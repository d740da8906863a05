"""Content of a page as JSON, in display units; each array is stored once, in base64."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from acoustube.base.units import CM, KHZ, MM, MM2, PERCENT
from acoustube.reports.figures import run as run_figure
from acoustube.reports.page.content import Content, Group, Signal, Spectrum, State
from acoustube.reports.scenes import tube as tube_scene

FINEST = 32767
"""Number of steps of a quantised coordinate to each side of zero: a 16-bit integer."""

COLOURS = {
    "wall": tube_scene.WALL, "lumen": tube_scene.LUMEN, "cut": tube_scene.SECTION,
    "tool": tube_scene.ROD, "floor": tube_scene.GROUND, "area": run_figure.AREA,
    "signal": run_figure.SIGNAL, "envelope": run_figure.ENVELOPE, "send": run_figure.SEND,
    "echo": run_figure.RETURN, "press": run_figure.PRESS,
}  # fmt: skip
"""Colours of the parts of a page: those of the figures."""


class Arrays:
    """Arrays of a page, each stored once.

    Attributes
    ----------
    kept : list of dict
        ``type``, ``scale`` and ``content`` (in base64) of each array; its values are the stored
        numbers times the scale.
    """

    def __init__(self) -> None:
        self.kept: list[dict[str, Any]] = []
        self._numbers: dict[bytes, int] = {}

    def real(self, values: Any) -> int:
        """Store an array in single precision, and return its index in `kept`.

        Values beyond that precision's range, as in a damaged file, become infinite and are not
        drawn.
        """
        with np.errstate(over="ignore"):
            return self._keep(np.asarray(values, "<f4").ravel(), "f4", 1.0)

    def coarse(self, values: Any) -> int:
        """Store an array in steps of 1/32767 of its largest magnitude, and return its index."""
        values = np.asarray(values, float).ravel()
        scale = float(np.abs(values).max(initial=0.0)) / FINEST or 1.0
        return self._keep(np.round(values / scale).astype("<i2"), "i2", scale)

    def whole(self, values: Any) -> int:
        """Store an array of natural numbers, and return its index."""
        values = np.asarray(values).ravel()
        small = values.max(initial=0) < 1 << 16
        return self._keep(values.astype("<u2" if small else "<u4"), "u2" if small else "u4", 1.0)

    def _keep(self, values: Any, kind: str, scale: float) -> int:
        content = values.tobytes()
        name = hashlib.sha256(f"{kind} {scale!r} ".encode() + content).digest()
        if name not in self._numbers:
            self._numbers[name] = len(self.kept)
            text = base64.b64encode(content).decode("ascii")
            self.kept.append({"type": kind, "scale": scale, "content": text})
        return self._numbers[name]


def encoded(content: Content) -> str:
    """Return a page's content as JSON, escaped for an HTML script element."""
    arrays = Arrays()
    page = {
        "title": content.title,
        "groups": [_group(group, arrays) for group in content.groups],
        "settings": _in_words(content.settings),
        "origin": dict(content.origin),
        "notes": list(content.notes),
        "missing": dict(content.missing),
        "colours": COLOURS,
        "arrays": arrays.kept,
    }
    text = json.dumps(page, allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    # Without "<", no text in the content can end the script element that contains it.
    return text.replace("<", "\\u003c")


def _in_words(settings: Mapping[str, Any]) -> dict[str, list[list[str]]]:
    """Return the settings that are not None as names and texts, by section."""
    return {
        section: [
            [name, f"{value:g}" if isinstance(value, float) else str(value)]
            for name, value in values.items()
            if value is not None
        ]
        for section, values in settings.items()
    }


def _number(value: float, scale: float = 1.0) -> float | None:
    """Return a number for JSON, times `scale` and rounded to six digits; None if not finite."""
    return float(f"{scale * value:.6g}") if math.isfinite(value) else None


def _group(group: Group, arrays: Arrays) -> dict[str, Any]:
    return {
        "tool": group.tool,
        "place": group.place,
        "other": group.other,
        "states": [_state(state, arrays) for state in group.states],
        "solid": {
            "points": arrays.coarse(MM * group.solid.points),
            "faces": arrays.whole(group.solid.faces),
            "outline": arrays.coarse(MM * group.solid.outline),
        },
        "position": _number(group.position, CM),
        "length": _number(group.length, CM),
        "bore": _number(group.bore_area, MM2),
        "diameter": _number(group.outer_diameter, MM),
        "floor": _number(group.floor, MM),
    }


def _state(state: State, arrays: Arrays) -> dict[str, Any]:
    shape = state.shape and {
        "points": arrays.coarse(MM * state.shape.points),
        "faces": {name: arrays.whole(faces) for name, faces in state.shape.faces.items()},
        "inner": arrays.coarse(MM * state.shape.inner),
        "outer": arrays.coarse(MM * state.shape.outer),
    }
    along = state.along and {
        "z": arrays.real(MM * state.along.z), "area": arrays.real(MM2 * state.along.area),
    }  # fmt: skip
    return {
        "depth": _number(state.depth, MM),
        "force": _number(state.force),
        "height": _number(state.height, MM),
        "width": _number(state.width, MM),
        "area": _number(state.area, MM2),
        "shape": shape,
        "tool": _number(state.tool_height, MM),
        "along": along,
        "signal": state.signal and _signal(state.signal, arrays),
        "spectrum": state.spectrum and _spectrum(state.spectrum, arrays),
    }


def _signal(signal: Signal, arrays: Arrays) -> dict[str, Any]:
    return {
        "distance": arrays.real(CM * signal.distance),
        "pressure": arrays.real(PERCENT * signal.pressure),
        "smooth": arrays.real(CM * signal.envelope_distance),
        "envelope": arrays.real(PERCENT * signal.envelope),
        "peakAt": arrays.real(CM * signal.peak_distance),
        "peak": arrays.real(PERCENT * signal.peak),
        "estimate": _number(signal.estimate, CM),
        "amplitude": _number(signal.amplitude, PERCENT),
        "height": _number(signal.height, PERCENT),
        "probe": _number(signal.probe, CM),
        "sourceEnd": signal.source_end,
    }


def _spectrum(spectrum: Spectrum, arrays: Arrays) -> dict[str, Any]:
    return {
        "frequency": arrays.real(KHZ * spectrum.frequency),
        "reflection": arrays.real(spectrum.reflection),
        "settled": arrays.whole(spectrum.settled.astype(int)),
        "cutOns": [[name, _number(at, KHZ)] for name, at in spectrum.cut_ons.items()],
        "carrier": _number(spectrum.carrier, KHZ),
    }
