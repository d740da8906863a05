"""How far is the press from an independent solution on each mesh, and what does it cost?

The paper's tube on a free support, 25 mm rod, to 6 mm. Errors against the CalculiX solution in
``tests/data/indentation_rod25.csv`` beside the time of a second, warm run:
``python benchmarks/indentation_work_precision.py``. Some five minutes on two cores.
"""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

import numpy as np

from acoustube.indentation import indent
from acoustube.lumen import deformed_wall, profile
from acoustube.tube import MeshSize, Tube

REFERENCE = Path(__file__).parents[1] / "tests" / "data" / "indentation_rod25.csv"
DEPTHS_MM = (2.0, 4.0, 6.0)
MESHES = (
    MeshSize(through_wall=1, around=8, along=10),
    MeshSize(through_wall=2, around=8, along=10),
    MeshSize(),
    MeshSize(through_wall=2, around=16, along=18),
)


def reference() -> dict[float, tuple[float, float, float]]:
    """Return force in N, height in mm and area in mm2 by depth in mm."""
    # NumPy would take the names from the first line of the comment.
    lines = [line for line in REFERENCE.read_text().splitlines() if not line.startswith("#")]
    table = np.genfromtxt(lines, delimiter=",", names=True)
    columns = ("force_N", "lumen_height_mm", "lumen_area_mm2")
    return {float(row["depth_mm"]): tuple(float(row[c]) for c in columns) for row in table}


if __name__ == "__main__":
    exact = reference()
    print("| mesh | unknowns | depth mm | force % | height mm | area mm2 | iterations | time s |")
    print("|" + "---|" * 8)
    for size in MESHES:
        name = f"{size.through_wall} x {size.around} x {size.along}"
        for _ in range(2):  # the first compiles
            start = perf_counter()
            press = indent(
                Tube(),
                rod_diameter=25e-3,
                depth=[1e-3 * depth for depth in DEPTHS_MM],
                support="free",
                size=size,
            )
            seconds = perf_counter() - start
        for depth in DEPTHS_MM:
            (i,) = np.flatnonzero(press.depth == 1e-3 * depth)
            section = profile(deformed_wall(press, i), np.zeros(1))
            force, height, area = exact[depth]
            print(
                f"| {name} | {press.mesh.nodes.size} | {depth:g} "
                f"| {100 * (press.contact_force[i] / force - 1):+.2f} "
                f"| {1e3 * section.height[0] - height:+.4f} "
                f"| {1e6 * section.area[0] - area:+.3f} "
                f"| {press.iterations.sum()} | {seconds:.1f} |",
                flush=True,
            )
