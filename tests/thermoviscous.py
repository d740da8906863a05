"""Sound in viscous, heat-conducting air by finite elements, independent of the package's solvers.

The linearised equations of Navier, Stokes and Fourier in a channel (between planes, or round),
symmetric about its axis and about its middle z = 0, with rigid isothermal walls at rest: velocity
and temperature are biquadratic, the pressure is bilinear (Taylor and Hood). With k = omega / c, the
velocity times rho c, u, and the temperature times rho cp, theta, both in Pa,

    j k u + grad p - l div(grad u) - l / 3 grad(div u) = 0,         l = nu / c,
    j k (gamma p - (gamma - 1) theta) + div u = 0,
    j k (theta - p) - l / Pr div(grad theta) = 0.

Needs scikit-fem.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from duct_losses import classical_absorption
from scipy import sparse
from scipy.sparse.linalg import splu
from skfem import (
    Basis,
    BilinearForm,
    ElementQuad1,
    ElementQuad2,
    FacetBasis,
    LinearForm,
    MeshQuad,
    MeshQuad2,
)
from skfem.helpers import dot, grad

from acoustube.air import Air
from acoustube.waves import spectral
from acoustube.waves.spectral.layers import filling, layer_thickness

AIR = Air(sound_speed=343.2, density=1.204)
ACROSS, ALONG, LEAD_ELEMENTS = 18, 56, 40
WALL_GRADING, THROAT_GRADING = 6.0, 4.0
"""Gradings of the mesh: elements are narrow at the wall, and short at the narrowest section."""


class Channel(NamedTuple):
    """A channel narrowed as (1 + cos) / 2, all lengths in m.

    Attributes
    ----------
    width : float
        Distance of the walls at the ends: height between planes, or diameter.
    least : float
        The same at z = 0.
    reach : float
        Half the length of the narrowed part.
    lead : float
        Length of the straight part on each side.
    is_round : bool
        Of circular section, instead of between planes.
    """

    width: float
    least: float
    reach: float
    lead: float
    is_round: bool = False

    def at(self, z):
        """Return the width at heights z."""
        inside = np.where(np.abs(z) < self.reach, 0.5 + 0.5 * np.cos(np.pi * z / self.reach), 0.0)
        return self.width - (self.width - self.least) * inside

    def wavenumber(self, frequency, width, air):
        """Return the plane mode's wavenumber of a straight channel, in 1/m, by its layers."""
        sides = 4 if self.is_round else 2
        taken = [
            sides / width * d * filling(np.array([width]), np.array([float(self.is_round)]), d)[0]
            for d in (part[0] for part in layer_thickness(np.array([frequency]), air))
        ]
        k = 2 * np.pi * frequency / air.sound_speed
        return k * np.sqrt((1 + (air.heat_capacity_ratio - 1) * taken[1]) / (1 - taken[0]))


def narrowed(least, *, is_round):
    """Return a channel of 4 mm, narrowed over 8 mm."""
    return Channel(4e-3, least, 4e-3, 8e-3, is_round)


def graded(n, grading):
    """Return points from 0 to 1, dense at 0."""
    return np.sinh(grading * np.linspace(0, 1, n + 1)) / np.sinh(grading)


def meshed(channel, across=ACROSS, along=ALONG, lead=LEAD_ELEMENTS, grading=THROAT_GRADING):
    """Return the quarter of a channel with z >= 0, between its axis and a wall."""
    narrowed = channel.reach * graded(along, grading)
    straight = channel.reach + channel.lead * np.linspace(0, 1, lead + 1)[1:]
    eta = 1 - graded(across, WALL_GRADING)[::-1]
    mesh = MeshQuad2.from_mesh(MeshQuad.init_tensor(np.concatenate([narrowed, straight]), eta))
    z, share = mesh.doflocs
    return MeshQuad2(np.stack([z, share * channel.at(z) / 2]), mesh.t)


def ends(mesh):
    """Return the numbers of the facets of the wall, of the middle, of the axis and of the end."""
    facets = mesh.boundary_facets()
    z, r = mesh.p[:, mesh.facets[:, facets]]
    end = mesh.p[0].max()
    middle, last = (np.abs(z - at).max(axis=0) < 1e-9 for at in (0.0, end))
    axis = np.abs(r).max(axis=0) < 1e-12
    return [facets[which] for which in (~(middle | last | axis), middle, axis, last)]


def weight(w, is_round):
    return w.x[1] if is_round else np.ones_like(w.x[1])


def thermoviscous(channel, frequency, air, mesh=None):
    """Return the pressure on the axis of the even and of the odd problem, and z of its points."""
    mesh = meshed(channel) if mesh is None else mesh
    is_round, k = channel.is_round, 2 * np.pi * frequency / air.sound_speed
    length = air.viscous_diffusivity / air.sound_speed
    two, one = Basis(mesh, ElementQuad2(), intorder=5), Basis(mesh, ElementQuad1(), intorder=5)
    laplace = BilinearForm(lambda u, v, w: weight(w, is_round) * dot(grad(u), grad(v)))
    product = BilinearForm(lambda u, v, w: weight(w, is_round) * u * v)
    hoop = BilinearForm(lambda u, v, w: u * v / w.x[1] if is_round else 0 * u * v)

    def divergence(u, w, i):
        # Times the radius: of the z component, or of the other.
        if i == 0:
            return weight(w, is_round) * u.grad[0]
        return weight(w, is_round) * u.grad[1] + (u if is_round else 0)

    def squared(i, j):
        return BilinearForm(
            lambda u, v, w: divergence(u, w, j) * divergence(v, w, i) / weight(w, is_round)
        ).assemble(two)

    def dilation(i):
        return BilinearForm(lambda u, q, w: divergence(u, w, i) * q).assemble(two, one)

    K, M, H = (form.assemble(two) for form in (laplace, product, hoop))
    P, M_p = product.assemble(one), product.assemble(one, two)
    bulk = [[length / 3 * squared(i, j) for j in (0, 1)] for i in (0, 1)]
    spread, gamma = length / air.prandtl, air.heat_capacity_ratio
    B = [dilation(i) for i in (0, 1)]
    own = 1j * k * M + length * K
    A = sparse.bmat(
        [
            [own + bulk[0][0], bulk[0][1], None, -B[0].T],
            [bulk[1][0], own + length * H + bulk[1][1], None, -B[1].T],
            [None, None, 1j * k * M + spread * K, -1j * k * M_p],
            [B[0], B[1], -1j * k * (gamma - 1) * M_p.T, 1j * k * gamma * P],
        ],
        format="csc",
    )
    wall, middle, axis, last = ends(mesh)
    drive = LinearForm(lambda v, w: -weight(w, is_round) * v).assemble(
        FacetBasis(mesh, ElementQuad2(), facets=last, intorder=5)
    )
    n, at = two.N, [two.get_dofs(facets).all() for facets in (wall, middle, axis)]
    load = np.concatenate([drive, np.zeros(2 * n + one.N)]).astype(complex)
    held = [at[0], n + at[0], 2 * n + at[0], n + at[2]]
    on_axis = one.get_dofs(axis).all()
    z = one.doflocs[0, on_axis]
    order, found = np.argsort(z), []
    for odd in (False, True):
        fixed = [*held, n + at[1], 2 * n + at[1]] if odd else [*held, at[1]]
        free = np.setdiff1d(np.arange(len(load)), np.concatenate(fixed))
        solution = np.zeros(len(load), complex)
        solution[free] = splu(A[free][:, free].tocsc()).solve(load[free])
        found.append(solution[3 * n + on_axis][order])
    return z[order], found


def by_layers(channel, frequency, air, mesh=None):
    """Return the same with the layers as a wall impedance, as the package models them."""
    mesh = meshed(channel) if mesh is None else mesh
    is_round, k = channel.is_round, 2 * np.pi * frequency / air.sound_speed
    basis = Basis(mesh, ElementQuad2(), intorder=5)
    wall, middle, axis, last = ends(mesh)
    side = FacetBasis(mesh, ElementQuad2(), facets=wall, intorder=6)
    layers = [part[0] for part in layer_thickness(np.array([frequency]), air)]
    gap = channel.at(np.asarray(side.global_coordinates()[0]))
    taken = [d * filling(gap, np.full_like(gap, float(is_round)), d) for d in layers]

    @BilinearForm(dtype=complex)
    def inside(p, q, w):
        return weight(w, is_round) * (dot(grad(p), grad(q)) - k**2 * p * q)

    @BilinearForm(dtype=complex)
    def at_wall(p, q, w):
        along = [f.grad[0] * w.n[1] - f.grad[1] * w.n[0] for f in (p, q)]
        thermal = (air.heat_capacity_ratio - 1) * w["thermal"] * k**2 * p * q
        return -weight(w, is_round) * (w["viscous"] * along[0] * along[1] + thermal)

    A = (
        inside.assemble(basis) + at_wall.assemble(side, viscous=taken[0], thermal=taken[1])
    ).tocsc()
    load = LinearForm(lambda q, w: weight(w, is_round) * q).assemble(
        FacetBasis(mesh, ElementQuad2(), facets=last, intorder=5)
    )
    on_axis, held = basis.get_dofs(axis).all(), basis.get_dofs(middle).all()
    z = basis.doflocs[0, on_axis]
    order, found = np.argsort(z), []
    for odd in (False, True):
        free = np.setdiff1d(np.arange(basis.N), held) if odd else np.arange(basis.N)
        solution = np.zeros(basis.N, complex)
        solution[free] = splu(A[free][:, free].tocsc()).solve(load[free].astype(complex))
        found.append(solution[on_axis][order])
    return z[order], found


def scattered(solve, channel, frequency, air, **options):
    """Return R and T of the plane mode, with z = 0 as the reference plane of both sides.

    Two waves in opposite directions are fitted to the pressure on the axis of the straight part,
    away from its ends.
    """
    z, sides = solve(channel, frequency, air, **options)
    start, length = channel.reach, channel.lead
    within = (z > start + 0.35 * length) & (z < start + 0.65 * length)
    kz = channel.wavenumber(frequency, channel.width, air)
    waves = np.exp(-1j * kz * np.outer(z[within], [1, -1]))
    even, odd = (np.linalg.lstsq(waves, p[within], rcond=None)[0] for p in sides)
    even, odd = even[0] / even[1], odd[0] / odd[1]
    return (even + odd) / 2, (even - odd) / 2


def spectral_scattering(channel, frequencies):
    """Return R and T of a round channel at each frequency by the spectral solver."""

    def lines(z, t):
        slope = np.where(np.abs(z) < channel.reach, np.sin(np.pi * z / channel.reach), 0.0)
        slope = (channel.width - channel.least) * np.pi / (4 * channel.reach) * slope
        r, x, y = channel.at(z) / 2, np.sin(t), -np.cos(t)
        return r * x, r * y, slope * x, slope * y

    ends, frequency = (-channel.reach, channel.reach), np.asarray(frequencies)
    wall = spectral.analytic_wall(lines, ends=ends, radius=channel.width / 2, reversible=True)
    # The absorption in the bulk, which the equations include as well.
    air = replace(AIR, classical_absorption=float(classical_absorption(1.0, AIR)))
    s = spectral.scatter_spectral(wall, air, frequency, symmetric_only=True).s
    return list(zip(s[:, 0, 0, 0, 0], s[:, 1, 0, 0, 0], strict=True))


def uniform_wavenumber(channel, frequency, air, along=80, across=ACROSS):
    """Return the wavenumber in 1/m of a straight channel: p = cos(kz z) far from the drive."""
    mesh = meshed(channel, across=across, along=along, lead=along // 4, grading=1e-3)
    z, (even, _) = thermoviscous(channel, frequency, air, mesh)
    place = int(np.abs(z - channel.reach / 2).argmin())
    found = np.arccos(even[place] / even[0]) / z[place]
    return found if found.real > 0 else -found
