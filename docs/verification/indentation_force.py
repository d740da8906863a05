"""
Indentation: force and height under a rod
=========================================

The sleeve paper's tube under a 25 mm rod is computed on a coarse mesh, with one element through the
wall. Force and height of the lumen are compared with a solution of CalculiX with 1056 elements of
another kind (`tests/data/indentation_rod25.csv`).
"""

# %%
# Press, and read the reference
# -----------------------------
# Presses are cached: other pages that need this press do not compute it again.
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import acoustube
from acoustube import pressed
from acoustube.lumen import measure

DEPTHS = np.arange(1.0, 7.0)
config = acoustube.load_config(indenter_mm=25, depth_mm=6, support="free", mesh="coarse")
press = pressed(config, 1e-3 * DEPTHS)
rows = press.rows_at(1e-3 * DEPTHS)

path = Path("../../tests/data/indentation_rod25.csv")
reference = np.genfromtxt(path, delimiter=",", names=True, skip_header=6)
expected = np.interp(DEPTHS, reference["depth_mm"], reference["force_N"])
expected_height = np.interp(DEPTHS, reference["depth_mm"], reference["lumen_height_mm"])

# %%
# Compare
# -------
# A mesh with one element through the wall is slightly too stiff. With the three elements of the
# default mesh, the force is within 0.2 % of the limit of refined meshes up to 6 mm (see the page of
# the stage).
force = press.contact_force[rows]
height = np.array([1e3 * measure(press, row, np.zeros(1)).height[0] for row in rows])
force_error = force / expected - 1
height_error = height - expected_height
for depth, df, dh in zip(DEPTHS, force_error, height_error, strict=True):
    print(f"{depth:.0f} mm: force {100 * df:+.1f} %, height of the lumen {1e3 * dh:+.0f} um")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
left.plot(reference["depth_mm"], reference["force_N"], "k--", lw=1, label="CalculiX")
left.plot(1e3 * press.depth, press.contact_force, ".-", label="acoustube, coarse mesh")
left.set(xlabel="depth (mm)", ylabel="force (N)", xlim=(0, 6.2), ylim=(0, 4.5))
left.legend()
right.bar(DEPTHS, 1e3 * height_error, width=0.5)
right.axhline(0, color="0.5", lw=1)
right.set(xlabel="depth (mm)", ylabel="height of the lumen less the reference (µm)")
plt.show()
