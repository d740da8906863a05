"""Which direct solver factorises the stiffness matrix of a pressed tube fastest?

The default tube, held, 1 mm under a 25 mm rod: the quarter by symmetry, the half, the
whole, and two refinements of the quarter. The state is that of the quarter, interpolated. Each row:
unknowns, bandwidth, entries of the lower triangle, and per solver the processor time to factorise
and to solve (median of three, one thread) and the residual relative to the right-hand side. The
multifrontal method reuses its order and analysis, as in a press; the others start anew. PARDISO
(pypardiso) and CHOLMOD (cvxopt) are timed where they are installed: ``python
benchmarks/indentation_linear_solvers.py``. Some four minutes on one core.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from functools import partial
from importlib import import_module
from statistics import median
from time import process_time
from typing import Any

import jax
import numpy as np
import scipy
from numpy.typing import NDArray
from scipy import sparse
from scipy.interpolate import RBFInterpolator
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse.linalg import splu
from threadpoolctl import threadpool_limits

from acoustube.base.limits import pressed_reach
from acoustube.indentation import USUAL_MESH, Indentation, Indenter, MeshSize, indent, linear_solver
from acoustube.indentation.assembly import stiffness
from acoustube.indentation.mesh import Mesh, sweep
from acoustube.indentation.multifrontal import Analysis
from acoustube.indentation.press import press_model
from acoustube.tube import Tube

Array = NDArray[np.float64]
Factorise = Callable[[sparse.csc_array], linear_solver.Solve]

TUBE, ROD, DEPTH, REPEATS = Tube(), Indenter(), 1e-3, 3
REACH = pressed_reach(TUBE.outer_diameter, ROD.diameter)
SIZE = USUAL_MESH
CASES = {
    "quarter": (SIZE, (True, True)),
    "half": (SIZE, (True, False)),
    "whole": (SIZE, (False, False)),
    "quarter, 3 x 24 x 21": (MeshSize(through_wall=3, around=24, along=21), (True, True)),
    "quarter, 4 x 32 x 28": (MeshSize(through_wall=4, around=32, along=28), (True, True)),
}
LARGEST_FOR_SUPERLU = 7.5e7
"""Size of the band beyond which SuperLU, at half a minute per factorisation, is left out."""


def in_elements(points: Array) -> Array:
    """Return

    x|, y and |z| in units in which elements are about as long as wide.
    """
    x, y, z = points.T
    along = np.arcsinh(np.abs(z) / REACH * np.sinh(SIZE.grading)) / SIZE.grading * SIZE.along
    wide = TUBE.wall_thickness / SIZE.through_wall
    return np.stack([np.abs(x) / wide, y / wide, along], axis=-1)


def matrix(mesh: Mesh, pressed: Indentation) -> tuple[sparse.csc_array, Analysis]:
    """Return the lower triangle of the stiffness for another mesh, and its analysis."""
    known = RBFInterpolator(
        in_elements(pressed.mesh.points), pressed.displacement[-1], neighbors=100
    )
    mirrored = np.where(mesh.points < 0, -1, 1) * [1, 0, 1] + [0, 1, 0]
    displacement = mirrored * known(in_elements(mesh.points))
    state = Indentation(
        **{
            **vars(pressed),
            "mesh": mesh,
            "depth": np.array([DEPTH]),
            "displacement": displacement[None],
        }
    )
    model = press_model(state)
    displacement[~model.free] = 0
    return (
        stiffness(model, displacement, state.bodies()),
        model.analysis,
    )


def cholmod(library: Any, lower: sparse.csc_array) -> linear_solver.Solve:
    """Factorise by CHOLMOD's supernodal method."""
    library.cholmod.options["supernodal"] = 2
    columns = np.repeat(np.arange(lower.shape[0]), np.diff(lower.indptr))
    a = library.spmatrix(lower.data, lower.indices.astype(int), columns, size=lower.shape)
    factor = library.cholmod.symbolic(a)
    library.cholmod.numeric(a, factor)

    def solve(right: Array) -> Array:
        solution = library.matrix(right)
        library.cholmod.solve(factor, solution)
        return np.array(solution).reshape(right.shape)

    return solve


def banded(lower: sparse.csc_array) -> linear_solver.Solve:
    """Factorise by banded Cholesky of LAPACK, with the numbering along the tube."""
    columns = np.repeat(np.arange(lower.shape[0]), np.diff(lower.indptr))
    band = np.zeros((bandwidth(lower) + 1, lower.shape[0]), order="F")
    band[lower.indices - columns, columns] = lower.data
    factor = cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
    return lambda right: np.asarray(cho_solve_banded((factor, True), right, check_finite=False))


def bandwidth(lower: sparse.csc_array) -> int:
    """Return the largest distance of an entry from the diagonal."""
    columns = np.repeat(np.arange(lower.shape[0]), np.diff(lower.indptr))
    return int((lower.indices - columns).max())


def superlu(lower: sparse.csc_array) -> linear_solver.Solve:
    """Factorise by sparse LU of SciPy, without pivoting."""
    whole = (lower + sparse.tril(lower, -1).T).tocsc()
    options = {"SymmetricMode": True}
    return splu(whole, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve


def solvers(analysis: Analysis) -> dict[str, Factorise]:
    """Return the solvers that are installed; name the others."""
    found: dict[str, Factorise] = {
        "multifrontal Cholesky": partial(linear_solver.factorise, analysis=analysis),
        "banded Cholesky": banded,
        "SuperLU": superlu,
    }
    for name, module, solver in (
        (
            "PARDISO",
            "pypardiso.pardiso_wrapper",
            lambda lib: partial(linear_solver.pardiso, library=lib),
        ),
        ("CHOLMOD", "cvxopt.cholmod", lambda _: partial(cholmod, import_module("cvxopt"))),
    ):
        try:
            found[name] = solver(import_module(module))
        except ImportError:
            print(f"{module.split('.')[0]} is not installed: {name} is left out.")
    return found


def times(factorise: Factorise, lower: sparse.csc_array) -> tuple[float, float, float]:
    """Return processor time in s to factorise and to solve, and the relative residual."""
    right = np.random.default_rng(0).normal(size=lower.shape[0])
    factorising, solving = [], []
    for _ in range(REPEATS):
        start = process_time()
        solve = factorise(lower)
        middle = process_time()
        solution = solve(right)
        factorising.append(middle - start)
        solving.append(process_time() - middle)
    residual = lower @ solution + sparse.tril(lower, -1).T @ solution - right
    error = float(np.linalg.norm(residual) / np.linalg.norm(right))
    return median(factorising), median(solving), error


if __name__ == "__main__":
    print(
        f"{platform.machine()} x {os.cpu_count()}, load {os.getloadavg()[0]:.1f}, "
        f"scipy {scipy.__version__}, float64"
    )
    with jax.enable_x64(True), threadpool_limits(1, user_api="blas"):
        pressed = indent(TUBE, ROD, depth=DEPTH, mesh=SIZE)
        # MKL is loaded after this limit is set and is not affected.
        os.environ["MKL_NUM_THREADS"] = "1"
        header = "| mesh | unknowns | band | entries | solver | factorise s | solve s "
        print(header + "| residual |\n" + "|" + "---|" * 8)
        for name, (size, halved) in CASES.items():
            lower, analysis = matrix(sweep(TUBE, REACH, size, halved=halved), pressed)
            width = bandwidth(lower)
            case = f"| {name} | {lower.shape[0]} | {width} | {lower.nnz} "
            for solver, factorise in solvers(analysis).items():
                if solver == "SuperLU" and lower.shape[0] * width > LARGEST_FOR_SUPERLU:
                    print(case + f"| {solver} | not timed | | |")
                    continue
                factor, solve, error = times(factorise, lower)
                print(f"{case}| {solver} | {factor:.2f} | {solve:.4f} | {error:.0e} |", flush=True)
