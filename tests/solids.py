"""Materials, meshes and models that several tests of the solid mechanics share."""

import itertools

import jax
import numpy as np
from jax.tree_util import Partial

from acoustube.indentation import element
from acoustube.indentation.assembly import build_model, evaluate
from acoustube.indentation.material import Material, mooney_rivlin, neo_hookean
from acoustube.indentation.mesh import Mesh
from acoustube.indentation.reference_element import HEX20

HEXAHEDRA_AT_4_MM = 2.1159
"""Force in N of the default tube under a 25 mm rod, free, on the default mesh of hexahedra."""

quadrature = jax.jit(element.quadrature, static_argnames="reference")
"""Compiled as a whole, since JAX would compile each of its thirty operations for each shape."""


class OpenLumen:
    """A lumen whose walls have no contact with each other."""

    def energy_and_forces(self, position):
        return 0.0, np.zeros_like(position)

    def tangent(self, position, *, convex=False):  # noqa: ARG002
        return None

    def collision_free_fraction(self, start, end):  # noqa: ARG002
        return 1.0


def neo_hookean_solid(shear_modulus, bulk_modulus):
    return Material(Partial(neo_hookean, np.float64(shear_modulus)), np.float64(bulk_modulus))


def mooney_rivlin_solid(c1, c2, bulk_modulus):
    return Material(
        Partial(mooney_rivlin, np.float64(c1), np.float64(c2)), np.float64(bulk_modulus)
    )


def bare_model(mesh, material, fixed):
    """Return a model of the wall and the bodies outside it, without contact in the lumen."""
    return build_model(mesh, material, fixed, OpenLumen())


def nodal_forces(mesh, material, displacement):
    """Return the forces on all nodes (n_nodes, 3), in N, in equilibrium with displacements."""
    everywhere = bare_model(mesh, material, np.zeros(mesh.points.shape, bool))
    return evaluate(everywhere, displacement, ()).gradient.reshape(-1, 3)


def block(x, y, z, halved=(False, False)):
    """Return a block of 20-node hexahedra between planes at x, y and z, whose top is 'outer'.

    The local coordinates are z, x and y, in that order.
    """
    axes = [np.interp(np.arange(2 * len(a) - 1) / 2, np.arange(len(a)), a) for a in (z, x, y)]
    along, across, up = np.meshgrid(*axes, indexing="ij")
    number = np.arange(along.size).reshape(along.shape)
    starts = itertools.product(*(range(0, n - 1, 2) for n in number.shape))
    blocks = [number[k : k + 3, i : i + 3, j : j + 3] for k, i, j in starts]
    local = np.round(HEX20.nodes).astype(int) + 1
    elements = np.array([piece[tuple(local.T)] for piece in blocks])
    used, elements = np.unique(elements, return_inverse=True)
    points = np.stack([across, up, along], axis=-1).reshape(-1, 3)[used]
    elements = elements.reshape(len(blocks), -1)
    (top,) = np.nonzero(HEX20.nodes[:, 2] == 1)
    highest = np.isclose(points[elements[:, top], 1].min(axis=1), y[-1])
    outer = elements[highest][:, top]
    return Mesh(points, elements, np.zeros((0, 8), int), outer, HEX20, halved)
