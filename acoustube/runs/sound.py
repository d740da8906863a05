"""Sound in a pressed tube: recordings at the probe, and the press located in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from acoustube import signals
from acoustube.air import Air
from acoustube.base.moved import renamed
from acoustube.base.report import ignore
from acoustube.lumen import Lumen
from acoustube.runs.config.si import SISettings
from acoustube.waves import (
    Budget,
    CutCells,
    PlacedScatterer,
    Pulse,
    Recording,
    Scattering,
    SourceEnd,
    cut_cells,
    error_budget,
    grid_spacing,
    probe_pressure,
    propagate,
    scatter,
)

SOURCE_ENDS: tuple[SourceEnd, ...] = ("release", "absorbing")
"""Boundary conditions of the source end; both are computed, as a real end lies between them."""

BAND_EDGE = -20.0
"""Level in dB relative to the pulse's spectral peak down to which cut-ons are warned of."""

BAND_LEVEL = -70.0
"""Level in dB relative to the pulse's spectral peak at which the computed band ends."""
LOWEST_CARRIERS = 0.1
"""Lowest computed frequency of a short pulse, whose band reaches to zero, in carriers."""
FREQUENCY_STEP = 100.0
"""Step in Hz of a scattering matrix, whose response may last for 10 ms then."""
TIME_STEP = 1e-6
"""Time step in s of recordings that are joined from scattering and straight tube."""


def blind_time(settings: SISettings) -> float:
    """Return the time in s from the maximum of the send pulse's envelope to its decay."""
    return signals.blind_time(settings.pulse.duration, settings.cutoff)


def tube_recordings(
    settings: SISettings, space: Lumen, progress: Callable[[float], None] | None = None
) -> tuple[dict[SourceEnd, Recording], Budget]:
    """Return the recordings at the probe of a pulse in a whole lumen, by FDTD.

    Parameters
    ----------
    settings : SISettings
    space : Lumen
        The lumen; where it is symmetric about x = 0, half of it is computed.
    progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    recordings : dict of Recording
        For each choice of the source end.
    budget : Budget
        Known errors of the recordings.
    """
    air, probe = settings.air, settings.probe
    spacing = grid_spacing(settings.tube.inner_diameter, settings.resolution, probe)
    cells = cut_cells(space.surface, spacing, half=space.symmetric)
    recordings: dict[SourceEnd, Recording] = {}
    # Both on the time axis of the first: their limits differ by less than a permille.
    time_step: float | None = None
    for done, source_end in enumerate(SOURCE_ENDS):
        recordings[source_end] = propagate(
            cells,
            air,
            settings.pulse,
            duration=_duration(settings, air),
            probes=(probe,),
            source_end=source_end,
            time_step=time_step,
            lossy_band=band_of(settings.pulse) if settings.lossy else None,
            progress=_share_of(progress or ignore, done),
        )
        time_step = recordings[source_end].time_step
    return recordings, _budget(settings, cells, time_step, recordings)


def scattered_recordings(
    settings: SISettings, part: Lumen, progress: Callable[[float], None] | None = None
) -> tuple[dict[SourceEnd, Recording], Budget]:
    """Return the recordings of :func:`tube_recordings` from the scattering of the pressed part.

    Parameters
    ----------
    settings : SISettings
    part : Lumen
        The pressed part, from :func:`acoustube.lumen.pressed_part`.
    progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    recordings : dict of Recording
        For each choice of the source end.
    budget : Budget
        Known errors of the recordings.
    """
    matrix, cells = scattering_of(
        part, settings.air, band_of(settings.pulse), bore=settings.tube.inner_diameter,
        resolution=settings.resolution, lossy=settings.lossy, progress=progress,
    )  # fmt: skip
    recordings = joined_recordings(settings, [PlacedScatterer(matrix, settings.position)])
    return recordings, _budget(settings, cells, None, recordings)


def scattering_of(
    part: Lumen,
    air: Air,
    band: tuple[float, float],
    *,
    bore: float,
    resolution: int,
    lossy: bool,
    progress: Callable[[float], None] | None = None,
) -> tuple[Scattering, CutCells]:
    """Return the scattering matrix of a press, referred to its own position.

    Parameters
    ----------
    part : Lumen
        The pressed part, from :func:`acoustube.lumen.pressed_part`.
    air : Air
    band : tuple of float
        Lowest and highest frequency in Hz.
    bore : float
        Inner diameter in m.
    resolution : int
        Grid cells across the bore.
    lossy : bool
        With losses at the wall and in the air.
    progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    scattering : Scattering
        In steps of `FREQUENCY_STEP`.
    cells : CutCells
        The lumen on its grid.
    """
    across, length = bore / resolution, 2 * part.position
    # A whole number of layers, so that the grid of a symmetric press is symmetric too.
    spacing = across, across, length / np.ceil(length / across)
    lowest, highest = band
    count = int(np.ceil((highest - lowest) / FREQUENCY_STEP))
    cells = cut_cells(part.surface, spacing)
    matrix = scatter(
        cells,
        air,
        lowest + FREQUENCY_STEP * np.arange(count + 1),
        reference=(part.position, part.position),
        lossy=lossy,
        symmetric=part.symmetric,
        symmetric_only=part.symmetric,
        progress=progress,
    )
    return matrix, cells


def joined_recordings(
    settings: SISettings, presses: Sequence[PlacedScatterer]
) -> dict[SourceEnd, Recording]:
    """Return the recordings at the probe of a tube, from presses of known scattering.

    Parameters
    ----------
    settings : SISettings
    presses : sequence of PlacedScatterer
        Instead of the settings' press; none for an untouched tube.

    Returns
    -------
    dict of Recording
        For each choice of the source end. Spacing and shape of the grid are the first press's.
    """
    air, probe = settings.air, settings.probe
    recordings: dict[SourceEnd, Recording] = {}
    for source_end in SOURCE_ENDS:
        time, pressure = probe_pressure(
            presses,
            air,
            settings.pulse,
            radius=settings.radius,
            length=settings.tube.length,
            duration=_duration(settings, air),
            time_step=TIME_STEP,
            probes=[probe],
            source_reflection=-1.0 if source_end == "release" else 0.0,
            lossy=settings.lossy,
        )
        # A bend has no grid.
        found = (press.scattering for press in presses)
        first = next((matrix for matrix in found if isinstance(matrix, Scattering)), None)
        recordings[source_end] = Recording(
            time=time,
            pressure=pressure,
            time_step=TIME_STEP,
            probes=(probe,),
            spacing=first.spacing if first else (np.nan,) * 3,
            shape=first.shape if first else (0, 0, 0),
        )
    return recordings


def _budget(
    settings: SISettings,
    cells: CutCells,
    time_step: float | None,
    recordings: Mapping[SourceEnd, Recording],
) -> Budget:
    """Return the known errors of recordings."""
    return error_budget(
        cells,
        settings.air,
        frequency=settings.pulse.frequency,
        highest=settings.pulse.band(BAND_EDGE)[1],
        radius=settings.radius,
        time_step=time_step,
        lossy=settings.lossy,
        pressure=recordings[settings.source_end].pressure,
    )


def band_of(pulse: Pulse) -> tuple[float, float]:
    """Return the band in Hz in which the sound of a pulse is computed."""
    lowest, highest = pulse.band(BAND_LEVEL)
    return max(lowest, LOWEST_CARRIERS * pulse.frequency), highest


def _duration(settings: SISettings, air: Air) -> float:
    """Return a time in s that is long enough for the middle of an echo from the far end."""
    return 2 * settings.tube.length / air.sound_speed + 0.5 * settings.pulse.duration


def _share_of(progress: Callable[[float], None], done: int) -> Callable[[float], None]:
    """Return the progress function of one source end, after `done` others."""
    return lambda part: progress((done + part) / len(SOURCE_ENDS))


def locate(settings: SISettings, recording: Recording) -> signals.Ranging:
    """Find the press in a recording by the settings' processing."""
    return signals.process(
        recording.time,
        recording.pressure[0],
        pulse_duration=settings.pulse.duration,
        probe_position=settings.probe,
        temperature=settings.temperature,
        cutoff=settings.cutoff,
        prominence=settings.prominence,
        farthest=settings.tube.length,
    )


__getattr__ = renamed(
    __name__,
    {
        "listen": "tube_recordings",
        "listen_by_parts": "scattered_recordings",
        "joined": "joined_recordings",
    },
)
