"""Report of a study: computed and published numbers, figures, and a page of both."""

from __future__ import annotations

import base64
import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any, NamedTuple, TypeVar

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from acoustube.base.version import __version__
from acoustube.base.writing import write as write_file
from acoustube.runs.sweep.workers import Workers

MARKED_DIFFERENCE = 1 / 3
"""Relative difference from the published number above which a row is marked."""
COLUMNS = (
    "study", "quantity", "unit", "published", "ours", "difference_percent", "coarser",
    "change_percent", "inversion", "why",
)  # fmt: skip
DPI = 110
T = TypeVar("T")


class Level(NamedTuple):
    """Discretisation of a study.

    Attributes
    ----------
    resolution : int
        Cells across the bore.
    mesh : str
        Mesh of the wall: a value of the setting ``mesh``.
    """

    resolution: int
    mesh: str


USUAL, COARSE = Level(16, "usual"), Level(12, "coarse")


@dataclass(frozen=True, kw_only=True)
class Scale:
    """Extent of a study, and its workers.

    Attributes
    ----------
    quick : bool
        A few presses on the coarse level alone, without waveform inversion, as a test; its numbers
        are not accurate.
    workers : int, Workers or None
        Number of processes, or a pool of them that an earlier study used; None for one process per
        core.
    """

    quick: bool = False
    workers: int | Workers | None = None

    @property
    def level(self) -> Level:
        """Level of mesh and grid refinement of the reported numbers."""
        return COARSE if self.quick else USUAL

    @property
    def coarser(self) -> Level | None:
        """Coarser mesh and grid, which show the effect of refinement; None for a quick study."""
        return None if self.quick else COARSE


@dataclass(frozen=True, kw_only=True)
class Row:
    """One number of a study.

    Attributes
    ----------
    quantity, unit : str
    ours : float
        Computed number; nan where there is none.
    published : float or None
        None where nothing is published.
    coarser : float or None
        Number computed on a coarser mesh and grid; None where mesh and grid do not matter, or where
        this was not computed.
    inversion : float or None
        Number computed by waveform inversion in place of the sleeve paper's processing; None where
        inversion does not give this quantity.
    why : str
        Why computed and published number differ, or how the computed number is defined.
    """

    quantity: str
    unit: str
    ours: float
    published: float | None = None
    coarser: float | None = None
    inversion: float | None = None
    why: str = ""

    @property
    def difference(self) -> float:
        """Computed minus published number, relative to the latter; nan where one is missing."""
        return _relative(self.ours, self.published)

    @property
    def change(self) -> float:
        """Computed number minus that of the coarser level, relative to the former.

        It is nan without a coarser level.
        """
        return -_relative(float("nan") if self.coarser is None else self.coarser, self.ours)


class Tables(NamedTuple):
    """Estimates for the cycles of a study.

    Attributes
    ----------
    ours : xarray.Dataset
        By the sleeve paper's processing.
    coarser : xarray.Dataset or None
        Likewise, from presses computed on a coarser mesh and grid.
    inversion : xarray.Dataset or None
        By waveform inversion, of the presses of `ours` or some of them.
    """

    ours: xr.Dataset
    coarser: xr.Dataset | None = None
    inversion: xr.Dataset | None = None

    def measured(self, measure: Callable[[xr.Dataset], T]) -> tuple[T, T | None, T | None]:
        """Return a measure of each table, in the order of the attributes; None without a table."""
        return (
            measure(self.ours),
            None if self.coarser is None else measure(self.coarser),
            None if self.inversion is None else measure(self.inversion),
        )


def compared_row(measure: Callable[[xr.Dataset], float], tables: Tables, **words: Any) -> Row:
    """Return a row of the values of `measure` for each table; `words` are its other attributes."""
    ours, coarser, inversion = tables.measured(measure)
    return Row(ours=ours, coarser=coarser, inversion=inversion, **words)


@dataclass(frozen=True, kw_only=True)
class Study:
    """Text, numbers and figures of a study.

    Attributes
    ----------
    title : str
    text : str
        Paragraphs with empty lines between them: what was done, what was assumed, and what the
        simulation does not include.
    rows : sequence of Row
    figures : mapping of str to matplotlib.figure.Figure
        Figures by their captions.
    """

    title: str
    text: str
    rows: Sequence[Row]
    figures: Mapping[str, Figure] = field(default_factory=dict)


def _relative(value: float, reference: float | None) -> float:
    if reference is None or not np.isfinite(reference) or reference == 0:
        return float("nan")
    return (value - reference) / abs(reference)


def write(study: Study, name: str, folder: Path) -> None:
    """Write ``index.html``, ``table.csv`` and a PNG per figure of a study; replace existing ones.

    Parameters
    ----------
    study : Study
    name : str
        Name of the study in the table.
    folder : Path
        Existing folder.
    """
    pictures = {}
    for number, (caption, figure) in enumerate(study.figures.items(), 1):
        png = io.BytesIO()
        figure.savefig(png, format="png", dpi=DPI)
        write_file(folder / f"figure-{number}.png", png.getvalue(), overwrite=True)
        pictures[caption] = png.getvalue()
    write_table({name: study}, folder / "table.csv")
    write_file(folder / "index.html", page(study, pictures), overwrite=True)


def write_table(studies: Mapping[str, Study], path: Path) -> None:
    """Write the numbers of studies, given by name, as a CSV file; an existing one is replaced."""
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(COLUMNS)
    for name, study in studies.items():
        for row in study.rows:
            numbers = (row.published, row.ours, 100 * row.difference, row.coarser,
                       100 * row.change, row.inversion)  # fmt: skip
            words = [plain(number, 6, "") for number in numbers]
            writer.writerow([name, row.quantity, row.unit, *words, row.why])
    write_file(path, table.getvalue(), overwrite=True)


def index_page(names: Sequence[str]) -> str:
    """Return an HTML page of links to the pages of studies."""
    template = files("acoustube.reports.studies").joinpath("index.html").read_text("utf-8")
    links = [f'<li><a href="{escape(n)}/index.html">{escape(n)}</a></li>' for n in names]
    return Template(template).substitute(links="\n".join(links), version=__version__)


def page(study: Study, pictures: Mapping[str, bytes]) -> str:
    """Return a study's self-contained HTML page; `pictures` are the PNG figures by caption."""
    figures = "\n".join(
        f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,'
        f'{base64.b64encode(png).decode()}"><figcaption>{escape(caption)}</figcaption></figure>'
        for caption, png in pictures.items()
    )
    template = files("acoustube.reports.studies").joinpath("page.html").read_text(encoding="utf-8")
    paragraphs = study.text.split("\n\n")
    return Template(template).substitute(
        title=escape(study.title),
        text="\n".join(f"<p>{escape(part)}</p>" for part in paragraphs),
        rows="\n".join(_html_row(row) for row in study.rows),
        figures=figures,
        version=__version__,
    )


def _html_row(row: Row) -> str:
    far = bool(abs(row.difference) > MARKED_DIFFERENCE)
    cells = (
        plain(row.published), plain(row.ours), _percent(row.difference), plain(row.coarser),
        _percent(row.change), plain(row.inversion),
    )  # fmt: skip
    numbers = "".join(f"<td>{cell}</td>" for cell in cells)
    return (
        f"<tr{' class=far' * far}><th scope=row>{escape(row.quantity)}</th>"
        f"<td>{escape(row.unit)}</td>{numbers}<td class=why>{escape(row.why)}</td></tr>"
    )


def plain(number: float | None, digits: int = 3, missing: str = "-") -> str:
    """Return a number as text with `digits` significant digits; `missing` if None or not finite."""
    return missing if number is None or not np.isfinite(number) else f"{number:.{digits}g}"


def _percent(fraction: float) -> str:
    return "-" if not np.isfinite(fraction) else f"{100 * fraction:+.0f} %"
