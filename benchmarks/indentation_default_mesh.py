"""Errors of force and echo of a press on each mesh, relative to those on a fine mesh.

The 25 mm rod on the default tube: force at 28 depths, every 0.25 mm to 7 mm, free; plane wave's
reflection coefficient at eight depths, held, by the spectral solver: rms error over 36 to 48 kHz
relative to its rms. References have 3 x 28 elements with 28 (force) and 36 (echo) along the tube.
``OMP_NUM_THREADS=1 python benchmarks/indentation_default_mesh.py`` takes some 15 minutes.
"""

from __future__ import annotations

from dataclasses import replace
from time import process_time

import numpy as np
from numpy.typing import NDArray

from acoustube.air import air_at
from acoustube.base.units import MM
from acoustube.indentation import USUAL_MESH, Indenter, MeshSize, indent
from acoustube.lumen import pressed_part
from acoustube.runs.config.si import MESH_SIZES
from acoustube.tube import Tube
from acoustube.waves.spectral import scatter_spectral, wall_of

FORCE_DEPTHS = np.arange(1, 29) / 4 / MM
ECHO_DEPTHS = np.array([2.0, 2.7, 3.4, 4.5, 5.3, 6.2, 7.0, 7.6]) / MM
FREQUENCY = np.arange(36e3, 48.01e3, 200.0)
TO_6_MM = slice(1, 24)
"""Rows of the force from 0.5 to 6 mm."""
REFERENCES = (
    replace(USUAL_MESH, around=28, along=28, grading=3.4),
    replace(USUAL_MESH, around=28, along=36, grading=3.2),
)
MESHES = (
    MeshSize(through_wall=2, around=20, along=13),
    *(
        replace(USUAL_MESH, along=along, grading=grading)
        for along, grading in ((12, 3.4), (14, 3.0), (14, 2.2), (15, 3.0), (16, 3.0), (16, 2.6))
    ),
    MESH_SIZES["fine"],
)


def forces(size: MeshSize) -> tuple[NDArray[np.float64], float]:
    """Return the forces in N, and the processor time in s."""
    start = process_time()
    press = indent(Tube(), Indenter(), depth=FORCE_DEPTHS, support="free", mesh=size)
    return press.contact_force[press.rows_at(FORCE_DEPTHS)], process_time() - start


def echoes(size: MeshSize) -> NDArray[np.complex128]:
    """Return the plane wave's reflection coefficients, (n_depths, n_frequencies)."""
    press = indent(Tube(), Indenter(), depth=ECHO_DEPTHS, mesh=size)
    walls = [wall_of(pressed_part(press, row)) for row in press.rows_at(ECHO_DEPTHS)]
    found = [scatter_spectral(wall, air_at(20.0), FREQUENCY, symmetric_only=True) for wall in walls]
    return np.array([one.s[:, 0, 0, 0, 0] for one in found])


if __name__ == "__main__":
    depths = " | ".join(f"R at {MM * depth:g} mm" for depth in ECHO_DEPTHS)
    print(f"| mesh (grading) | s | force rms | to 6 mm | to 7 mm | {depths} |")
    print("|---" * (5 + len(ECHO_DEPTHS)) + "|")
    force, echo = forces(REFERENCES[0])[0], echoes(REFERENCES[1])
    for size in MESHES:
        own, seconds = forces(size)
        error = np.abs(100 * (own / force - 1))
        off = np.sqrt(np.mean(np.abs(echoes(size) - echo) ** 2, axis=1))
        relative = 100 * off / np.sqrt(np.mean(np.abs(echo) ** 2, axis=1))
        print(
            f"| {size.through_wall} x {size.around} x {size.along} ({size.grading:g}) "
            f"| {seconds:.1f} | {np.sqrt(np.mean(error[TO_6_MM] ** 2)):.2f} % "
            f"| {error[TO_6_MM].max():.2f} % | {error[1:].max():.2f} % "
            f"| {' | '.join(f'{one:.1f} %' for one in relative)} |",
            flush=True,
        )
