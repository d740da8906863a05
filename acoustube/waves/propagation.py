"""Propagation of a pulse through a lumen by finite differences in the time domain (FDTD)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acoustube.air import Air
from acoustube.base.checks import DURATION, LENGTH, PLACE, Either, Optional, Reals, Several, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.waves.grid.cells import CutCells
from acoustube.waves.modes.probes import (
    ModalProbe,
    PointProbe,
    Probe,
    launching,
    with_probes,
)
from acoustube.waves.scheme.leapfrog import CHUNK, Array, Progress, march
from acoustube.waves.scheme.problem import FarEnd, Setup, SourceEnd, prepare
from acoustube.waves.scheme.pulse import check_pulse

Signal = Callable[[Array], ArrayLike]
CONE_MARGIN = 32
"""Number of layers that are advanced beyond those that sound can have reached."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """Pressure at probes over time.

    Attributes
    ----------
    time : ndarray
        (n,) in s, from 0 in steps of `time_step`.
    pressure : ndarray
        Pressure, or amplitude of a probed mode, in units of the pulse, (n_probes, n).
    time_step : float
        In s.
    probes : tuple of float
        Actual axial positions of the probes in m.
    spacing : tuple of float
        Cell size (dx, dy, dz) in m.
    shape : tuple of int
        Number of grid cells (nx, ny, nz), absorbers included.
    """

    time: Array
    pressure: Array
    time_step: float
    probes: tuple[float, ...]
    spacing: tuple[float, float, float]
    shape: tuple[int, int, int]


@checked(inner_diameter=LENGTH, resolution=Number(1, 1e6, "cells"), probe=LENGTH)
def grid_spacing(
    inner_diameter: float, resolution: int, probe: float = 0.02
) -> tuple[float, float, float]:
    """Return the cell size that divides the bore and puts cell centres on the probe plane.

    Parameters
    ----------
    inner_diameter : float
        Diameter of the bore in m.
    resolution : int
        Number of cells across the bore.
    probe : float
        Distance of the probe plane from the source end in m.

    Returns
    -------
    tuple of float
        (dx, dy, dz) in m with dx = dy, and dz the largest value up to dx that divides the probe's
        distance.

    Raises
    ------
    ValueError
        If the probe lies within the first cell layer.
    """
    across = inner_diameter / resolution
    if probe < across:
        raise ValueError(
            f"probe = {probe} m lies within the first cell layer; use at least {across:.3g} m, "
            f"inner_diameter / resolution"
        )
    # With a tolerance, so that a distance of a whole number of cells keeps that number.
    return across, across, probe / ceil(probe / across - 1e-9)


@checked(
    cells=CutCells,
    air=Air,
    duration=DURATION,
    probes=Several(Either((ModalProbe, PointProbe), PLACE), 1),
    source_mode=str,
    absorber_thickness=LENGTH,
    time_step=Optional(DURATION),
    lossy_band=Optional(Reals(1e-3, 1e12, "Hz", ndim=1, last=2)),
)
def propagate(
    cells: CutCells,
    air: Air,
    pulse: Signal,
    *,
    duration: float,
    probes: tuple[Probe, ...] = (0.02,),
    source_end: SourceEnd = "release",
    source_mode: str = "00",
    far_end: FarEnd = "absorbing",
    absorber_thickness: float = 0.02,
    time_step: float | None = None,
    lossy_band: tuple[float, float] | None = None,
    progress: Progress | None = None,
) -> Recording:
    """Compute the propagation of a pulse through a lumen, and record the pressure at probes.

    Parameters
    ----------
    cells : CutCells
        The lumen.
    air : Air
        Gas in the lumen.
    pulse : callable
        Pressure as a function of time in s, zero before t = 0: a `Pulse`, a `SampledPulse` or any
        such function.
    duration : float
        Recorded time in s.
    probes : tuple of Probe
        Each a `ModalProbe`, a `PointProbe`, or the distance in m from the source end of a plane
        over which the pressure is averaged.
    source_mode : str
        Mode launched by the absorbing end, as ``11c``; see `ModalProbe`.
    source_end, far_end, absorber_thickness, time_step, lossy_band
        See `prepare`. With the release end the pressure at z = 0 is the pulse, afterwards 0; with
        the absorbing end the plane wave launched at z = 0 has the pulse's pressure. A rigid end
        has no source.
    progress : callable, optional
        Called with the finished fraction after each chunk of 250 steps.

    Returns
    -------
    Recording
        Pressure at each probe.

    Raises
    ------
    SimulationError
        If the pressure is no longer finite.
    ValueError
        If the pulse is longer than the run, the source end is rigid, or `source_mode` is not ``00``
        although the source end does not absorb; see also `prepare` and `with_probes`.

    Notes
    -----
    The volume-weighted mean over a layer of a straight section is the projection on the plane
    mode: every other discrete mode is orthogonal to it.
    """
    check_pulse(pulse, duration)
    if source_end == "rigid":
        raise ConfigError(
            "has no source", setting="source_end", value=source_end,
            allowed=("release", "absorbing"), advice="use one of these",
        )  # fmt: skip
    if source_mode != "00" and source_end != "absorbing":
        raise ValueError(
            f'source_mode = "{source_mode}" needs source_end = "absorbing", not "{source_end}"'
        )
    places = tuple(
        one.position if isinstance(one, ModalProbe | PointProbe) else one for one in probes
    )
    setup = prepare(
        cells, air, probes=places, source_end=source_end,
        far_end=far_end, absorber_thickness=absorber_thickness, time_step=time_step,
        lossy_band=lossy_band,
    )  # fmt: skip
    setup = with_probes(setup, probes, air)
    n_samples = ceil(duration / setup.time_step) + 1
    # Whole chunks only: a shorter last one would be compiled anew for every duration.
    n_steps = CHUNK * ceil((n_samples - 1) / CHUNK)
    time = np.arange(n_steps + 1) * setup.time_step
    samples = np.asarray(pulse(time), dtype=float)
    if source_mode != "00":
        setup, source = launching(setup, samples, source_mode, air)
    elif source_end == "absorbing":
        source = launching_source(samples, setup, air)
    else:
        source = samples[1:]
    layers = audible_layers(setup, air, n_steps, n_samples)
    _, pressure = march(setup, setup.state, source, layers=layers, progress=progress)
    silence = np.zeros((len(setup.probes), 1))
    return Recording(
        time=time[:n_samples],
        pressure=np.concatenate([silence, pressure], axis=1)[:, :n_samples],
        time_step=setup.time_step, probes=setup.probes, spacing=cells.spacing,
        shape=setup.cells.shape,
    )  # fmt: skip


def audible_layers(setup: Setup, air: Air, n_steps: int, n_samples: int) -> NDArray[np.int64]:
    """Return the number of layers that can affect the recording in each step of a run from rest.

    Sound from the source has not yet reached the layers beyond, or can no longer return from them
    to a probe before the recording ends.

    Parameters
    ----------
    setup : Setup
        The discrete problem.
    air : Air
        Gas in the lumen.
    n_steps : int
        Number of time steps.
    n_samples : int
        Number of recorded samples, the first at rest.

    Returns
    -------
    ndarray
        Number of layers from the first, (n_steps,).

    Notes
    -----
    `CONE_MARGIN` layers are added. No resolved wave of the scheme is faster than sound, but a
    discrete wave front has a small precursor.
    """
    courant = air.sound_speed * setup.time_step / setup.cells.spacing[2]
    step = np.arange(1, n_steps + 1)
    reached = setup.source_layer + courant * step
    heard = int(np.max(setup.scheme.probe_layers)) + courant * np.maximum(n_samples - step, 0)
    layers = np.ceil(np.minimum(reached, heard)).astype(np.int64) + CONE_MARGIN
    n_layers = setup.cells.shape[2]
    return layers.clip(min(setup.source_layer + CONE_MARGIN, n_layers), n_layers)


def launching_source(wave: Array, setup: Setup, air: Air) -> Array:
    """Return the source's pressure increments per step that launch a given plane wave at z = 0.

    Parameters
    ----------
    wave : ndarray
        Required pressure at z = 0 at the start and at the end of each step, (n+1,).
    setup : Setup
        The discrete problem.
    air : Air
        Gas in the lumen.

    Returns
    -------
    ndarray
        Pressure increments in the unit of `wave`, (n,).

    Notes
    -----
    With theta, Omega, nu and beta of :mod:`acoustube.waves.scheme.operator` and s = sin(theta/2),
    the residue of the axial Green's function gives the amplitude p of the plane wave that
    increments of amplitude g in the middle of the steps launch,
    p/g = sqrt(1 + 4 beta s^2) / (2 nu cos(theta/2) (1 + 8 beta s^2)).
    With beta = (1 - nu^2)/12 this is (1 + Omega^2/8) / (2 nu), with an error of fourth order. The
    factor 1 + Omega^2/8 is cancelled by the mean of two neighbouring samples of the wave, whose
    response is cos(Omega/2). The source layer and its neighbours also have a near field of a few
    per cent.
    """
    courant = air.sound_speed * setup.time_step / setup.cells.spacing[2]
    return courant * (wave[1:] + wave[:-1])
