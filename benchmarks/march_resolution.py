"""Error of the march's echo against the spectral solver, and its cost, by resolution.

Rods of 10, 25 and 35 mm on the default tube of 40 cm, without losses. For each resolution: distance
and height of the highest echo less those of the spectral solver, the difference of the two
recordings after the send pulse (rms, relative to the spectral solver's), and the processor time of
grid and march for both source ends. Some ten minutes on one core:
``python benchmarks/march_resolution.py [RESOLUTIONS [DEPTHS_MM]]``, for instance ``24,32 4,6``.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from acoustube import load_config, pressed
from acoustube.lumen import lumen, pressed_part
from acoustube.runs.config.si import SISettings, settings_in_si
from acoustube.runs.sound import (
    SOURCE_ENDS,
    band_of,
    blind_time,
    joined_recordings,
    locate,
    spectral_scattering_of,
    tube_recordings,
)
from acoustube.waves import PlacedScatterer, Recording

RODS_MM, DEPTHS_MM = (10.0, 25.0, 35.0), (2.0, 4.0, 6.0, 7.0)
RESOLUTIONS = (16, 20, 24, 28, 32)


def of(rod_mm: float, depths_mm: list[float], resolutions: list[int]) -> None:
    """Print a row for each depth and resolution."""
    settings = {
        n: settings_in_si(load_config(indenter_mm=rod_mm, resolution=n, prominence=1e-4))
        for n in resolutions
    }
    any_of_them = settings[resolutions[0]]
    press = pressed(load_config(indenter_mm=rod_mm), [1e-3 * depth for depth in depths_mm])
    for depth in depths_mm:
        (increment,) = np.flatnonzero(np.isclose(press.depth, 1e-3 * depth))
        part = pressed_part(press, increment)
        matrix = spectral_scattering_of(
            part, any_of_them.air, band_of(any_of_them.pulse), lossy=False
        )
        scatterer = PlacedScatterer(matrix, any_of_them.position)
        expected = joined_recordings(any_of_them, [scatterer])
        space = lumen(press, any_of_them.position, increment)
        for resolution in resolutions:
            began = time.process_time()
            found, _ = tube_recordings(settings[resolution], space)
            seconds = time.process_time() - began
            row = [f"{rod_mm:g}", f"{depth:g}", str(resolution)]
            for end in SOURCE_ENDS:
                row += compared(any_of_them, found[end], expected[end])
            print("| " + " | ".join([*row, f"{seconds:.1f}"]) + " |", flush=True)


def compared(settings: SISettings, found: Recording, expected: Recording) -> list[str]:
    """Return the differences of distance, height and waveform, and the echo's height."""
    here, there = locate(settings, found), locate(settings, expected)
    late = expected.time > 2 * settings.probe / settings.air.sound_speed
    late &= expected.time > settings.pulse.duration + blind_time(settings)
    moved = np.interp(expected.time, found.time, found.pressure[0])
    error = np.sqrt(
        np.sum((moved - expected.pressure[0])[late] ** 2) / np.sum(expected.pressure[0][late] ** 2)
    )
    return [
        f"{1e3 * float(here.distance - there.distance):+.3f}",
        f"{100 * (float(here.amplitude / there.amplitude) - 1):+.2f}",
        f"{100 * error:.2f}",
        f"{100 * float(there.amplitude):.2f}",
    ]


if __name__ == "__main__":
    given = [[float(text) for text in argument.split(",")] for argument in sys.argv[1:]]
    chosen = [int(n) for n in given[0]] if given else list(RESOLUTIONS)
    depths = given[1] if len(given) > 1 else list(DEPTHS_MM)
    four = "place mm | height % | waveform % | echo %"
    print(f"| rod mm | depth mm | cells | release: {four} | absorbing: {four} | s |")
    print("|" + "---|" * 12)
    for rod in RODS_MM:
        of(rod, depths, chosen)
