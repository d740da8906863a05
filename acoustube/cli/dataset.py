"""The command ``acoustube dataset``: labelled cycles of the cases of a sweep."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.cli._options import WHOLE, Checked, Output, Workers

COUNT = Number(1, 1_000_000, "", "how many", whole=True)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Counts(Checked):
    """Numbers of cycles and of random specimens.

    Attributes
    ----------
    cycles : int
        Cycles to simulate per case, specimen and session.
    tubes : int
        Specimens of each tube of the sweep, each with its own irregularities.
    sessions : int
        Sessions per specimen, each with its own drift and temperature error.
    seed : int
        Random seed; the cycles do not depend on the number of workers.
    """

    cycles: Annotated[int, WHOLE, COUNT] = 50
    tubes: Annotated[int, WHOLE, COUNT] = 1
    sessions: Annotated[int, WHOLE, COUNT] = 1
    seed: Annotated[int, WHOLE, Number(0, 2**63 - 1, "", "seed", whole=True)] = 0


def dataset(
    *sweep: Path,
    counts: Counts = Counts(),
    rangefinder: Annotated[
        list[Path] | None, Parameter(name=("--rangefinder", "--sensor"), consume_multiple=True)
    ] = None,
    out: Path,
    processes: Workers = Workers(),
    output: Output = Output(),
) -> None:
    """Simulate labelled cycles of a rangefinder for each case of a sweep, for training.

    Parameters
    ----------
    sweep : Path
        Folders that ``acoustube sweep`` wrote.
    rangefinder : list
        TOML file with the parameters of the rangefinder, or file of a twin; by default the sleeve
        paper's rangefinder at the carrier of each case. With a twin, the first specimen has the
        clutter measured on the sensor. With files of several twins, fitted to sessions of one
        sensor, the parameters of each session are random, with the mean and the spread of the
        twins.
    out : Path
        Folder to write, or to resume.
    """
    if not sweep:
        raise ConfigError(
            "dataset needs the folder of a sweep; name one or more, before --sensor, which takes "
            "all files that follow it"
        )

    from acoustube.runs.sweep.cycles import Recipe
    from acoustube.runs.sweep.dataset import run_dataset
    from acoustube.runs.twin_sessions import recipe_settings

    report = output.reporter()
    settings: dict[str, Any] = {}
    if rangefinder:
        settings, table = recipe_settings(rangefinder)
        report.rows([
            (one.name, f"{one.mean:.6g} +- {one.deviation:.2g}, "
             + (f"varies by {one.spread:.2g}" if one.wanders else "constant"))
            for one in table
        ])  # fmt: skip
    recipe = Recipe(
        n_cycles=counts.cycles, n_tubes=counts.tubes, n_sessions=counts.sessions, seed=counts.seed,
        **settings,
    )  # fmt: skip
    run_dataset(sweep, out, recipe, report=report, workers=processes.workers)
