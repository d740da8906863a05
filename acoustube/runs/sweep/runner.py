"""The tasks of a sweep's work, and what becomes of their results."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from acoustube.runs import presses as press_runs
from acoustube.runs.scattering_file import to_dataset
from acoustube.runs.sweep import store
from acoustube.runs.sweep import tasks as sweep_tasks
from acoustube.runs.sweep.costs import hear_cost, matrix_cost, path_cost
from acoustube.runs.sweep.graph import Case, Descent, Group
from acoustube.runs.sweep.progress import Board
from acoustube.runs.sweep.workers import Task
from acoustube.waves import Scattering

CHUNK = 100
"""Cases that are heard in one task."""


class Runner:
    """Makes tasks of the work, and writes what comes of them."""

    def __init__(
        self, folder: Path, board: Board, failed: dict[str, str], done: Counter[str]
    ) -> None:
        self.folder, self.board, self.failed, self.done = folder, board, failed, done

    def first(self, paths: Sequence[Descent]) -> list[Task]:
        """Return the tasks that need no other, the longest first."""
        tasks = []
        for path in paths:
            if path.presses:
                tasks.append(self._press(path))
            for group in path.groups:
                if group.depth == 0:
                    tasks += self._hear(group, sweep_tasks.untouched(group.config), None)
        return sorted(tasks, key=lambda task: -task.cost)

    def _press(self, path: Descent) -> Task:
        def then(done: sweep_tasks.Done[sweep_tasks.PressPath]) -> list[Task]:
            self._count("path", done.reused, path_cost(path))
            tasks = []
            for group in path.groups:
                if group.depth in done.result.at:
                    tasks += self._scatter(path, group, done.result.at[group.depth])
                elif group.depth > 0:
                    self._fail(group.cases, done.result.stopped, group)
            return tasks

        def failed(reason: str) -> None:
            self.board.count("path", path_cost(path))
            for group in path.groups:
                if group.depth > 0:
                    self._fail(group.cases, reason, group)

        arguments = path.config, path.depths
        return Task("path", sweep_tasks.press, arguments, then, failed, path_cost(path))

    def _scatter(self, path: Descent, group: Group, pressed: sweep_tasks.Pressed) -> list[Task]:
        if group.band is None or pressed.part is None:
            return self._hear(group, pressed, None)
        cost = matrix_cost(group)

        def then(done: sweep_tasks.Done[Scattering]) -> list[Task]:
            self._count("scattering", done.reused, cost)
            light = dataclasses.replace(pressed, part=None)
            return self._hear(group, light, done.result)

        def failed(reason: str) -> None:
            self.board.count("scattering", cost)
            self._fail(group.cases, reason, None)

        config = group.config
        name = sweep_tasks.scattering_name(config, path.depths, group.depth, group.band)
        label = f"sound of {press_runs.press_in_words(config)}; {press_runs.wall_in_words(config)}"
        arguments = config, name, group.band, pressed.part, label
        return [Task("scattering", sweep_tasks.scattering, arguments, then, failed, cost)]

    def _hear(
        self, group: Group, pressed: sweep_tasks.Pressed, matrix: Scattering | None
    ) -> list[Task]:
        return [
            self._hear_some(group.cases[i : i + CHUNK], pressed, matrix)
            for i in range(0, len(group.cases), CHUNK)
        ]

    def _hear_some(
        self, cases: Sequence[Case], pressed: sweep_tasks.Pressed, matrix: Scattering | None
    ) -> Task:
        cost = hear_cost(cases)
        configs = {case.name: case.config for case in cases}

        def then(done: sweep_tasks.Done[sweep_tasks.Heard]) -> list[Task]:
            data, reasons = done.result
            if data is not None:
                sound = None if matrix is None else to_dataset(matrix)
                store.write(self.folder, data, sound, pressed.walls)
                store.forget_failures(self.folder, configs.keys() - reasons)
            for name, reason in reasons.items():
                self._fail([Case(name, configs[name])], reason, None)
            self.done["case"] += len(configs) - len(reasons)
            good = [case for case in cases if case.name not in reasons]
            self.board.count("cases", hear_cost(good), len(good))
            return []

        def failed(reason: str) -> None:
            self._fail(cases, reason, None)

        return Task("cases", sweep_tasks.hear, (configs, pressed, matrix), then, failed, cost)

    def _count(self, stage: str, reused: bool, cost: float) -> None:
        self.done[f"{stage} reused" if reused else f"{stage} computed"] += 1
        self.board.count(stage, cost, reused=reused)

    def _fail(self, cases: Sequence[Case], reason: str, skipped: Group | None) -> None:
        """Record that cases have failed; `skipped` is what will not be scattered then."""
        for case in cases:
            self.failed[case.name] = reason
            store.record_failure(self.folder, case.name, reason, dataclasses.asdict(case.config))
        self.board.count("cases", hear_cost(cases), len(cases))
        if skipped is not None and skipped.band is not None:
            self.board.count("scattering", matrix_cost(skipped))
