"""
Will it fit my arm?
===================

Two tubes are wound around a forearm of given length and girths. How long must the tubes be, how
much skin do they cover, and where on the arm is a press at a distance of 1.1 m along the tube?
"""

# %%
# From the dimensions of an arm to tubes
# --------------------------------------
# The sleeve is 25 cm long, 17 cm around at the wrist and 26 cm around below the elbow; lengths in
# the code are in m. The first 15 cm of each tube lead to its sensor.
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from acoustube.reports.scenes.sleeve import Picture, draw
from acoustube.reports.sleeve_table import in_words
from acoustube.sleeve import design, layout

LENGTH, GIRTHS = 0.25, (0.17, 0.26)
tubes = design(LENGTH, GIRTHS, pitch=0.05, n_tubes=2)
found = layout(tubes)
print("\n".join(in_words(tubes, found)))

# %%
# A press at 1.1 m
# ----------------
# An estimated distance has a standard deviation of about 5 cm along the tube. A loop on this arm is
# longer than that. The estimated position is therefore a patch, not a ring around the arm.
DISTANCE = 1.1
x, y, z = tubes[0].place(DISTANCE)
angle = np.degrees(np.arctan2(y, x)) % 360
print(f"{100 * DISTANCE:g} cm: {100 * z:.1f} cm along the arm, {angle:.0f} degrees around it")

# %%
# In three dimensions
# -------------------
# This is the picture of ``acoustube sleeve``. Tubes are coloured within their range and grey
# outside of it. The press is red, with the uncertainty of its position.
picture = Picture(
    tubes=tuple(tubes), detection_range=found.detection_range, outer_diameter=11.1e-3,
    contacts=((0, DISTANCE),),
    deviation=found.deviation, markers=np.empty((0, 3)),
)  # fmt: skip
with tempfile.TemporaryDirectory() as folder:
    draw(picture, Path(folder) / "sleeve.png")
    image = plt.imread(Path(folder) / "sleeve.png")
figure, axes = plt.subplots(figsize=(9, 5), layout="constrained")
axes.imshow(image)
axes.set_axis_off()
plt.show()
