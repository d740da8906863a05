"""Sweeps: the cases of a plan that a folder lacks, computed on many workers."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from acoustube.base.checks import FLAG, Optional, Several, checked
from acoustube.base.errors import ConfigError
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.names import PATH
from acoustube.base.report import SILENT, Reporter, counted, time_in_words
from acoustube.base.rules import Number
from acoustube.base.version import __version__
from acoustube.base.writing import write
from acoustube.runs.sweep import store
from acoustube.runs.sweep.costs import (
    GIGABYTES,
    cached,
    case_cost,
    matrix_cost,
    path_cost,
    size_of,
)
from acoustube.runs.sweep.graph import Case, LoadPath, load_paths, only_cases, shard
from acoustube.runs.sweep.plan import Plan, case_name, load_plan, to_toml
from acoustube.runs.sweep.progress import Board, totals_of
from acoustube.runs.sweep.runner import Runner
from acoustube.runs.sweep.workers import WORKERS, Task, Workers, count_of, run_tasks, worker_pool

LISTED = 10
"""Largest number of failed cases that are printed."""


class Work(NamedTuple):
    """Finished, failed and remaining cases of a plan, or of a part of it.

    Attributes
    ----------
    todo : list of LoadPath
        Load paths of the remaining cases.
    finished : int
        Number of finished cases.
    failed : dict of str
        Reasons why cases have failed, by name of the case; these are not repeated.
    n_cases : int
        Number of all cases of the part.
    """

    todo: list[LoadPath]
    finished: int
    failed: dict[str, str]
    n_cases: int


@checked(
    plan=Plan,
    out=PATH,
    workers=WORKERS,
    width=Optional(Number(1, 1e6, "tasks", whole=True)),
    share=Several(Number(1, 1e9, whole=True), 2),
    retry=FLAG,
)
def run_sweep(
    plan: Plan,
    out: str | Path,
    *,
    report: Reporter = SILENT,
    workers: int | Workers | None = None,
    executor: Executor | None = None,
    width: int | None = None,
    share: tuple[int, int] = (1, 1),
    retry: bool = False,
) -> bool:
    """Compute the missing cases of a plan.

    Parameters
    ----------
    plan : Plan
    out : str or path
        Folder of the sweep, new or to be resumed.
    report : Reporter
        Receives messages and progress; by default nothing is shown.
    workers : int or Workers, optional
        Number of processes, by default that of the cores; or an existing pool.
    executor : concurrent.futures.Executor, optional
        Runs the tasks in place of processes of this machine.
    width : int, optional
        Number of tasks submitted to `executor` at a time; by default the number of its workers if
        known, else that of the processes.
    share : (int, int)
        Number, from 1, of the part of the plan to compute, and count of parts of nearly equal size.
    retry : bool
        Whether cases that failed before are tried again.

    Returns
    -------
    bool
        Whether no case has failed, now or, without `retry`, before.

    Raises
    ------
    ConfigError
        If the plan, the part of it or the folder cannot be used.
    SimulationError
        If a file cannot be written, as on a full disk, or the workers are gone.
    """
    started = time.perf_counter()
    if len(share) > 2 or share[0] > share[1]:
        raise ConfigError(
            "is not a part of a plan", setting="share", value=tuple(share),
            advice="give (number, count) with a number from 1 to count",
        )  # fmt: skip
    cases = cases_of(plan)
    folder = store.prepared(out)
    found = store.contents(folder)
    _note_contents(folder, found, report)
    work = work_of(cases, folder, found, share, retry)
    _note_other_plan(plan, folder, found, {case.name for case in cases}, report)
    store.delete_failures(folder, found.finished.keys() & store.failures(folder).keys())
    write(folder / store.PLAN, to_toml(plan), overwrite=True)
    at_once: int = width or getattr(executor, "_max_workers", None) or count_of(workers)
    report_work(work, at_once, report)
    done = Counter[str]()
    failed = dict(work.failed)
    if work.todo:
        with watched_interrupts() as check, report.progress(check) as show:
            board = Board(totals_of(work.todo), at_once, show)
            runner = Runner(folder, board, failed, done)
            try:
                run_with_progress(
                    runner.first(work.todo), board, workers=workers, executor=executor,
                    width=at_once,
                )  # fmt: skip
            except KeyboardInterrupt:
                there = work.finished + done["case"]
                raise KeyboardInterrupt(
                    f"interrupted; {there} of {work.n_cases} cases are finished, run the same "
                    "command again to go on"
                ) from None
    _report_end(done, failed, folder, time.perf_counter() - started, report)
    return not failed


def run_with_progress(
    tasks: Iterable[Task],
    board: Board,
    *,
    workers: int | Workers | None,
    executor: Executor | None = None,
    width: int | None = None,
) -> None:
    """Run tasks and show their progress.

    Parameters
    ----------
    tasks : iterable of Task
    board : Board
        Progress display; refreshing it also raises a keyboard interrupt that a library suppressed.
    workers : int, Workers or None
        Processes of this machine, unless there is an executor.
    executor : concurrent.futures.Executor, optional
        Runs the tasks in place of processes of this machine.
    width : int, optional
        Number of tasks submitted at a time; as many as `workers` by default.
    """
    with worker_pool(workers) as processes:
        run_tasks(tasks, executor or processes, width or processes.count, board.tick)


def _note_contents(folder: Path, found: store.Contents, report: Reporter) -> None:
    """Rename damaged files, and report them and the files of other programs."""
    for path in found.damaged:
        aside = store.set_aside(path)
        report.note(f"{path.name} is damaged; it is computed again, and kept as {aside.name}")
    if found.foreign:
        names = ", ".join(path.name for path in found.foreign[:3])
        more = f" and {len(found.foreign) - 3} more" * (len(found.foreign) > 3)
        report.note(f"{names}{more} in {folder} are not files of a sweep; they are kept")


class Scale(NamedTuple):
    """Size of a plan of which only a sample of cases is examined.

    Attributes
    ----------
    cases : float
        Number of cases of the plan divided by that of the sample.
    n_paths, n_matrices : int
        Numbers of load paths and of scattering matrices of the plan.
    """

    cases: float
    n_paths: int
    n_matrices: int


def cases_of(plan: Plan) -> list[Case]:
    """Return the cases of a plan, each once.

    Raises
    ------
    ConfigError
        If there are none, or a case is not valid.
    """
    if not len(plan):
        raise ConfigError("the plan has no cases; give values to vary")
    named = {case_name(config): config for config in plan.configs()}
    return [Case(name, config) for name, config in named.items()]


def work_of(
    cases: Sequence[Case],
    folder: Path | None,
    found: store.Contents,
    share: tuple[int, int],
    retry: bool,
) -> Work:
    """Return the work that remains of a part of the cases.

    Parameters
    ----------
    cases : sequence of Case
        All cases of a plan.
    folder : Path or None
        Folder of the sweep; None if there is none.
    found : Contents
        Contents of the folder.
    share : (int, int)
        Number of the part, from 1, and count of parts.
    retry : bool
        Whether cases that failed before remain.
    """
    paths = load_paths(cases)
    mine = shard(paths, *share)
    finished = mine & set(found.finished)
    known = {} if folder is None or retry else store.failures(folder)
    failed = {n: reason for n, reason in known.items() if n in mine - finished}
    return Work(only_cases(paths, mine - finished - set(failed)), len(finished), failed, len(mine))


def _note_other_plan(
    plan: Plan, folder: Path, found: store.Contents, names: set[str], report: Reporter
) -> None:
    """Report the results in a folder of another plan or of another version of acoustube."""
    path = folder / store.PLAN
    before = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    if not before or before == to_toml(plan):
        return
    if f'acoustube_version = "{__version__}"' not in before:
        report.note(f"{folder.name} was begun by another version of acoustube, or its plan is "
              "damaged; what is finished there is kept")  # fmt: skip
    there, others = names & set(found.finished), set(found.finished) - names
    if others or _names_of(path) != names:
        kept_too = f", and {len(others)} that it no longer asks for are kept" * bool(others)
        report.note(
            f"the plan has changed since {folder.name} was begun; {len(there)} of its "
            f"{len(names)} cases are there already{kept_too}",
        )


def _names_of(path: Path) -> set[str]:
    """Return the names of the cases of a plan in a file; none if the file is not a plan."""
    try:
        return {case_name(config) for config in load_plan(path).configs()}
    except ConfigError:
        return set()


def report_work(work: Work, workers: int, report: Reporter, scale: Scale | None = None) -> None:
    """Report the cases, the load paths and matrices that they share, and their expected cost.

    If `scale` is given, `work` is that of a sample, from which the cost of the plan is estimated.
    """
    groups = [group for path in work.todo for group in path.groups]
    n_paths = sum(path.presses for path in work.todo)
    n_matrices = sum(1 for group in groups if group.band is not None)
    known_paths, known_matrices, cost = cached(work.todo) if scale is None else (0, 0, 0.0)
    size = sum(size_of(group) for group in groups)
    if scale is not None:
        costs = [path_cost(path) for path in work.todo], [matrix_cost(g) for g in groups]
        cost = scale.n_paths * float(np.mean(costs[0] or [0.0]))
        cost += scale.n_matrices * float(np.mean(costs[1] or [0.0]))
        cost += scale.cases * sum(case_cost(group.cases) for group in groups)
        n_paths, n_matrices, size = scale.n_paths, scale.n_matrices, scale.cases * size
    state = f"{work.finished} finished" + f", {len(work.failed)} failed" * bool(work.failed)
    processes = counted(workers, "worker")
    needed = f"{time_in_words(cost / workers)} on {processes}, {GIGABYTES * workers:.0f} GB"
    report.title("a sweep")
    report.rows(
        [
            ("cases", f"{work.n_cases}, {state}"),
            ("load paths", f"{n_paths}, {known_paths} cached"),
            ("scattering matrices", f"{n_matrices}, {known_matrices} cached"),
            ("expected", f"{needed} of memory, {size / 1e6:.3g} MB of disk"),
        ]
    )


def _report_end(
    done: Counter[str], failed: dict[str, str], folder: Path, seconds: float, report: Reporter
) -> None:
    """Report the numbers of computed tasks and cases, and the failed cases with the reasons."""
    if done:
        report.line(
            f"load paths: {done['load paths computed']} computed, "
            f"{done['load paths reused']} reused; "
            f"scattering: {done['scattering computed']} computed, "
            f"{done['scattering reused']} reused; cases: {done['case']} computed"
        )
    else:
        report.line("nothing to compute")
    for name, reason in list(failed.items())[:LISTED]:
        report.failure(f"{name}: {reason}")
    if failed:
        more = f", {len(failed) - LISTED} more in {store.FAILURES}/" * (len(failed) > LISTED)
        them = "it" if len(failed) == 1 else "them"
        report.failure(
            f"{counted(len(failed), 'case')}{more}; try {them} again with --retry failed"
        )
    report.line(f"Written to {folder} in {time_in_words(seconds)}.")
