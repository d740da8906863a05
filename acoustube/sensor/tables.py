"""Scattering of a library's tools at fixed frequencies, at depths dense enough for interpolation.

Between adjacent depths of the tables the scattering is interpolated linearly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.inversion import Library, Tool
from acoustube.inversion.tables import MOST_MODES, cut_on_law
from acoustube.waves.cut_on_steps import Onsets, onsets
from acoustube.waves.interpolation import interpolated
from acoustube.waves.scattering import Complex

MOST_PARTS = 64
"""Largest number of parts into which an interval between depths of a library is divided."""
EQUAL = 1e-6
"""Difference, relative to the largest coefficient, up to which coefficients count as equal."""


@dataclass(frozen=True, eq=False)
class PressTables:
    """Scattering coefficients of the tools of a library, at rows of depth.

    Attributes
    ----------
    values : ndarray
        Real and imaginary parts of the distinct coefficients, (n_rows, 2, n_different, n_f)
        float32; the rows of one tool follow those of the one before.
    number : ndarray of int
        Index of each coefficient of a scattering matrix among the distinct ones, (2, m, 2, m).
    depths : ndarray
        Depths of each tool's rows in m, from 0, padded with infinity, (n_tools, n_most).
    first : ndarray of int
        Each tool's first row, (n_tools,).
    forces : ndarray
        Forces in N at the depths, padded with infinity, (n_tools, n_most).
    diameters : ndarray
        Of the tools in m, rising, (n_tools,).
    between : ndarray
        Relative rms error of the plane wave's reflection by each tool if it is interpolated between
        the next smaller and the next larger tool, (n_tools,). It is the largest over the common
        depths; nan for the first and the last tool.
    """

    values: NDArray[np.float32]
    number: NDArray[np.int64]
    depths: Array
    first: NDArray[np.int64]
    forces: Array
    diameters: Array
    between: Array

    @property
    def modes(self) -> int:
        """Number m of modes that propagate between contacts."""
        return int(self.number.shape[1])

    @property
    def deepest(self) -> Array:
        """Largest depth of each tool in m, (n_tools,)."""
        return np.max(np.where(np.isfinite(self.depths), self.depths, 0), axis=1)


def press_tables(
    library: Library, frequency: Complex, stretch: float, tolerance: float
) -> PressTables:
    """Return the scattering of a library's tools at fixed frequencies, over refined depths.

    Parameters
    ----------
    library : Library
    frequency : ndarray
        Complex frequencies in Hz, evenly spaced, (n_f,).
    stretch : float
        Ratio of the speed of sound in the tube to that of the library.
    tolerance : float
        Relative rms error that linear interpolation between rows may add to the cubic splines
        between the library's depths.

    Raises
    ------
    ConfigError
        If tools differ in shape or have equal diameters, a depth is 0, the first mode is not the
        plane mode, or the scattering of a tool is not reciprocal.

    Notes
    -----
    At depth 0 the tube is untouched: all is transmitted. Coefficients that are equal at all depths
    and frequencies, by reciprocity and by the mirror symmetry of a press, are stored once.
    """
    tools = sorted(library.tools, key=lambda tool: tool.diameter)
    diameters = np.array([tool.diameter for tool in tools])
    if len({tool.shape for tool in tools}) > 1 or np.any(np.diff(diameters) <= 0):
        raise ConfigError(
            f"the library holds {', '.join(tool.name for tool in tools)}; give one whose "
            "indenters have one shape and different diameters"
        )
    if any(tool.depth[0] <= 0 for tool in tools):
        raise ConfigError(
            "the first depth of the library is 0, at which the tube is untouched; leave it out"
        )
    number, kept = _different(tools)
    plane = int(number[0, 0, 0, 0])
    rows, depths, forces, reflections = [], [], [], []
    for tool in tools:
        nodes = np.concatenate([[0.0], tool.depth])
        columns = _at_frequencies(tool, kept, frequency, stretch)
        splines = [CubicSpline(nodes, column) for column in columns]
        reflections.append(splines[plane])
        found = _refined(splines, nodes, plane, tolerance)
        depths.append(found)
        rows.append(_rows(splines, found))
        shallow = found < tool.depth[0]
        rising = np.where(shallow, tool.force[0] * found / tool.depth[0],
                          tool.force_at(np.maximum(found, tool.depth[0])))  # fmt: skip
        forces.append(np.maximum.accumulate(rising))
    return PressTables(
        values=rows.pop() if len(rows) == 1 else np.concatenate(rows),
        number=number, depths=_padded(depths), forces=_padded(forces),
        first=np.cumsum([0, *(len(d) for d in depths[:-1])]), diameters=diameters,
        between=_error_between(reflections, depths, diameters),
    )  # fmt: skip


def _different(tools: list[Tool]) -> tuple[NDArray[np.int64], list[int]]:
    """Return the index of each coefficient among the distinct ones, and where these first occur."""
    m = min(len(tools[0].modes), MOST_MODES)
    if tools[0].modes[0] != "00":
        raise ConfigError(
            f"the first mode of the library is {tools[0].modes[0]}, not the plane mode, 00; make "
            "it anew"
        )
    flat = np.concatenate([tool.s[:, :, :, :m, :, :m].reshape(-1, (2 * m) ** 2) for tool in tools])
    equal = EQUAL * float(np.abs(flat).max())
    number, kept = np.zeros(flat.shape[1], int), list[int]()
    for i in range(flat.shape[1]):
        same = (n for n, j in enumerate(kept) if np.abs(flat[:, i] - flat[:, j]).max() <= equal)
        number[i] = next(same, len(kept))
        if number[i] == len(kept):
            kept.append(i)
    square = number.reshape(2 * m, 2 * m)
    if np.any(square != square.T):
        raise ConfigError("the scattering of the library is not reciprocal; make it anew")
    return number.reshape(2, m, 2, m), kept


def _at_frequencies(tool: Tool, kept: list[int], frequency: Complex, stretch: float) -> Complex:
    """Return a tool's distinct coefficients over depth at frequencies in Hz, (n_different, n, n_f).

    The first of the n depths is 0, the untouched tube; the others are those of the tool. `kept`
    holds the places of the distinct coefficients in the flattened matrix. `stretch` is the ratio of
    the speed of sound in the tube to that of the library.
    """
    m = min(len(tool.modes), MOST_MODES)
    s = tool.s[:, :, :, :m, :, :m]
    untouched = np.zeros(s.shape[1:], s.dtype)
    for mode in range(m):
        propagates = np.any(s[:, :, :, mode] != 0, axis=(0, 2, 3, 4))
        for port in (0, 1):
            untouched[:, port, mode, 1 - port, mode] = propagates
    speed = stretch * tool.sound_speed
    cut_ons, axial = cut_on_law(tool, m, speed)
    begun = onsets(cut_ons)
    given = tool.frequency * stretch
    found = np.empty((len(kept), len(s) + 1, len(frequency)), complex)
    for row, place in zip(found, kept, strict=True):  # one by one, for a tenth of the memory
        o, i, p, j = map(int, np.unravel_index(place, s.shape[2:]))
        column = np.column_stack([untouched[:, o, i, p, j], s[:, :, o, i, p, j].T])
        same = Onsets(*(np.full(column.shape[1], one[place]) for one in begun))
        row[:] = interpolated(given, column.astype(complex), frequency, same, axial).T
    return found


def _refined(splines: list[CubicSpline], nodes: Array, plane: int, tolerance: float) -> Array:
    """Return depths, the nodes among them, so dense that linear interpolation meets the tolerance.

    The splines are those of the distinct coefficients over depth. The error is relative for that of
    index `plane`, the plane wave's reflection, and absolute for the others. It is computed in the
    middle of each interval between nodes and falls with the square of the number of parts of the
    interval, of which there are at most :data:`MOST_PARTS`.
    """
    middle, worst = (nodes[1:] + nodes[:-1]) / 2, np.zeros(len(nodes) - 1)
    for i, spline in enumerate(splines):
        ends, exact = spline(nodes), spline(middle)
        size = np.maximum(_rms(exact), 1e-6) if i == plane else 1.0
        worst = np.maximum(worst, _rms((ends[1:] + ends[:-1]) / 2 - exact) / size)
    parts = np.ceil(np.sqrt(worst / tolerance)).astype(int)
    parts = np.clip(parts, 1, MOST_PARTS)
    pieces = [
        a + (b - a) * np.arange(n) / n for a, b, n in zip(nodes[:-1], nodes[1:], parts, strict=True)
    ]
    return np.concatenate([*pieces, nodes[-1:]])


def _rows(splines: list[CubicSpline], depths: Array) -> NDArray[np.float32]:
    """Return distinct coefficients (real, imaginary) at depths, (n_rows, 2, n_different, n_f)."""
    values = np.empty((len(depths), 2, len(splines), splines[0].c.shape[-1]), np.float32)
    for i, spline in enumerate(splines):
        found = spline(depths)
        values[:, 0, i], values[:, 1, i] = found.real, found.imag
    return values


def _rms(values: Complex) -> Array:
    """Return the root mean square of magnitudes over the last axis."""
    return np.sqrt(np.mean(np.abs(values) ** 2, axis=-1))


def _padded(arrays: list[Array]) -> Array:
    """Return arrays of different length as rows, padded with infinity."""
    found = np.full((len(arrays), max(map(len, arrays))), np.inf)
    for row, one in zip(found, arrays, strict=True):
        row[: len(one)] = one
    return found


def _error_between(reflections: list[CubicSpline], depths: list[Array], diameters: Array) -> Array:
    """Return relative rms errors of each tool's reflection interpolated between its neighbours."""
    found = np.full(len(reflections), np.nan)
    for i in range(1, len(reflections) - 1):
        deepest = min(depths[j][-1] for j in (i - 1, i, i + 1))
        d = depths[i][(depths[i] > 0) & (depths[i] <= deepest)]
        low, exact, high = (reflections[j](d) for j in (i - 1, i, i + 1))
        w = (diameters[i] - diameters[i - 1]) / (diameters[i + 1] - diameters[i - 1])
        found[i] = np.max(_rms((1 - w) * low + w * high - exact) / _rms(exact))
    return found
