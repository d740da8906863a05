"""The command ``acoustube sweep``."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from acoustube.base.console import ConsoleReporter
from acoustube.runs.config import section_of
from acoustube.runs.sweep import store
from acoustube.runs.sweep.graph import CASE_SETTINGS, SCATTERING_SETTINGS, Case, load_paths
from acoustube.runs.sweep.plan import Plan
from acoustube.runs.sweep.run import Scale, Work, cases_of, report_work, work_of
from acoustube.runs.sweep.workers import cores

LOOKED_UP = 20_000
"""Cases of a plan up to which each is checked, and looked up, in a dry run."""
SAMPLED = 2000
"""Cases that are checked of a larger one."""


def dry_run(
    plan: Plan,
    out: str | Path | None,
    workers: int | None,
    console: Console,
    *,
    share: tuple[int, int] = (1, 1),
    retry: bool = False,
) -> None:
    """Print what a plan asks for, what is there, and what the rest costs.

    Parameters
    ----------
    plan : Plan
    out : str or path or None
        The sweep's folder, if any.
    workers : int, optional
        As many as there are cores by default.
    console : rich.console.Console
    share, retry
        See :func:`run_sweep`.

    Raises
    ------
    ConfigError
        If a case cannot be.
    """
    workers, report = workers or cores(), ConsoleReporter(console)
    if len(plan) <= LOOKED_UP:
        cases = cases_of(plan)
        folder = Path(out) if out is not None else None
        there = folder is not None and (folder / store.PLAN).is_file()
        found = store.contents(folder) if folder and there else store.Contents({}, [], [])
        work = work_of(cases, folder if there else None, found, share, retry)
        report_work(work, workers, report)
        return
    step = len(plan) // SAMPLED + 1
    sample = [Case(str(i), c) for i, c in enumerate(plan.configs(range(0, len(plan), step)))]
    part = load_paths(sample)
    scale = Scale(len(plan) / len(sample), *counted(plan))
    report_work(Work(part, 0, {}, len(plan)), workers, report, scale)
    report.note(f"one in {step} cases was checked, none looked up")


def counted(plan: Plan) -> tuple[int, int]:
    """Return how many paths and scattering matrices a plan has, from what varies in it."""
    own = {name for names in CASE_SETTINGS.values() for name in names}
    of_path = [n for n in plan.columns() if section_of(n) in CASE_SETTINGS and n not in own]
    return plan.distinct(of_path), plan.distinct([*of_path, "depth_mm", *SCATTERING_SETTINGS])
