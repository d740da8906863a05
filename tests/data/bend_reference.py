"""Write `bend.csv`: scattering by a bend of a round bore, by finite elements in three dimensions.

A bore of radius 3.95 mm turns by 90 degrees about a centre 10 mm away, between two endless straight
parts; rigid, lossless, 343.2 m/s. Helmholtz's equation is solved in Cartesian coordinates on
quadratic hexahedra with curved faces. The ends are matched to the modes of the straight bore,
including evanescent ones. The model shares no equation with the curvilinear formulation of
`acoustube.waves.bends`.

Needs scikit-fem, which acoustube does not need: `python tests/data/bend_reference.py`.
"""

import csv
import sys
from pathlib import Path

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu
from scipy.special import jnp_zeros, jv
from skfem import Basis, BilinearForm, ElementHex2, FacetBasis, LinearForm, MeshHex, MeshHex2
from skfem.helpers import dot, grad

RADIUS, BEND_RADIUS, ANGLE, SOUND_SPEED = 3.95e-3, 10e-3, np.pi / 2, 343.2
FREQUENCIES = 10e3, 20e3, 30e3, 42e3, 48e3
MODES = ((0, 0), (1, 1), (2, 1), (0, 1), (3, 1), (4, 1), (1, 2), (5, 1), (2, 2), (0, 2))
INNER = 0.5


def quads(n, n_ring):
    """Return the points and cells of a square with a square core and four blocks around it."""
    ring = np.linspace(INNER, 1, n_ring + 1)
    across = np.linspace(-1, 1, n + 1)
    blocks = [np.stack(np.meshgrid(INNER * across, INNER * across, indexing="ij"), -1)]
    side = np.stack([ring[:, None] + 0 * across, ring[:, None] * across], -1)
    turn = np.array([[0, 1], [-1, 0]])
    blocks += [side @ np.linalg.matrix_power(turn, i) for i in range(4)]
    return blocks


def mesh(n, n_ring, n_along):
    """Return curved hexahedra in the bend."""
    s = np.linspace(0, 1, n_along + 1)
    whole = None
    for block in quads(n, n_ring):
        a, b = (np.arange(size) for size in block.shape[:2])
        part = MeshHex.init_tensor(a.astype(float), b.astype(float), s)
        i, j = np.rint(part.p[0]).astype(int), np.rint(part.p[1]).astype(int)
        part = MeshHex(np.stack([*block[i, j].T, part.p[2]]), part.t)
        whole = part if whole is None else whole + part
    curved = MeshHex2.from_mesh(whole)
    return MeshHex2(bent(curved.doflocs), curved.t)


def bent(places):
    """Map the square to the disc, and the line to the bend in the y-z plane, towards -y."""
    u, v, s = places
    big = np.maximum(np.abs(u), np.abs(v))
    flip = np.abs(v) > np.abs(u)
    major, minor = np.where(flip, v, u), np.where(flip, u, v)
    t = minor / np.where(big > 0, big, 1) * np.where(major < 0, -1, 1)
    q = np.clip((big - INNER) / (1 - INNER), 0, 1)
    core = 0.55 / INNER
    sign = np.where(major < 0, -1, 1)
    # A core whose sides bulge would be rounder; straight ones do.
    near = np.stack([sign * INNER * core, sign * t * INNER * core])
    far = np.stack([sign * np.cos(np.pi / 4 * t), sign * np.sin(np.pi / 4 * t)])
    outer = (1 - q) * near + q * far
    a, b = np.where(big <= INNER, core * np.stack([major, minor]), outer)
    x, y = RADIUS * np.where(flip, b, a), RADIUS * np.where(flip, a, b)
    along = ANGLE * s
    reach = BEND_RADIUS + y
    return np.stack([x, reach * np.cos(along) - BEND_RADIUS, reach * np.sin(along)])


def mode(m, n, x, y):
    """Return a mode symmetric about x = 0 with a mean square of one, and its j'."""
    zero = 0.0 if (m, n) == (0, 0) else jnp_zeros(m, n)[-1]
    r, phi = np.hypot(x, y) / RADIUS, np.arctan2(x, -y)
    square = jv(m, zero) ** 2 * (1 - (m / zero) ** 2 if zero else 1) * (0.5 if m else 1)
    return jv(m, zero * r) * np.cos(m * phi) / np.sqrt(square), zero


@BilinearForm
def stiffness(p, q, _):
    return dot(grad(p), grad(q))


@BilinearForm
def mass(p, q, _):
    return p * q


def scattered(n, n_ring, n_along):
    """Yield, for each frequency, the mode amplitudes excited by a plane wave of unit power."""
    grid = mesh(n, n_ring, n_along)
    basis = Basis(grid, ElementHex2(), intorder=5)
    K, M = stiffness.assemble(basis), mass.assemble(basis)
    middle = grid.p[:, grid.facets].mean(axis=1)
    on_end = [np.abs(middle[2]) < 1e-9, np.abs(middle[1] + BEND_RADIUS) < 1e-9]
    ends = [FacetBasis(grid, ElementHex2(), facets=np.flatnonzero(e), intorder=8) for e in on_end]
    weights = []
    for end in (0, 1):
        rows = []
        for m, n_ in MODES:

            def load(q, w, m=m, n_=n_, end=end):
                # After a quarter of a turn, what was y is z.
                y = w.x[1] if end == 0 else w.x[2] - BEND_RADIUS
                return mode(m, n_, w.x[0], y)[0] * q

            rows.append(LinearForm(load).assemble(ends[end]))
        weights.append(np.array(rows))
    area = weights[0][0].sum()
    print(f"{basis.N} unknowns, area off by {area / (np.pi * RADIUS**2) - 1:.1e}", file=sys.stderr)
    zeros = np.array([mode(m, n_, 1e-3, 0.0)[1] for m, n_ in MODES])
    for f in FREQUENCIES:
        k = 2 * np.pi * f / SOUND_SPEED
        kz = np.conj(np.sqrt((k**2 - (zeros / RADIUS) ** 2).astype(complex)))
        A = csc_matrix(K - k**2 * M, dtype=complex)
        for w in weights:
            w = csc_matrix(w)
            A = A + w.T @ csc_matrix(np.diag(1j * kz / area)) @ w
        options = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0}
        factors = splu(csc_matrix(A), **options, options={"SymmetricMode": True})
        p = factors.solve(2j * kz[0] * weights[0][0].astype(complex))
        back, on = (w @ p / area for w in weights)
        back[0] -= 1
        travels = kz.real > 0
        power = np.where(travels, kz.real / kz[0].real, 0)
        yield f, np.sqrt(power) * back, np.sqrt(power) * on, travels


if __name__ == "__main__":
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    with (Path(__file__).parent / "bend.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["frequency_hz", "mode", "r_real", "r_imag", "t_real", "t_imag"])
        for f, back, on, travels in scattered(n, max(2, n // 2), 6 * n):
            total = sum(abs(back[travels]) ** 2) + sum(abs(on[travels]) ** 2)
            print(f, total - 1, abs(back[:3]), abs(on[:3]), file=sys.stderr)
            for (m, n_), r, t, is_in in zip(MODES, back, on, travels, strict=True):
                if is_in:
                    numbers = (r.real, r.imag, t.real, t.imag)
                    name = f"{m}{n_}{'c' if m else ''}"
                    table.writerow([f"{f:g}", name, *(f"{value:.6f}" for value in numbers)])
