"""
Physics: what a press does to the lumen and to its modes
========================================================

A 25 mm rod presses the default tube, computed on a coarse mesh. The figures show the section under
the rod, and the cut-on frequencies above which the modes of that section propagate.
"""

# %%
import matplotlib.pyplot as plt
import numpy as np

import acoustube
from acoustube import pressed
from acoustube.lumen import pressed_part
from acoustube.waves import cut_cells, section_cut_ons

config = acoustube.load_config(indenter_mm=25, depth_mm=6, support="free", mesh="coarse")
DEPTHS = np.arange(1.0, 7.0)
press = pressed(config, 1e-3 * DEPTHS)
parts = [pressed_part(press, row) for row in (0, *press.rows_at(1e-3 * DEPTHS))]
depths = np.concatenate([[0], DEPTHS])

# %%
# The modes symmetric about the vertical plane, in the middle of the press
# ------------------------------------------------------------------------
# The press lowers the lumen and widens it. The lowest mode of the round bore, whose pressure varies
# vertically, cuts on at higher and higher frequencies. The next mode, (2,1), whose pressure varies
# horizontally, cuts on at lower frequencies. Near 3 mm the two curves change places: the lowest is
# then the horizontal mode and the second the vertical one. The cut-on of the vertical mode is above
# the carrier at depths of 3.4 mm and more.
SPEED = 343.2
cut_ons = []
for part in parts:
    cells = cut_cells(part.surface, 7.9e-3 / 24, half=True)
    layer = np.argmin(np.abs(cells.centres(2) - part.position))
    cut_ons.append(section_cut_ons(cells, layer, SPEED, 4)[1:])
cut_ons = 1e-3 * np.array(cut_ons)
deep = depths >= 3
blocked = float(np.interp(42, cut_ons[deep, 1], depths[deep]))
print(f"the upright mode does not pass the rod at 42 kHz from a depth of {blocked:.1f} mm on")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for depth, part in zip(depths, parts, strict=True):
    if depth in (0, 2, 4, 6):
        rings = part.rings
        ring = 1e3 * rings[np.argmin(np.abs(rings[:, :, 2].mean(axis=1) - part.position))]
        closed = np.vstack([ring, ring[:1]])
        left.plot(closed[:, 0], closed[:, 1], label=f"{depth:.0f} mm")
left.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
left.legend(title="depth", loc="upper right")
for column, label in enumerate(
    ("lowest, (1,1) if round", "second, (2,1) if round", "third, (0,1) if round")
):
    right.plot(depths, cut_ons[:, column], "o-", label=label)
right.axhline(42, color="0.5", ls="--", label="carrier")
right.set(xlabel="depth (mm)", ylabel="cut-on under the rod (kHz)", ylim=(20, 80))
right.legend()
plt.show()
