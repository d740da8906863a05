"""Do a march of the whole tube and a scattering matrix in straight tube give the same recording?

The default tube of 40 cm with a 25 mm rod in its middle. Each row: losses, source end, difference
of the two recordings over the norm of the first (in total, and behind the pulse), and the time in s
of each. Takes some minutes: ``python benchmarks/whole_tube_or_scattering.py [RESOLUTION]``.
"""

from __future__ import annotations

import sys
from time import perf_counter

import numpy as np
from scipy.interpolate import CubicSpline

from acoustube import load_config, pressed
from acoustube.lumen import lumen, pressed_part
from acoustube.runs.config.si import settings_in_si
from acoustube.runs.sound import scattered_recordings, tube_recordings


def compare(resolution: int, losses: str) -> None:
    """Print one row for each source end."""
    config = load_config(resolution=resolution, losses=losses)
    settings = settings_in_si(config)
    press, position = pressed(config, [settings.depth]), settings.position
    start = perf_counter()
    whole, _ = tube_recordings(settings, lumen(press, position))
    between = perf_counter()
    parts, _, _ = scattered_recordings(settings, pressed_part(press))
    seconds = between - start, perf_counter() - between
    answer = 2 * (position - 0.03) / settings.air.sound_speed
    for end, recording in whole.items():
        time, full = recording.time, recording.pressure[0]
        joined = CubicSpline(parts[end].time, parts[end].pressure[0])(time)
        late = time > answer
        shares = [
            np.linalg.norm((joined - full)[part]) / np.linalg.norm(full[part])
            for part in (slice(None), late)
        ]
        print(
            f"| {losses} | {end} | {100 * shares[0]:.2f} % | {100 * shares[1]:.1f} % | "
            f"{seconds[0]:.0f} | {seconds[1]:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    print("| losses | source end | all | echo | s, whole | s, joined |\n|---|---|---|---|---|---|")
    for losses in ("off", "on"):
        compare(int(sys.argv[1]) if len(sys.argv) > 1 else 32, losses)
