"""Write `forearm_markers.csv`: two columns of markers on a forearm, as motion capture records them.

The forearm is 25 cm long, 17 cm around at the wrist and 26 cm around at the elbow. It is rotated
relative to the axes of the room. Each of its two sides has eight markers, with errors of half a
millimetre in each coordinate. One marker has slipped by 3 cm and one was not recorded. The script
can be run from anywhere; it writes the table to its own folder.
"""

# %%
import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

random = np.random.default_rng(8)
height = np.linspace(0.0, 250.0, 8)
radius = np.interp(height, [0, 250], [170, 260]) / (2 * np.pi) + 5.55
around = Rotation.from_euler("xyz", [70, 15, 30], degrees=True)
origin, rows = np.array([412.0, -180.0, 930.0]), []
for column, side in (("A", 1), ("B", -1)):
    arm = np.stack([side * radius, 0 * height, height], axis=1)
    places = origin + around.apply(arm + random.normal(0, 0.5, arm.shape))
    if column == "A":
        places[4] += around.apply([0.0, 30.0, 0.0])
    for number, place in enumerate(places, start=1):
        unseen = column == "B" and number == 6
        cells = ["", "", ""] if unseen else [f"{value:.2f}" for value in place]
        rows.append([column, f"{column}{number}", *cells])

# %%
path = Path(__file__).with_suffix(".csv")
with path.open("w", newline="", encoding="utf-8") as file:
    table = csv.writer(file)
    table.writerow(["column", "marker", "x_mm", "y_mm", "z_mm"])
    table.writerows(rows)
