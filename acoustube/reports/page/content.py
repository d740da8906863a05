"""Content of an HTML page: states of a tube by depth, grouped by indenter and position."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array
from acoustube.reports.page.shapes import Shape, Tool
from acoustube.runs.config import Config, Mechanics

SAMPLES = 4000
"""Largest number of samples of a signal that are drawn, approximately."""
PRESSED = "A soft tube is pressed."
PULSED = (
    "Sound is sent into a soft tube. Where the tube is pressed its lumen narrows, and an echo "
    "comes back."
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Along:
    """The lumen's cross-section along the tube.

    Attributes
    ----------
    z, area : array of shape (n,)
        Axial position relative to the press in m, and cross-section of the lumen in m2.
    """

    z: Array
    area: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Signal:
    """Pressure at the probe and its envelope, over distance from the source end in m.

    Attributes
    ----------
    distance, pressure : array of shape (n,)
        Distance that corresponds to the delay, and pressure as a fraction of its largest magnitude.
    envelope_distance, envelope : array of shape (m,)
        Distance, and envelope as a fraction of its maximum in the send pulse.
    peak_distance, peak : array of shape (k,)
        Distances of all peaks of the envelope, and their heights in the unit of the envelope.
    estimate, amplitude : float
        Distance and height of the highest echo; nan where there is none.
    probe : float
        Position of the probe.
    source_end : str
        ``release`` or ``absorbing``.
    height : float
        Largest magnitude of `pressure` and `envelope` after the send pulse has decayed.
    """

    distance: Array
    pressure: Array
    envelope_distance: Array
    envelope: Array
    peak_distance: Array
    peak: Array
    estimate: float
    amplitude: float
    probe: float
    source_end: str
    height: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Spectrum:
    """Plane-wave reflection coefficient of a press.

    Attributes
    ----------
    frequency, reflection : array of shape (n,)
        Frequency in Hz; magnitude of the plane wave's reflection coefficient.
    settled : array of bool, shape (n,)
        True where the coefficient is reliable: the signal had decayed or, with the spectral method,
        the estimated error is within its tolerance.
    cut_ons : dict of float
        Cut-on of each higher mode in Hz, by name.
    carrier : float
        Carrier of the pulse in Hz.
    """

    frequency: Array
    reflection: Array
    settled: NDArray[np.bool_]
    cut_ons: Mapping[str, float]
    carrier: float


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """A tube pressed to one depth, in SI units.

    Attributes
    ----------
    depth, force, height, width, area : float
        Indentation depth and contact force, and size of the lumen under the indenter.
    shape : Shape or None
        Surfaces of the pressed tube; None if unknown.
    tool_height : float
        Coordinate y of the indenter's lowest point, as in `shape`; nan if unknown.
    along : Along or None
    signal : Signal or None
    spectrum : Spectrum or None
    """

    depth: float
    force: float
    height: float
    width: float
    area: float
    shape: Shape | None = None
    tool_height: float = np.nan
    along: Along | None = None
    signal: Signal | None = None
    spectrum: Spectrum | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Group:
    """States of one indenter at one place of one tube, in order of increasing depth.

    Attributes
    ----------
    tool, place, other : str
        In words: the indenter; its position, empty if there is none; other settings that vary
        between groups, empty if there are none.
    states : sequence of State
    solid : Tool
        Surface of the indenter.
    position, length : float
        Position of the press and length of the tube in m; nan where there is no position.
    bore_area, outer_diameter : float
        Cross-section of the bore in m2, and outer diameter of the tube in m.
    floor : float
        Coordinate y of the rigid floor in m; nan without one.
    """

    tool: str
    place: str
    other: str
    states: Sequence[State]
    solid: Tool
    position: float
    length: float
    bore_area: float
    outer_diameter: float
    floor: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Content:
    """Content of a page.

    Attributes
    ----------
    title, lead : str
        Heading, and the sentences under it.
    groups : sequence of Group
    settings : mapping
        Settings that all groups share, by section.
    origin : mapping of str to str
        Origin of the data, such as version and device, by name.
    notes : sequence of str
        Notes on the data, a sentence each.
    missing : mapping of str to str
        Reason for a missing picture, by its name: ``shape``, ``along``, ``signal``, ``spectrum``.
    """

    title: str
    lead: str
    groups: Sequence[Group]
    settings: Mapping[str, Any]
    origin: Mapping[str, str]
    notes: Sequence[str]
    missing: Mapping[str, str]


def tool_in_words(config: Config | Mechanics) -> str:
    """Return the indenter's shape, diameter, yaw and offset as text."""
    press = config.indentation
    turned = f", turned by {press.yaw_deg:g}°" if press.yaw_deg else ""
    beside = f", {press.offset_mm:g} mm beside the axis" if press.offset_mm else ""
    return f"{press.shape}, {press.indenter_mm:g} mm{turned}{beside}"


def signal_of(
    time: Array,
    pressure: Array,
    envelope: Array,
    peak_times: Array,
    peaks: Array,
    *,
    place: Callable[[Array], Array],
    faded: float,
    **others: Any,
) -> Signal:
    """Return the signal to draw from a recording.

    Parameters
    ----------
    time, pressure, envelope : array of shape (n,)
        Time in s, pressure in any unit, and envelope as a fraction of the send pulse.
    peak_times, peaks : array of shape (k,)
        Times in s of the peaks of the envelope, and their heights as fractions of the send pulse.
    place : callable
        Function that returns the distance in m of an echo from its time in s.
    faded : float
        Time in s at which the send pulse has decayed.
    **others
        The other attributes of :class:`Signal`.
    """
    pressure = pressure / np.abs(pressure).max()
    shown, smooth = drawn(pressure), drawn(envelope, np.searchsorted(time, peak_times))
    return Signal(
        distance=place(time[shown]),
        pressure=pressure[shown],
        envelope_distance=place(time[smooth]),
        envelope=envelope[smooth],
        peak_distance=place(peak_times),
        peak=peaks,
        height=float(np.abs([pressure, envelope])[:, time > faded].max(initial=0.0)),
        **others,
    )


def drawn(values: Array, keep: Sequence[int] | NDArray[np.int64] = ()) -> NDArray[np.int64]:
    """Return the indices of the samples to draw: a decimation that keeps the extremes.

    Parameters
    ----------
    values : array of shape (n,)
    keep : sequence of int
        Indices of samples to draw in any case.

    Returns
    -------
    array of int
        Rising indices. All if there are at most `SAMPLES` samples; otherwise those of the first,
        the least and the greatest sample of each of `SAMPLES` / 3 equal intervals, of the last
        sample, and those to keep.
    """
    n = len(values)
    if n <= SAMPLES:
        return np.arange(n)
    edges = np.unique(np.linspace(0, n, SAMPLES // 3 + 1).astype(np.int64))
    extremes = [
        a + extreme(values[a:b]) for a, b in pairwise(edges) for extreme in (np.argmin, np.argmax)
    ]
    return np.unique(np.concatenate([edges[:-1], extremes, np.asarray(keep, np.int64), [n - 1]]))
