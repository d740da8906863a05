"""Arrays of a sensor on a wrapped tube: modes of the bends, and presses between them.

The modes of the bent tube propagate without conversion, with a phase that is an integral along the
tube (:mod:`acoustube.inversion.wrap`). The scattering of a press between these modes
(:mod:`acoustube.inversion.joints`) varies with depth and, as the curvature does, with place. It is
computed at every depth of the tables for a few places and interpolated between them. Its reference
plane is the place of the press, as if the bend continued through it: a press of depth 0 then
transmits all, and the matrices vary little with place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.base.units import CM
from acoustube.inversion import Library, Wrap
from acoustube.inversion.wrap import MODES, NEARLY, WrappedPath
from acoustube.sensor.tables import PressTables
from acoustube.waves.modes.grid_modes import wavenumbers
from acoustube.waves.scattering import Complex

PLACES = 9
"""Number of places along a wrap at which the scattering of presses is computed. Linear
interpolation between them changes echoes of presses on the sleeve paper's arm by up to 0.2 %
(rms)."""
SPACING = 0.01
"""Largest spacing in m of the places at which the phases are tabulated; between these places the
phases are interpolated linearly."""
ROWS = 64
"""Number of rows of the tables (each one depth of one indenter) that are converted to the modes of
the bends at once, in double precision."""


def wrapped_path(
    wrap: Wrap, air: Air, frequency: Complex, library: Library, modes: int
) -> WrappedPath:
    """Return the propagation along a wrapped tube at complex frequencies.

    Parameters
    ----------
    wrap : Wrap
    air : Air
    frequency : ndarray
        Complex frequencies in Hz, evenly spaced, (n_f,).
    library : Library
    modes : int
        Number of modes of the presses' matrices, the first ones of the library.
    """
    names = library.modes[:modes]
    k = wavenumbers(names, frequency, library.radius, air, lossy=True)
    none = np.zeros_like(k)
    return WrappedPath(wrap, air, frequency, library.radius, names, k, none, 0.0)


def check_wrap(wrap: Wrap, length: float) -> None:
    """Raise :class:`ConfigError` if a wrap has no place for a press, or ends beyond its tube."""
    if wrap.stop > length + NEARLY:
        raise ConfigError(
            f"the wrap ends at {CM * wrap.stop:.5g} cm, beyond the tube's length of "
            f"{CM * length:.5g} cm; make length {wrap.stop:.5g} m or more"
        )
    if wrap.stop - wrap.start <= 2 * wrap.reach:
        raise ConfigError(
            f"a wrap from {CM * wrap.start:.4g} to {CM * wrap.stop:.4g} cm has no place for a "
            f"press, which takes {2 * CM * wrap.reach:.4g} cm; check lead and loops"
        )


def phases(path: WrappedPath) -> tuple[Array, Array]:
    """Return the integrals of -j times the modes' wavenumbers from the start of the wrap.

    Returns
    -------
    decay, turn : ndarray
        Real part in nepers, and imaginary part in revolutions, (n_z, m, n_f), at equal steps of at
        most :data:`SPACING` along the wrap.
    """
    start, stop = path.wrap.start, path.wrap.stop
    n = max(int(np.ceil((stop - start) / SPACING)), 2) + 1
    phase = (path.phase(np.linspace(start, stop, n)) - path.phase(start)).swapaxes(1, 2)
    return phase.imag, -phase.real / (2 * np.pi)


def joined_tables(tables: PressTables, library: Library, path: WrappedPath) -> PressTables:
    """Return the scattering of presses between the modes of a wrap, at places along it.

    Parameters
    ----------
    tables : PressTables
        Of the straight tube.
    library : Library
    path : WrappedPath

    Returns
    -------
    PressTables
        Its rows are those of the given tables at the first of :data:`PLACES` places, then at the
        second, and so on.

    Notes
    -----
    At depth 0 there is the bend alone; from the library's first depth on, the tube is taken as
    straight over the reach of a press. The scattering is interpolated between these depths.
    """
    upper = np.triu_indices(2 * MODES)
    number = np.zeros((2 * MODES, 2 * MODES), int)
    number[upper] = number.T[upper] = np.arange(len(upper[0]))
    n_rows, _, _, n_f = tables.values.shape
    values = np.empty((PLACES, n_rows, 2, len(upper[0]), n_f), np.float32)
    tools = sorted(library.tools, key=lambda tool: tool.diameter)
    for found, place in zip(
        values, np.linspace(path.wrap.start, path.wrap.stop, PLACES), strict=True
    ):
        for begin in range(0, n_rows, ROWS):
            rows = slice(begin, begin + ROWS)
            joined = _joined(tables.values[rows], tables.number, path, float(place))
            part = joined.reshape(len(joined), n_f, 2 * MODES, 2 * MODES)[:, :, *upper]
            found[rows, 0], found[rows, 1] = part.real.swapaxes(1, 2), part.imag.swapaxes(1, 2)
        for tool, first, depth in zip(tools, tables.first, tables.depths, strict=True):
            shallow = int(np.searchsorted(depth, tool.depth[0] * (1 - 1e-9)))
            share = (depth[:shallow] / depth[shallow])[:, None, None, None]
            found[first : first + shallow] = share * found[first + shallow]
            found[first : first + shallow] += (1 - share) * _bend(number)
    return replace(
        tables, values=values.reshape(-1, *values.shape[2:]),
        number=number.reshape(2, MODES, 2, MODES),
    )  # fmt: skip


def _joined(
    rows: NDArray[np.float32], number: NDArray[np.int64], path: WrappedPath, place: float
) -> Complex:
    """Return rows of the straight tube's tables as scattering between a wrap's modes at a place.

    `rows` and `number` are as in :class:`PressTables`, with n rows, (n, 2, n_different, n_f); the
    place is in m. The result is (n, n_f, 2, 3, 2, 3): port and mode out, port and mode in.
    """
    from acoustube.inversion.joint_sums import joined_values  # imports Numba, if a tube is wrapped

    n, _, _, n_f = rows.shape
    m = number.shape[1]
    s = np.zeros((n, n_f, 2, MODES, 2, MODES), complex)
    given = (rows[:, 0] + 1j * rows[:, 1])[:, number.ravel()].reshape(n, 2, m, 2, m, n_f)
    s[:, :, :, :m, :, :m] = np.moveaxis(given, -1, 1)
    reach = path.wrap.reach
    ports = np.clip([place - reach, place + reach], path.wrap.start, path.wrap.stop)
    joints = path.joints(ports)[:, None]
    way, through = np.exp(-1j * reach * path.k), -np.exp(-2j * reach * path.own_k)
    shapes = (2, n, *joints.shape[2:]), (n, *way.shape), (n, *through.shape)
    full = [
        np.ascontiguousarray(np.broadcast_to(one, shape))
        for one, shape in zip((joints, way, through), shapes, strict=True)
    ]
    # Sections end at the place of the press, although the bend ends at the ports.
    inside = np.exp(1j * np.diff(path.phase([place - reach, place, place + reach]), axis=0))
    back = inside.swapaxes(0, 1)
    return np.asarray(joined_values(s, *full) * back[:, :, :, None, None] * back[:, None, None])


def _bend(number: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the coefficients of a bend without a press: each mode is transmitted unchanged.

    They are real and imaginary parts of the distinct coefficients, (2, n_different, 1), equal at
    all frequencies.
    """
    m = len(number) // 2
    found = np.zeros((2, number.max() + 1, 1), np.float32)
    found[0, number[np.arange(m), m + np.arange(m)]] = 1.0
    return found


def far_end(path: WrappedPath, length: float, reflection: float) -> Complex:
    """Return the reflection matrix of a tube's far end, seen at the wrap's end, (n_f, m, m)."""
    k = np.concatenate([path.k, path.own_k], axis=1)
    passed, reflected = path.joint(path.wrap.stop)
    end = reflection * np.exp(-2j * k * (length - path.wrap.stop))
    return np.asarray(passed.swapaxes(1, 2) @ (end[:, :, None] * passed) + reflected)


def untouched_echo(path: WrappedPath, far: Complex, entry: Complex, face: complex) -> Complex:
    """Return the echo of a wrapped tube without contact or clutter, (n_f,).

    It is the amplitude of the plane mode that arrives at the transducer's face, relative to that
    launched there; repeated reflections at the face are included.

    Parameters
    ----------
    path : WrappedPath
    far : ndarray
        Reflection matrix from :func:`far_end`, (n_f, m, m).
    entry : ndarray
        Matrix of :class:`acoustube.inversion.paths.Entry`, from the m_s straight modes at the face
        to the m modes of the wrap, (n_f, m, m_s).
    face : complex
        Reflection coefficient of the transducer's face.
    """
    way = np.exp(-1j * (path.phase(path.wrap.stop) - path.phase(path.wrap.start)))
    load = entry.swapaxes(1, 2) @ (way[:, :, None] * far * way[:, None]) @ entry
    loop = np.eye(load.shape[-1]) - face * load
    return np.asarray(np.linalg.solve(loop, load)[:, 0, 0])
