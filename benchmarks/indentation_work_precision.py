"""Errors of the press against an independent solution, up to a closed lumen, and its cost.

The default tube on a free support, 25 mm rod. First, on the default mesh, every row of the CalculiX
solution in ``tests/data/indentation_rod25.csv``, which ends at 7 mm, and the area along the tube at
4 mm. Then to 8 mm, on several meshes, with several ranges of the barrier between the lumen's
walls, and with reduced integration: errors, and time and memory of a warm run.
``python benchmarks/indentation_work_precision.py`` takes some fifteen minutes on two cores; with
the argument ``rows`` only the first part, in one.
"""

from __future__ import annotations

import resource
import sys
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from acoustube.base.limits import pressed_reach
from acoustube.indentation import USUAL_MESH, Indentation, Indenter, MeshSize, indent
from acoustube.indentation.mesh import Mesh, sweep
from acoustube.indentation.reference_element import FACE, HEX20, QUAD8, Reference, gauss
from acoustube.lumen import measure
from acoustube.runs.config.si import MESH_SIZES
from acoustube.tube import Tube

DATA = Path(__file__).parents[1] / "tests" / "data"
DEPTHS_MM = (2.0, 4.0, 6.0, 7.0, 7.5, 8.0)
MESHES = (
    MeshSize(through_wall=1, around=12, along=10),
    MeshSize(through_wall=2, around=12, along=12),
    MeshSize(through_wall=2, around=20, along=13),
    MeshSize(through_wall=2, around=24, along=18),
    MeshSize(through_wall=3, around=18, along=14),
    USUAL_MESH,
    MESH_SIZES["fine"],
)
REACH = pressed_reach(Tube().outer_diameter, 25e-3)
BARRIER_DISTANCES_MM = (0.04, 0.02, 0.01, 0.005)


def table(name: str) -> NDArray[np.void]:
    """Return the independent solution's table of this name; its columns are named with units."""
    # NumPy would read the names from the first line of the comment.
    lines = (DATA / name).read_text().splitlines()
    return np.genfromtxt([s for s in lines if not s.startswith("#")], delimiter=",", names=True)


def rows() -> None:
    """Print the errors of the default mesh at every row of the independent solution."""
    exact, along = table("indentation_rod25.csv"), table("indentation_rod25_area_at_4mm.csv")
    depths = 1e-3 * exact["depth_mm"]
    press = indent(Tube(), Indenter(diameter=25e-3), depth=depths, support="free")
    print("| depth mm | force % | lumen height mm | lumen width mm | lumen area mm2 |")
    print("|" + "---|" * 5)
    for row, i in zip(exact, press.rows_at(depths), strict=True):
        found = measure(press, i, np.zeros(1))
        force = 100 * (press.contact_force[i] / row["force_N"] - 1)
        height, width = 1e3 * found.height[0], 1e3 * found.width[0]
        print(
            f"| {row['depth_mm']:g} | {force:+.2f} | {height - row['lumen_height_mm']:+.3f} "
            f"| {width - row['lumen_width_mm']:+.3f} "
            f"| {1e6 * found.area[0] - row['lumen_area_mm2']:+.3f} |"
        )
    (deep,) = press.rows_at([4e-3])
    inside = along["z_mm"] < 1e3 * REACH
    area = 1e6 * measure(press, deep, 1e-3 * along["z_mm"][inside]).area
    error = np.abs(area - along["area_mm2"][inside]).max()
    print(f"\nArea along the tube at 4 mm: within {error:.3f} mm2 in {inside.sum()} planes\n")


def pressed(size: Mesh | MeshSize, barrier_distance_mm: float = 0.02) -> tuple[Indentation, float]:
    """Return a press and its duration in s."""
    start = perf_counter()
    found = indent(
        Tube(),
        Indenter(diameter=25e-3),
        depth=[1e-3 * depth for depth in DEPTHS_MM],
        support="free",
        mesh=size,
        barrier_distance=1e-3 * barrier_distance_mm,
    )
    return found, perf_counter() - start


def reduced() -> Reference:
    """Return the 20-node hexahedron with 2 x 2 x 2 points throughout, as CalculiX's C3D20R."""
    points, weights = gauss(2, 3)
    kind = replace(HEX20, points=points, weights=weights)
    FACE[kind] = QUAD8
    return kind


def cells(press: Indentation, exact: dict[float, float]) -> str:
    """Return the cells of a row: force at every depth, and the section at 8 mm."""
    words = []
    for depth in DEPTHS_MM:
        (i,) = np.flatnonzero(press.depth == 1e-3 * depth)
        force = press.contact_force[i]
        error = f" ({100 * (force / exact[depth] - 1):+.2f} %)" if depth in exact else ""
        words.append(f"{force:.3f}{error}")
    section = measure(press, -1, np.zeros(1))
    words.append(f"{1e6 * section.area[0]:.3f}")
    words.append(f"{press.iterations.sum()} in {len(press.depth) - 1}")
    return " | ".join(words)


if __name__ == "__main__":
    rows()
    if "rows" in sys.argv[1:]:
        sys.exit()
    exact = {
        float(row["depth_mm"]): float(row["force_N"]) for row in table("indentation_rod25.csv")
    }
    depths = " | ".join(f"force at {depth:g} mm, N" for depth in DEPTHS_MM)
    tail = "area at 8 mm, mm2 | iterations in increments | time s |"
    pressed(MESHES[0])  # compiles
    print(f"| mesh | unknowns | {depths} | {tail}")
    print("|" + "---|" * (len(DEPTHS_MM) + 5))
    for size in MESHES:
        press, seconds = pressed(size)
        name = f"{size.through_wall} x {size.around} x {size.along}"
        print(f"| {name} | {press.mesh.points.size} | {cells(press, exact)} | {seconds:.1f} |")
    print(f"\n| barrier distance mm | {depths} | {tail}")
    print("|" + "---|" * (len(DEPTHS_MM) + 4))
    for distance in BARRIER_DISTANCES_MM:
        press, seconds = pressed(USUAL_MESH, distance)
        print(f"| {distance:g} | {cells(press, exact)} | {seconds:.1f} |", flush=True)
    print(f"\n| element | {depths} | {tail}")
    print("|" + "---|" * (len(DEPTHS_MM) + 4))
    for name, kind in {"27 points, J projected": HEX20, "8 points": reduced()}.items():
        mesh = replace(sweep(Tube(), REACH), reference=kind)
        press, seconds = pressed(mesh)
        print(f"| {name} | {cells(press, exact)} | {seconds:.1f} |", flush=True)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"\nPeak memory of all runs: {memory:.2f} GiB")
