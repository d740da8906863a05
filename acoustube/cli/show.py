"""The command ``acoustube show``: a figure or a page of results."""

from __future__ import annotations

from pathlib import Path

from acoustube.base.errors import ConfigError
from acoustube.base.files import check_new_file
from acoustube.base.foreign.limits import reading
from acoustube.base.report import counted
from acoustube.base.writing import write_all
from acoustube.cli._options import Output, check_picture

PAGES = (".html", ".htm")


def show(
    results: Path,
    /,
    *,
    out: Path | None = None,
    html: Path | None = None,
    output: Output = Output(),
) -> None:
    """Draw results as a figure, or as an interactive page.

    The figure of a sweep has force, highest echo, distance error and envelopes as functions of
    depth; that of a run is the one in its folder. The page is one file that opens in any browser,
    without a network: a slider over the depth changes tube, section, lumen area, signal and
    reflection.

    Parameters
    ----------
    results : Path
        Folder that ``acoustube sweep``, ``simulate`` or ``indent`` wrote.
    out : Path
        Picture to write (PNG, PDF or SVG), which must be new.
    html : Path
        Page to write, which must be new.
    """
    if out is None and html is None:
        raise ConfigError("nothing to write; give --html FILE, --out FILE or both")
    if out is not None:
        check_new_file(out)
        check_picture(out, "out")
    if html is not None:
        check_new_file(html, "html")
        if html.suffix.lower() not in PAGES:
            raise ConfigError("must end in .html", setting="html", value=html)
    contents: dict[Path, bytes | str] = {}
    said = []
    if html is not None:
        from acoustube.reports.page.write import assembled, plotly_js, read

        contents[html] = assembled(read(results), plotly_js())
        said.append(f"Written to {html}, {len(contents[html]) / 1e6:.1f} MB.")
    if out is not None:
        from acoustube.reports.page.runs import RUN, folder_of

        folder = folder_of(results)
        single = (folder / RUN).is_file()
        contents[out], drawn = (_run_figure if single else _sweep_figure)(folder, out)
        said.append(f"{drawn} drawn in {out}.")
    write_all(contents)
    for line in said:
        output.reporter().line(line)


def _run_figure(where: Path, out: Path) -> tuple[bytes, str]:
    """Draw a run; return the picture and what it shows."""
    from acoustube.reports.figures import run as run_figure
    from acoustube.reports.page.runs import reading_run
    from acoustube.reports.scenes import tube as tube_scene

    with reading_run(where) as data:
        if "source_end" in data.dims:
            with tube_scene.drawing(data) as pictures:
                sheet = run_figure.figure(data, pictures())
        else:
            sheet = run_figure.press_figure(data)
    return run_figure.picture(sheet, out), "Run"


def _sweep_figure(where: Path, out: Path) -> tuple[bytes, str]:
    """Draw the results of a sweep; return the picture and what it shows."""
    from acoustube.reports.figures import sweep as sweep_figure
    from acoustube.reports.figures.run import picture
    from acoustube.runs.opening import open_dataset

    cases = open_dataset(where)
    if "press" not in cases.dims:
        raise ConfigError(
            f"{where} is a dataset of cycles; name a folder that acoustube sweep, simulate or "
            "indent wrote"
        )
    advice = "repeat the command acoustube sweep to recompute it"
    with reading(where, "holds a damaged file", advice):
        drawn = sweep_figure.figure(cases.load())
    return picture(drawn, out), counted(cases.sizes["press"], "case")
