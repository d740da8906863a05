"""
Lumen: area along the tube
==========================

The area of the lumen's cross-sections is measured in planes that cut the deformed wall, at a depth
of 4 mm under a 25 mm rod. It is compared with an independent solution
(`tests/data/indentation_rod25_area_at_4mm.csv`, in which two codes agree within 0.013 mm²).
"""

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import acoustube
from acoustube import pressed
from acoustube.lumen import measure

config = acoustube.load_config(indenter_mm=25, depth_mm=6, support="free", mesh="coarse")
depths = 1e-3 * np.arange(1.0, 7.0)
press = pressed(config, depths)
increment = press.rows_at(depths)[3]

path = Path("../../tests/data/indentation_rod25_area_at_4mm.csv")
reference = np.genfromtxt(path, delimiter=",", names=True, skip_header=3)

# %%
# The planes are perpendicular to the axis of the undeformed tube. Far from the rod the tube tilts
# off the floor, so that the planes cut it obliquely, in the reference too.
z = 1e-3 * reference["z_mm"]
area = 1e6 * measure(press, increment, z).area
error = area - reference["area_mm2"]
worst = float(np.abs(error).max())
print(f"at most {worst:.2f} mm2 off, {100 * worst / 49.02:.2f} % of the bore")

# %%
figure, (top, bottom) = plt.subplots(
    2, 1, figsize=(8, 5), sharex=True, height_ratios=(2, 1), layout="constrained"
)
top.plot(reference["z_mm"], reference["area_mm2"], "k--", lw=1, label="reference")
top.plot(reference["z_mm"], area, label="acoustube, coarse mesh")
top.set(ylabel="area (mm²)")
top.legend()
bottom.plot(reference["z_mm"], error)
bottom.axhline(0, color="0.5", lw=1)
bottom.set(xlabel="distance from the middle of the press (mm)", ylabel="difference (mm²)")
plt.show()
