"""Sound in a pressed tube: recordings at the probe, and the press located in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from acoustube import signals
from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.base.moved import renamed
from acoustube.base.report import part_of
from acoustube.lumen import Lumen
from acoustube.runs.config.si import SISettings
from acoustube.runs.scattering_file import StoredScattering
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
from acoustube.waves.budget import SpectralBudget, spectral_budget
from acoustube.waves.spectral import SpectralScattering, scatter_spectral, wall_of
from acoustube.waves.spectral.result import ERROR_QUANTILE

SOURCE_ENDS: tuple[SourceEnd, ...] = ("release", "absorbing")
"""Boundary conditions of the source end; both are computed, as a real end lies between them."""

BAND_EDGE = -20.0
"""Level in dB re the pulse's spectral peak; cut-ons where the spectrum exceeds it are reported."""

BAND_LEVEL = -70.0
"""Level in dB relative to the pulse's spectral peak at which the computed band ends."""
LOWEST_CARRIERS = 0.05
"""Lowest computed frequency divided by the carrier; 6e-5 of a one-cycle pulse's energy is lower."""
FREQUENCY_STEP = 100.0
"""Frequency step in Hz of a scattering matrix, for impulse responses of up to 10 ms."""
LOSSLESS_REFINEMENT = 4
"""Factor by which the frequency step of the spectral solver is divided without losses."""
LARGEST_SPECTRAL_ERROR = 0.02
"""Largest accepted error estimate of the spectral solver at 95 % (library: 75 %) of frequencies."""
TIME_STEP = 1e-6
"""Time step in s of recordings computed from scattering matrices and straight tube."""


def blind_time(settings: SISettings) -> float:
    """Return the duration in s of the send pulse's envelope after its maximum."""
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
        For each boundary condition at the source end.
    budget : Budget
        Known errors of the recordings.
    """
    air, probe = settings.air, settings.probe
    spacing = grid_spacing(settings.tube.inner_diameter, settings.resolution, probe)
    cells = cut_cells(space.surface, spacing, half=space.symmetric)
    recordings: dict[SourceEnd, Recording] = {}
    # Both source ends take the time step of the first: their stability limits differ by < 0.1 %.
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
            progress=part_of(progress, done / len(SOURCE_ENDS), (done + 1) / len(SOURCE_ENDS)),
        )
        time_step = recordings[source_end].time_step
    return recordings, _budget(settings, cells, time_step, recordings)


def scattered_recordings(
    settings: SISettings, part: Lumen, progress: Callable[[float], None] | None = None
) -> tuple[dict[SourceEnd, Recording], Budget | SpectralBudget, str]:
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
        For each boundary condition at the source end.
    budget : Budget or SpectralBudget
        Known errors of the recordings.
    note : str
        Reason why the requested spectral solver was not used, or the statement that its estimated
        error exceeds the tolerance; empty otherwise.
    """
    matrix, cells, note = scattering_of(
        part, settings.air, band_of(settings.pulse), method=settings.method,
        bore=settings.tube.inner_diameter, resolution=settings.resolution, lossy=settings.lossy,
        progress=progress,
    )  # fmt: skip
    recordings = joined_recordings(settings, [PlacedScatterer(matrix, settings.position)])
    if isinstance(matrix, SpectralScattering):
        return recordings, spectral_budget(matrix, recordings[settings.source_end].pressure), note
    return recordings, _budget(settings, cast(CutCells, cells), None, recordings), note


def scattering_of(
    part: Lumen,
    air: Air,
    band: tuple[float, float],
    *,
    method: str,
    bore: float,
    resolution: int,
    lossy: bool,
    progress: Callable[[float], None] | None = None,
) -> tuple[StoredScattering, CutCells | None, str]:
    """Return the scattering matrix of a press, with both reference planes at its middle.

    Parameters
    ----------
    part : Lumen
        The pressed part, from :func:`acoustube.lumen.pressed_part`.
    air : Air
    band : tuple of float
        Lowest and highest frequency in Hz.
    method : {"scattering", "spectral"}
        Time-domain or spectral solver. The time-domain solver also computes lumens for which the
        spectral solver is requested but unsuitable.
    bore : float
        Inner diameter in m.
    resolution : int
        Grid cells across the bore.
    lossy : bool
        Whether there are losses at the wall and in the air.
    progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    scattering : Scattering or SpectralScattering
        In frequency steps of `FREQUENCY_STEP`, which the spectral solver refines without losses.
    cells : CutCells or None
        The lumen on the grid of the time-domain solver; None for the spectral one.
    note : str
        Reason why the requested spectral solver was not used, or the statement that its estimated
        error exceeds the tolerance; empty otherwise.
    """
    note = ""
    if method == "spectral":
        try:
            found = spectral_scattering_of(part, air, band, lossy=lossy)
            return found, None, _excess(found)
        except ConfigError as reason:
            cause = str(reason).partition(";")[0]
            note = (
                "The time-domain solver computed the scattering, since the spectral solver "
                f"cannot: {cause}"
            )
    across, length = bore / resolution, 2 * part.position
    # A whole number of layers, so that the grid of a symmetric press is symmetric too.
    spacing = across, across, length / np.ceil(length / across)
    cells = cut_cells(part.surface, spacing)
    matrix = scatter(
        cells,
        air,
        _frequencies(band, FREQUENCY_STEP),
        reference=(part.position, part.position),
        lossy=lossy,
        symmetric=part.symmetric,
        symmetric_only=part.symmetric,
        progress=progress,
    )
    return matrix, cells, note


def _excess(matrix: SpectralScattering) -> str:
    """Return a note if the estimated error exceeds the tolerance at over 5 % of the frequencies."""
    return matrix.excess if matrix.typical_error > matrix.tolerance else ""


def spectral_scattering_of(
    part: Lumen,
    air: Air,
    band: tuple[float, float],
    *,
    lossy: bool,
    share: float = ERROR_QUANTILE,
) -> SpectralScattering:
    """Return the scattering matrix of a press by the spectral solver, as :func:`scattering_of`.

    Parameters
    ----------
    part, air, band, lossy
        As of :func:`scattering_of`.
    share : float
        Fraction of the frequencies at which the estimated error must be at most
        `LARGEST_SPECTRAL_ERROR`.

    Raises
    ------
    ConfigError
        If the lumen is unsuitable for the spectral solver, or its error estimate is too large.
    """
    # Without losses a trapped mode rings for longer than the inverse of the usual step.
    step = FREQUENCY_STEP if lossy else FREQUENCY_STEP / LOSSLESS_REFINEMENT
    try:
        found = scatter_spectral(
            wall_of(part), air, _frequencies(band, step), lossy=lossy, symmetric_only=part.symmetric
        )
    except np.linalg.LinAlgError as cause:
        raise ConfigError(
            "the sections of the lumen overlap themselves; use method = scattering"
        ) from cause
    error = float(np.quantile(found.error, share))
    if not error <= LARGEST_SPECTRAL_ERROR:
        raise ConfigError(
            f"the spectral solver's error estimate is {error:.1g}, more than "
            f"{LARGEST_SPECTRAL_ERROR:g}; use method = scattering"
        )
    return found


def _frequencies(band: tuple[float, float], step: float) -> NDArray[np.float64]:
    """Return equally spaced frequencies in Hz from the lowest of a band to the highest or above."""
    lowest, highest = band
    return np.asarray(lowest + step * np.arange(int(np.ceil((highest - lowest) / step)) + 1))


class SpectralCheck(NamedTuple):
    """The echo of a press from its spectral scattering matrix, for each source end.

    Attributes
    ----------
    distance : tuple of float
        Distance of the highest echo in m; nan without one.
    amplitude : tuple of float
        Amplitude of the highest echo, relative to the send pulse; nan without one.
    error : float
        Estimated error of the scattering coefficients, 95 % quantile over frequency.
    note : str
        Statement that the error exceeds the tolerance; empty otherwise.
    """

    distance: tuple[float, ...]
    amplitude: tuple[float, ...]
    error: float
    note: str = ""


def spectral_check(settings: SISettings, part: Lumen) -> SpectralCheck:
    """Return the echo of a pressed part from the spectral solver.

    Raises
    ------
    ConfigError
        As :func:`spectral_scattering_of`.
    """
    band = band_of(settings.pulse)
    matrix = spectral_scattering_of(part, settings.air, band, lossy=settings.lossy)
    recordings = joined_recordings(settings, [PlacedScatterer(matrix, settings.position)])
    found = [locate(settings, recordings[end]) for end in SOURCE_ENDS]
    return SpectralCheck(
        tuple(float(ranging.distance) for ranging in found),
        tuple(float(ranging.amplitude) for ranging in found),
        matrix.typical_error,
        _excess(matrix),
    )


def joined_recordings(
    settings: SISettings, presses: Sequence[PlacedScatterer]
) -> dict[SourceEnd, Recording]:
    """Return the recordings at the probe of a tube, from presses of known scattering.

    Parameters
    ----------
    settings : SISettings
    presses : sequence of PlacedScatterer
        Presses in place of that of the settings; none for an untouched tube.

    Returns
    -------
    dict of Recording
        For each boundary condition at the source end. Spacing and shape are those of the first
        grid of a press; nan and 0 if no press has a grid.
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
    """Return the error budget of recordings by FDTD."""
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
    """Return the duration in s of a recording: to the middle of an echo from the far end."""
    return 2 * settings.tube.length / air.sound_speed + 0.5 * settings.pulse.duration


def locate(settings: SISettings, recording: Recording) -> signals.Ranging:
    """Estimate the distance of the press from a recording, with the settings' signal processing."""
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
