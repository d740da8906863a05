"""How far is the press from an independent solution, to a closed lumen, and what does it cost?

The paper's tube on a free support, 25 mm rod, to 8 mm: on several meshes, with several distances at
which the lumen's walls begin to feel each other, and with reduced integration. Errors against the
CalculiX solution in ``tests/data/indentation_rod25.csv``, which ends at 7 mm, beside the time and
the memory of a warm run: ``python benchmarks/indentation_work_precision.py``. Some fifteen minutes
on two cores.
"""

from __future__ import annotations

import resource
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np

from acoustube.indentation import Indentation, MeshSize, Press, indent
from acoustube.indentation.mesh import Mesh, sweep
from acoustube.indentation.reference import FACE, HEX20, QUAD8, Reference, gauss
from acoustube.limits import pressed_reach
from acoustube.lumen import measure
from acoustube.tube import Tube

REFERENCE = Path(__file__).parents[1] / "tests" / "data" / "indentation_rod25.csv"
DEPTHS_MM = (2.0, 4.0, 6.0, 7.0, 7.5, 8.0)
MESHES = (
    MeshSize(through_wall=1, around=12, along=10),
    MeshSize(through_wall=2, around=12, along=12),
    MeshSize(),
    MeshSize(through_wall=2, around=24, along=18),
    MeshSize(through_wall=3, around=18, along=14),
)
REACH = pressed_reach(Tube().outer_diameter, 25e-3)
CLOSING_DISTANCES_MM = (0.04, 0.02, 0.01, 0.005)


def reference() -> dict[float, float]:
    """Return the force in N by depth in mm."""
    # NumPy would take the names from the first line of the comment.
    lines = [line for line in REFERENCE.read_text().splitlines() if not line.startswith("#")]
    table = np.genfromtxt(lines, delimiter=",", names=True)
    return {float(row["depth_mm"]): float(row["force_N"]) for row in table}


def pressed(size: Mesh | MeshSize, closing_distance_mm: float = 0.02) -> tuple[Indentation, float]:
    """Return a press and how long it took, in s."""
    start = perf_counter()
    found = indent(
        Tube(),
        Press(diameter=25e-3),
        depth=[1e-3 * depth for depth in DEPTHS_MM],
        support="free",
        mesh=size,
        closing_distance=1e-3 * closing_distance_mm,
    )
    return found, perf_counter() - start


def reduced() -> Reference:
    """Return the 20-node hexahedron with 2 x 2 x 2 points for everything, as CalculiX's C3D20R."""
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
    exact = reference()
    depths = " | ".join(f"force at {depth:g} mm, N" for depth in DEPTHS_MM)
    tail = "area at 8 mm, mm2 | iterations in increments | time s |"
    pressed(MESHES[0])  # compiles
    print(f"| mesh | unknowns | {depths} | {tail}")
    print("|" + "---|" * (len(DEPTHS_MM) + 5))
    for size in MESHES:
        press, seconds = pressed(size)
        name = f"{size.through_wall} x {size.around} x {size.along}"
        print(f"| {name} | {press.mesh.points.size} | {cells(press, exact)} | {seconds:.1f} |")
    print(f"\n| closing distance mm | {depths} | {tail}")
    print("|" + "---|" * (len(DEPTHS_MM) + 4))
    for distance in CLOSING_DISTANCES_MM:
        press, seconds = pressed(MeshSize(), distance)
        print(f"| {distance:g} | {cells(press, exact)} | {seconds:.1f} |", flush=True)
    print(f"\n| element | {depths} | {tail}")
    print("|" + "---|" * (len(DEPTHS_MM) + 4))
    for name, kind in {"27 points, J projected": HEX20, "8 points": reduced()}.items():
        mesh = replace(sweep(Tube(), REACH), reference=kind)
        press, seconds = pressed(mesh)
        print(f"| {name} | {cells(press, exact)} | {seconds:.1f} |", flush=True)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"\nPeak memory of all runs: {memory:.2f} GiB")
