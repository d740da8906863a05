"""
Waves: cut-ons of the round bore
================================

A mode of a round bore cuts on where kR is a zero of the derivative of a Bessel function. On the
grid of cut cells the cut-on has a small error, which falls with the square of the cell size. On a
grid of whole cells the error falls slowly, if at all.
"""

# %%
# The five lowest modes, on grids that the bore's axis misses by a third of a cell
# --------------------------------------------------------------------------------
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import trimesh

from acoustube.air import air_at
from acoustube.waves import cut_cells, cut_on_frequency, section_cut_ons
from acoustube.waves.grid.small_cells import share_small_volumes

RADIUS, AIR = 3.95e-3, air_at(20.0)
MODES = [(1, 1), (1, 1), (2, 1), (2, 1), (0, 1)]
exact = np.array([cut_on_frequency(m, n, RADIUS, AIR.sound_speed) for m, n in MODES])


def slice_of_bore(resolution):
    """Return two layers of cells of the bore."""
    h = 2 * RADIUS / resolution
    # The cylinder is made at unit size and then scaled: facets of one thin in metres would be
    # dropped.
    bore = trimesh.creation.cylinder(1.0, 1.0, sections=512)
    bore.apply_translation([0, 0, 0.5])
    bore.apply_transform(np.diag([RADIUS, RADIUS, 1.5 * h, 1.0]))
    bore.apply_translation([0.31 * h, 0.07 * h, 0])
    return cut_cells(bore, h)


def whole_cells(cells):
    """Return the same section made of whole cells: those that are more than half full."""
    full = np.where(cells.volume_fraction > 0.5, 1.0, 0.0)
    open_x, open_y = np.zeros_like(cells.open_x), np.zeros_like(cells.open_y)
    open_x[1:-1], open_y[:, 1:-1] = full[1:] * full[:-1], full[:, 1:] * full[:, :-1]
    return replace(cells, volume_fraction=full, open_x=open_x, open_y=open_y)


def errors(cells):
    """Return the relative errors of the five cut-ons."""
    return np.abs(section_cut_ons(cells, 1, AIR.sound_speed, 6)[1:] / exact - 1)


resolutions = np.array([12, 16, 24, 32, 48, 64])
slices = [slice_of_bore(n) for n in resolutions]
cut = np.array([errors(share_small_volumes(cells)) for cells in slices])
whole = np.array([errors(whole_cells(cells)) for cells in slices])
order = float(np.log2(cut[1].max() / cut[-1].max()) / 2)
print(
    f"worst error at 32 cells: cut {100 * cut[3].max():.2f} %, whole {100 * whole[3].max():.1f} %"
)
print(f"order of the cut cells {order:.1f}")

# %%
figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
for column, label in ((0, "(1,1)"), (2, "(2,1)"), (4, "(0,1)")):
    axes.loglog(resolutions, 100 * cut[:, column], "o-", label=f"{label}, cut cells")
axes.loglog(resolutions, 100 * whole.max(axis=1), "s:", color="0.5", label="worst, whole cells")
axes.loglog(
    resolutions, 100 * cut[0].max() * (12 / resolutions) ** 2.0, "k--", lw=1, label="second order"
)
axes.set(xlabel="cells across the bore", ylabel="error of the cut-on (%)")
axes.set_xticks(resolutions, [str(n) for n in resolutions], minor=False)
axes.minorticks_off()
axes.legend()
plt.show()
