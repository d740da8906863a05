"""The command ``acoustube sweep``: presses of many tubes, positions, indenters and depths."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from acoustube.base.errors import ConfigError
from acoustube.cli._options import FLAG, WHOLE, Checked, Output, Workers, axis, settings_of
from acoustube.runs.config import section_of
from acoustube.runs.sweep.plan import COUNT, SEED, Plan, load_plan
from acoustube.runs.sweep.plan_text import other_settings

if TYPE_CHECKING:
    from acoustube.base.report import Reporter

LOOKED_UP = 20_000
"""Largest number of cases of a plan for which a dry run looks up the results of every case."""
SAMPLED = 2000
"""Largest number of cases, evenly spaced, from which a dry run estimates the cost of a larger plan;
their results are not looked up."""
Values = list[str] | None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Axes:
    """Settings with one or more values each."""

    indenter: Annotated[Values, axis("indenter")] = None
    shape: Annotated[Values, axis("shape")] = None
    depth: Annotated[Values, axis("depth")] = None
    position: Annotated[Values, axis("position")] = None
    length: Annotated[Values, axis("length")] = None
    bore: Annotated[Values, axis("bore")] = None
    hardness: Annotated[Values, axis("hardness")] = None
    support: Annotated[Values, axis("support")] = None
    frequency: Annotated[Values, axis("frequency")] = None
    temperature: Annotated[Values, axis("temperature")] = None
    resolution: Annotated[Values, axis("resolution")] = None
    losses: Annotated[Values, axis("losses")] = None
    method: Annotated[Values, axis("method")] = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Choice(Checked):
    """Options that select the cases.

    Attributes
    ----------
    vary : list
        Other settings, such as wall_mm=1.2:2:0.2 or support=held,free.
    random : int
        Number of random cases; settings may then be given as a range low:high.
    sampler : str
        Sampling of the ranges of a random plan: sobol (default) or latin.
    seed : int
        Random seed of a random plan.
    plan : Path
        TOML file with the plan, which options override.
    """

    vary: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None
    random: Annotated[int | None, WHOLE, COUNT] = None
    sampler: Literal["sobol", "latin"] | None = None
    seed: Annotated[int | None, WHOLE, SEED] = None
    plan: Path | None = None

    def with_axes(self, axes: Axes) -> Plan:
        """Return the plan from these options and from the settings that vary."""
        over = {name: words for name, words in settings_of(axes).items() if words is not None}
        over |= other_settings(self.vary or [], over)
        return load_plan(self.plan, over, count=self.random, sampler=self.sampler, seed=self.seed)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Execution:
    """Options of the computation: output folder, shard, cluster, repetition of failed cases.

    Attributes
    ----------
    out : Path
        Folder to write, or to resume.
    shard : str
        Part of the plan to compute, for job arrays: 3/40 is the third of 40 parts. All parts write
        to the same folder.
    dask : str
        Address of the scheduler of a running Dask cluster, in place of local processes.
    retry : str
        Cases to compute again: ``failed``.
    dry_run : bool
        Report the cases, their cached results and the expected cost; compute nothing.
    """

    out: Path | None = None
    shard: str | None = None
    dask: str | None = None
    retry: Literal["failed"] | None = None
    dry_run: Annotated[bool, FLAG] = False

    def share(self) -> tuple[int, int]:
        """Return number and count of the shard, such as (3, 40) for 3/40; (1, 1) by default.

        Raises
        ------
        ConfigError
            If the shard is not of this form, or its number is not from 1 to the count.
        """
        if self.shard is None:
            return 1, 1
        found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", self.shard)
        number, count = (int(found[1]), int(found[2])) if found else (0, 0)
        if not 1 <= number <= count:
            raise ConfigError(
                "is not a shard", setting="shard", value=self.shard,
                advice="write NUMBER/COUNT with NUMBER from 1 to COUNT, such as 3/40",
            )  # fmt: skip
        return number, count


def sweep(
    *,
    axes: Axes = Axes(),
    choice: Choice = Choice(),
    execution: Execution = Execution(),
    processes: Workers = Workers(),
    output: Output = Output(),
) -> int:
    """Simulate many presses and tubes; results in the folder are not computed again.

    Each setting takes one or more values, or ranges first:last:step that include both ends. All
    combinations are computed, or random ones. A depth of 0 is the untouched tube.
    """
    plan, share, out = choice.with_axes(axes), execution.share(), execution.out
    if out is None and not execution.dry_run:
        raise ConfigError("out is missing; name the folder to write, or give --dry-run")
    report, retry = output.reporter(), execution.retry is not None
    if execution.dry_run or out is None:
        _dry_run(plan, out, processes.workers, report, share=share, retry=retry)
        return 0

    from acoustube.runs.sweep.run import run_sweep
    from acoustube.runs.sweep.workers import dask_executor

    executor, width = (None, None) if execution.dask is None else dask_executor(execution.dask)
    try:
        complete = run_sweep(
            plan, out, report=report, workers=processes.workers, executor=executor, width=width,
            share=share, retry=retry,
        )  # fmt: skip
    finally:
        if executor is not None:
            executor.shutdown(wait=False)
    return 0 if complete else 1


def _dry_run(
    plan: Plan,
    out: Path | None,
    workers: int | None,
    report: Reporter,
    *,
    share: tuple[int, int],
    retry: bool,
) -> None:
    """Report the cases of a plan, those that are finished, and the cost of the rest."""
    from acoustube.runs.sweep import store
    from acoustube.runs.sweep.graph import Case, load_paths
    from acoustube.runs.sweep.run import Scale, Work, cases_of, report_work, work_of
    from acoustube.runs.sweep.workers import cores

    workers = workers or cores()
    if len(plan) <= LOOKED_UP:
        cases = cases_of(plan)
        there = out is not None and (out / store.PLAN).is_file()
        found = store.contents(out) if out and there else store.Contents({}, [], [])
        work = work_of(cases, out if there else None, found, share, retry)
        report_work(work, workers, report)
        return
    step = len(plan) // SAMPLED + 1
    sample = [Case(str(i), c) for i, c in enumerate(plan.configs(range(0, len(plan), step)))]
    part = load_paths(sample)
    scale = Scale(len(plan) / len(sample), *_counted(plan))
    report_work(Work(part, 0, {}, len(plan)), workers, report, scale)
    report.note(f"only one in {step} cases was checked; cached results were not looked up")


def _counted(plan: Plan) -> tuple[int, int]:
    """Return the numbers of load paths and scattering matrices of a plan, from its settings."""
    from acoustube.runs.sweep.graph import CASE_SETTINGS, SCATTERING_SETTINGS

    own = {name for names in CASE_SETTINGS.values() for name in names}
    of_path = [n for n in plan.columns() if section_of(n) in CASE_SETTINGS and n not in own]
    return plan.distinct(of_path), plan.distinct([*of_path, "depth_mm", *SCATTERING_SETTINGS])
