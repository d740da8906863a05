"""
Sleeve: length along the tube
=============================

The table that converts a distance along the tube to a position on the arm integrates the length of
the helix by the trapezoidal rule. It is compared with adaptive quadrature of the same density (tube
length per length of the arm), and on a cylinder with the hypotenuse of the unrolled tube.
"""

# %%
import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import quad

from acoustube.sleeve import Helix

SHAPES = {
    "slender cone": {"radius": 0.01, "taper": 0.5, "length": 0.25, "loops": 1},
    "forearm": {"radius": 0.0326, "taper": 0.057, "length": 0.25, "loops": 9},
}


def exact_length(shape):
    """Return the length in m by adaptive quadrature."""
    rho = 2 * np.pi * shape["loops"] / shape["length"]

    def density(z):
        return np.sqrt(
            1 + shape["taper"] ** 2 + (rho * (shape["radius"] + shape["taper"] * z)) ** 2
        )

    return quad(density, 0, shape["length"], epsabs=1e-13, epsrel=1e-13)[0]


# %%
# On a forearm the density is almost linear, and the length is within 3 um even with ten intervals.
# The default is two thousand.
intervals = np.array([10, 20, 40, 80, 160, 320, 640, 2000])
errors = {}
for name, shape in SHAPES.items():
    length = exact_length(shape)
    errors[name] = np.array(
        [abs(Helix(**shape, intervals=int(n)).table[1, -1] / length - 1) for n in intervals]
    )
order = float(np.log2(errors["slender cone"][0] / errors["slender cone"][3]) / 3)
usual = float(errors["forearm"][-1])
cylinder = Helix(radius=0.04, length=0.25, loops=9)
unrolled = float(np.hypot(0.25, 9 * 2 * np.pi * 0.04))
straight = float(abs(cylinder.table[1, -1] / unrolled - 1))
print(f"order {order:.2f}; forearm {usual:.0e}; cylinder {straight:.0e}")

# %%
figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
for name, error in errors.items():
    axes.loglog(intervals, np.maximum(error, 1e-17), "o-", label=name)
axes.loglog(
    intervals,
    errors["slender cone"][0] * (10 / intervals) ** 2.0,
    "k--",
    lw=1,
    label="second order",
)
axes.set(xlabel="intervals along the arm", ylabel="relative error of the length")
axes.legend()
plt.show()
