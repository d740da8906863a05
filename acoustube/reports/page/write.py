"""Pages: results as one HTML file that opens from disk, without a network."""

from __future__ import annotations

import html
from importlib.resources import files
from pathlib import Path
from string import Template

from acoustube.base.errors import ConfigError
from acoustube.base.names import PATH
from acoustube.base.version import __version__
from acoustube.reports.page.cases import read_sweep
from acoustube.reports.page.content import Content
from acoustube.reports.page.encoded import encoded
from acoustube.reports.page.runs import RUN, folder_of, read_run
from acoustube.runs.sweep.store import PLAN

PARTS = {"style": "page.css", "charts": "charts.js", "script": "page.js"}
DEEPER = " Move the slider to press deeper."
"""Sentence added to the text under a page's heading if there are several depths."""


def read(where: str | Path) -> Content:
    """Read the content of a page from a run or a sweep.

    Parameters
    ----------
    where : str or path
        A folder that ``acoustube simulate``, ``indent`` or ``sweep`` wrote.

    Raises
    ------
    ConfigError
        If the folder does not exist, is of another kind, or contains no result yet.
    """
    PATH.check("where", where)
    folder = folder_of(where)
    if not folder.exists():
        raise ConfigError(
            f"{where} does not exist; name a folder that acoustube simulate, indent or sweep wrote"
        )
    if (folder / RUN).is_file():
        return read_run(folder)
    if (folder / PLAN).is_file() or any(folder.glob("cases-*.nc")):
        return read_sweep(folder)
    cycles = " is a dataset of cycles;" if any(folder.glob("cycles-*.nc")) else " holds no run;"
    raise ConfigError(
        f"{where}{cycles} name a folder that acoustube simulate, indent or sweep wrote"
    )


def plotly_js() -> str:
    """Return the source of plotly.js, which is embedded in each page."""
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


def assembled(content: Content, library: str) -> str:
    """Return a page with given content as HTML.

    Parameters
    ----------
    content : Content
    library : str
        Source of plotly.js, from :func:`plotly_js`.

    Returns
    -------
    str
        One self-contained HTML document.
    """
    folder = files("acoustube.reports.page")
    several = any(len(group.states) > 1 for group in content.groups)
    parts = {slot: folder.joinpath(name).read_text("utf-8") for slot, name in PARTS.items()}
    parts |= {
        "title": html.escape(content.title),
        "lead": html.escape(content.lead + DEEPER * several),
        "version": html.escape(__version__),
        # Unescaped, this sequence in a string of plotly.js would end the script element.
        "library": library.replace("</script", "<\\/script"),
        "content": encoded(content),
    }
    template = folder.joinpath("page.html").read_text("utf-8")
    return Template(template).substitute(parts)
