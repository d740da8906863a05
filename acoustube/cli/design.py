"""The command ``acoustube design``: tube, transducer and pulse of a sensor that meets a goal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from acoustube.base.files import check_out
from acoustube.base.rules import Number
from acoustube.base.writing import write_all
from acoustube.cli._options import FLAG, WHOLE, Checked, Output, Workers


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Effort(Checked):
    """Extent of the search.

    Attributes
    ----------
    tubes : int
        Largest number of tubes that are pressed.
    seed : int
        Random seed of the tubes with which the search starts.
    robust : bool
        Also compute how the errors change with bore, hardness and temperature.
    """

    tubes: Annotated[int, WHOLE, Number(1, 2000, "", "tubes", whole=True)] = 40
    seed: Annotated[int, WHOLE, Number(0, 2**31, "", "random seed", whole=True)] = 0
    robust: Annotated[bool, FLAG] = False


def design(
    goal: Path,
    *,
    out: Path,
    effort: Effort = Effort(),
    processes: Workers = Workers(),
    output: Output = Output(),
) -> None:
    """Search for tube, transducer and pulse of a sensor that meets a goal.

    Presses and scattering matrices of each tube are cached. To resume an interrupted search, repeat
    the command.

    Parameters
    ----------
    goal : Path
        TOML file with the requirements ([goal]) and the design variables ([variables]).
    out : Path
        Folder to write, new or empty: the Pareto front, recommended sensors, and a page of both.
    """
    from acoustube.runs.config.goal import read_goal

    wanted = read_goal(goal)
    folder = check_out(out)
    from acoustube.reports.design.files import contents_of
    from acoustube.runs.design.run import run_design, summary

    report = output.reporter()
    found = run_design(
        wanted, seed=effort.seed, tubes=effort.tubes, robust=effort.robust, report=report,
        workers=processes.workers,
    )  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    write_all({folder / name: content for name, content in contents_of(found).items()})
    for note in found.notes:
        report.note(note)
    report.rows(summary(found))
    report.line(f"Written to {out}; see design.html.")
