"""Commands that are ended at random moments: ``python -m tests.fuzz.kills --count 1000``.

Each must end in time with the right exit code and a sentence, and leave a complete output or none;
the repeated command must give the results of an undisturbed one.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from acoustube.base import remnants
from tests.boards import FRAMES, Board
from tests.fuzz.__main__ import ROOT, _corpus
from tests.fuzz.harness import Session
from tests.fuzz.streams import rows_of, waited

ENDS = {"KILL": (signal.SIGKILL,), "INT": (signal.SIGINT,), "TERM": (signal.SIGTERM,),
        "INT twice": (signal.SIGINT, signal.SIGINT)}  # fmt: skip
IN_TIME, PATIENCE = 5.0, 120.0
"""Limits in s of processor time or waiting: for ending after a signal, and for a whole command."""
BEFORE_PYTHON = 0.2
"""Processor time in s in which Python starts, before the command can print anything."""
REPORTED = 50
"""Trials between two lines of progress."""
NOISE = ("Traceback", "Exception ignored", "Error:", "free()", "Warning")
SMALL = ("--indenter", "25", "--depth", "0.6")
TIMES = ("elapsed_time",)
"""Variables that differ from run to run."""
COMMANDS: dict[str, tuple[str, ...]] = {
    "simulate": ("simulate", *SMALL, "--config", "CORPUS/coarse.toml", "--resolution", "11",
                 "--method", "scattering", "--out", "new/o"),
    "indent": ("indent", *SMALL, "--steps", "1", "--config", "CORPUS/coarse.toml", "--out", "o"),
    "sweep": ("sweep", *SMALL, "0", "--vary", "mesh=coarse", "resolution=11", "--workers", "1",
              "--out", "o"),
    "dataset": ("dataset", "CORPUS/sweep", "--cycles", "2", "--workers", "1", "--out", "o"),
    "page": ("show", "CORPUS/indent", "--html", "o.html"),
    "figure": ("show", "CORPUS/sweep", "--out", "o.png"),
    "export vtu": ("export", "CORPUS/indent", "--format", "vtu", "--out", "o"),
    "export stl": ("export", "CORPUS/sweep", "--format", "stl", "--out", "o"),
    "export wav": ("export", "CORPUS/cycles", "--out", "o"),
    "scatter": ("scatter", "CORPUS/lumen.stl", "--resolution", "8", "--band", "5", "15", "--step",
                "1", "--out", "o.nc"),
    "process": ("process", "CORPUS/good.npz", "--out", "o.csv", "--figure", "p.png"),
    "calibrate": ("calibrate", "MADE/blocked.npz", "--untouched", "MADE/untouched.npz", "--out",
                  "o.toml", "--figure", "p.png"),
    "train": ("train", "MADE/labelled.nc", "--estimator", "network", "--epochs", "3", "--folds",
              "2", "--prominence", "0.001", "--out", "o.model"),
    "evaluate": ("evaluate", "CORPUS/boosting.model", "CORPUS/labelled.nc", "--out", "o.csv"),
    "sleeve": ("sleeve", "--forearm", "25", "17", "26", "--loops", "9", "--out", "o"),
    "reproduce": ("reproduce", "calibration", "--quick", "--workers", "1", "--out", "o"),
    "wall": ("indent", "--tube", "MESHES/d_bore.stl", "--indenter", "10", "--depth", "0.3",
             "--steps", "1", "--out", "o"),
    "live": ("live", "--port", "PORT", "--prominence", "0.05", "--duration", "3", "--out",
             "o.csv"),
    "check": ("check",),
    "cite": ("cite", "CORPUS/indent"),
    "cache": ("cache", "list"),
    "help": ("simulate", "--help"),
}  # fmt: skip
"""Commands by name; the paths of valid files begin with CORPUS, those made here with MADE."""
CACHED = ("simulate", "indent", "sweep", "wall", "scatter")
"""Commands that are faster the second time."""
RESUMED = ("sweep", "dataset", "reproduce")
"""Commands whose folder grows, and is completed by repeating the command."""


@dataclass(frozen=True)
class Ending:
    """How a command ended.

    Attributes
    ----------
    code : int
    before, used : float
        Processor time in s before the first signal, and since.
    idle : float
        Time in s since then in which it was not ready to run.
    errors : str
        Standard error.
    """

    code: int
    before: float
    used: float
    idle: float
    errors: str


class Bench:
    """Folder for running commands: valid files, a cache that holds the presses, and results.

    Parameters
    ----------
    place : Path
        Empty folder.
    corpus : Path, optional
        Valid files; made, or taken from an earlier run, if not given.
    """

    def __init__(self, place: Path, corpus: Path | None = None) -> None:
        self.place, self.corpus = place, corpus or _corpus()
        self.cache = place / "cache"
        self.environment = os.environ | {"ACOUSTUBE_CACHE": str(self.cache), "MPLBACKEND": "agg"}
        self.environment |= {"COLUMNS": "80"}
        self.port = ""
        self.known: dict[str, tuple[float, dict[str, Any]]] = {}
        os.environ["ACOUSTUBE_CACHE"] = str(self.cache)
        _make(place / "made")

    def words(self, name: str) -> list[str]:
        """Return the words of a command, with its paths."""
        places = {"CORPUS": str(self.corpus), "MADE": str(self.place / "made"), "PORT": self.port}
        places["MESHES"] = str(ROOT / "meshes")
        words = list(COMMANDS[name])
        for short, path in places.items():
            words = [word.replace(short, path) for word in words]
        return words

    def run(self, name: str, folder: Path, ends: Sequence[int] = (), delay: float = 0) -> Ending:
        """Run a command, and send it signals after a delay."""
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        with self.beside(name, folder), subprocess.Popen(
            [sys.executable, "-m", "acoustube", *self.words(name)],
            cwd=folder, env=self.environment, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, text=True, start_new_session=True, preexec_fn=_not_ignored,
        ) as process:  # fmt: skip
            ended = False
            if ends:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    ended = process.wait(delay) is not None
            session = Session(process.pid)
            for number in ends:
                process.send_signal(number)
                time.sleep(0.05)
            errors = _watched(process, session)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        total = after.ru_utime + after.ru_stime - children.ru_utime - children.ru_stime
        before = total if ended else min(session.before, total)
        return Ending(process.returncode, before, total - before, session.idle, errors)

    @contextlib.contextmanager
    def beside(self, name: str, folder: Path) -> Iterator[None]:
        """Send frames of a board for commands that read a serial line; else do nothing."""
        if name != "live":
            yield
            return
        board = Board()
        self.port = board.port
        with board.sending(lambda board: _send(board, folder / "o.csv")):
            yield

    def expected(self, name: str) -> tuple[float, dict[str, Any]]:
        """Return the duration of an undisturbed command with a filled cache, and its outputs."""
        if name not in self.known:
            for _ in range(2 if name in CACHED else 1):
                with self.folder() as folder:
                    started = time.monotonic()
                    ending = self.run(name, folder)
                    if ending.code:
                        raise RuntimeError(f"{name}: {ending.errors}")
                    self.known[name] = time.monotonic() - started, outputs(folder)
        return self.known[name]

    @contextlib.contextmanager
    def folder(self) -> Iterator[Path]:
        """Yield an empty folder."""
        with tempfile.TemporaryDirectory(dir=self.place) as folder:
            yield Path(folder)

    def trial(self, name: str, how: str, delay: float, *, again: bool) -> list[str]:
        """End a command after a delay; return what is wrong, or an empty list."""
        _, whole = self.expected(name)
        with self.folder() as folder:
            ending = self.run(name, folder, ENDS[how], delay)
            wrong = _about_end(ending, how) + _about_files(folder, whole, name, ending)
            hidden = _hidden(folder)
            if how != "KILL":
                wrong += [f"left behind: {path.name}" for path in hidden]
            remnants.clear()
            wrong += [f"not found by cache clear: {path.name}" for path in _hidden(folder)]
            if again and (not outputs(folder) or name in RESUMED):
                repeated = self.run(name, folder)
                if repeated.code:
                    wrong.append(f"repeated, it ends with {repeated.code}: {repeated.errors}")
                elif not _alike(outputs(folder), whole):
                    wrong.append("repeated, it gives another result")
        return wrong


def _send(board: Board, log: Path) -> None:
    """Send frames once a command has opened the line."""
    if waited(board, log.exists):
        for frame in FRAMES:
            board.send(frame)


def _watched(process: subprocess.Popen[str], session: Session) -> str:
    """Wait for the end of a process; return its standard error."""
    while True:
        try:
            return process.communicate(timeout=0.1)[1]
        except subprocess.TimeoutExpired:
            session.look()
            if max(session.used, session.idle) > PATIENCE:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                return f"{process.communicate()[1]}\nstill running after {PATIENCE:.0f} s"


def _not_ignored() -> None:
    """Accept interrupts, which are ignored in the background of a shell."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _make(folder: Path) -> None:
    """Write the recordings that the valid files lack."""
    sys.path.insert(0, str(ROOT / "tests"))  # as pytest does
    from labelled_cycles import cycles
    from test_calibration import PLACES, blocked, untouched
    from test_pipeline import RATE

    folder.mkdir()
    common = {"rate": RATE, "temperature": 20.0}
    np.savez(folder / "blocked.npz", signal=blocked(), true_distance=PLACES, **common)
    np.savez(folder / "untouched.npz", signal=untouched(), **common)
    cycles(56, seed=2).to_netcdf(folder / "labelled.nc", engine="h5netcdf")


def _about_end(ending: Ending, how: str) -> list[str]:
    """Return what is wrong with the end of a command."""
    last = ending.errors.strip().splitlines()[-1:] or [""]
    if ending.code == -signal.SIGKILL and how == "KILL":
        return []
    noise = [word for word in NOISE if word in ending.errors]
    if ending.before < BEFORE_PYTHON and ending.code in (
        -signal.SIGINT,
        -signal.SIGTERM,
        130,
        143,
        1,
    ):
        return []
    wrong = [f"it says {' and '.join(noise)}:\n{ending.errors}"] if noise else []
    if ending.code == 0:  # it had ended before the signal
        return wrong if ending.used + ending.idle < 1 else [*wrong, "it went on, and ended with 0"]
    if ending.code != 128 + ENDS[how][0]:
        wrong.append(f"it ended with {ending.code}:\n{ending.errors}")
    if not last[0].startswith("acoustube: interrupted"):
        wrong.append(f"no sentence, but {last[0]!r}")
    if max(ending.used, ending.idle) > IN_TIME:
        wrong.append(f"it took {ending.used:.1f} s to end, and {ending.idle:.1f} s of waiting")
    return wrong


def _about_files(folder: Path, whole: dict[str, Any], name: str, ending: Ending) -> list[str]:
    """Return what is wrong with the outputs of a command that was ended."""
    found = outputs(folder)
    if name == "live":  # its log grows, by whole rows
        parts = all(found[path] == whole[path][: len(found[path])] for path in found)
        return [] if parts else ["the log is not the first rows of a whole one"]
    if ending.code == 0 and not _alike(found, whole):
        return ["it ended with 0, without its outputs"]
    if name in RESUMED:
        parts = {path: content for path, content in found.items() if path in whole}
        return [] if _alike(parts, {p: whole[p] for p in parts}) else ["a part is not whole"]
    # Two files are written one after the other: one may exist without the other, but complete.
    there = {path: content for path, content in whole.items() if path in found}
    if not _alike(found, there):
        return [f"half an output: {', '.join(found)}"]
    return [] if not found or found.keys() == whole.keys() or "/" not in "".join(found) else [
        f"half a folder: {', '.join(found)}"
    ]  # fmt: skip


def _hidden(folder: Path) -> list[Path]:
    return [path for path in folder.rglob(f"{remnants.ASIDE}*") if path.name.startswith(".")]


def outputs(folder: Path) -> dict[str, Any]:
    """Return the contents of all files that are not hidden, by their paths."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_file() and remnants.ASIDE not in name:
            found[name] = _content(path)
    return found


def _content(path: Path) -> Any:
    """Return the part of a file's contents that does not differ from run to run."""
    if path.suffix == ".nc":
        import xarray as xr

        try:
            with xr.open_dataset(path, engine="h5netcdf") as data:
                kept = data.load().drop_vars(TIMES, errors="ignore")
        except Exception as error:  # half written
            return str(error)
        return {str(n): v.values.tobytes() for n, v in kept.variables.items() if v.dtype != object}
    if path.suffix in (".model", ".npz"):
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name].tobytes() for name in archive.files if name != "header"}
    if path.name == "o.csv" and b"received_s" in path.read_bytes()[:500]:
        return rows_of(path)
    content = path.read_bytes()
    # Page and report contain times.
    return len(content) > 1000 if path.suffix == ".html" else content


def _alike(found: dict[str, Any], expected: dict[str, Any]) -> bool:
    return found == expected


def main() -> int:
    """Run trials, print the findings, and return 1 if there are any."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.kills", description=__doc__)
    parser.add_argument("--seed", type=int, default=secrets.randbits(32), help="drawn if not given")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seconds", type=float, help="time after which no trial begins")
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--command", action="append", choices=COMMANDS, help="all if not given")
    parser.add_argument("--again", type=float, default=0.3, help="share that is repeated")
    given = parser.parse_args()
    print(f"seed {given.seed}", flush=True)
    place, tally, found = Path(tempfile.mkdtemp(prefix="acoustube-kills-")), Counter[str](), 0
    end = time.monotonic() + (given.seconds or float("inf"))
    try:
        bench = Bench(place)
        for number in range(given.first, given.first + given.count):
            if time.monotonic() > end:
                break
            name, how, delay, again = _drawn(bench, Random(f"{given.seed} {number}"), given)
            wrong = bench.trial(name, how, delay, again=again)
            tally[how] += 1
            if tally.total() % REPORTED == 0:
                print(f"{tally.total()} kills, {found} found", flush=True)
            if wrong:
                found += 1
                print(f"\n{number}: {name}, {how} after {delay:.2f} s: {'; '.join(wrong)}")
                print(f"  again: --seed {given.seed} --first {number} --count 1", flush=True)
    finally:
        shutil.rmtree(place, ignore_errors=True)
    counts = ", ".join(f"{count} {how}" for how, count in sorted(tally.items()))
    print(f"{tally.total()} kills ({counts}) with seed {given.seed}, {found} found")
    return 1 if found else 0


def _drawn(bench: Bench, chance: Random, given: argparse.Namespace) -> tuple[str, str, float, bool]:
    """Draw a command, a way to end it, a moment, and whether it is repeated."""
    names = given.command or list(COMMANDS)
    # In inverse proportion to its duration, so that all seconds of commands are about as likely.
    name = chance.choices(names, [1 / (1 + bench.expected(name)[0]) for name in names])[0]
    how = chance.choice(list(ENDS))
    share, again = chance.random(), chance.random() < given.again
    return name, how, share * min(bench.expected(name)[0], 30.0), again


if __name__ == "__main__":
    sys.exit(main())
