"""The command ``acoustube show``: a picture or a page of results that are there."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from acoustube.base.errors import ConfigError
from acoustube.reports.figures import run as run_figure
from acoustube.runs.opening import open_dataset


def run_show(where: Path, out: Path, console: Console) -> Path:
    """Draw the results of a sweep.

    Parameters
    ----------
    where : Path
        Its folder.
    out : Path
        The picture to write.
    console : rich.console.Console
        Where to print.

    Returns
    -------
    Path
        The picture.

    Raises
    ------
    ConfigError
        If there is no sweep.
    """
    from acoustube.reports.figures import sweep as sweep_figure

    if (Path(where) / "run.nc").is_file():
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
    return out


def run_page(where: Path, out: Path, console: Console) -> Path:
    """Write a page that shows a run.

    Parameters
    ----------
    where : Path
        A folder of ``acoustube simulate``, ``indent`` or ``sweep``.
    out : Path
        The HTML file to write.
    console : rich.console.Console
        Where to print.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ConfigError
        If there is no run, or the package plotly is missing.
    """
    from acoustube.reports.page import write_page

    page = write_page(where, out)
    size = page.stat().st_size / 1e6
    console.print(f"Written to [bold]{page}[/], {size:.1f} MB.", soft_wrap=True)
    return page
