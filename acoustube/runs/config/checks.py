"""Checks of settings against each other, within a section and across sections."""

from __future__ import annotations

import math

from acoustube.air import sound_speed
from acoustube.base.errors import ConfigError
from acoustube.base.limits import (
    CLEARANCE,
    JOINED_CLEARANCE,
    PUNCH_EDGE,
    SHALLOWEST_MM,
    pressed_reach,
)
from acoustube.runs.config.settings import IndentationSettings, TubeSettings, WaveSettings

MM_PER_CM = 10

CELLS_PER_WAVELENGTH = 8
"""Smallest allowed number of grid cells per wavelength of the sound."""

BAND_WIDTH = 3.83
"""Half width of a pulse's band at -70 dB divided by the carrier, times the number of cycles."""
MOST_CELLS = 50_000_000
"""Largest number of cells of the acoustic grid; these take some 15 GB of memory."""


def check_touched(press: IndentationSettings) -> None:
    """Raise ConfigError if the depth is zero, so that the press does not touch the tube."""
    if press.depth_mm == 0:
        raise ConfigError(
            "is not a press", setting="depth_mm", value=0,
            advice=f"use {SHALLOWEST_MM:g} or more (only a sweep may include the untouched tube)",
        )  # fmt: skip


def check_press(press: IndentationSettings) -> None:
    """Raise if settings of the press have no effect or contradict each other."""
    if 0 < press.depth_mm < SHALLOWEST_MM:
        raise ConfigError(
            "is below the smallest supported depth", setting="depth_mm", value=press.depth_mm,
            advice=f"use {SHALLOWEST_MM:g} or more",
        )  # fmt: skip
    if press.yaw_deg != 0 and press.shape != "rod":
        raise ConfigError(
            f"turns a {press.shape}, which is round", setting="yaw_deg", value=press.yaw_deg,
            advice="use 0",
        )  # fmt: skip
    if press.offset_mm != 0 and press.shape == "rod":
        raise ConfigError(
            "moves a rod along itself, which changes nothing", setting="offset_mm",
            value=press.offset_mm, advice="use 0",
        )  # fmt: skip
    if (press.layer_mm is None) != (press.layer_mpa is None):
        raise ConfigError(
            "layer_mm and layer_mpa describe one layer", advice="give both or neither"
        )
    if press.layer_mm is not None and press.support == "held":
        raise ConfigError(
            "needs a free tube, not support = held", setting="layer_mm", value=press.layer_mm,
            advice="use support free",
        )  # fmt: skip


def check_round(tube: TubeSettings) -> None:
    """Raise for an imported surface: the acoustics support round tubes only."""
    if tube.surface is not None:
        raise ConfigError(
            "applies to the indentation only", setting="surface", value=tube.surface,
            advice="use acoustube indent",
        )  # fmt: skip


def check_depth(tube: TubeSettings, indentation: IndentationSettings) -> None:
    """Raise if the depth exceeds the outer diameter, or the bore plus half the wall thickness.

    An elastic layer raises both limits by its thickness.
    """
    depth, outer, bore = indentation.depth_mm, tube.outer_diameter_mm, tube.inner_diameter_mm
    gives = indentation.layer_mm or 0.0
    deepest = _round_down(bore + tube.wall_mm / 2 + gives)
    if depth > outer + gives:
        reason = f"is past the floor (outer diameter {outer:g} mm)"
    elif depth > deepest:
        reason = f"is beyond a closed lumen by more than half a wall (bore {bore:g} mm)"
    else:
        return
    raise ConfigError(
        reason, setting="depth_mm", value=depth, allowed=(SHALLOWEST_MM, deepest),
        advice=f"use at most {deepest:g}",
    )  # fmt: skip


def check_offset(tube: TubeSettings, press: IndentationSettings) -> None:
    """Raise if an indenter misses a round tube on its path down, or reaches the floor next to it.

    Notes
    -----
    In section the indenter is flat up to ``flat`` from its axis, then rounded with the radius
    ``edge``; ``outer`` is the tube's outer radius. At first contact the distance from the centre of
    the rounding to the tube's axis is ``outer + edge``. On the way down this distance is least with
    centre and axis at one height if ``edge < outer``, otherwise with the indenter's lowest point
    level with the tube's bottom. If the least distance is ``outer + edge`` or more, the indenter
    misses.
    """
    if press.offset_mm == 0 or press.depth_mm == 0:
        return
    outer, radius = tube.outer_diameter_mm / 2, press.indenter_mm / 2
    edge = radius if press.shape == "sphere" else PUNCH_EDGE * radius
    flat = radius - edge
    most = flat + (outer + edge if edge < outer else 2 * math.sqrt(outer * edge))
    if abs(press.offset_mm) >= most:
        bound = (math.ceil(100 * most) - 1) / 100
        raise ConfigError(
            f"is so large that the {press.indenter_mm:g} mm {press.shape} misses the tube",
            setting="offset_mm", value=press.offset_mm, allowed=(-bound, bound),
            advice=f"use {-bound:g} to {bound:g}, or a larger indenter",
        )  # fmt: skip
    beside = max(abs(press.offset_mm) - flat, 0.0)
    lowest = math.sqrt((outer + edge) ** 2 - beside**2) - edge
    room = outer + lowest + (press.layer_mm or 0.0)
    if press.depth_mm >= room:
        deepest = (math.ceil(100 * room) - 1) / 100
        raise ConfigError(
            f"pushes the {press.shape}, {press.offset_mm:g} mm beside the axis, into the floor",
            setting="depth_mm", value=press.depth_mm, allowed=(SHALLOWEST_MM, deepest),
            advice=f"use at most {deepest:g}, or a smaller offset_mm",
        )  # fmt: skip


def check_position(
    tube: TubeSettings, indenter_mm: float, position: float, waves: WaveSettings
) -> None:
    """Raise if the part deformed by a press at `position` in cm reaches probe plane or far end."""
    reach, nearest, shortest = _room(tube.outer_diameter_mm, indenter_mm, waves)
    farthest = _round_down(tube.length_cm - reach)
    bends = f"the press needs {reach:.4g} cm of the tube on each side"
    if nearest > farthest:
        raise ConfigError(
            f"is too short: {bends} and the probe plane is at {waves.probe_cm:g} cm",
            setting="length_cm", value=tube.length_cm, allowed=(shortest, math.inf),
            advice=f"use at least {shortest:g}",
        )  # fmt: skip
    if not nearest <= position <= farthest:
        end = "source" if position < nearest else "far"
        raise ConfigError(
            f"is too near the {end} end: {bends}", setting="position_cm", value=position,
            allowed=(nearest, farthest), advice=f"use {nearest:g} to {farthest:g}",
        )  # fmt: skip


def grid_cells(
    *,
    bore: float,
    outer_diameter: float,
    indenter_diameter: float,
    tube_length: float,
    resolution: int,
    method: str,
) -> float:
    """Return the number of cells of the FDTD grid, a box around the bore.

    Parameters
    ----------
    bore, outer_diameter, indenter_diameter, tube_length : float
        Lengths, all in one unit.
    resolution : int
        Cells across the bore.
    method : {"full", "scattering", "spectral"}
        The grid is that of the whole tube with ``full``, otherwise that of the pressed part.
    """
    length = tube_length
    if method != "full":
        length = 2 * (pressed_reach(outer_diameter, indenter_diameter) + 4 * outer_diameter)
    return resolution**3 * length / bore


def check_resolution(tube: TubeSettings, indenter_mm: float, waves: WaveSettings) -> None:
    """Raise if the grid is too coarse for the sound, or too large."""
    bore, highest = tube.inner_diameter_mm, _highest_khz(waves)
    words = "the carrier" if waves.method == "full" else "the pulse's highest frequency"
    coarsest = coarsest_grid(bore, waves)
    if waves.resolution < coarsest:
        raise ConfigError(
            f"is too coarse for {words}, {highest:.4g} kHz, in a bore of {bore:g} mm "
            f"({CELLS_PER_WAVELENGTH} cells per wavelength are needed)",
            setting="resolution", value=waves.resolution, allowed=(coarsest, math.inf),
            advice=f"use at least {coarsest}",
        )  # fmt: skip
    cells = grid_cells(
        bore=bore,
        outer_diameter=tube.outer_diameter_mm,
        indenter_diameter=indenter_mm,
        tube_length=MM_PER_CM * tube.length_cm,
        resolution=waves.resolution,
        method=waves.method,
    )
    if cells > MOST_CELLS:
        finest = math.floor(waves.resolution * (MOST_CELLS / cells) ** (1 / 3))
        raise ConfigError(
            f"makes {cells:.1e} grid cells in {tube.length_cm:g} cm of tube, more than "
            f"{MOST_CELLS:.0e}",
            setting="resolution", value=waves.resolution, allowed=(coarsest, finest),
            advice=f"use at most {finest} or a shorter tube",
        )  # fmt: skip


def check_probe(tube: TubeSettings, waves: WaveSettings) -> None:
    """Raise if the probe plane lies within the first layer of cells, where the pulse is set."""
    nearest = _round_up(tube.inner_diameter_mm / waves.resolution / MM_PER_CM)
    if waves.probe_cm < nearest:
        raise ConfigError(
            "lies in the first layer of cells", setting="probe_cm", value=waves.probe_cm,
            allowed=(nearest, math.inf), advice=f"use at least {nearest:g} or a higher resolution",
        )  # fmt: skip


def check_pulse(tube: TubeSettings, waves: WaveSettings) -> None:
    """Raise if the pulse lasts longer than the round trip of sound to the far end."""
    pulse_ms = waves.cycles / waves.frequency_khz
    record_ms = _record_ms(tube, waves)
    if pulse_ms > record_ms:
        most = math.floor(record_ms * waves.frequency_khz)
        raise ConfigError(
            f"make a pulse of {pulse_ms:.3g} ms, longer than the {record_ms:.3g} ms of the "
            f"round trip in a {tube.length_cm:g} cm tube",
            setting="cycles", value=waves.cycles, allowed=(1, most), advice=f"use at most {most}",
        )  # fmt: skip


def check_lowpass(tube: TubeSettings, waves: WaveSettings, lowpass: float) -> None:
    """Raise if a low-pass in kHz passes the rectified carrier, or is too low for the record."""
    # Rectification doubles the carrier's frequency. The filter attenuates by 48 dB two octaves
    # above its cut-off, which is therefore at most half the carrier.
    highest = waves.frequency_khz / 2
    record_ms = _record_ms(tube, waves)
    # The filter extends the record at both ends by three periods of the cut-off.
    lowest = _round_up(3 / record_ms)
    if lowest > highest:
        least = shortest_tube(waves, highest)
        raise ConfigError(
            f"is too short for a low-pass of at most half of frequency_khz, {highest:g} kHz",
            setting="length_cm", value=tube.length_cm, allowed=(least, math.inf),
            advice=f"use at least {least:g}, or a higher frequency_khz",
        )  # fmt: skip
    if lowpass < lowest:
        raise ConfigError(
            f"is too low for the {record_ms:.2f} ms of the round trip in a "
            f"{tube.length_cm:g} cm tube",
            setting="lowpass_khz", value=lowpass, allowed=(lowest, highest),
            advice=f"use at least {lowest:g}",
        )  # fmt: skip
    if lowpass > highest:
        most = _round_down(highest)
        raise ConfigError(
            f"lets the rectified {waves.frequency_khz:g} kHz carrier through",
            setting="lowpass_khz", value=lowpass, allowed=(lowest, most),
            advice=f"use at most {most:g}",
        )  # fmt: skip


def _room(outer_mm: float, indenter_mm: float, waves: WaveSettings) -> tuple[float, float, float]:
    """Return the length that a press needs on each side, its least position, the least tube length.

    All are in cm. The length on each side is the deformed part and a clearance.
    """
    clearance = CLEARANCE if waves.method == "full" else JOINED_CLEARANCE
    reach = (pressed_reach(outer_mm, indenter_mm) + clearance * outer_mm) / MM_PER_CM
    nearest = _round_up(waves.probe_cm + reach)
    return reach, nearest, _round_up(nearest + reach)


def usual_lowpass(waves: WaveSettings) -> float:
    """Return the default cut-off of the envelope's low-pass in kHz."""
    return min(10.0, waves.frequency_khz / 2)


def shortest_tube(waves: WaveSettings, lowpass: float) -> float:
    """Return the least length in cm of a tube for the pulse and for a low-pass cut-off in kHz."""
    # The cut-off is rounded to two decimals, as in the advice of check_lowpass.
    record_ms = max(3 / _round_down(lowpass), waves.cycles / waves.frequency_khz)
    return _round_up(sound_speed(waves.temperature_c) * record_ms / (2 * MM_PER_CM))


def shortest_for_middle(outer_mm: float, indenter_mm: float, waves: WaveSettings) -> float:
    """Return the least length in cm of a tube that can be pressed in its middle."""
    _, nearest, shortest = _room(outer_mm, indenter_mm, waves)
    return max(2 * nearest, shortest)


def coarsest_grid(bore: float, waves: WaveSettings) -> int:
    """Return the least number of grid cells across a bore in mm."""
    wavelength_mm = sound_speed(waves.temperature_c) / _highest_khz(waves)
    return math.ceil(CELLS_PER_WAVELENGTH * bore / wavelength_mm)


def _highest_khz(waves: WaveSettings) -> float:
    """Return the carrier, or for scattering matrices the upper end of the pulse's band, in kHz."""
    wide = 1.0 if waves.method == "full" else 1 + BAND_WIDTH / waves.cycles
    return waves.frequency_khz * wide


def _record_ms(tube: TubeSettings, waves: WaveSettings) -> float:
    """Return the time in ms in which sound travels to the far end and back (mm divided by m/s)."""
    return 2 * MM_PER_CM * tube.length_cm / sound_speed(waves.temperature_c)


def _round_up(value: float) -> float:
    """Return a lower limit rounded up to two decimals, so that it is allowed as displayed."""
    return math.ceil(round(value * 100, 6)) / 100


def _round_down(value: float) -> float:
    """Return an upper limit rounded down to two decimals, so that it is allowed as displayed."""
    return math.floor(round(value * 100, 6)) / 100
