"""The command ``acoustube twin``: the simulator fitted to recordings of a sensor."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from acoustube.base.errors import ConfigError
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.report import Reporter, counted
from acoustube.base.rules import Number
from acoustube.base.units import CM, PERCENT
from acoustube.base.writing import write_all
from acoustube.cli._options import WHOLE, Checked, Lead, Output, Recording, check_files

if TYPE_CHECKING:
    from acoustube.runs.twin import FittedSensor

POOR_FIT = 0.95
"""Fraction of the echoes' energy explained by the model below which a note reports a poor fit."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Known(Checked):
    """Known properties of the tube and of the converter.

    Attributes
    ----------
    length : float
        Length of the tube in cm.
    bits : int
        Resolution of the converter in bits; by default the least that holds the recorded counts.
    humidity : float
        Relative humidity of the air in per cent, with which temperatures are those of moist air; by
        default they are those at which dry air has the measured speed of sound.
    """

    length: Annotated[float | None, Number(1, 1000, "cm", "length of the tube")] = None
    bits: Annotated[int | None, WHOLE, Number(1, 16, "", "bits", whole=True)] = None
    humidity: Annotated[float | None, Number(0, 100, "%", "relative humidity")] = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Others:
    """Further recordings.

    Attributes
    ----------
    untouched : list
        Recordings of the untouched tube, in place of the last file.
    pressed : list
        Recordings of presses by a known indenter, with the label ``force`` or ``depth``, files or
        folders: they determine the wall's modulus and whether the ground yields.
    tools : Path
        Library of the indenters used: a folder that ``acoustube library`` wrote.
    """

    untouched: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None
    pressed: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None
    tools: Annotated[Path | None, Parameter(name="--library")] = None

    def __post_init__(self) -> None:
        """Check that presses have a library."""
        if (self.pressed is None) != (self.tools is None):
            raise ConfigError(
                "--pressed and --library go together: recordings of presses, and the indenters' "
                "library, which acoustube library wrote"
            )


def twin(
    *files: Path,
    others: Others = Others(),
    known: Known = Known(),
    recording: Recording = Recording(),
    lead: Lead = Lead(),
    out: Path,
    figure: Path | None = None,
    output: Output = Output(),
) -> None:
    """Fit the simulator to a sensor, from cycles of the tube closed at known places and untouched.

    Parameters
    ----------
    files : Path
        Recordings with the tube closed, with the label ``true_distance`` (or ``distance_cm``,
        ``distance_m``), files or folders; the last is that of the untouched tube.
    out : Path
        File to write (TOML), which must be new: every parameter with its standard deviation.
    figure : Path
        Picture to write (PNG, PDF or SVG) of simulated and recorded cycles; must be new.
    """
    untouched = others.untouched
    if len(files) < (2 if untouched is None else 1):
        raise ConfigError(
            "twin needs recordings of the closed tube, then one of the untouched tube; name both"
        )
    closed, free = (files[:-1], files[-1:]) if untouched is None else (files, untouched)
    check_files(out=out, figure=figure)
    from acoustube.runs.twin import Bench, fitted_sensor
    from acoustube.runs.twin_file import in_toml, parameters, time_zero_note

    report = output.reporter()
    length = None if known.length is None else known.length / CM
    bench = Bench(length=length, bits=known.bits, humidity=known.humidity)
    options = dataclasses.asdict(recording)
    with watched_interrupts() as check:
        found = fitted_sensor(
            closed, free, options, lead.pulse_at, bench=bench, report=report, check=check
        )
        if others.pressed is not None and others.tools is not None:
            from acoustube.runs.twin_pressed import fitted_material

            material, states = fitted_material(
                found, others.pressed, free, others.tools, options, lead.pulse_at,
                report=report, check=check,
            )  # fmt: skip
            found = dataclasses.replace(found, material=material, pressed=states)
    contents: dict[Path, bytes | str] = {out: in_toml(found)}
    if figure is not None:
        from acoustube.reports.figures.run import picture
        from acoustube.reports.figures.twin import twin_figure

        contents[figure] = picture(twin_figure(found), figure)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_all(contents)
    if note := time_zero_note(found):
        report.note(note)
    _print_closures(found, report)
    _print_presses(found, report)
    rows = [
        (one.name, f"{one.value:.6g} +- {one.deviation:.2g}"
         + ("" if one.determined else ", not determined by the recordings"))
        for one in parameters(found)
    ]  # fmt: skip
    report.rows(rows)
    report.line(f"Written to {out}.")


def _print_closures(found: FittedSensor, report: Reporter) -> None:
    """Report the closures that were left out, and the quality of the fit to the others."""
    for i, reason in found.twin.left_out.items():
        group = found.closed[i]
        report.note(
            f"{group.source}: the closure at {CM * group.place:.1f} cm is left out: {reason}"
        )
    explained = found.twin.explained
    report.line(
        f"{len(found.twin.used)} of {len(found.closed)} closures are fitted; the model explains "
        f"{PERCENT * float(explained.mean()):.2f} % of their echoes' energy"
    )
    if explained.mean() < POOR_FIT:
        report.note(
            f"the model explains less than {PERCENT * POOR_FIT:g} % of that energy, so that it "
            "lacks some part of this sensor; compare the cycles in the picture of --figure"
        )


def _print_presses(found: FittedSensor, report: Reporter) -> None:
    """Report the presses that determine wall and ground, and those that are left out."""
    material = found.material
    if material is None:
        return
    for i, state in enumerate(found.pressed):
        where = f" at {CM * state.place:.1f} cm" if isfinite(state.place) else ""
        words = [state.reason, material.left_out.get(i, "")]
        if reasons := " and ".join(word for word in words if word):
            report.note(f"{state.source}: the press{where}: {reasons}")
    measured = sum(isfinite(state.press.depth) for state in found.pressed)
    used = len(found.pressed) - len(material.left_out)
    presses = counted(len(found.pressed), "press")
    report.line(
        f"{presses}: the depths of {measured} are estimated from their echoes; "
        f"the forces of {used} determine the wall's modulus"
    )
    if material.yields:
        report.note(
            "the ground yields under the tube: stated depths are larger than those of the echoes"
        )
