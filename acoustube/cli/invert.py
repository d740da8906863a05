"""The command ``acoustube invert``: contacts in recordings, by inversion of the forward model."""

from __future__ import annotations

import csv
import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from acoustube.base.console import failure
from acoustube.base.errors import ConfigError, about
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.rules import Number
from acoustube.cli._options import WHOLE, Checked, Output, Recording, check_files


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Search(Checked):
    """Options of the inversion.

    Attributes
    ----------
    group : int
        Cycles that are evaluated together; the tube must be at rest meanwhile.
    most : int
        Largest number of contacts.
    """

    group: Annotated[int, WHOLE, Number(1, 100_000, "", "cycles", whole=True)] = 1
    most: Annotated[int, WHOLE, Number(1, 8, "", "contacts", whole=True)] = 3


def invert(
    *files: Path,
    library: Path,
    sensor: Path | None = None,
    untouched: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None,
    search: Search = Search(),
    recording: Recording = Recording(),
    out: Path | None = None,
    figure: Path | None = None,
    output: Output = Output(),
) -> int:
    """Find the contacts in recordings: number, distance, depth, force and tool, with uncertainty.

    Parameters
    ----------
    files : Path
        Recordings in the formats of `process`, in ADC counts; the first sample starts the drive.
    library : Path
        Folder that the command library wrote.
    sensor : Path
        TOML file with the parameters of the rangefinder, the tube's length_cm, a table [priors],
        and a table [wrap] if it is worn on a forearm; that of the sleeve paper if not given.
    untouched : Path
        Recordings of the tube without contact, from which its clutter is learned.
    out : Path
        Table to write (CSV), one row a contact; standard output if not given.
    figure : Path
        Picture to write (PNG, PDF or SVG): the posterior along the tube of the first group with a
        contact.
    """
    if not files:
        raise ConfigError("invert needs a file or a folder; name one or more")
    check_files(out=out, figure=figure)
    from acoustube import recordings
    from acoustube.runs import inversion
    from acoustube.runs.libraries.files import open_library
    from acoustube.runs.recordings import opened, read_cycles

    options = dataclasses.asdict(recording)
    known = open_library(library)
    own = inversion.Sensor() if sensor is None else inversion.read_sensor(sensor)
    free = list(read_cycles(untouched, **options)) if untouched else []
    inverter = inversion.RecordingInverter(known, own, free, search.most)
    report = output.reporter(stderr=out is None)
    failures = n_groups = n_contacts = 0
    pictures: dict[Path, bytes | str] = {}
    with watched_interrupts() as check, opened(out, pictures) as file:
        writer = csv.writer(file, lineterminator="\n")
        header: list[object] = list(inversion.COLUMNS)
        for path, data in recordings.read_all(files, **options):
            table, misfits, count = [], [], 0
            try:
                if isinstance(data, ConfigError):
                    raise data
                total = -(-data.sizes["cycle"] // search.group)
                with report.progress(check) as show:
                    for group, found in inverter.groups(path, data, search.group, check):
                        table += inversion.rows_of(path, group, found, known)
                        misfits += [] if found.fits else [found.misfit]
                        count += 1
                        show(path.name, count, total)
                        if figure is not None and not pictures and found.contacts:
                            pictures[figure] = _drawn(found, known, figure)
            except (ConfigError, ValueError) as error:
                failures += 1
                failure(about(path, error), "not inverted")
                continue
            writer.writerows([header, *table] if header else table)
            header = []
            inversion.note_misfit(path, misfits, count, report)
            n_groups, n_contacts = n_groups + count, n_contacts + len(table)
        if failures and not n_groups:
            raise ConfigError("no file could be inverted, and nothing was written; see above")
    if figure is not None and not pictures:
        report.note("no contact is found, so no picture is drawn")
    failed = f"; {failures} files could not be inverted" if failures else ""
    report.line(f"{n_contacts} contacts in {n_groups} groups of cycles{failed}")
    return 1 if failures else 0


def _drawn(found: object, library: object, figure: Path) -> bytes:
    """Return a picture of the posterior along the tube."""
    from acoustube.reports.figures.posterior import posterior_figure
    from acoustube.reports.figures.run import picture

    return picture(posterior_figure(found, library), figure)  # type: ignore[arg-type]
