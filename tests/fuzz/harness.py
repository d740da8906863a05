"""Cases in forked processes, so that a crash, a hang or a full memory is attributed to its case."""

from __future__ import annotations

import contextlib
import faulthandler
import io
import json
import os
import re
import resource
import select
import shutil
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

from acoustube.base.errors import readable

HANG_S, IDLE_S = 10.0, 20.0
"""Processor time, and time without any, in s, after which a case counts as hanging; time taken by
other programs on a busy machine counts as neither."""
MEMORY, ADDRESSES = 2 * 1024**3, 8 * 1024**3
"""Memory in bytes that the cases of a process may use, and address space in bytes that they may
reserve, as compilers do, beyond the loaded code."""
OVERDONE = {"hang": f"hang of over {HANG_S:g} s", "memory": "memory of over 2 GB"}
BATCH = 100
"""Number of cases per process."""
TRIES = 5
"""Largest number of attempts to make a case of which all mutations are possible."""
LONGEST = 650
"""Largest length of an error message in characters."""
NOISE = re.compile(
    r"Traceback|Exception ignored|Warning:|\[Errno|Error:|HDF5-DIAG|dumped|^\w+:\d+:"
)
SENTENCE = re.compile(r"^(acoustube: |not processed: )")


@dataclass(frozen=True)
class Case:
    """A case: the words of a command run in `folder`, or a call that returns what is wrong.

    Attributes
    ----------
    words : tuple of str
    call : callable, optional
        In place of words; returns a complaint, or an empty text.
    told : tuple of str
        Words of which an error must name one; those of the command if empty.
    beside : callable, optional
        Makes a context in which the command runs.
    check : callable, optional
        Returns what is wrong with the files that the command left, or nothing.
    """

    words: tuple[str, ...] = ()
    call: Callable[[], str] | None = None
    told: tuple[str, ...] = ()
    beside: Callable[[], contextlib.AbstractContextManager[object]] = contextlib.nullcontext
    check: Callable[[], str] | None = None


Maker = Callable[[Random, Path, Path], Case]
"""Function that makes a random case from a generator, the valid files, and the case's folder."""


@dataclass(frozen=True)
class Finding:
    """A case that failed."""

    category: str
    number: int
    what: str
    folder: Path | None


def seeded(seed: int, category: str, number: int) -> Random:
    """Return the random generator of a case, which depends on these arguments only."""
    return Random(f"{seed} {category} {number}")


def run(
    maker: Maker, category: str, numbers: list[int], seed: int, corpus: Path, kept: Path
) -> Iterator[Finding | int]:
    """Run cases in child processes; yield the number of each that passed, or a finding."""
    left = list(numbers)
    while left:
        batch, left = left[:BATCH], left[BATCH:]
        with _scratch(kept) as scratch:
            done = 0
            for number, what in _forked(maker, category, batch, seed, corpus, scratch):
                done += 1
                if not what:
                    yield number
                    continue
                yield Finding(category, number, what, _keep(scratch, kept, category, seed, number))
            left = batch[done:] + left


@contextlib.contextmanager
def _scratch(kept: Path) -> Iterator[Path]:
    """Yield a folder for a batch, removed at the end."""
    folder = kept / f".batch-{os.getpid()}-{time.monotonic_ns()}"
    folder.mkdir(parents=True)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _keep(scratch: Path, kept: Path, category: str, seed: int, number: int) -> Path | None:
    """Move the folder of a case that failed to where it is kept."""
    folder, target = scratch / str(number), kept / f"{category}-{seed}-{number}"
    if folder.is_dir() and not target.exists():
        shutil.move(folder, target)
        return target
    return None


def _forked(
    maker: Maker, category: str, batch: list[int], seed: int, corpus: Path, scratch: Path
) -> Iterator[tuple[int, str]]:
    """Yield the number and the complaint of each case, up to one that ends the process."""
    reading, writing = os.pipe()
    sys.stdout.flush()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # on threads: none that matter exist before the fork
        child = os.fork()
    if child == 0:
        os.close(reading)
        _child(maker, category, batch, seed, corpus, scratch, writing)
    os.close(writing)
    number, ended = batch[0], ""
    with os.fdopen(reading, "rb") as results:
        for number in batch:
            line, ended = _line(results, child)
            if ended:
                break
            yield number, json.loads(line)
    if ended in OVERDONE:
        os.killpg(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # processes that it may have left running
    if ended:
        how = f"signal {os.WTERMSIG(status)}" if os.WIFSIGNALED(status) else f"status {status}"
        crash = scratch / str(number) / "stderr.txt"
        words = crash.read_text(errors="replace")[-1500:] if crash.exists() else ""
        yield number, f"{OVERDONE.get(ended, f'crash: {how}')}\n{words}"


def _line(results: Any, child: int) -> tuple[bytes, str]:
    """Return a line of results, or how the process ended: ``end``, ``hang`` or ``memory``."""
    held, session = _memory(Path("/proc/self")), Session(child)
    while not select.select([results], [], [], 0.2)[0]:
        session.look()
        if session.used > HANG_S or session.idle > IDLE_S:
            return b"", "hang"
        if session.memory - held > MEMORY:
            return b"", "memory"
    line = results.readline()
    return line, "" if line.endswith(b"\n") else "end"


class Session:
    """Use of processor and memory by a session of processes.

    Parameters
    ----------
    leader : int
        Process that leads the session.

    Attributes
    ----------
    before, used : float
        Processor time in s up to the start and since then, of the present processes and of their
        children that have ended.
    idle : float
        Time in s between samples at which no thread of the session was running or ready to run.
    memory : int
        Bytes of memory at the last sample.
    """

    def __init__(self, leader: int) -> None:
        self._leader, self._seen = leader, time.monotonic()
        self.before, self.memory, _ = _session(leader)
        self.used = self.idle = 0.0

    def look(self) -> None:
        """Update the numbers."""
        now = time.monotonic()
        total, self.memory, busy = _session(self._leader)
        self.used, self._seen, passed = total - self.before, now, now - self._seen
        self.idle += 0.0 if busy else passed


def _session(leader: int) -> tuple[float, int, bool]:
    """Return the processor time in s of a session, its memory in bytes, and whether it is busy."""
    ticks, memory, busy = 0, 0, False
    for process in Path("/proc").iterdir():
        if not process.name.isdigit():
            continue
        try:
            fields = _status(process)
            if int(fields[3]) == leader:
                ticks += sum(map(int, fields[11:15]))
                memory += _memory(process)
                busy |= any(_status(thread)[0] in "RD" for thread in process.glob("task/*"))
        except OSError:  # it has just ended
            continue
    return ticks / os.sysconf("SC_CLK_TCK"), memory, busy


def _status(process: Path) -> list[str]:
    """Return the status of a process or thread as the system reports it, from its state on."""
    return (process / "stat").read_text().rpartition(")")[2].split()


def _memory(process: Path) -> int:
    """Return the bytes of memory that a process uses."""
    return int((process / "statm").read_text().split()[1]) * resource.getpagesize()


def _child(
    maker: Maker, category: str, batch: list[int], seed: int, corpus: Path, scratch: Path, to: int
) -> None:
    """Run a batch and write a line for each case; never returns."""
    os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    home = scratch / "home"
    os.environ |= {"HOME": str(home), "ACOUSTUBE_CACHE": str(home / "cache"), "COLUMNS": "80"}
    os.environ |= {"XDG_DATA_HOME": str(home), "XDG_CONFIG_HOME": str(home), "SHELL": "/bin/bash"}
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + ADDRESSES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    code = 0
    try:
        for number in batch:
            folder = scratch / str(number)
            folder.mkdir()
            what = one(maker, seeded(seed, category, number), corpus, folder)
            os.write(to, json.dumps(what[:4000]).encode() + b"\n")
            if not what:
                shutil.rmtree(folder, ignore_errors=True)
    except BaseException:
        traceback.print_exc(file=(scratch / str(number) / "stderr.txt").open("a"))
        code = 70
    os._exit(code)


def one(maker: Maker, chance: Random, corpus: Path, folder: Path) -> str:
    """Make a case and run it; return what is wrong, or an empty text."""
    case = _made(maker, chance, corpus, folder)
    if case.call is not None:
        return case.call()
    before = _content(folder)
    os.chdir(folder)
    with case.beside():
        (out, err), code = _captured(case.words, folder)
    (folder / "command.txt").write_text(
        " ".join(map(repr, ("acoustube", *case.words))), encoding="utf-8", errors="backslashreplace"
    )
    what = judged(case, code, out, err, before, _content(folder))
    return what or ("" if case.check is None else case.check())


def _made(maker: Maker, chance: Random, corpus: Path, folder: Path) -> Case:
    """Make a case, and another one where a mutation makes the next one impossible."""
    for _ in range(TRIES):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return maker(chance, corpus, folder)
        except (
            OSError,
            RuntimeError,
            MemoryError,
            LookupError,
        ):  # on damaged files
            shutil.rmtree(folder)
            folder.mkdir()
    return Case(call=str)


def _captured(words: tuple[str, ...], folder: Path) -> tuple[tuple[str, str], Any]:
    """Run a command in this process; return its output, also of libraries, and its code."""
    from acoustube.cli import main

    paths = folder / "stdout.txt", folder / "stderr.txt"
    files = [os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC) for path in paths]
    for number, file in zip((1, 2), files, strict=True):
        os.dup2(file, number)
    sys.stdout = io.TextIOWrapper(io.FileIO(1, "w", closefd=False), encoding="utf-8")
    sys.stderr = io.TextIOWrapper(
        io.FileIO(2, "w", closefd=False), encoding="utf-8", errors="backslashreplace"
    )
    faulthandler.enable(2)
    code: Any
    try:
        with warnings.catch_warnings():
            code = main(list(words))
    except SystemExit as error:
        code = f"SystemExit {error.code}"
    except BaseException:
        code = "exception"
        traceback.print_exc()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    for file in files:
        os.close(file)
    return (_text(paths[0]), _text(paths[1])), code


def _text(path: Path) -> str:
    with path.open(errors="replace") as file:
        return file.read(200_000)


OURS = {"stdout.txt", "stderr.txt", "command.txt"}


def _content(folder: Path) -> dict[str, tuple[int, int]]:
    """Return the files and folders of a folder by name, with their size and time of change."""
    found = {}
    for path in folder.rglob("*"):
        name = str(path.relative_to(folder))
        if name not in OURS:
            status = path.lstat()
            plain = not path.is_dir()
            found[name] = (status.st_size, status.st_mtime_ns) if plain else (-1, 0)
    return found


def judged(case: Case, code: Any, out: str, err: str, before: Any, after: Any) -> str:
    """Return what is wrong with the exit and the output of a command, or nothing."""
    told = f"\n{err[-1500:]}"
    if code not in (0, 1, 2):
        return f"exit code {code}{told}"
    if NOISE.search(err) or "Traceback" in out:
        return f"not a sentence{told or out[-1500:]}"
    lines = [line for line in err.splitlines() if line.strip()]
    if code:
        sentences = [line for line in lines if SENTENCE.match(line)]
        partly = code == 1 and any(line.startswith("not processed: ") for line in sentences)
        if not sentences or (len(lines) > len(sentences) and not partly):
            return f"{len(lines)} lines, {len(sentences)} sentences{told}"
        if max(map(len, sentences)) > LONGEST:
            return f"sentence of {max(map(len, sentences))} characters{told}"
        if not _names_something(case, err):
            return f"names neither a file nor an argument{told}"
    changed = [name for name, state in before.items() if after.get(name) != state]
    if changed:
        return f"changed {changed}{told}"
    new = sorted(set(after) - set(before))
    hidden = [name for name in new if ".acoustube" in name]
    if hidden or (code == 2 and new):
        return f"left {hidden or new}{told}"
    return ""


def _names_something(case: Case, err: str) -> bool:
    """Return whether an error names a word of the command, or an argument with its value."""
    words = case.told or case.words
    # As written, or as a path is printed: "" and "./" as the folder ".".
    forms = ((word, Path(word).name, f"{Path(word)} ") for word in words)
    given = [readable(part) for form in forms for part in form if part]
    shown = " ".join(err.split())
    return any(word[:20] in shown for word in given) or bool(
        re.search(r"\w+ = |--\w|needs |cannot be read|give |line \d|\"", shown)
    )
