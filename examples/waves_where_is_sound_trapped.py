"""
Where is sound trapped?
=======================

Mode (2,1) cuts on at 42.24 kHz in the round bore, just above the carrier. On both sides of a deep
press the lumen is wider, and the corresponding mode propagates at 38 kHz and above. Under the rod,
where the lumen is flat, it propagates only at 62 kHz and above. Sound in this mode is therefore
trapped in the wider section, between the rod and the round bore. It rings after the pulse and
causes the late echoes of deep presses.
"""

# %%
# Press, and the cut-ons of the section along the tube
# ----------------------------------------------------
import matplotlib.pyplot as plt
import numpy as np

import acoustube
from acoustube import pressed
from acoustube.lumen import lumen
from acoustube.waves import cut_cells, grid_spacing, section_cut_ons

config = acoustube.load_config(indenter_mm=10, depth_mm=6, mesh="coarse")
space = lumen(pressed(config, [6e-3]), position=0.2)
cells = cut_cells(space.surface, grid_spacing(7.9e-3, resolution=32), half=True)
z = cells.centres(2) - 0.2
layers = np.flatnonzero(np.abs(z) < 65e-3)[::2]
cut_ons = np.array([section_cut_ons(cells, k, 343.2, n_modes=3) for k in layers])

# %%
# The third mode symmetric about x = 0, which is (2,1) in the round bore
# ----------------------------------------------------------------------
z_mm, third_khz = 1e3 * z[layers], 1e-3 * cut_ons[:, 2]
under_the_rod = third_khz[np.argmin(np.abs(z_mm))]
lowest, place = third_khz.min(), abs(z_mm[np.argmin(third_khz)])
print(
    f"(2,1) cuts on at {third_khz[0]:.2f} kHz far away, {lowest:.2f} kHz {place:.0f} mm from the "
    f"rod, {under_the_rod:.1f} kHz under it"
)

# %%
# Where the carrier is above the cut-on
# -------------------------------------
figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
axes.plot(z_mm, 1e-3 * cut_ons[:, 1], label="second symmetric mode, (1,1) in the round bore")
axes.plot(z_mm, third_khz, label="third, (2,1) in the round bore")
axes.axhline(42, color="0.5", ls="--", label="carrier")
axes.fill_between(z_mm, third_khz, 42, where=third_khz < 42, alpha=0.3)
axes.set(xlabel="distance from the rod (mm)", ylabel="cut-on (kHz)", ylim=(20, 80))
axes.legend()
plt.show()
