"""Processor time of a press to 8 mm against the error of its force, compared with CalculiX.

The default tube, free on a rigid floor, under a 25 mm rod; quarter model, 60 mm long. Both codes
use the nodes of the same sweep, in meshes from coarse to fine, and one thread. CalculiX has 20-node
elements with reduced integration, and surface-to-surface contact with a penalty as stiff as
acoustube's; from the fold on, roof and sole of its lumen are in contact as well.

The converged force at each depth is the limit of acoustube's uniformly refined meshes: the
numbers of elements through the wall, around and along grow in the same ratio, and Richardson's
extrapolation uses the third power of their size. Its uncertainty follows from the last two meshes
and from CalculiX. Processor times are those to 7 mm, without acoustube's compilation, with set-up.
``python benchmarks/indentation_against_calculix.py FILE`` adds a line of JSON for each run that
FILE lacks, and prints the tables; a run of CalculiX is ended after ten minutes of processor time.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import tempfile
from collections.abc import Iterable
from dataclasses import astuple
from pathlib import Path
from time import process_time, sleep
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.indentation import USUAL_MESH, Indenter, MeshSize, indent
from acoustube.indentation.contact import CONTACT_STIFFNESS
from acoustube.indentation.mesh import Mesh, sweep
from acoustube.runs.config.si import MESH_SIZES
from acoustube.tube import Tube

Array = NDArray[np.float64]

TUBE, ROD, REACH = Tube(), Indenter(), 60e-3
DEPTHS_MM = (2.0, 4.0, 6.0, 7.0, 7.5, 8.0)
TIMED = DEPTHS_MM.index(7.0)
"""Index of the depth to which a run is timed."""
REFINED = (
    MeshSize(through_wall=1, around=10, along=7),
    MeshSize(through_wall=2, around=20, along=13),
    MeshSize(through_wall=3, around=30, along=20),
    MeshSize(through_wall=4, around=40, along=26),
)
"""Meshes that are refined in the same ratio in all three directions."""
OTHERS = (
    MeshSize(through_wall=1, around=12, along=10),
    MeshSize(through_wall=2, around=12, along=12),
    MeshSize(through_wall=2, around=24, along=18),
)
GRADED = (USUAL_MESH, MESH_SIZES["fine"])
"""Default and fine mesh, computed by acoustube only."""
ORDER = 3
"""Assumed order of convergence of the force; 2 and 4 differ by 0.8 of the last difference, which is
the uncertainty stated."""
LIMIT = 600.0
"""Processor time in s after which CalculiX is ended."""
BEYOND = 1.25
"""Ratio of processor time to that at 7 mm after which CalculiX is ended."""
POLL = 0.05
"""Time in s between checks of CalculiX's progress."""

CORNERS = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
EDGES = [(0, -1), (1, 0), (0, 1), (-1, 0)]
C3D20 = [
    *[(*corner, z) for z in (-1, 1) for corner in CORNERS],
    *[(*edge, z) for z in (-1, 1) for edge in EDGES],
    *[(*corner, 0) for corner in CORNERS],
]
"""Local coordinates of the nodes in the order of CalculiX."""
FACETS = 160
"""Facets of the rod's quarter in CalculiX: its surface is off by at most 0.2 um."""


def lines(keyword: str, rows: Iterable[Iterable[object]]) -> str:
    """Return a keyword of CalculiX with its data."""
    written = (
        ", ".join(f"{v:.10g}" if isinstance(v, float) else f"{v}" for v in row) for row in rows
    )
    return "\n".join([f"*{keyword}", *written]) + "\n"


def brick_strip(profile: Array, first_node: int, first_element: int, name: str) -> str:
    """Return a strip of 8-node bricks with their faces 1 along the profile.

    Parameters
    ----------
    profile : array of shape (2, n, 2)
        Height y and position z in mm of the lower (or upper) surface and of the other one.
    """
    across = np.array([-1.0, 12.0])
    n = profile.shape[1]
    nodes = [(x, y, z) for surface in profile for y, z in surface for x in across]
    number = first_node + np.arange(len(nodes)).reshape(2, n, 2)
    s = slice(None, -1), slice(1, None)
    face = [number[:, s[0], 0], number[:, s[0], 1], number[:, s[1], 1], number[:, s[1], 0]]
    if (
        np.linalg.det(
            np.subtract(
                [nodes[i - first_node] for i in (face[1][0, 0], face[3][0, 0], face[0][1, 0])],
                nodes[face[0][0, 0] - first_node],
            )
        )
        < 0
    ):
        face = [face[i] for i in (0, 3, 2, 1)]
    elements = np.stack([*(f[0] for f in face), *(f[1] for f in face)], axis=-1)
    ids = first_element + np.arange(n - 1)
    return (
        lines(f"NODE, NSET={name}", ((first_node + i, *node) for i, node in enumerate(nodes)))
        + lines(
            f"ELEMENT, TYPE=C3D8, ELSET={name}",
            ((i, *e) for i, e in zip(ids, elements, strict=True)),
        )
        + lines(f"SURFACE, NAME={name}", [(name, "S1")])
    )


def rod_profile() -> Array:
    """Return the rod's lower side from just before its lowest line to 80 degrees beyond."""
    angle = np.deg2rad(np.linspace(-5, 80, FACETS))
    radii = 500 * ROD.diameter * np.array([1.0, 0.9])[:, None]
    top = 500 * TUBE.outer_diameter
    return np.stack([top + radii[0] - radii * np.cos(angle), radii * np.sin(angle)], axis=-1)


def floor_profile() -> Array:
    """Return the floor, and its underside."""
    height = -500 * TUBE.outer_diameter + np.array([[0.0], [-1.0]])
    place = np.linspace(-1.0, 1e3 * REACH + 2, 64)
    return np.stack([height + 0 * place, place + 0 * height], axis=-1)


def deck(mesh: Mesh) -> str:
    """Return the input of CalculiX, in mm, N and MPa."""
    local = [tuple(node) for node in mesh.reference.nodes.astype(int)]
    elements = mesh.elements[:, [local.index(node) for node in C3D20]] + 1
    points = 1e3 * mesh.points
    _, around, through = mesh.sweep.shape
    across = np.arange(len(elements)).reshape(-1, around, through) + 1
    # Without the sides of the lumen, where both walls meet in the fold.
    faces = {
        "OUTER": (across[:, :, -1], "S4"),
        "SOLE": (across[:, : int(0.4 * around), 0], "S6"),
        "ROOF": (across[:, -int(0.4 * around) :, 0], "S6"),
    }
    planes = {"XPLANE": points[:, 0] == 0, "ZPLANE": points[:, 2] == 0}
    bottom = mesh.bottom[np.argmin(points[mesh.bottom, 2])] + 1
    n, m = len(points) + 1, len(elements) + 1
    mu, bulk = 1e-6 * TUBE.shear_modulus, 1e-6 * TUBE.bulk_modulus
    penalty = CONTACT_STIFFNESS * mu / (1e3 * TUBE.wall_thickness)
    return (
        lines("NODE, NSET=TUBE", ((i + 1, *p) for i, p in enumerate(points)))
        + lines("ELEMENT, TYPE=C3D20R, ELSET=TUBE", (
            (i + 1, *e[:11], "\n" + ", ".join(map(str, e[11:]))) for i, e in enumerate(elements)))
        + "".join(lines(f"ELSET, ELSET={name}", ([i] for i in part.flat))
                  + lines(f"SURFACE, NAME={name}", [(name, face)])
                  for name, (part, face) in faces.items())
        + "".join(lines(f"NSET, NSET={name}", ([i + 1] for i in np.flatnonzero(on)))
                  for name, on in planes.items())
        + brick_strip(rod_profile(), n, m, "ROD")
        + brick_strip(floor_profile(), n + 4 * FACETS, m + FACETS, "FLOOR")
        + lines("ELEMENT, TYPE=SPRING1, ELSET=HOLD", [(m + FACETS + 100, bottom)])
        # Until the contacts close, nothing else supports the tube.
        + "*SPRING, ELSET=HOLD\n2\n0.01\n"
        + f"*MATERIAL, NAME=SILICONE\n*HYPERELASTIC, NEO HOOKE\n{mu / 2}, {2 / bulk}\n"
        + "*MATERIAL, NAME=STEEL\n*ELASTIC\n2e5, 0.3\n"
        + "*SOLID SECTION, ELSET=TUBE, MATERIAL=SILICONE\n"
        + "".join(f"*SOLID SECTION, ELSET={name}, MATERIAL=STEEL\n" for name in ("ROD", "FLOOR"))
        + "*SURFACE INTERACTION, NAME=SMOOTH\n"
        + f"*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR\n{penalty}\n"
        + "".join(f"*CONTACT PAIR, INTERACTION=SMOOTH, TYPE=SURFACE TO SURFACE\n{pair}\n"
                  for pair in ("OUTER, ROD", "OUTER, FLOOR", "ROOF, SOLE"))
        + "*BOUNDARY\nXPLANE, 1, 1\nZPLANE, 3, 3\nFLOOR, 1, 3\n"
        + lines("TIME POINTS, NAME=DEPTHS", ([depth] for depth in DEPTHS_MM))
        + f"*STEP, NLGEOM, INC=1000\n*STATIC\n0.05, {DEPTHS_MM[-1]}, 1e-6, 0.5\n"
        + f"*BOUNDARY\nROD, 1, 1\nROD, 3, 3\nROD, 2, 2, {-DEPTHS_MM[-1]}\n"
        + "*NODE PRINT, NSET=ROD, TOTALS=ONLY, TIME POINTS=DEPTHS\nRF\n"
        # Fills the output buffer, so that the forces are written while CalculiX runs.
        + "*NODE PRINT, NSET=ROD, TIME POINTS=DEPTHS\nU\n*END STEP\n"
    )  # fmt: skip


def calculix(size: MeshSize) -> dict[str, Any]:
    """Return the record of a press with CalculiX, up to the depth that it reaches."""
    mesh = sweep(TUBE, REACH, size)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "press.inp").write_text(deck(mesh))
        peer = subprocess.Popen(
            ["ccx", "press"],
            cwd=folder,
            env=os.environ | {"OMP_NUM_THREADS": "1", "CCX_NPROC_EQUATION_SOLVER": "1"},
            stdout=(folder / "log").open("w"),
        )
        force: list[float] = []
        used, limit, seconds = 0.0, LIMIT, np.nan
        while peer.poll() is None and used < limit:
            sleep(POLL)
            used = _processor_seconds(peer.pid) or used
            force = printed(folder / "press.dat")
            if len(force) > TIMED and np.isnan(seconds):
                seconds, limit = used, min(LIMIT, BEYOND * used)
        peer.kill()
        peer.wait()
        force = printed(folder / "press.dat")
        last = float((folder / "press.sta").read_text().splitlines()[-1].split()[-3])
    return record("CalculiX", mesh, size, force, seconds) | {"last_mm": last, "used": used}


def printed(path: Path) -> list[float]:
    """Return the forces in N for the whole tube that CalculiX has printed."""
    found = path.read_text() if path.exists() else ""
    rows = re.findall(r"force.*time\s+\S+\s+\S+\s+(\S+)\s+\S+\n", found)
    return [-4 * float(value) for value in rows]


def _processor_seconds(process: int) -> float:
    """Return the processor time of a running process, 0 if it has ended."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except FileNotFoundError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def acoustube(size: MeshSize) -> dict[str, Any]:
    """Return the record of a press with acoustube, with everything compiled beforehand."""
    mesh, depths = sweep(TUBE, REACH, size), 1e-3 * np.array(DEPTHS_MM)
    indent(TUBE, ROD, depth=0.02e-3, support="free", mesh=mesh)
    seconds = np.nan
    if size != REFINED[-1]:  # this mesh is used for the limit only
        start = process_time()
        indent(TUBE, ROD, depth=depths[: TIMED + 1], support="free", mesh=mesh)
        seconds = process_time() - start
    start = process_time()
    press = indent(TUBE, ROD, depth=depths, support="free", mesh=mesh)
    force = press.contact_force[press.rows_at(depths)].tolist()
    more = {"last_mm": DEPTHS_MM[-1], "used": process_time() - start}
    return record("acoustube", mesh, size, force, seconds) | more


def record(
    code: str, mesh: Mesh, size: MeshSize, force: list[float], seconds: float
) -> dict[str, Any]:
    """Return the results of a run: forces in N at the first depths, and processor time to 7 mm."""
    return {
        "code": code, "size": list(astuple(size)), "components": mesh.points.size,
        "force": force, "seconds": seconds,
    }  # fmt: skip


CODES = {"acoustube": acoustube, "CalculiX": calculix}
RUNS = [
    *(("acoustube", size) for size in (*OTHERS, *GRADED, *REFINED)),
    *(("CalculiX", size) for size in (*OTHERS, REFINED[1])),
]


def limit(known: list[dict[str, Any]]) -> tuple[Array, Array]:
    """Return the limit of the forces in N of acoustube's refined meshes, and its uncertainty.

    Extrapolated from the two finest meshes with `ORDER`; the uncertainty is their difference.
    """
    sizes = [list(astuple(size)) for size in REFINED]
    refined = [each for each in known if each["code"] == "acoustube" and each["size"] in sizes]
    coarse, fine = sorted(refined, key=lambda each: int(each["components"]))[-2:]
    ratio = fine["size"][1] / coarse["size"][1]
    change = np.subtract(fine["force"], coarse["force"])
    return fine["force"] + change / (ratio**ORDER - 1), np.abs(change)


def padded(force: list[float]) -> Array:
    """Return forces at all depths, NaN at those that were not reached."""
    return np.append(force, np.full(len(DEPTHS_MM) - len(force), np.nan))


def tables(known: list[dict[str, Any]]) -> str:
    """Return the limit, and each run's time to 7 mm and errors against it."""
    depths = " | ".join(f"{depth:g} mm" for depth in DEPTHS_MM)
    exact, by = limit(known)
    cells = [f"{force:.4f} +- {spread:.4f}" for force, spread in zip(exact, by, strict=True)]
    lines = [f"| limit | {depths} |", "|" + "---|" * (len(DEPTHS_MM) + 1)]
    lines.append(f"| N | {' | '.join(cells)} |")
    lines += ["", f"| code | mesh | components | s to 7 mm | {depths} | ended at mm |"]
    lines.append("|" + "---|" * (len(DEPTHS_MM) + 5))
    for each in sorted(known, key=lambda each: (each["code"], each["components"])):
        errors = [f"{error:+.2f} %" for error in 100 * (padded(each["force"]) / exact - 1)]
        mesh = " x ".join(str(count) for count in each["size"][:3])
        row = [each["code"], mesh, each["components"], f"{each['seconds']:.1f}", *errors]
        lines.append(f"| {' | '.join(map(str, row))} | {each['last_mm']:.2f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("file", type=Path, help="gets a line of JSON for each run")
    asked = parser.parse_args()
    old = asked.file.read_text().splitlines() if asked.file.exists() else []
    known = [json.loads(line) for line in old]
    done = [(each["code"], each["size"]) for each in known]
    for code, size in RUNS:
        if (code, list(astuple(size))) not in done:
            known.append(CODES[code](size))
            with asked.file.open("a") as file:
                file.write(json.dumps(known[-1]) + "\n")
    print(tables(known))
