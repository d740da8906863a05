"""Files in the folder that ``acoustube design`` writes."""

from __future__ import annotations

from pathlib import Path

from acoustube.reports.design.drawing import drawing
from acoustube.reports.design.figures import front_figure, map_figure
from acoustube.reports.design.page import page_of
from acoustube.reports.figures.run import picture
from acoustube.runs.config import to_toml
from acoustube.runs.design.files import config_toml, front_csv, sensor_toml
from acoustube.runs.design.run import Designed


def contents_of(found: Designed) -> dict[str, bytes | str]:
    """Return the contents of the files of a design, by file name.

    Parameters
    ----------
    found : Designed

    Returns
    -------
    dict of str to bytes or str
        The goal, the front as a table and a figure, for each sensor its rangefinder, its tube, its
        maps and its drawing, and a page.
    """
    named = [(one.name, one.candidate) for one in found.sensors]
    png = Path("figure.png")
    pictures = {
        "front": picture(front_figure(found.front, named, found.design.goal.reach_m), png),
        **{one.name: picture(map_figure(one.map, one.candidate.tube.words), png)
           for one in found.sensors},
        **{f"{one.name} drawing": picture(drawing(found.design, one.candidate), png)
           for one in found.sensors},
    }  # fmt: skip
    goal = to_toml(found.design)
    contents: dict[str, bytes | str] = {
        "goal.toml": goal + f"# found with --seed {found.seed}\n",
        "front.csv": front_csv(found.front),
        "front.png": pictures["front"],
        "design.html": page_of(goal, found.sensors, pictures, found.notes, found.design),
    }
    for one in found.sensors:
        contents[f"{one.name}.sensor.toml"] = sensor_toml(found.design, one.candidate)
        contents[f"{one.name}.config.toml"] = config_toml(found.design, one.candidate)
        contents[f"{one.name}-map.png"] = pictures[one.name]
        contents[f"{one.name}-drawing.svg"] = picture(
            drawing(found.design, one.candidate), Path("drawing.svg")
        )
    return contents
