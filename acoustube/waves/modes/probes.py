"""Probes of the mean pressure, of a mode's amplitude or of a point's pressure; modal sources."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sqrt
from typing import NamedTuple

import numpy as np

from acoustube.air import Air
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.grid.straight_part import is_mirrored
from acoustube.waves.modes.grid_modes import DuctModes, duct_modes, labels, phases
from acoustube.waves.scheme.operator import on_device
from acoustube.waves.scheme.problem import Setup

CELLS_PER_RADIAN = 1.5
"""Smallest number of cells per 1/k for which a mode can be probed; k is the wavenumber in free air
at the mode's cut-on."""


class ModalProbe(NamedTuple):
    """Probe of the amplitude of a duct mode, to be placed in a straight part of the tube.

    Attributes
    ----------
    position : float
        Distance from the source end in m.
    mode : str
        As ``11c``: nodal diameters, nodal circles, and c for symmetric about x = 0, s for
        antisymmetric. The mode's pressure has a mean square of one over the section.
    """

    position: float
    mode: str


class PointProbe(NamedTuple):
    """Probe of the pressure at a point, interpolated across the tube.

    Attributes
    ----------
    position, x, y : float
        Distance from the source end, and transverse coordinates, in m.
    """

    position: float
    x: float
    y: float


Probe = float | ModalProbe | PointProbe
"""Probe; a distance in m stands for the mean pressure over the plane (plane-mode amplitude)."""


def with_probes(setup: Setup, probes: tuple[Probe, ...], air: Air) -> Setup:
    """Return a setup with the weights of modal and point probes.

    Parameters
    ----------
    setup : Setup
        Prepared with a plane at the position of each probe.
    probes : tuple of Probe
        In the order of these planes.
    air : Air

    Raises
    ------
    ValueError
        If a mode is not resolved by the grid or not defined, see :func:`named_mode`, or a point
        does not lie in the air.
    """
    scheme = setup.scheme
    weights = [
        _weights(probe, setup, int(layer), air)
        for probe, layer in zip(probes, scheme.probe_layers, strict=True)
    ]
    stacked = on_device(np.stack(weights, axis=-1), scheme.probe_weights.dtype)
    return replace(setup, scheme=scheme._replace(probe_weights=stacked))


def _weights(probe: Probe, setup: Setup, layer: int, air: Air) -> Array:
    """Return the weights of a probe over its layer, (nx, ny)."""
    volume = setup.cells.volume_fraction[:, :, layer]
    if isinstance(probe, ModalProbe):
        modes, which = named_mode(setup, layer, probe.mode, air)
        return modes.weights[which]
    if isinstance(probe, PointProbe):
        return _at_point(probe, setup, volume)
    return np.asarray(volume / volume.sum())


def named_mode(setup: Setup, layer: int, name: str, air: Air) -> tuple[DuctModes, int]:
    """Return the modes of a layer that the grid resolves, and the index of the named one.

    Parameters
    ----------
    setup : Setup
    layer : int
        Index of a layer in a straight part.
    name : str
        Name of the mode; see `ModalProbe`.
    air : Air

    Raises
    ------
    ValueError
        If the grid resolves no mode of that name, or the section has no symmetry about x = 0, from
        which modes other than the plane one have their names.
    """
    dx, dy, _ = setup.cells.spacing
    half = setup.cells.origin[0] == 0.0
    volume = setup.cells.volume_fraction
    section = volume[:, :, layer]
    if name != "00" and not half and not is_mirrored(section):
        raise ValueError(
            f'mode = "{name}" is not defined, because the section is not symmetric about x = 0; '
            "turn or move the lumen"
        )
    highest = air.sound_speed / (2 * pi * CELLS_PER_RADIAN * dx)
    modes = duct_modes(setup.scheme, volume, layer, highest, whole=not half)
    radius = sqrt(volume[:, :, layer].sum() * dx * dy * (2 if half else 1) / pi)
    names = labels(modes, radius, air.sound_speed)
    if name not in names:
        raise ValueError(
            f'mode = "{name}" is not one of {", ".join(names)}, which this grid '
            "resolves; use one of these or a finer grid"
        )
    return modes, names.index(name)


def _at_point(probe: PointProbe, setup: Setup, volume: Array) -> Array:
    """Return the bilinear weights of the open cells around a point."""
    # A half model stands for both halves.
    x = abs(probe.x) if setup.cells.origin[0] == 0.0 else probe.x
    weights_of_axes = [
        np.clip(1 - np.abs(setup.cells.centres(axis) - value) / setup.cells.spacing[axis], 0, 1)
        for axis, value in enumerate((x, probe.y))
    ]
    weights = np.where(volume > 0, np.outer(*weights_of_axes), 0.0)
    if not weights.sum() > 0:
        raise ValueError(
            f"the point at x = {probe.x:.4g} m, y = {probe.y:.4g} m is not in the air; move "
            "it into the lumen"
        )
    return np.asarray(weights / weights.sum())


def launching(setup: Setup, wave: Array, mode: str, air: Air) -> tuple[Setup, Array]:
    """Return a setup and source increments that launch a mode into the tube.

    Parameters
    ----------
    setup : Setup
        Setup with an absorber before z = 0.
    wave : ndarray
        Required amplitude of the mode at z = 0, at the start and at the end of each step, (n+1,).
    mode : str
        See `ModalProbe`.
    air : Air

    Returns
    -------
    setup : Setup
        Setup whose source has the shape of the mode.
    source : ndarray
        Pressure increments in the unit of `wave`, one per step, (n,).

    Raises
    ------
    ValueError
        If the grid resolves no mode of that name, or it is not defined, see :func:`named_mode`.

    Notes
    -----
    The response to a unit source in a layer is exp(-j theta m) / (j slope), m layers away in either
    direction, with theta and slope of `grid_modes.Phases`. The increments are the wave divided by
    this response at each frequency; at the cut-on, where the slope vanishes, they vanish too. The
    source layer and its neighbours also have a near field of a few per cent.
    """
    modes, which = named_mode(setup, setup.source_layer, mode, air)
    # Padded against wrap-around: the filter's response decays slowly at a cut-on.
    n = 4 * len(wave)
    omega = 2 * pi * np.fft.rfftfreq(n)[1:]
    slope = phases(
        modes, setup.scheme, setup.cells.spacing[2], omega / (2 * pi * setup.time_step),
        air.sound_speed,
    ).slope[:, which]  # fmt: skip
    # The second difference of the pressure follows the first difference of the increments.
    gain = 1j * slope / (1 - np.exp(-1j * omega))
    spectrum = np.fft.rfft(wave, n)
    spectrum[0], spectrum[1:] = 0.0, spectrum[1:] * gain
    shape = on_device(modes.shapes[which], setup.scheme.source.dtype)
    driven = replace(setup, scheme=setup.scheme._replace(source=shape))
    return driven, np.fft.irfft(spectrum, n)[: len(wave) - 1]
