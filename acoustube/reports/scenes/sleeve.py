"""A sleeve in three dimensions: arm, tubes, dead zones and contacts, drawn by VTK off screen.

VTK runs in a separate process, which it ends where it cannot draw:
``python -m acoustube.reports.scenes.sleeve PICTURE.pkl FIGURE.png``.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from acoustube.base.types import Array
from acoustube.base.units import CM
from acoustube.base.writing import write
from acoustube.reports.scenes.offscreen import TIME_LIMIT
from acoustube.sleeve.helix import Helix

PIXELS = (1800, 1000)
SKIN, DEAD, MARKER = "#d0ab8c", "#8a8f98", "#222222"
TUBES = ("#2f6fb0", "#3f9b6e", "#8a5fb0", "#b08a2f")
CONTACT, SPREAD, ESTIMATE = "#c8322b", "#f0a08c", "#f2c230"
POINTS_PER_LOOP = 90


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """Tubes, markers and contacts to draw.

    Attributes
    ----------
    tubes : tuple of Helix
    detection_range : ndarray
        Least and largest distance along each tube at which a press is detected, in m, (n_tubes, 2).
    outer_diameter : float
        Outer diameter of the tubes in m.
    contacts : tuple of (int, float)
        Index of the tube, from 0, and distance along it in m, of each contact.
    deviation : float
        Standard deviation of a contact's distance in m, the length marked on each side of it.
    markers : ndarray
        Markers on the arm in m, (n, 3); may be empty and may contain nan.
    estimates : tuple of (int, float)
        Index of the tube, from 0, and distance along it in m, of each estimated contact.
    """

    tubes: tuple[Helix, ...]
    detection_range: Array
    outer_diameter: float
    contacts: tuple[tuple[int, float], ...]
    deviation: float
    markers: Array
    estimates: tuple[tuple[int, float], ...] = ()


def draw(picture: Picture, path: Path) -> bool:
    """Draw a sleeve in a separate process.

    Parameters
    ----------
    picture : Picture
    path : Path
        The PNG file to write, which must be new.

    Returns
    -------
    bool
        Whether the file was written; False if VTK cannot draw on this machine.
    """
    try:
        with tempfile.TemporaryDirectory() as folder:
            content = Path(folder) / "picture.pkl"
            content.write_bytes(pickle.dumps(picture))
            drawn = Path(folder) / "figure.png"
            command = [sys.executable, "-m", __name__, str(content), str(drawn)]
            subprocess.run(command, capture_output=True, check=True, timeout=TIME_LIMIT)
            image = drawn.read_bytes()
    except (subprocess.SubprocessError, OSError):
        return False
    write(path, image)
    return True


def render(picture: Picture) -> Any:
    """Return an off-screen PyVista plotter with the sleeve, in the coordinates of the arm."""
    import pyvista

    plotter: Any = pyvista.Plotter(off_screen=True, window_size=list(PIXELS))
    plotter.set_background("white")
    tube, thick, side = picture.tubes[0], picture.outer_diameter / 2, _side(picture)
    plotter.add_mesh(_arm(tube, thick), color=SKIN, smooth_shading=True, ambient=0.3)
    legend = [["arm", SKIN]]
    for number, (each, (near, far)) in enumerate(
        zip(picture.tubes, picture.detection_range, strict=True)
    ):
        colour, end = TUBES[number % len(TUBES)], each.tube_length
        for start, stop, shade in ((each.lead, near, DEAD), (near, far, colour), (far, end, DEAD)):
            if stop > start + 1e-6:
                _add(plotter, _along(each, start, stop), thick, shade)
        if each.lead:
            _add(plotter, _lead(each), thick, DEAD)
        legend.append([f"tube {number + 1}", colour])
    legend.append(["not detected", DEAD])
    for number, distance in picture.contacts:
        each, (near, far) = picture.tubes[number], picture.detection_range[number]
        ends = np.clip(distance + picture.deviation * np.array([-1, 1]), near, far)
        if picture.deviation > 0:
            _add(plotter, _along(each, *ends), 1.12 * thick, SPREAD)
        place = each.point(each.height(distance))
        plotter.add_mesh(
            pyvista.Sphere(radius=1.7 * thick, center=place), color=CONTACT, ambient=0.3
        )
        label = [f"{CM * distance:g} cm"]
        plotter.add_point_labels(
            [place + 4.5 * thick * np.cross(side, [0, 0, 1])], label,
            font_size=26, text_color=CONTACT, shape_color="white", shape_opacity=0.8,
            always_visible=True, show_points=False,
        )  # fmt: skip
    for number, distance in picture.estimates:
        each = picture.tubes[number]
        place = each.point(each.height(distance))
        dot = pyvista.Sphere(radius=1.45 * thick, center=place)
        plotter.add_mesh(dot, color=ESTIMATE, ambient=0.3)
    if picture.contacts:
        legend.append(["contact", CONTACT])
    if picture.estimates:
        legend.append(["estimate", ESTIMATE])
    if picture.contacts and picture.deviation > 0:
        spread = f"± {CM * picture.deviation:g} cm of a distance"
        legend.append([spread, SPREAD])
    seen = picture.markers[np.all(np.isfinite(picture.markers), axis=-1)]
    if len(seen):
        dots = pyvista.PolyData(tube.frame.inwards(seen))
        dots = dots.glyph(geom=pyvista.Sphere(radius=0.5 * thick), scale=False, orient=False)
        plotter.add_mesh(dots, color=MARKER)
        legend.append(["marker", MARKER])
    plotter.add_legend(legend, bcolor=None, face="rectangle", size=(0.2, 0.035 * len(legend)))
    _look(plotter, tube, side)
    plotter.enable_anti_aliasing(aa_type="ssaa")
    return plotter


def _arm(tube: Helix, thick: float) -> Any:
    """Return the arm's surface, under the tubes and a little beyond them."""
    import pyvista

    z = np.linspace(-0.06 * tube.length, 1.06 * tube.length, 2)
    psi = np.linspace(0, 2 * np.pi, 121)
    r = np.maximum(tube.radius_at(z) - thick, 1e-3)[:, None]
    x, y = r * np.cos(psi), r * np.sin(psi)
    return pyvista.StructuredGrid(x, y, z[:, None] + 0 * psi)


def _along(tube: Helix, start: float, stop: float) -> Array:
    """Return points (n, 3) in m on a tube between two distances in m, in the arm's coordinates."""
    n = 2 + int(POINTS_PER_LOOP * tube.loops * (stop - start) / tube.tube_length)
    return tube.point(tube.height(np.linspace(start, stop, n)))


def _lead(tube: Helix) -> Array:
    """Return points (n, 3) in m of the lead, the tube before the helix, tangent to its start."""
    start, ahead = tube.point([0.0, 1e-4 * tube.length])
    back = (start - ahead) / np.linalg.norm(ahead - start)
    # The lead is drawn short and bent: its actual path is the wearer's choice.
    s = np.linspace(0, 1, 30)[:, None]
    drawn = min(tube.lead, 0.3 * tube.length)
    return np.asarray(start + drawn * (s * back + 0.7 * s**2 * np.array([0, 0, -1.0])))


def _add(plotter: Any, points: Array, radius: float, colour: str) -> None:
    import pyvista

    line = pyvista.MultipleLines(points)
    plotter.add_mesh(
        line.tube(radius=radius, n_sides=24), color=colour, smooth_shading=True, ambient=0.25
    )


def _side(picture: Picture) -> Array:
    """Return the unit vector from the arm's axis to the viewer, on the side of the contacts."""
    places = [
        picture.tubes[i].point(picture.tubes[i].height(distance))[:2]
        for i, distance in picture.contacts
    ]
    mean = np.sum([place / np.linalg.norm(place) for place in places], axis=0) + np.zeros(2)
    # There is no mean direction without contacts, or with contacts on opposite sides.
    if np.linalg.norm(mean) < 0.1:
        mean = np.array([0.94, 0.34])
    return np.array([*mean / np.linalg.norm(mean), 0.0])


def _look(plotter: Any, tube: Helix, side: Array) -> None:
    """Set the camera beside the arm, in the direction `side`, with the arm's start on the left."""
    size = tube.length + 4 * float(np.max(tube.radius_at([0.0, tube.length])))
    plotter.camera.focal_point = (0, 0, 0.45 * tube.length)
    plotter.camera.position = size * (1.1 * side + [0, 0, -0.3]) + [0, 0, 0.45 * tube.length]
    plotter.camera.up = np.cross(side, [0, 0, 1.0])
    plotter.camera.view_angle = 30
    plotter.reset_camera_clipping_range()


if __name__ == "__main__":
    render(pickle.loads(Path(sys.argv[1]).read_bytes())).screenshot(sys.argv[2])
