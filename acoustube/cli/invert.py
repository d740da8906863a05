"""The command ``acoustube invert``: contacts in recordings, by inversion of the whole waveform."""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from acoustube.base.console import failure
from acoustube.base.errors import ConfigError, about
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.report import counted
from acoustube.base.rules import Number
from acoustube.cli._options import WHOLE, Checked, Output, Recording, check_files

if TYPE_CHECKING:
    from acoustube.inversion import Library
    from acoustube.runs.two_ends import EndsContacts


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Search(Checked):
    """Options of the inversion.

    Attributes
    ----------
    group : int
        Cycles that are inverted together; the contacts must not change during them.
    most : int
        Largest number of contacts.
    """

    group: Annotated[int, WHOLE, Number(1, 100_000, "", "cycles", whole=True)] = 1
    most: Annotated[int, WHOLE, Number(1, 8, "", "contacts", whole=True)] = 3


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class FarEnd(Checked):
    """Recordings from a second rangefinder, like the first one, at the far end.

    Attributes
    ----------
    far : Path
        Recordings of the same cycles by a second rangefinder, equal to the first, at the far end:
        one for each of the files, in the same order.
    far_untouched : Path
        Recordings of the tube without contact from the far end.
    """

    far: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None
    far_untouched: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None

    def __post_init__(self) -> None:
        """Check that untouched cycles of the far end come with recordings from there."""
        super().__post_init__()
        if self.far_untouched and not self.far:
            raise ConfigError("--far-untouched needs --far; give the recordings from the far end")

    def check_pairs(self, files: Sequence[Path]) -> None:
        """Raise :class:`ConfigError` unless there is one recording from each end."""
        from acoustube.recordings import find

        if self.far:
            near, far = len(find(files)), len(find(self.far))
            if near != far:
                raise ConfigError(
                    f"{near} recordings from the near end and {far} of --far; give one for each, "
                    "in the same order"
                )


def invert(
    *files: Path,
    library: Path,
    sensor: Path | None = None,
    untouched: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None,
    far_end: FarEnd = FarEnd(),
    search: Search = Search(),
    recording: Recording = Recording(),
    out: Path | None = None,
    figure: Path | None = None,
    detection_limits: Path | None = None,
    output: Output = Output(),
) -> int:
    """Estimate contacts: number, distance, depth, force and indenter, with uncertainties.

    Parameters
    ----------
    files : Path
        Recordings in the formats of `process`, in ADC counts, from the start of the drive.
    library : Path
        Folder that the command library wrote.
    sensor : Path
        TOML file with the parameters of the rangefinder, the tube's length_cm, a table [priors],
        and a table [wrap] for a tube around a forearm; by default the sleeve paper's sensor.
    untouched : Path
        Recordings of the tube without contact, from which its clutter is estimated.
    out : Path
        Table to write (CSV), one row per contact; standard output if not given.
    figure : Path
        Picture to write (PNG, PDF or SVG): echoes from each end, posterior and limit of
        detection along the tube, of the first group with contacts that do not explain the echo;
        else of the first group with a contact, or of the first group.
    detection_limits : Path
        Table to write (CSV) of the limits of detection along the tube for each group and indenter:
        the least depth and force at which a further contact would be detected; inf if at no depth.
    """
    _check(files, far_end, out, figure, detection_limits)
    from acoustube.recordings import read_all
    from acoustube.runs import inversion
    from acoustube.runs.contact_table import COLUMNS, note_warnings, rows_of
    from acoustube.runs.libraries.files import open_library
    from acoustube.runs.recordings import opened, read_cycles
    from acoustube.runs.sensor_check import note_differences
    from acoustube.runs.two_ends import EndsInverter

    options = dataclasses.asdict(recording)
    known = open_library(library)
    own = inversion.Sensor() if sensor is None else inversion.read_sensor(sensor)
    named = untouched, far_end.far_untouched
    free, far_free = (list(read_cycles(paths or [], **options)) for paths in named)
    near = inversion.RecordingInverter(known, own, free, search.most)
    wanted = _Results(near.tool_library, figure, detection_limits)
    inverter, others = EndsInverter(near, far_free), read_all(far_end.far or [], **options)
    report, failures, n_groups, n_contacts = output.reporter(stderr=out is None), 0, 0, 0
    written: dict[Path, bytes | str] = {}
    with watched_interrupts() as check, opened(out, written) as file:
        writer, header = csv.writer(file, lineterminator="\n"), [list[object](COLUMNS)]
        for path, data in read_all(files, **options):
            table, poor, count, other = [], [], 0, next(others, None)
            try:
                if isinstance(data, ConfigError):
                    raise data
                with report.progress(check) as show:
                    for group, found in inverter.groups(path, data, other, search.group, check):
                        table += rows_of(path, group, found.contacts, known)
                        poor += [] if found.fits else [(group, found.misfit, found.residual)]
                        wanted.add(path, group, found)
                        show(path.name, count := count + 1, -(-data.sizes["cycle"] // search.group))
            except (ConfigError, ValueError) as error:
                failures += 1
                failure(about(path, error), "not inverted")
                continue
            wanted.keep()
            writer.writerows([*header, *table])
            header.clear()
            note_warnings(path, poor, count, near.length(data), report)
            n_groups, n_contacts = n_groups + count, n_contacts + len(table)
        if failures and not n_groups:
            raise ConfigError("no file could be inverted, and nothing was written; see above")
        written |= wanted.contents()
    note_differences(wanted.estimates, own, known, report)
    report.line(_summary(n_contacts, n_groups, failures))
    return int(failures > 0)


def _summary(n_contacts: int, n_groups: int, failures: int) -> str:
    """Return the numbers of contacts, groups and files that could not be inverted, as text."""
    failed = f"; {counted(failures, 'file')} could not be inverted" if failures else ""
    return f"{counted(n_contacts, 'contact')} in {counted(n_groups, 'group')}{failed}"


@dataclass
class _Results:
    """Results of complete recordings: picture and table of limits, if requested, and estimates.

    Attributes
    ----------
    library : Library
    figure, limits : Path or None
        Files of picture and table; None if not requested.
    rows : list of list
        Rows of the table.
    shown : EndsContacts or None
        Group of cycles to draw.
    estimates : list of dict
        Estimates of the sensor's parameters from each group of cycles.
    pending, candidate, told
        Like `rows`, `shown` and `estimates`, of the recording in progress.
    """

    library: Library
    figure: Path | None
    limits: Path | None
    rows: list[list[object]] = field(default_factory=list)
    shown: EndsContacts | None = None
    pending: list[list[object]] = field(default_factory=list)
    candidate: EndsContacts | None = None
    estimates: list[dict[str, tuple[float, float]]] = field(default_factory=list)
    told: list[dict[str, tuple[float, float]]] = field(default_factory=list)

    def add(self, path: Path, group: int, found: EndsContacts) -> None:
        """Add the results of a group of cycles, pending until its recording is complete."""
        from acoustube.runs.sensor_check import estimates_of
        from acoustube.runs.two_ends import limit_rows

        if group == 0:  # what a recording that failed has left is discarded
            self._begin()
        self.told.append(estimates_of(found.near))
        if self.limits is not None:
            self.pending += limit_rows(path, group, found, self.library)
        self.candidate = _preferred(self.candidate, found)

    def _begin(self) -> None:
        self.pending, self.candidate, self.told = [], None, []

    def keep(self) -> None:
        """Add the pending results of a complete recording to those kept."""
        self.rows += self.pending
        self.shown = _preferred(self.shown, self.candidate)
        self.estimates += self.told
        self._begin()

    def contents(self) -> dict[Path, bytes | str]:
        """Return the contents of the requested files."""
        from acoustube.reports.figures.posterior import posterior_figure
        from acoustube.reports.figures.run import picture
        from acoustube.runs.two_ends import LIMIT_COLUMNS

        found: dict[Path, bytes | str] = {}
        if self.limits is not None:
            table = io.StringIO()
            csv.writer(table, lineterminator="\n").writerows([LIMIT_COLUMNS, *self.rows])
            found[self.limits] = table.getvalue()
        if self.figure is not None and self.shown is not None:
            sheet = posterior_figure(self.shown, self.library)
            found[self.figure] = picture(sheet, self.figure)
        return found


def _preferred(known: EndsContacts | None, new: EndsContacts | None) -> EndsContacts | None:
    """Return the group to draw, the first of those preferred.

    Groups with a contact are preferred, and among them those whose echo is not explained.
    """
    if known is None or (new is not None and _rank(new) > _rank(known)):
        return new
    return known


def _rank(group: EndsContacts) -> tuple[bool, bool]:
    return bool(group.contacts), not group.fits


def _check(
    files: Sequence[Path],
    far_end: FarEnd,
    out: Path | None,
    figure: Path | None,
    limits: Path | None,
) -> None:
    if not files:
        raise ConfigError("invert needs a file or a folder; name one or more")
    check_files(out=out, figure=figure, detection_limits=limits)
    far_end.check_pairs(files)
