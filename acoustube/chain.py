"""The whole chain for one press: tube, indentation, lumen, waves, signals."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import jax
import numpy as np
import xarray as xr

from acoustube import record, signals
from acoustube.air import LAYERS_OF_A_GAP, Air, air_at, viscous_thickness
from acoustube.config import Config, check_touched
from acoustube.errors import SimulationError
from acoustube.indentation import Indentation
from acoustube.limits import LARGEST_CLOSING
from acoustube.lumen import Lumen, lumen, measure, pressed_part
from acoustube.mechanics import pressed
from acoustube.rules import filled
from acoustube.waves import (
    Budget,
    CutCells,
    Placed,
    Pulse,
    Recording,
    Scattering,
    SourceEnd,
    attenuation,
    cut_cells,
    cut_ons_in_band,
    error_budget,
    grid_spacing,
    heard,
    propagate,
    scatter,
)

SOURCE_ENDS: tuple[SourceEnd, ...] = ("release", "absorbing")
"""Both choices of the source end are computed: a real one lies between them."""

BAND_EDGE = -20.0
"""Level in dB under the pulse's spectral peak down to which a mode's cut-on is warned of."""

HEARD = -70.0
"""Level in dB under the pulse's spectral peak down to which its sound is followed."""
LOWEST = 0.1
"""Lowest frequency that is followed of a short pulse, whose band reaches to zero, in carriers."""
FREQUENCY_STEP = 100.0
"""Step in Hz of a scattering matrix, whose response may last for 10 ms then."""
TIME_STEP = 1e-6
"""Of the sound in s that is put together from scattering and straight tube."""

Report = Callable[[str, float], None]
"""Called with the name of a stage and the fraction of it that is done."""


def simulate(config: Config | None = None, *, report: Report | None = None) -> xr.Dataset:
    """Press a tube once, send a pulse through it, and find the press by its echo.

    Parameters
    ----------
    config : Config, optional
        The settings; see :func:`acoustube.load_config`. The paper's tube and a 25 mm rod by
        default.
    report : callable, optional
        Called with the name of a stage and the fraction of it that is done.

    Returns
    -------
    xarray.Dataset
        Every stage's arrays, in SI units, with both choices of the source end along the dimension
        ``source_end``. ``distance`` and ``amplitude`` are those of the chosen one.

    Raises
    ------
    SimulationError
        If a stage cannot finish.
    ConfigError
        If the tube is not pressed.

    Notes
    -----
    The stages are functions of their own: :func:`acoustube.indentation.indent`,
    :func:`acoustube.lumen.lumen`, :func:`acoustube.waves.cut_cells`,
    :func:`acoustube.waves.propagate`, :func:`acoustube.signals.process`.
    """
    config = config or Config()
    check_touched(config)
    report = report or _silent
    seconds: dict[str, float] = {}
    notes: list[str] = []
    air = air_of(config)

    with stage("indentation", seconds, report) as progress:
        depth = 1e-3 * config.indentation.depth_mm
        indentation = pressed(config, [depth], progress, notes.append)
    with stage("lumen", seconds, report):
        space = lumen(indentation, 1e-2 * filled(config.indentation.position_cm))
    with stage("waves", seconds, report) as progress:
        if config.waves.method == "full":
            recordings, budget = listen(config, space, progress)
        else:
            recordings, budget = listen_by_parts(config, pressed_part(indentation), progress)
    with stage("signals", seconds, report):
        rangings = {end: locate(config, recording) for end, recording in recordings.items()}

    return record.dataset(
        config,
        indentation,
        space,
        recordings,
        rangings,
        sound_speed=air.sound_speed,
        seconds=seconds,
        budget=budget,
        warnings=[*notes, *warnings_for(config), *_narrow(config, indentation)],
        device=jax.devices()[0].device_kind,
    )


def warnings_for(config: Config) -> list[str]:
    """Return one sentence for each way in which the settings leave the model's range."""
    waves, radius = config.waves, 0.5e-3 * config.tube.inner_diameter_mm
    air, pulse = air_of(config), _pulse(config)
    found = [
        f"Mode ({mode.m},{mode.n}) cuts on at {1e-3 * mode.cut_on:.2f} kHz, inside the pulse's "
        "band: small errors of bore or temperature decide whether it propagates."
        for mode in cut_ons_in_band(pulse.band(BAND_EDGE), radius, air.sound_speed)
    ]
    path = 2 * (1e-2 * filled(config.indentation.position_cm) - _probe(config))
    blind = blind_time(config)
    if path < air.sound_speed * blind:
        found.append(
            f"The echo comes back within {1e3 * blind:.2f} ms of the send pulse, where it is not "
            "looked for: move the press away from the source or raise the low-pass."
        )
    depth, bore = config.indentation.depth_mm, config.tube.inner_diameter_mm
    if depth > LARGEST_CLOSING * bore:
        found.append(
            f"At {depth:g} mm the walls of the {bore:g} mm lumen meet, or nearly: what is narrower "
            f"than a cell of {bore / waves.resolution:.2g} mm passes sound only about as it should."
        )
    if waves.losses == "off":
        loss = attenuation(0, 0, pulse.frequency, radius, air) * path * 20 / np.log(10)
        found.append(
            f"The losses are off; boundary layers and the air, {waves.temperature_c:g} degC warm, "
            f"would lower this echo by {loss:.1f} dB."
        )
    return found


def blind_time(config: Config) -> float:
    """Return how long after its maximum the send pulse's envelope has faded, in s."""
    return signals.blind_time(_pulse(config).duration, 1e3 * filled(config.signals.lowpass_khz))


def _narrow(config: Config, indentation: Indentation) -> list[str]:
    """Return a warning where the lumen is so narrow that its boundary layers fill it."""
    height = measure(indentation, -1, np.array([indentation.presses[0].z])).height[0]
    layers = height / viscous_thickness(air_of(config), 1e3 * config.waves.frequency_khz)
    warning = (
        f"The lumen is {1e6 * height:.0f} um high under the tool, {layers:.0f} viscous boundary "
        "layers: the losses there are more than first order."
    )
    return [warning] if layers < LAYERS_OF_A_GAP else []


def air_of(config: Config) -> Air:
    """Return the air in the tube that the settings describe."""
    waves = config.waves
    return air_at(
        waves.temperature_c,
        humidity=waves.humidity_percent,
        pressure=1e3 * waves.pressure_kpa,
    )


def _pulse(config: Config) -> Pulse:
    return Pulse(frequency=1e3 * config.waves.frequency_khz, cycles=config.waves.cycles)


def listen(
    config: Config, space: Lumen, progress: Callable[[float], None] | None = None
) -> tuple[dict[SourceEnd, Recording], Budget]:
    """Send a pulse through a lumen and record it at the probe plane.

    Parameters
    ----------
    config : Config
        The settings of the tube and of the sound.
    space : Lumen
        The lumen; where it is symmetric about x = 0, half of it is computed.
    progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    recordings : dict of Recording
        For each choice of the source end.
    budget : Budget
        What they can be trusted with.
    """
    air, pulse, probe = air_of(config), _pulse(config), _probe(config)
    spacing = grid_spacing(1e-3 * config.tube.inner_diameter_mm, config.waves.resolution, probe)
    cells = cut_cells(space.surface, spacing, half=space.symmetric)
    recordings: dict[SourceEnd, Recording] = {}
    # Both on the time axis of the first: their limits differ by less than a permille.
    time_step: float | None = None
    for done, source_end in enumerate(SOURCE_ENDS):
        recordings[source_end] = propagate(
            cells,
            air,
            pulse,
            duration=_duration(config, air),
            probes=(probe,),
            source_end=source_end,
            time_step=time_step,
            lossy_band=band_of(config) if config.waves.losses == "on" else None,
            progress=_share_of(progress or _ignore, done),
        )
        time_step = recordings[source_end].time_step
    return recordings, _budget(config, cells, time_step, recordings)


def listen_by_parts(
    config: Config, part: Lumen, progress: Callable[[float], None] | None = None
) -> tuple[dict[SourceEnd, Recording], Budget]:
    """Return what :func:`listen` does, from the scattering of the pressed part and straight tube.

    Parameters
    ----------
    config : Config
        The settings of the tube and of the sound.
    part : Lumen
        The pressed part, from :func:`acoustube.lumen.pressed_part`.
    progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    recordings : dict of Recording
        For each choice of the source end.
    budget : Budget
        What they can be trusted with.
    """
    bore = 1e-3 * config.tube.inner_diameter_mm
    matrix, cells = scattering_of(
        part, air_of(config), band_of(config), bore=bore, resolution=config.waves.resolution,
        lossy=config.waves.losses == "on", progress=progress,
    )  # fmt: skip
    recordings = joined(config, [Placed(matrix, 1e-2 * filled(config.indentation.position_cm))])
    return recordings, _budget(config, cells, None, recordings)


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
    """Return the scattering of a press, by its own place.

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
        symmetric_only=part.symmetric,
        progress=progress,
    )
    return matrix, cells


def joined(config: Config, presses: Sequence[Placed]) -> dict[SourceEnd, Recording]:
    """Return what the probe of a tube hears, from presses of known scattering.

    Parameters
    ----------
    config : Config
        The settings of the tube and of the sound.
    presses : sequence of Placed
        Instead of the settings' press; none for an untouched tube.

    Returns
    -------
    dict of Recording
        For each choice of the source end. Spacing and shape of the grid are the first press's.
    """
    probe = _probe(config)
    recordings: dict[SourceEnd, Recording] = {}
    for source_end in SOURCE_ENDS:
        time, pressure = heard(
            presses,
            air_of(config),
            _pulse(config),
            radius=0.5e-3 * config.tube.inner_diameter_mm,
            length=1e-2 * config.tube.length_cm,
            duration=_duration(config, air_of(config)),
            time_step=TIME_STEP,
            probes=[probe],
            source_reflection=-1.0 if source_end == "release" else 0.0,
            lossy=config.waves.losses == "on",
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
    config: Config,
    cells: CutCells,
    time_step: float | None,
    recordings: Mapping[SourceEnd, Recording],
) -> Budget:
    """Return what recordings can be trusted with."""
    pulse = _pulse(config)
    return error_budget(
        cells,
        air_of(config),
        frequency=pulse.frequency,
        highest=pulse.band(BAND_EDGE)[1],
        radius=0.5e-3 * config.tube.inner_diameter_mm,
        time_step=time_step,
        lossy=config.waves.losses == "on",
        pressure=recordings[config.waves.source_end].pressure,
    )


def band_of(config: Config) -> tuple[float, float]:
    """Return the band in Hz in which the sound is followed."""
    pulse = _pulse(config)
    lowest, highest = pulse.band(HEARD)
    return max(lowest, LOWEST * pulse.frequency), highest


def _duration(config: Config, air: Air) -> float:
    """Return a time in s that is long enough for the middle of an echo from the far end."""
    return 2e-2 * config.tube.length_cm / air.sound_speed + 0.5 * _pulse(config).duration


def _share_of(progress: Callable[[float], None], done: int) -> Callable[[float], None]:
    """Return a progress function for one of the runs, `done` of which are over."""
    return lambda part: progress((done + part) / len(SOURCE_ENDS))


def locate(config: Config, recording: Recording) -> signals.Ranging:
    """Find the press in a recording by the settings' processing."""
    return signals.process(
        recording.time,
        recording.pressure[0],
        pulse_duration=_pulse(config).duration,
        probe_position=_probe(config),
        temperature=config.waves.temperature_c,
        cutoff=1e3 * filled(config.signals.lowpass_khz),
        prominence=config.signals.prominence,
        farthest=1e-2 * config.tube.length_cm,
    )


def _probe(config: Config) -> float:
    return 1e-2 * config.waves.probe_cm


def _ignore(_fraction: float) -> None:
    """Report nothing."""


def _silent(_stage: str, _fraction: float) -> None:
    """Report nothing."""


@contextmanager
def stage(
    name: str, seconds: dict[str, float], report: Report
) -> Iterator[Callable[[float], None]]:
    """Report and time a stage; what it refuses in SI terms becomes a failure of that stage."""
    start = time.perf_counter()
    report(name, 0.0)
    try:
        yield lambda fraction: report(name, fraction)
    except ValueError as error:
        raise SimulationError(f"{name}: {error}") from error
    report(name, 1.0)
    seconds[name] = time.perf_counter() - start
