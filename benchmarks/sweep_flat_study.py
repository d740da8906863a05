"""What do 143 250 labelled cycles of the flat study cost, and how far are they from whole marches?

The plan: 191 places, 15 depths of a 25 mm rod, 50 cycles each, in a tube of 2.5 m. Its presses and
their scattering are computed first, for one place; then the cases and the cycles are timed. A
sample of cases is marched whole, at the same resolution, and compared at the probe.

    python benchmarks/sweep_flat_study.py FOLDER [--march 10]
"""

import argparse
import json
import resource
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.interpolate import CubicSpline

import acoustube
from acoustube import chain
from acoustube.config import configured
from acoustube.datasets import run_dataset
from acoustube.lumen import whole_tube
from acoustube.sweep import pieces
from acoustube.sweep.cycles import Recipe
from acoustube.sweep.execution import cores
from acoustube.sweep.graph import depth_of
from acoustube.sweep.plan import load_plan
from acoustube.swept import run_sweep

OVER = {"indenter_mm": ["25"], "depth_mm": ["1:8:0.5"], "length_cm": ["250"]}
PLACES = {"position_cm": ["20:210:1"]}


def size_of(folder):
    """Return the bytes of all files in a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def timed(what, work):
    """Do something and print how long it took."""
    start = time.perf_counter()
    result = work()
    seconds = time.perf_counter() - start
    print(f"{what}: {seconds:.0f} s", flush=True)
    return seconds, result


def memory():
    """Return the most memory in GB of this process and of its largest worker."""
    kinds = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return [resource.getrusage(kind).ru_maxrss / 1e6 for kind in kinds]


def marched(data, count):
    """Return the differences of some cases from whole marches, and the time of one."""
    rng = np.random.default_rng(1)
    found = []
    depths = tuple(1e-3 * 0.5 * i for i in range(2, 17))
    for i in sorted(rng.choice(data.sizes["press"], count, replace=False)):
        case = data.isel(press=int(i))
        config = configured(json.loads(str(case["configuration"].values)))
        pressed = pieces.press(config, depths).result.at[depth_of(config)]
        lumen = whole_tube(pressed.part, float(case["true_distance"]), float(case["tube_length"]))
        start = time.perf_counter()
        recordings, _ = chain.listen(config, lumen)
        seconds = (time.perf_counter() - start) / len(recordings)
        for end, recording in recordings.items():
            time_axis = case["time"].values
            here = case["pressure"].sel(source_end=end).values
            time_axis = time_axis[time_axis < recording.time[-1]]
            here = here[: len(time_axis)]
            there = CubicSpline(recording.time, recording.pressure[0])(time_axis)
            # The echo begins when the pulse has passed the probe; before it both are the pulse.
            echo = time_axis > 2 * float(case["true_distance"]) / 345 - 2e-4
            all_off = np.linalg.norm(here - there) / np.linalg.norm(there)
            echo_off = np.linalg.norm((here - there)[echo]) / np.linalg.norm(there[echo])
            level = np.abs(there[echo]).max()
            found.append([all_off, echo_off, level])
            print(
                f"{1e3 * float(case['depth']):.1f} mm at {100 * float(case['true_distance']):.0f} "
                f"cm, {end}: {100 * all_off:.2f} % of all, {100 * echo_off:.1f} % of the echo, "
                f"which reaches {level:.1e}; marched in {seconds:.0f} s",
                flush=True,
            )
    return np.array(found), seconds


def main():
    """Print the times."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--march", type=int, default=0)
    arguments = parser.parse_args()
    folder, quiet = arguments.folder, Console(quiet=True)
    print(f"{cores()} cores")
    one = load_plan(None, OVER | {"position_cm": ["100"]})
    timed("pieces, unless remembered", lambda: run_sweep(one, folder / "one", quiet))
    plan = load_plan(None, OVER | PLACES)
    sweep, _ = timed(f"{len(plan)} cases", lambda: run_sweep(plan, folder / "sweep", quiet))
    recipe = Recipe(n_cycles=50)
    cycles, _ = timed(
        "cycles", lambda: run_dataset([folder / "sweep"], folder / "dataset", recipe, quiet)
    )
    data = acoustube.open_dataset(folder / "dataset")
    print(f"{data.sizes['cycle']} cycles in {(sweep + cycles) / 60:.1f} min")
    sizes = [size_of(folder / name) / 1e9 for name in ("sweep", "dataset")]
    print(f"disk: {sizes[0]:.2f} + {sizes[1]:.2f} GB; memory, this and a worker: {memory()} GB")
    if arguments.march:
        cases = acoustube.open_dataset(folder / "sweep")
        found, seconds = marched(cases, arguments.march)
        print(f"worst of {arguments.march}: {100 * found[:, 0].max():.2f} % of all")
        per_cycle = (sweep + cycles) / data.sizes["cycle"]
        print(f"a case: {per_cycle * 50:.2f} s for 50 cycles, {seconds:.0f} s marched for each end")


if __name__ == "__main__":
    main()
