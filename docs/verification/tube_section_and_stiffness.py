"""
Tube: section of the mesh, and stiffness from hardness
======================================================

The mesh of the wall is a section of quadratic elements, swept along the tube. The area of the
section is compared with that of the ring, pi (B² - A²). The modulus that follows from the hardness
is compared with Gent's theory of a flat punch on an elastic half space.
"""

# %%
# The area of the section, from the volume of the elements
# --------------------------------------------------------
# Quadratic edges approximate a circle with an error of fourth order.
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

from acoustube.indentation.mesh import USUAL_MESH, sweep
from acoustube.tube import Tube, shear_modulus_from_shore

tube, reach = Tube(), 0.02
exact = np.pi / 4 * (tube.outer_diameter**2 - tube.inner_diameter**2)


def section_area(around):
    """Return the area in m2 of a tube meshed with this number of elements around half of it."""
    mesh = sweep(tube, reach, replace(USUAL_MESH, around=around))
    shape = mesh.reference
    slopes = np.einsum("qad,eax->eqxd", shape.slopes, mesh.points[mesh.elements])
    volume = np.sum(np.linalg.det(slopes) * shape.weights)
    return mesh.copies * volume / (2 * reach)


around = np.array([6, 8, 12, 16, 24, 32])
error = np.array([abs(section_area(n) / exact - 1) for n in around])
order = float(np.log2(error[0] / error[3]) / np.log2(around[3] / around[0]))
usual = float(abs(section_area(USUAL_MESH.around) / exact - 1))
print(f"order {order:.2f}; {usual:.1e} of the area with the usual {USUAL_MESH.around} elements")

# %%
# The modulus
# -----------
# Gent (1958, doi:10.5254/1.3542351) derived E = 0.0981 (56 + 7.62336 S) / (0.137505 (254 - 2.54 S))
# MPa from the durometer's geometry. acoustube uses the sleeve paper's fit to silicones.
hardness = np.linspace(15, 75, 61)
fitted = 3e-6 * shear_modulus_from_shore(hardness)
gent = 0.0981 * (56 + 7.62336 * hardness) / (0.137505 * (254 - 2.54 * hardness))
apart = float(np.interp(35, hardness, fitted / gent - 1))
print(f"at 35 Shore A {100 * apart:+.1f} % from Gent's modulus")

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
left.loglog(around, error, "o-", label="mesh")
left.loglog(around, error[0] * (around[0] / around) ** 4.0, "k--", lw=1, label="fourth order")
left.set(xlabel="elements around half the tube", ylabel="relative error of the wall's area")
left.legend()
right.semilogy(hardness, fitted, label="acoustube, $10^{0.0235 S - 0.64}$ MPa")
right.semilogy(hardness, gent, "k--", lw=1, label="Gent")
right.axvline(35, color="0.8")
right.set(xlabel="hardness (Shore A)", ylabel="Young's modulus (MPa)")
right.legend()
plt.show()
