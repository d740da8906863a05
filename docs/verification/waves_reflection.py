"""
Waves: reflection of a pinched lumen
====================================

A bore is flattened by 30 % over 24 mm. Its reflection and transmission by the time-domain solver
(FDTD), from 8 to 58 kHz without losses, are compared with a spectral solution. A finite-element
solution of degree 5 confirms that solution within 3e-7 (`tests/data/scattering.csv`, lumen A).
"""

# %%
# The lumen
# ---------
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import trimesh

from acoustube.air import Air
from acoustube.lumen import ring_faces
from acoustube.waves import cut_cells, scatter

AIR, RADIUS, MIDDLE, RESOLUTION = Air(sound_speed=343.2, density=1.204), 3.95e-3, 0.02, 16


def lumen_a():
    """Return the bore, pinched in its middle in the shape of a raised cosine."""
    z = np.union1d([0, 2 * MIDDLE], MIDDLE + np.linspace(-12.5e-3, 12.5e-3, 167))
    angle = 2 * np.pi * np.arange(166) / 166
    zz, tt = np.meshgrid(z, angle, indexing="ij")
    inside = np.abs(zz - MIDDLE) < 12e-3
    pinch = 0.3 * np.where(inside, 0.5 + 0.5 * np.cos(np.pi * (zz - MIDDLE) / 12e-3), 0)
    x = RADIUS * np.cos(tt) * (1 + 0.45 * pinch)
    y = RADIUS * (np.sin(tt) + 1) * (1 - pinch) - RADIUS
    rings = np.stack([x, y, zz], axis=-1)
    return trimesh.Trimesh(rings.reshape(-1, 3), ring_faces(*rings.shape[:2]), process=False)


# %%
# Scatter, and compare
# --------------------
h = 2 * RADIUS / RESOLUTION
spacing = h, h, 2 * MIDDLE / np.ceil(2 * MIDDLE / h)
frequency = np.arange(8e3, 58.1e3, 200.0)
found = scatter(
    cut_cells(lumen_a(), spacing), AIR, frequency,
    reference=(MIDDLE, MIDDLE), lossy=False, symmetric_only=True,
)  # fmt: skip
path = Path("../../tests/data/scattering.csv")
table = np.genfromtxt(path, delimiter=",", names=True, dtype=None, skip_header=5, encoding="utf-8")
table = table[table["case"] == "A"]
reflection, transmission = found.s[:, 0, 0, 0, 0], found.s[:, 1, 0, 0, 0]
at = np.searchsorted(frequency, table["f_hz"])
error_r = np.abs(reflection[at] - (table["R_re"] + 1j * table["R_im"]))
error_t = np.abs(transmission[at] - (table["T_re"] + 1j * table["T_im"]))
print(
    f"at most {error_r.max():.4f} of R and {error_t.max():.4f} of T off, {RESOLUTION} cells across"
)

# %%
# The gaps are at the cut-ons of (1,1) and (2,1), where the reference has no values.
figure, (top, bottom) = plt.subplots(
    2, 1, figsize=(8, 5.5), sharex=True, height_ratios=(2, 1), layout="constrained"
)
khz = 1e-3 * table["f_hz"]
top.semilogy(1e-3 * frequency, np.abs(reflection), label=f"acoustube, {RESOLUTION} cells across")
top.semilogy(khz, np.hypot(table["R_re"], table["R_im"]), "k.", label="spectral solution")
top.set(ylabel="|R| of the plane wave", ylim=(3e-4, 0.3))
for mode in found.cut_ons[1:3]:
    top.axvline(1e-3 * mode, color="0.8", zorder=0)
top.legend()
bottom.semilogy(khz, error_r, ".", label="of R")
bottom.semilogy(khz, error_t, ".", label="of T")
bottom.set(xlabel="frequency (kHz)", ylabel="error")
bottom.legend()
plt.show()
