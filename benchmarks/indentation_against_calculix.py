"""How long does a press to 6 mm take, next to CalculiX at the same accuracy?

The default tube, free on a rigid floor, under a 25 mm rod; quarter model, 60 mm long. Both codes
get nodes from the same sweep. CalculiX has 20-node elements with reduced integration, and contact
of surface with surface by a penalty as stiff as acoustube's. Its meshes and acoustube's each go
from coarse to fine, so that times can be compared where the errors at 6 mm are about the same, and
one sees how they grow with the number of unknowns. Errors are of the force, and of the height of
the lumen at the deepest press, against an independent CalculiX 2.20 solution with 1056 C3D20R
elements, itself good to 0.5 % at 2 and 4 mm and to 1 % and 0.005 mm at 6 mm. It is of the same kind
of element as the peer here, and may share its errors. acoustube is warm, with nothing left to
compile, but for the row that says so. CalculiX may use two threads:
``python benchmarks/indentation_against_calculix.py``. Some five minutes on two idle cores.
"""

from __future__ import annotations

import os
import platform
import re
import resource
import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path
from time import perf_counter, process_time
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from acoustube.indentation import Indenter, MeshSize, indent
from acoustube.indentation.assembly import indenter_force
from acoustube.indentation.contact import CONTACT_STIFFNESS
from acoustube.indentation.mesh import Mesh, sweep
from acoustube.indentation.press import press_model
from acoustube.tube import Tube

Array = NDArray[np.float64]

TUBE, ROD, REACH = Tube(), Indenter(), 60e-3
DEPTHS_MM = (2.0, 4.0, 6.0)
REFERENCE_N = np.array([1.03047, 2.11272, 3.79888])
REFERENCE_HEIGHT_MM = 1.94969
SIZES = (
    MeshSize(through_wall=1, around=12, along=10),
    MeshSize(through_wall=2, around=18, along=9),
    MeshSize(),
)
CALCULIX_SIZES = (
    MeshSize(through_wall=1, around=12, along=10),
    MeshSize(through_wall=2, around=12, along=12),
    MeshSize(),
)
THREADS = "2"

CORNERS = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
EDGES = [(0, -1), (1, 0), (0, 1), (-1, 0)]
C3D20 = [
    *[(*corner, z) for z in (-1, 1) for corner in CORNERS],
    *[(*edge, z) for z in (-1, 1) for edge in EDGES],
    *[(*corner, 0) for corner in CORNERS],
]
"""Local coordinates of the nodes in the order of CalculiX."""
FACETS = 160
"""Of the rod's quarter in CalculiX: its surface is off by at most 0.2 um."""


class Run(NamedTuple):
    """A press by one of the codes."""

    code: str
    mesh: Mesh
    force: Array
    height: float
    wall: float
    processor: float

    @property
    def error(self) -> float:
        """Of the force at the deepest press, in percent."""
        return float(100 * (self.force[-1] / REFERENCE_N[-1] - 1))


def roof_and_sole(mesh: Mesh) -> NDArray[np.int64]:
    """Return the numbers of the highest and the lowest node of the lumen at the press."""
    x, y, z = mesh.points.T
    inner = np.flatnonzero((mesh.sweep.layer == 0) & (x == 0) & (z == 0))
    return inner[[np.argmax(y[inner]), np.argmin(y[inner])]]


def lines(keyword: str, rows: Iterable[Iterable[object]]) -> str:
    """Return a keyword of CalculiX with its data."""
    written = (
        ", ".join(f"{v:.10g}" if isinstance(v, float) else f"{v}" for v in row) for row in rows
    )
    return "\n".join([f"*{keyword}", *written]) + "\n"


def brick_strip(profile: Array, first_node: int, first_element: int, name: str) -> str:
    """Return a strip of 8-node bricks, of which face 1 of each is along the profile.

    Parameters
    ----------
    profile : array of shape (2, n, 2)
        Height y and place z in mm of the lower (or upper) surface and of the other one.
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
    outermost = np.arange(len(elements)).reshape(-1, mesh.sweep.shape[2])[:, -1] + 1
    planes = {"XPLANE": points[:, 0] == 0, "ZPLANE": points[:, 2] == 0}
    lumen = roof_and_sole(mesh) + 1
    bottom = mesh.bottom[np.argmin(points[mesh.bottom, 2])] + 1
    n, m = len(points) + 1, len(elements) + 1
    mu, bulk = 1e-6 * TUBE.shear_modulus, 1e-6 * TUBE.bulk_modulus
    penalty = CONTACT_STIFFNESS * mu / (1e3 * TUBE.wall_thickness)
    return (
        lines("NODE, NSET=TUBE", ((i + 1, *p) for i, p in enumerate(points)))
        + lines("ELEMENT, TYPE=C3D20R, ELSET=TUBE", (
            (i + 1, *e[:11], "\n" + ", ".join(map(str, e[11:]))) for i, e in enumerate(elements)))
        + lines("ELSET, ELSET=OUTER", ([i] for i in outermost))
        + lines("SURFACE, NAME=OUTER", [("OUTER", "S4")])
        + "".join(lines(f"NSET, NSET={name}", ([i + 1] for i in np.flatnonzero(on)))
                  for name, on in planes.items())
        + lines("NSET, NSET=LUMEN", [lumen])
        + brick_strip(rod_profile(), n, m, "ROD")
        + brick_strip(floor_profile(), n + 4 * FACETS, m + FACETS, "FLOOR")
        + lines("ELEMENT, TYPE=SPRING1, ELSET=HOLD", [(m + FACETS + 100, bottom)])
        # Until the contacts close, nothing else keeps the tube from falling.
        + "*SPRING, ELSET=HOLD\n2\n0.01\n"
        + f"*MATERIAL, NAME=SILICONE\n*HYPERELASTIC, NEO HOOKE\n{mu / 2}, {2 / bulk}\n"
        + "*MATERIAL, NAME=STEEL\n*ELASTIC\n2e5, 0.3\n"
        + "*SOLID SECTION, ELSET=TUBE, MATERIAL=SILICONE\n"
        + "".join(f"*SOLID SECTION, ELSET={name}, MATERIAL=STEEL\n" for name in ("ROD", "FLOOR"))
        + "*SURFACE INTERACTION, NAME=SMOOTH\n"
        + f"*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR\n{penalty}\n"
        + "".join(f"*CONTACT PAIR, INTERACTION=SMOOTH, TYPE=SURFACE TO SURFACE\nOUTER, {name}\n"
                  for name in ("ROD", "FLOOR"))
        + "*BOUNDARY\nXPLANE, 1, 1\nZPLANE, 3, 3\nFLOOR, 1, 3\n"
        + lines("TIME POINTS, NAME=DEPTHS", ([depth] for depth in DEPTHS_MM))
        + f"*STEP, NLGEOM, INC=1000\n*STATIC\n0.05, {DEPTHS_MM[-1]}, 1e-6, 0.5\n"
        + f"*BOUNDARY\nROD, 1, 1\nROD, 3, 3\nROD, 2, 2, {-DEPTHS_MM[-1]}\n"
        + "*NODE PRINT, NSET=ROD, TOTALS=ONLY, TIME POINTS=DEPTHS\nRF\n"
        + "*NODE PRINT, NSET=LUMEN, TIME POINTS=DEPTHS\nU\n*END STEP\n"
    )  # fmt: skip


def calculix(size: MeshSize) -> Run:
    """Press with CalculiX; forces that it does not come to are NaN."""
    mesh = sweep(TUBE, REACH, size)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "press.inp").write_text(deck(mesh))
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
        subprocess.run(
            ["ccx", "press"],
            cwd=folder,
            env={**os.environ, "OMP_NUM_THREADS": THREADS, "CCX_NPROC_EQUATION_SOLVER": THREADS},
            stdout=(Path(folder) / "log").open("w"),
            check=False,
        )
        wall, after = perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
        found = (Path(folder) / "press.dat").read_text()
    force = np.full(len(DEPTHS_MM), np.nan)
    for time, values in re.findall(r"force.*time\s+(\S+)\s+([^a-z]+)", found):
        force[DEPTHS_MM.index(round(float(time), 6))] = -4 * float(values.split()[1])
    height = np.nan
    if np.isfinite(force[-1]):
        moved = re.findall(r"displacements.*\n\s*\n((?:.+\n){2})", found)[-1]
        at = {int(node): float(y) for node, _, y, _ in map(str.split, moved.splitlines())}
        roof, sole = (at[node + 1] for node in roof_and_sole(mesh))
        height = 1e3 * TUBE.inner_diameter + roof - sole
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Run("CalculiX", mesh, force, height, wall, used)


def acoustube(size: MeshSize, *, code: str = "acoustube", compiled: bool = True) -> Run:
    """Press with acoustube, with everything compiled before or not."""
    mesh = sweep(TUBE, REACH, size)
    if compiled:
        indent(TUBE, ROD, depth=0.02e-3, support="free", mesh=mesh)
    start, used = perf_counter(), process_time()
    pressed = indent(TUBE, ROD, depth=1e-3 * np.array(DEPTHS_MM), support="free", mesh=mesh)
    wall, used = perf_counter() - start, process_time() - used
    with jax.enable_x64(True):
        model = press_model(pressed)
        at = [int(np.argmin(np.abs(pressed.depth - 1e-3 * depth))) for depth in DEPTHS_MM]
        force = [indenter_force(model, pressed.displacement[i], pressed.bodies(i)[0]) for i in at]
    roof, sole = 1e3 * pressed.position()[roof_and_sole(mesh), 1]
    return Run(code, mesh, np.array(force), roof - sole, wall, used)


def row(run: Run) -> str:
    """Return a row of the table."""
    shape = run.mesh.sweep.shape
    forces = [
        f"{force:.4f} ({100 * (force / exact - 1):+.2f} %)"
        for force, exact in zip(run.force, REFERENCE_N, strict=True)
    ]
    height = f"{run.height:.4f} ({run.height - REFERENCE_HEIGHT_MM:+.4f} mm)"
    numbers = f"{height} | {run.wall:.1f} | {run.processor:.1f}"
    mesh = f"{shape[2]} x {shape[1]} x {shape[0]} | {run.mesh.points.size}"
    return f"| {run.code} | {mesh} | {' | '.join(forces)} | {numbers} |"


if __name__ == "__main__":
    load = f"load {os.getloadavg()[0]:.1f}"
    print(f"{platform.machine()} x {os.cpu_count()}, {load}, jax {jax.__version__}, float64")
    depths = " | ".join(f"N at {depth:g} mm" for depth in DEPTHS_MM)
    print(f"| code | mesh | components | {depths} | height mm | wall s | processor s |")
    print("|" + "---|" * 9)
    print(row(acoustube(SIZES[-1], code="acoustube, compiling", compiled=False)), flush=True)
    ours = []
    for size in SIZES:
        ours.append(acoustube(size))
        print(row(ours[-1]), flush=True)
    if shutil.which("ccx") is None:
        print("ccx is not installed: CalculiX's rows are left out.")
    peers = []
    for size in CALCULIX_SIZES if shutil.which("ccx") else ():
        peers.append(calculix(size))
        print(row(peers[-1]), flush=True)
    for peer in peers:
        run = min(ours, key=lambda run: abs(abs(run.error) - abs(peer.error)))
        print(
            f"CalculiX with {peer.mesh.points.size} components ({peer.error:+.2f} %) took "
            f"{peer.wall / run.wall:.2f} of the wall time and {peer.processor / run.processor:.2f} "
            f"of the processor time of acoustube with {run.mesh.points.size} ({run.error:+.2f} %)."
        )
    print(f"load at the end {os.getloadavg()[0]:.1f}")
