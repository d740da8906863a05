"""The command ``acoustube show``: a figure or a page of results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from acoustube.base.errors import ConfigError
from acoustube.base.files import check_new_file
from acoustube.cli._options import Output, check_picture

if TYPE_CHECKING:
    from rich.console import Console

PAGES = (".html", ".htm")


def show(
    results: Path,
    /,
    *,
    out: Path | None = None,
    html: Path | None = None,
    output: Output = Output(),
) -> None:
    """Draw results: a sweep as a figure, or any run as an interactive page.

    The figure has force, echo and error over depth, and the echoes. The page is one file that opens
    in any browser, without a network: a slider over the depth moves the tube, its section, the
    lumen's area, the signal and the reflection.

    Parameters
    ----------
    results : Path
        Folder that ``acoustube sweep`` wrote; for a page also of ``simulate`` or ``indent``.
    out : Path
        Picture to write (PNG, PDF or SVG), which must be new.
    html : Path
        Page to write, which must be new.
    """
    if out is None and html is None:
        raise ConfigError("There is nothing to write; give --html FILE, --out FILE or both")
    if out is not None:
        check_new_file(out)
        check_picture(out, "out")
    if html is not None:
        check_new_file(html, "html")
        if html.suffix.lower() not in PAGES:
            raise ConfigError(f"html = {html} must end in .html")
    console = output.console()
    if html is not None:
        _write_page(results, html, console)
    if out is not None:
        _write_figure(results, out, console)


def _write_figure(where: Path, out: Path, console: Console) -> None:
    """Draw the results of a sweep."""
    from acoustube.reports.figures import run as run_figure
    from acoustube.reports.figures import sweep as sweep_figure
    from acoustube.runs.opening import open_dataset

    if (where / "run.nc").is_file():
        raise ConfigError(
            f"{where} is a single run, and a figure is of a sweep; give --html FILE for a page"
        )
    cases = open_dataset(where)
    if "press" not in cases.dims:
        raise ConfigError(f"{where} is a dataset of cycles; name the folder of a sweep")
    try:
        cases = cases.load()
    except (OSError, RuntimeError) as error:
        raise ConfigError(
            f"{where} holds a damaged file; repeat the command acoustube sweep to mend it"
        ) from error
    run_figure.save(sweep_figure.figure(cases), out)
    console.print(f"{cases.sizes['press']} cases drawn in [bold]{out}[/].", soft_wrap=True)


def _write_page(where: Path, out: Path, console: Console) -> None:
    """Write a page that shows a run."""
    from acoustube.reports.page import write_page

    page = write_page(where, out)
    size = page.stat().st_size / 1e6
    console.print(f"Written to [bold]{page}[/], {size:.1f} MB.", soft_wrap=True)
