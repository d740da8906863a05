"""Scheduling of a sweep: tasks for its load paths, and the tasks that follow from the results."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from acoustube.runs import presses as press_runs
from acoustube.runs.scattering_file import StoredScattering, to_dataset
from acoustube.runs.sweep import store
from acoustube.runs.sweep import tasks as sweep_tasks
from acoustube.runs.sweep.case_results import CaseResults, simulate_cases
from acoustube.runs.sweep.costs import case_cost, matrix_cost, path_cost
from acoustube.runs.sweep.graph import Case, Group, LoadPath
from acoustube.runs.sweep.progress import Board
from acoustube.runs.sweep.workers import Task

CASES_PER_TASK = 100
"""Largest number of cases that a task simulates."""


class Runner:
    """Scheduler of a sweep: creates the tasks, and writes their results.

    Parameters
    ----------
    folder : Path
        Folder of the sweep.
    board : Board
        Progress display.
    failed : dict of str
        Reasons of failure by name of the case; failures of the sweep are added.
    done : Counter
        Numbers of finished tasks by kind; those of the sweep are added.
    """

    def __init__(
        self, folder: Path, board: Board, failed: dict[str, str], done: Counter[str]
    ) -> None:
        self.folder, self.board, self.failed, self.done = folder, board, failed, done

    def first(self, paths: Sequence[LoadPath]) -> list[Task]:
        """Return the tasks that depend on no other, the longest first."""
        tasks = []
        for path in paths:
            if path.presses:
                tasks.append(self._press(path))
            for group in path.groups:
                if group.depth == 0:
                    tasks += self._simulate(group, sweep_tasks.untouched(group.settings), None)
        return sorted(tasks, key=lambda task: -task.cost)

    def _press(self, path: LoadPath) -> Task:
        def then(done: sweep_tasks.Done[sweep_tasks.PressPath]) -> list[Task]:
            self._count("load paths", done.reused, path_cost(path))
            tasks = []
            for group in path.groups:
                if group.depth in done.result.at:
                    tasks += self._scatter(path, group, done.result.at[group.depth])
                elif group.depth > 0:
                    self._fail(group.cases, done.result.failed[group.depth], group)
            return tasks

        def failed(reason: str) -> None:
            self.board.count("load paths", path_cost(path))
            for group in path.groups:
                if group.depth > 0:
                    self._fail(group.cases, reason, group)

        arguments = path.settings, path.depths
        return Task(sweep_tasks.press, arguments, then, failed, path_cost(path))

    def _scatter(self, path: LoadPath, group: Group, pressed: sweep_tasks.Pressed) -> list[Task]:
        if group.band is None or pressed.part is None:
            return self._simulate(group, pressed, None)
        cost = matrix_cost(group)

        def then(done: sweep_tasks.Done[StoredScattering]) -> list[Task]:
            self._count("scattering", done.reused, cost)
            light = dataclasses.replace(pressed, part=None)
            return self._simulate(group, light, done.result)

        def failed(reason: str) -> None:
            self.board.count("scattering", cost)
            self._fail(group.cases, reason, None)

        settings = group.settings
        name = sweep_tasks.scattering_key(settings, path.depths, group.depth, group.band)
        press, wall = press_runs.press_in_words(settings), press_runs.wall_in_words(settings)
        label = f"sound of {press}; {wall}"
        arguments = settings, name, group.band, pressed.part, label
        return [Task(sweep_tasks.scattering, arguments, then, failed, cost)]

    def _simulate(
        self, group: Group, pressed: sweep_tasks.Pressed, matrix: StoredScattering | None
    ) -> list[Task]:
        return [
            self._simulate_some(group.cases[i : i + CASES_PER_TASK], pressed, matrix)
            for i in range(0, len(group.cases), CASES_PER_TASK)
        ]

    def _simulate_some(
        self, cases: Sequence[Case], pressed: sweep_tasks.Pressed, matrix: StoredScattering | None
    ) -> Task:
        cost = case_cost(cases)
        configs = {case.name: case.config for case in cases}

        def then(done: sweep_tasks.Done[CaseResults]) -> list[Task]:
            data, reasons = done.result
            if data is not None:
                sound = None if matrix is None else to_dataset(matrix)
                store.write(self.folder, data, sound, pressed.walls)
                store.delete_failures(self.folder, configs.keys() - reasons)
            for name, reason in reasons.items():
                self._fail([Case(name, configs[name])], reason, None)
            self.done["case"] += len(configs) - len(reasons)
            good = [case for case in cases if case.name not in reasons]
            self.board.count("cases", case_cost(good), len(good))
            return []

        def failed(reason: str) -> None:
            self._fail(cases, reason, None)

        return Task(simulate_cases, (configs, pressed, matrix), then, failed, cost)

    def _count(self, stage: str, reused: bool, cost: float) -> None:
        self.done[f"{stage} reused" if reused else f"{stage} computed"] += 1
        self.board.count(stage, cost, reused=reused)

    def _fail(self, cases: Sequence[Case], reason: str, skipped: Group | None) -> None:
        """Record that cases failed; the matrix of the group `skipped` is then not computed."""
        for case in cases:
            self.failed[case.name] = reason
            store.record_failure(self.folder, case.name, reason, dataclasses.asdict(case.config))
        self.board.count("cases", case_cost(cases), len(cases))
        if skipped is not None and skipped.band is not None:
            self.board.count("scattering", matrix_cost(skipped))
