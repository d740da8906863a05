"""Views of triangle meshes, rendered by VTK off screen.

Where the libraries for drawing without a screen are missing, VTK ends the process. Views are
therefore rendered in a separate process, which loads no solver, and a simulation goes on:
``python -m acoustube.reports.scenes.offscreen VIEWS.pkl IMAGES.npz``.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
TIME_LIMIT = 120.0
"""Longest time in s that a drawing may take."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """A triangulated surface in a view.

    Attributes
    ----------
    points : ndarray
        Points in m, (n, 3).
    faces : ndarray of int
        Triangles, (m, 3).
    look : dict
        Colour, shading and lighting, as ``pyvista.Plotter.add_mesh`` takes them.
    """

    points: NDArray[np.float64]
    faces: NDArray[Any]
    look: dict[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """Surfaces, and the camera from which they are seen.

    Attributes
    ----------
    pixels : tuple of int
        Width and height of the picture.
    meshes : tuple of Mesh
    camera : dict
        Attributes of ``pyvista.Camera``.
    """

    pixels: tuple[int, int]
    meshes: tuple[Mesh, ...]
    camera: dict[str, Any] = field(default_factory=dict)


@contextmanager
def rendering(views: Mapping[str, View]) -> Iterator[Callable[[], dict[str, Image] | None]]:
    """Render views in a separate process, while this one goes on.

    Parameters
    ----------
    views : mapping of str to View
        Views by name.

    Yields
    ------
    callable
        Waits for the pictures and returns them, of shape (height, width, 3), by name of the view.
        Returns None if VTK cannot draw on this machine, drawing takes longer than `TIME_LIMIT`, or
        there is no disk space. The process ends with the context.
    """
    with ExitStack() as opened:
        try:
            folder = opened.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
            content, images = Path(folder) / "views.pkl", Path(folder) / "images.npz"
            content.write_bytes(pickle.dumps(dict(views)))
            command = [sys.executable, "-m", __name__, str(content), str(images)]
            process = opened.enter_context(_started(command))
        except OSError:
            yield lambda: None
            return
        yield lambda: _pictures(process, images)


def _pictures(process: subprocess.Popen[bytes], path: Path) -> dict[str, Image] | None:
    """Wait for the pictures that a process draws; return them by name, or None if it fails."""
    try:
        if process.wait(TIME_LIMIT):
            return None
        with np.load(path) as file:
            return {name: file[name] for name in file.files}
    except (subprocess.TimeoutExpired, OSError):
        return None


@contextmanager
def _started(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Start a process whose output is discarded, and kill it at the end of the context."""
    none = subprocess.DEVNULL
    process = subprocess.Popen(command, stdin=none, stdout=none, stderr=none)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def _render(view: View) -> Image:
    """Return the picture of a view, (height, width, 3)."""
    import pyvista

    plotter: Any = pyvista.Plotter(off_screen=True, window_size=list(view.pixels))
    plotter.set_background("white")
    for mesh in view.meshes:
        plotter.add_mesh(pyvista.PolyData.from_regular_faces(mesh.points, mesh.faces), **mesh.look)
    plotter.enable_anti_aliasing(aa_type="ssaa")
    for name, value in view.camera.items():
        setattr(plotter.camera, name, value)
    return np.asarray(plotter.screenshot(return_img=True))


if __name__ == "__main__":
    loaded: dict[str, View] = pickle.loads(Path(sys.argv[1]).read_bytes())
    pictures: dict[str, Any] = {name: _render(view) for name, view in loaded.items()}
    np.savez(sys.argv[2], **pictures)
