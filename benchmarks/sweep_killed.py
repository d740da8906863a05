"""Does a sweep that is killed repeatedly give the results of an undisturbed one?

A small sweep of two depths, two places and the untouched tube. In turn a worker, the whole sweep
with its workers, or the sweep alone is killed (SIGKILL) at a random moment, and the command is
repeated, until it has been killed as often as requested; then it is completed, and compared
bit by bit. Results that are complete before the last kill are removed, and computed again from
cached presses and matrices. Some minutes: ``python benchmarks/sweep_killed.py [KILLS]``.
"""

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import xarray as xr

import acoustube
from acoustube.runs.sweep import store

SMALL = ["--depth", "0", "0.3", "0.6", "--position", "15", "25", "--frequency", "20"]
COMMAND = [sys.executable, "-m", "acoustube", "sweep", *SMALL, "--resolution", "8", "--quiet"]
WHAT = ("worker", "all", "sweep alone")


def started(folder, name):
    """Start a sweep with its own cache."""
    environment = os.environ | {"ACOUSTUBE_CACHE": str(folder / f"cache of {name}")}
    return subprocess.Popen(
        [*COMMAND, "--out", str(folder / name)], env=environment, start_new_session=True
    )


def workers_of(pid):
    """Return the workers that a sweep has started."""
    command = ["ps", "-o", "pid=,args=", "--ppid", str(pid)]
    lines = subprocess.run(command, capture_output=True, text=True).stdout.splitlines()
    return [int(line.split()[0]) for line in lines if "spawn_main" in line]


def kill(sweep, what):
    """Kill a worker, all processes, or the sweep alone; return what was killed."""
    workers = workers_of(sweep.pid)
    if what == "worker" and workers:
        os.kill(workers[0], signal.SIGKILL)
        return f"one of {len(workers)} workers"
    if what == "sweep alone":
        sweep.kill()
    else:
        os.killpg(sweep.pid, signal.SIGKILL)
    sweep.wait()
    return f"{what} of {1 + len(workers)} processes"


def main():
    """Print each kill, and whether the results are the same."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    moments = random.Random(0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        begin = time.perf_counter()
        assert started(folder, "whole").wait() == 0
        alone = time.perf_counter() - begin
        print(f"left alone: {alone:.0f} s", flush=True)
        killed, sweep, kills = folder / "killed", None, 0
        while kills < count:
            if sweep is None or sweep.poll() is not None:
                for path in killed.glob("cases-*.nc"):
                    path.unlink()
                sweep = started(folder, "killed")
            time.sleep(moments.uniform(0.02, 0.6) * alone)
            if sweep.poll() is not None:
                continue
            done = kill(sweep, WHAT[kills % 3])
            found = store.contents(killed) if killed.is_dir() else store.Contents({}, [], [])
            assert not found.damaged
            kills += 1
            print(f"{kills}: {done}; {len(found.finished)} cases are there", flush=True)
        sweep.wait()
        assert started(folder, "killed").wait() == 0
        one, other = (acoustube.open_dataset(folder / n).load() for n in ("whole", "killed"))
        xr.testing.assert_identical(one, other)
        print("the same, bit by bit")


if __name__ == "__main__":
    main()
