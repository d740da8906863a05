"""Cost of 143 250 labelled cycles of the flat study, and their difference from whole marches.

The plan: 191 positions, 15 depths of a 25 mm rod, 50 cycles each, in a tube of 2.5 m. Presses and
their scattering are computed first, for one position; then the cases and the cycles are timed. A
sample of cases is marched in the whole tube, at the same resolution, and compared at the probe.

    python benchmarks/sweep_flat_study.py FOLDER [--march 10]
"""

import argparse
import json
import resource
import time
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

import acoustube
from acoustube import Recipe, load_plan, run_dataset, run_sweep
from acoustube.lumen import whole_tube
from acoustube.runs import sound
from acoustube.runs.config import configured
from acoustube.runs.config.si import settings_in_si
from acoustube.runs.sweep import tasks as sweep_tasks
from acoustube.runs.sweep.workers import cores
from acoustube.waves import cut_cells, grid_spacing, propagate

REST = 0.5
"""Length in m of the marched tube beyond a press, and of the path of the sound."""
OVER = {"indenter_mm": ["25"], "depth_mm": ["1:8:0.5"], "length_cm": ["250"]}
PLACES = {"position_cm": ["20:210:1"]}


def size_of(folder):
    """Return the bytes of all files in a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def timed(what, work):
    """Do something and print its duration."""
    start = time.perf_counter()
    result = work()
    seconds = time.perf_counter() - start
    print(f"{what}: {seconds:.0f} s", flush=True)
    return seconds, result


def memory():
    """Return the largest memory in GB of this process and of its largest worker."""
    kinds = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return [resource.getrusage(kind).ru_maxrss / 1e6 for kind in kinds]


def marched(data, count):
    """Return the differences of some cases from marches, and the time of a whole march.

    A case is marched in the length of tube and for the time that its echo needs, REST beyond it.
    """
    rng = np.random.default_rng(1)
    depths = tuple(1e-3 * 0.5 * i for i in range(2, 17))
    found, costs = [], []
    for i in sorted(rng.choice(data.sizes["press"], count, replace=False)):
        case = data.isel(press=int(i)).sel(source_end="release")
        settings = settings_in_si(configured(json.loads(str(case["configuration"].values))))
        pressed = sweep_tasks.press(settings, depths).result.at[settings.depth]
        place, whole = float(case["true_distance"]), float(case["tube_length"])
        length = min(whole, place + REST)
        lumen = whole_tube(pressed.part, place, length)
        duration = (2 * place + REST) / 343
        start = time.perf_counter()
        recording = propagate(
            cut_cells(
                lumen.surface,
                grid_spacing(settings.tube.inner_diameter, settings.resolution, settings.probe),
                half=lumen.symmetric,
            ),
            settings.air,
            settings.pulse,
            duration=duration,
            probes=(settings.probe,),
            source_end="release",
            lossy_band=sound.band_of(settings.pulse),
        )
        seconds = time.perf_counter() - start
        costs.append(seconds * whole / length * (2 * whole / 343) / duration)
        at = case["time"].values
        at = at[at < recording.time[-1]]
        here = case["pressure"].values[: len(at)]
        there = CubicSpline(recording.time, recording.pressure[0])(at)
        # The echo begins long after the pulse has passed the probe.
        echo = at > 2 * place / 345 - 2e-4
        off = [
            np.linalg.norm((here - there)[part]) / np.linalg.norm(there[part])
            for part in (slice(None), echo)
        ]
        found.append(off)
        print(
            f"{1e3 * float(case['depth']):.1f} mm at {100 * place:.0f} cm: {100 * off[0]:.2f} % of "
            f"all, {100 * off[1]:.1f} % of the echo of {np.abs(there[echo]).max():.1e}; "
            f"marched in {seconds:.0f} s, as a whole in {costs[-1]:.0f} s",
            flush=True,
        )
    return np.array(found), float(np.mean(costs))


def main():
    """Print the times."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--march", type=int, default=0)
    arguments = parser.parse_args()
    folder = arguments.folder
    print(f"{cores()} cores")
    one = load_plan(None, OVER | {"position_cm": ["100"]})
    timed("pieces, unless remembered", lambda: run_sweep(one, folder / "one"))
    plan = load_plan(None, OVER | PLACES)
    sweep, _ = timed(f"{len(plan)} cases", lambda: run_sweep(plan, folder / "sweep"))
    recipe = Recipe(n_cycles=50)
    cycles, _ = timed("cycles", lambda: run_dataset([folder / "sweep"], folder / "dataset", recipe))
    data = acoustube.open_dataset(folder / "dataset")
    print(f"{data.sizes['cycle']} cycles in {(sweep + cycles) / 60:.1f} min")
    sizes = [size_of(folder / name) / 1e9 for name in ("sweep", "dataset")]
    print(f"disk: {sizes[0]:.2f} + {sizes[1]:.2f} GB; memory, this and a worker: {memory()} GB")
    if arguments.march:
        cases = acoustube.open_dataset(folder / "sweep")
        found, seconds = marched(cases, arguments.march)
        worst = 100 * found.max(axis=0)
        print(f"worst of {arguments.march}: {worst[0]:.2f} % of all, {worst[1]:.1f} % of the echo")
        per_case = 50 * (sweep + cycles) / data.sizes["cycle"]
        print(f"a case with its 50 cycles {per_case:.2f} s, marched {seconds:.0f} s and the cycles")


if __name__ == "__main__":
    main()
