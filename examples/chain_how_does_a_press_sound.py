"""
How does a press sound?
=======================

A rod presses a soft tube. A pulse of ultrasound is launched into the tube, and is reflected where
the lumen narrows. One call computes the whole chain: the deformed silicone, the air inside it, the
sound field, and the distance estimated from the echo.
"""

# %%
# Press and sound field
# ---------------------
# The default settings are those of the sleeve paper: a tube of 40 cm with a bore of 7.9 mm, pressed
# in its middle. The finite elements and the grid are coarser than usual, to save time. The source
# end absorbs the returning wave, so that there is only one echo.
import matplotlib.pyplot as plt
import numpy as np
import pyvista

import acoustube
from acoustube.reports.scenes.tube import half_walls

config = acoustube.load_config(
    indenter_mm=10, depth_mm=5, mesh="coarse", resolution=12, source_end="absorbing"
)
run = acoustube.simulate(config)
force = float(run["contact_force"][-1])
distance, truth = float(run["distance"]), float(run["true_distance"])
print(f"{force:.2f} N press the lumen to {1e3 * float(run['lumen_height'][-1]):.2f} mm")
print(f"estimated from the echo: {100 * distance:.1f} cm, the press is at {100 * truth:.1f} cm")

# %%
# The tube
# --------
# ``half_walls`` returns the deformed tube, cut open along its length. The rod is drawn above it.
plotter = pyvista.Plotter(window_size=(1200, 560))
for part, colour in (("outer", "tan"), ("inner", "steelblue"), ("cut", "wheat")):
    points, faces = half_walls(run)[part]
    plotter.add_mesh(
        pyvista.PolyData.from_regular_faces(1e3 * points, faces),
        color=colour, smooth_shading=part != "cut",
    )  # fmt: skip
wall = 1e3 * run["outer_wall"].values
middle = wall[np.argmin(np.abs(wall[:, 0, 2] - 1e3 * truth))]
top = middle[len(middle) // 2, 1]  # rings begin at the bottom
plotter.add_mesh(
    pyvista.Cylinder(
        center=(-7, top + 5, 1e3 * truth), direction=(1, 0, 0), radius=5, height=14,
        resolution=80,
    ),
    color="silver", smooth_shading=True, split_sharp_edges=True,
)  # fmt: skip
plotter.camera_position = [(75, 28, 1e3 * truth - 38), (0, 1, 1e3 * truth), (0, 1, 0)]
plotter.show()

# %%
# The echo
# --------
# The send pulse passes the probe, 2 cm into the tube, at full height. The echo is 2 % of the pulse,
# so the lower panel enlarges the vertical axis 20 times. Later peaks are sound that was trapped
# near the rod.
time = 1e3 * run["time"].values
recorded = run.sel(source_end="absorbing")
figure, panels = plt.subplots(2, 1, figsize=(8, 5), sharex=True, layout="constrained")
for axes, limit in zip(panels, (1.05, 0.05), strict=True):
    axes.plot(time, recorded["pressure"], color="0.7", lw=0.7, label="pressure")
    axes.plot(time, recorded["envelope"], label="envelope")
    axes.set(ylim=(-limit, limit), ylabel="fraction of the send pulse")
panels[1].plot(
    1e3 * recorded["return_time"],
    recorded["echo_amplitude"],
    "o",
    label=f"echo: {100 * distance:.1f} cm",
)
panels[1].set_xlabel("time (ms)")
panels[1].legend(loc="upper right")
plt.show()
