"""Simulation of one press: indentation, lumen, waves, signals."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import jax
import numpy as np
import xarray as xr

from acoustube.air import NARROW_GAP_LAYERS, viscous_thickness
from acoustube.base.checks import Optional, checked
from acoustube.base.errors import SimulationError
from acoustube.base.limits import LARGEST_CLOSING
from acoustube.base.report import ignore
from acoustube.base.types import Report
from acoustube.base.units import KHZ, MM, MS, UM
from acoustube.indentation import Indentation
from acoustube.lumen import lumen, measure, pressed_part
from acoustube.runs import results
from acoustube.runs.config import Config, check_touched
from acoustube.runs.config.si import SISettings, settings_in_si
from acoustube.runs.presses import press_to
from acoustube.runs.sound import (
    BAND_EDGE,
    blind_time,
    locate,
    scattered_recordings,
    spectral_check,
    tube_recordings,
)
from acoustube.waves import Budget, attenuation, cut_ons_in_band
from acoustube.waves.budget import SpectralBudget
from acoustube.waves.scheme.cpu_ahead import compile_march


@checked(config=Optional(Config))
def simulate(
    config: Config | None = None,
    *,
    report: Report | None = None,
    pressed: Callable[[xr.Dataset], None] | None = None,
) -> xr.Dataset:
    """Simulate a press, a pulse in the lumen, and the localisation of the press by its echo.

    Parameters
    ----------
    config : Config, optional
        The settings; see :func:`acoustube.load_config`. The sleeve paper's tube and a 25 mm rod by
        default.
    report : callable, optional
        Called with the name of a stage and the fraction of it that is done.
    pressed : callable, optional
        Called before the sound is computed, with a dataset of ``inner_wall``, ``outer_wall`` and
        ``true_distance`` of the pressed tube.

    Returns
    -------
    xarray.Dataset
        Every stage's arrays, in SI units, with both boundary conditions of the source end along the
        dimension ``source_end``. ``distance`` and ``amplitude`` are those of the condition that the
        settings select.

    Raises
    ------
    SimulationError
        If a stage cannot finish.
    ConfigError
        If the depth in the settings is zero.

    Notes
    -----
    Each stage is a function: :func:`acoustube.indentation.indent`,
    :func:`acoustube.lumen.lumen`, :func:`acoustube.waves.cut_cells`,
    :func:`acoustube.waves.propagate`, :func:`acoustube.signals.process`.
    """
    config = config or Config()
    check_touched(config.indentation)
    settings = settings_in_si(config)
    report = report or ignore
    seconds: dict[str, float] = {}
    notes: list[str] = []

    with stage("indentation", seconds, report) as progress:
        march = [partial(compile_march, lossy=settings.lossy)] * (settings.method == "full")
        indentation = press_to(settings, [settings.depth], progress, notes.append, then=march)
    with stage("lumen", seconds, report):
        space = lumen(indentation, settings.position)
    if pressed is not None:
        pressed(results.walls(config, space))
    budget: Budget | SpectralBudget
    with stage("waves", seconds, report) as progress:
        if settings.method == "full":
            recordings, budget = tube_recordings(settings, space, progress)
        else:
            part = pressed_part(indentation)
            recordings, budget, unsuitable = scattered_recordings(settings, part, progress)
            notes += [unsuitable] if unsuitable else []
    with stage("signals", seconds, report):
        rangings = {end: locate(settings, recording) for end, recording in recordings.items()}
    check = None
    if settings.method == "full":
        with stage("check", seconds, report):
            try:
                check = spectral_check(settings, pressed_part(indentation))
                notes += [f"Spectral solver: {check.note}"] if check.note else []
            except ValueError as error:
                reason = str(error).partition(";")[0]
                notes.append(f"The spectral solver could not verify this run: {reason}")

    return results.dataset(
        config,
        settings,
        indentation,
        space,
        recordings,
        rangings,
        seconds=seconds,
        budget=budget,
        check=check,
        warnings=[*notes, *warnings_for(settings), *_narrow(settings, indentation)],
        device=jax.devices()[0].device_kind,
    )


def warnings_for(settings: SISettings) -> list[str]:
    """Return a warning for each limit of the model that the settings exceed or approach."""
    air, pulse, radius = settings.air, settings.pulse, settings.radius
    found = [
        f"Mode ({mode.m},{mode.n}) cuts on at {KHZ * mode.cut_on:.2f} kHz, inside the pulse's "
        "band: small errors of bore or temperature decide whether it propagates."
        for mode in cut_ons_in_band(pulse.band(BAND_EDGE), radius, air.sound_speed)
    ]
    path = 2 * (settings.position - settings.probe)
    blind = blind_time(settings)
    if path < air.sound_speed * blind:
        found.append(
            f"The echo comes back within {MS * blind:.2f} ms of the send pulse, a time that is not "
            "searched: move the press away from the source or raise the low-pass."
        )
    if not settings.lossy:
        loss = attenuation(0, 0, pulse.frequency, radius, air) * path * 20 / np.log(10)
        found.append(
            f"The losses are off; boundary layers and the air, {settings.temperature:g} degC warm, "
            f"would lower this echo by {loss:.1f} dB."
        )
    return found


def _narrow(settings: SISettings, indentation: Indentation) -> list[str]:
    """Return warnings if the lumen is too narrow for the grid or for the model of losses."""
    found, bore = [], settings.tube.inner_diameter
    height = measure(indentation, -1, np.array([indentation.indenters[0].z])).height[0]
    if settings.method != "spectral" and height < (1 - LARGEST_CLOSING) * bore:
        found.append(
            f"At {MM * settings.depth:g} mm the walls of the {MM * bore:g} mm lumen meet, or "
            f"nearly: sound in gaps narrower than a cell of {MM * bore / settings.resolution:.2g} "
            "mm is approximate."
        )
    layers = height / viscous_thickness(settings.air, settings.pulse.frequency)
    if layers < NARROW_GAP_LAYERS:
        found.append(
            f"The lumen is {UM * height:.0f} um high under the indenter, {layers:.0f} viscous "
            "boundary layers: there the first-order model of losses is not valid."
        )
    return found


@contextmanager
def stage(
    name: str, seconds: dict[str, float], report: Report
) -> Iterator[Callable[[float], None]]:
    """Report a stage, add its time in s to `seconds`, raise a ValueError as a SimulationError."""
    start = time.perf_counter()
    report(name, 0.0)
    try:
        yield lambda fraction: report(name, fraction)
    except ValueError as error:
        raise SimulationError(f"{name}: {error}") from error
    report(name, 1.0)
    seconds[name] = time.perf_counter() - start
