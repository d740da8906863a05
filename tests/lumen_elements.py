"""Scattering of a lumen by quadratic hexahedra, a method independent of the package's solvers.

Helmholtz's equation without losses, the ends closed by the round bore's modes. The mesh is one of
the unit disc, mapped into every section: with the contour c(t), t = 0 at the bottom, the point
(u, v) of the disc goes to the line from c(s) to c(pi - s), sin s = |u|, and on it to the share that
v has of the disc's height there. A circle stays as it is. Needs scikit-fem.
"""

from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import splu
from scipy.special import jnp_zeros, jv
from skfem import Basis, BilinearForm, ElementHex2, FacetBasis, LinearForm, MeshHex, MeshHex2
from skfem.helpers import dot, grad

HIGHEST_ZERO = 12.0
"""Largest j' of the modes of an end."""
LEAD = 0.5
"""Straight bore between the lumen and a port, in radii."""
INNER, CORE = 0.5, 0.55
"""Half width of the square in the middle of the square, and of the disc."""


def half_square(n):
    """Return blocks of points of the half square u > 0: its middle, and what lies around that."""
    across, ring = np.linspace(-1, 1, 2 * n + 1), np.linspace(INNER, 1, n + 1)
    middle = np.stack(np.meshgrid(INNER * across[n:], INNER * across, indexing="ij"), -1)
    side = np.stack([ring[:, None] + 0 * across, ring[:, None] * across], -1)
    above = np.stack([ring[:, None] * across[n:], ring[:, None] + 0 * across[n:]], -1)
    return middle, side, above, above * [1, -1]


def extruded(n, heights):
    """Return hexahedra: the half square extruded over intervals of height."""
    whole = None
    for block in half_square(n):
        i, j = (np.arange(float(size)) for size in block.shape[:2])
        part = MeshHex.init_tensor(i, j, heights)
        a, b = np.rint(part.p[:2]).astype(int)
        part = MeshHex(np.stack([*block[a, b].T, part.p[2]]), part.t)
        whole = part if whole is None else whole + part
    return MeshHex2.from_mesh(whole)


def disc(u, v):
    """Map the square to the unit disc: concentric squares to ever rounder lines."""
    large, small = np.where(np.abs(v) > np.abs(u), (v, u), (u, v))
    big = np.maximum(np.abs(large), 1e-300)
    share, turn = np.clip((big - INNER) / (1 - INNER), 0, 1), small / big
    angle = np.pi / 4 * turn
    straight = CORE * np.minimum(big / INNER, 1)
    a = np.sign(large) * ((1 - share) * straight + share * np.cos(angle))
    b = (1 - share) * straight * turn + share * np.sin(angle)
    return np.where(np.abs(v) > np.abs(u), (b, a), (a, b))


def mapped(mesh, lines):
    """Return the mesh with its points moved into the sections whose contours `lines` gives."""
    (u, v), z = disc(*mesh.doflocs[:2]), mesh.doflocs[2]
    heights, where = np.unique(np.round(z, 12), return_inverse=True)
    x, y, *_ = lines(heights)
    n = x.shape[1]
    s = np.arcsin(np.minimum(u, 1.0))
    t = 2 * np.pi * np.arange(n + 1) / n
    found = np.empty((3, len(z)))
    found[2] = z
    order = np.argsort(where, kind="stable")
    for part in np.split(order, np.cumsum(np.bincount(where))[:-1]):
        row = where[part[0]]
        ring = np.stack([x[row], y[row]], -1)
        curve = CubicSpline(t, np.concatenate([ring, ring[:1]]), bc_type="periodic")
        low, high = curve(s[part]), curve(np.pi - s[part])
        reach = np.cos(s[part])
        share = np.divide(v[part], reach, out=np.zeros_like(reach), where=reach > 1e-9)
        found[:2, part] = ((low + high) / 2 + share[:, None] * (high - low) / 2).T
    return MeshHex2(found, mesh.t)


def end_modes():
    """Return numbers m and zeros j' of the modes symmetric about x = 0, sorted."""
    pairs = [(0.0, 0)]
    for m in range(int(HIGHEST_ZERO) + 1):
        pairs += [(float(zero), m) for zero in jnp_zeros(m, 6) if zero < HIGHEST_ZERO]
    return sorted(pairs)


@BilinearForm
def stiffness(p, q, _):
    return dot(grad(p), grad(q))


@BilinearForm
def mass(p, q, _):
    return p * q


def loads(facets, radius, modes):
    """Return the integrals of the elements' functions times the normalised modes, (n, n_modes)."""
    columns = []
    for zero, m in modes:
        square = jv(m, zero) ** 2 * (1 - (m / zero) ** 2 if zero else 1) * (0.5 if m else 1)
        norm = np.sqrt(np.pi * radius**2 * square)

        def value(q, w, zero=zero, m=m, norm=norm):
            r, phi = np.hypot(w.x[0], w.x[1]), np.arctan2(w.x[0], -w.x[1])
            return jv(m, zero * r / radius) * np.cos(m * phi) / norm * q

        columns.append(LinearForm(value).assemble(facets))
    # The half stands for the whole.
    return np.array(columns).T * np.sqrt(2)


def scattered(wall, frequencies, sound_speed, n, step):
    """Return R and T of the modes symmetric about x = 0, and the number of unknowns.

    Parameters
    ----------
    wall : acoustube.waves.spectral.Wall
        Symmetric about x = 0 and about its middle, z = 0; the planes of reference are there.
    frequencies : sequence of float
        In Hz.
    sound_speed : float
        In m/s.
    n : int
        Cells across the middle of the half bore; as many again from there to its rim.
    step : float
        Length of the elements in m.

    Returns
    -------
    reflected, passed : ndarray
        (n_frequencies, n_modes, n_modes) each; zero where a mode does not propagate.
    size : int
    """
    end = wall.ends[1] + LEAD * wall.radius
    borders = [0.0, *(z for z in sorted(wall.breaks) if z > 0), wall.ends[1], end]
    pieces = [
        np.linspace(low, high, max(1, round((high - low) / step)) + 1)[:-1]
        for low, high in pairwise(borders)
    ]
    heights = np.concatenate([*pieces, [end]])
    mesh = mapped(extruded(n, heights), wall.lines)
    basis = Basis(mesh, ElementHex2(), intorder=5)
    K, M = stiffness.assemble(basis).tocsc(), mass.assemble(basis).tocsc()
    middle = mesh.p[2, mesh.facets].mean(axis=0)
    modes = end_modes()
    last = FacetBasis(mesh, ElementHex2(), facets=np.flatnonzero(middle > end - 1e-9), intorder=8)
    C = loads(last, wall.radius, modes)
    free = np.flatnonzero(basis.doflocs[2] > 1e-9)
    zeros = np.array([zero for zero, _ in modes])
    reflected, passed = [], []
    for f in frequencies:
        k = 2 * np.pi * f / sound_speed
        kz = np.conj(np.sqrt((k**2 - (zeros / wall.radius) ** 2).astype(complex)))
        sides = []
        for kept in (np.arange(K.shape[0]), free):
            A = (K - k**2 * M)[kept][:, kept].tocsc()
            factors = splu(
                A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )  # fmt: skip
            response = C[kept].T @ factors.solve(C[kept])
            root = np.sqrt(1j * kz)
            q = root[:, None] * response * root
            one = np.eye(len(q))
            there = np.exp(1j * kz.real * end) * (kz.real > 0)
            sides.append(there[:, None] * np.linalg.solve(one + q, q - one) * there)
        reflected.append((sides[0] + sides[1]) / 2)
        passed.append((sides[0] - sides[1]) / 2)
    return np.array(reflected), np.array(passed), K.shape[0]


def extrapolated(wall, frequencies, sound_speed, meshes):
    """Return R00 and T00 extrapolated from two meshes (n, step), with order four.

    Also return how much the extrapolation changes the values of the finer mesh, (n_frequencies,).
    """
    coarse, fine = (scattered(wall, frequencies, sound_speed, *mesh)[:2] for mesh in meshes)
    gain = (meshes[0][1] / meshes[1][1]) ** 4 - 1
    pairs = [(a[:, 0, 0], b[:, 0, 0]) for a, b in zip(coarse, fine, strict=True)]
    values = [b + (b - a) / gain for a, b in pairs]
    return *values, np.max([np.abs(b - a) / gain for a, b in pairs], axis=0)
