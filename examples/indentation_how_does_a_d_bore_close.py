"""
How does a D-shaped bore close?
===============================

A tube need not be round. Here a tube whose bore is flat at the bottom is read from an STL file, as
the surface of its wall. It is compared with the sleeve paper's round tube of the same outer
diameter.
"""

# %%
# Press both
# ----------
# The D-shaped wall is meshed with tetrahedra, the round wall with hexahedra. Both meshes are
# coarse, to save time.
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pyvista

from acoustube.indentation import Indenter, MeshSize, indent
from acoustube.indentation.tetrahedra import TetrahedronSize, tetrahedral_mesh
from acoustube.indentation.wall_surface import tube_of
from acoustube.lumen import measure
from acoustube.reports.export import vtu
from acoustube.runs.imported_wall import read_surface
from acoustube.tube import Tube

DEPTH, REACH = 2e-3, 0.03
rod, round_tube = Indenter(diameter=10e-3), Tube()
checkout = Path(sys.argv[0]).resolve().parents[1]  # the checkout that this script is in
surface = read_surface(checkout / "meshes" / "d_bore.stl")
d_tube = tube_of(
    surface, shear_modulus=round_tube.shear_modulus, poisson_ratio=round_tube.poisson_ratio
)
tetrahedra = tetrahedral_mesh(
    surface, reach=REACH, halved=rod.halves, size=TetrahedronSize(fine=1.3, coarse=3.0)
)
hexahedra = MeshSize(through_wall=1, around=12, along=10)
presses = {
    "D-shaped": indent(d_tube, rod, depth=DEPTH, mesh=tetrahedra),
    "round": indent(round_tube, rod, depth=DEPTH, mesh=hexahedra),
}

# %%
# Remaining lumen area
# --------------------
# The D-shaped lumen is smaller and lower, with a thick wall below it. The same depth therefore
# closes more of it.
areas = {
    name: np.array([measure(press, i, np.zeros(1)).area[0] for i in range(len(press.depth))])
    for name, press in presses.items()
}
for name, press in presses.items():
    left = areas[name][-1] / areas[name][0]
    print(
        f"{name}: {1e6 * areas[name][0]:.1f} mm2, of which {100 * left:.0f} % are left at "
        f"{1e3 * DEPTH:g} mm, under {press.contact_force[-1]:.2f} N"
    )

# %%
# In three dimensions
# -------------------
# Wall and rod are symmetric, so only a quarter of the tube is computed. It is written as a VTU
# file, as for ParaView, and read by PyVista. It is reflected once, so that the tube is drawn cut
# open. Colours show the displacement of the silicone.
d_press = presses["D-shaped"]
with tempfile.TemporaryDirectory() as folder:
    vtu.write(d_press.mesh, d_press.depth[-1:], d_press.displacement[-1:], Path(folder))
    quarter = pyvista.read(Path(folder) / "press-0001.vtu")
quarter["moved (mm)"] = 1e3 * np.linalg.norm(quarter["displacement"], axis=1)
pressed = quarter.warp_by_vector("displacement").scale(1e3)
plotter = pyvista.Plotter(window_size=(1200, 560))
for part in (pressed, pressed.reflect((0, 0, 1))):
    plotter.add_mesh(part, scalars="moved (mm)", cmap="YlOrRd", ambient=0.3, show_scalar_bar=False)
plotter.add_scalar_bar("moved (mm)", n_labels=4, fmt="%.1f", position_x=0.3, width=0.4)
plotter.camera_position = [(-56, 25, 35), (0, -2, 0), (0, 1, 0)]
plotter.show()

# %%
# Force and area against depth
# ----------------------------
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
for name, press in presses.items():
    left.plot(1e3 * press.depth, press.contact_force, "o-", ms=3, label=name)
    right.plot(1e3 * press.depth, 100 * areas[name] / areas[name][0], "o-", ms=3, label=name)
left.set(xlabel="depth (mm)", ylabel="force (N)")
right.set(xlabel="depth (mm)", ylabel="lumen under the rod (%)", ylim=(0, 105))
left.legend(title="bore")
plt.show()
