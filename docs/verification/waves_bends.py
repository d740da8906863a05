"""
Waves: a sharp bend
===================

A bend of 90 degrees has a radius of 10 mm, two and a half bore radii. Its scattering by the
multimodal method is compared with finite elements in three dimensions (`tests/data/bend.csv`). The
two methods have only the modes of the ends in common.
"""

# %%
import csv
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from acoustube.air import air_at
from acoustube.waves import bend

AIR, RADIUS, BEND = air_at(20.0), 3.95e-3, 0.01
path = Path("../../tests/data/bend.csv")
with path.open() as file:
    rows = list(csv.DictReader(file))

# %%
# The reference is for 343.2 m/s. In any lossless air sound of the same wavelength scatters alike,
# so the frequencies are scaled by the speed of sound.
ratio = AIR.sound_speed / 343.2
frequency = np.linspace(8e3, 50e3, 211)
settings = {
    "radius": RADIUS,
    "bend_radius": BEND,
    "angle": np.pi / 2,
    "lossy": False,
    "highest": 14,
}
found = bend(AIR, ratio * frequency, **settings)
known = np.unique([float(row["frequency_hz"]) for row in rows])
there = bend(AIR, ratio * known, **settings)

error = 0.0
figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for port, (name, letter) in enumerate((("reflected", "r"), ("passed on", "t"))):
    for mode, colour in (("00", "C0"), ("11c", "C1"), ("21c", "C2")):
        k = found.modes.index(mode)
        size = np.where(found.propagates[:, k], np.abs(found.s[:, port, k, 0, 0]), np.nan)
        axes[port].plot(1e-3 * frequency, size, color=colour, label=f"({mode[0]},{mode[1]})")
        for row in (row for row in rows if row["mode"] == mode):
            f = float(row["frequency_hz"])
            expected = abs(float(row[f"{letter}_real"]) + 1j * float(row[f"{letter}_imag"]))
            computed = abs(there.s[np.searchsorted(known, f), port, k, 0, 0])
            error = max(error, float(abs(computed - expected)))
            axes[port].plot(1e-3 * f, expected, "ko", ms=4)
    axes[port].set(xlabel="frequency (kHz)", ylabel=f"amplitude {name}")
axes[0].legend(title="dots: finite elements")
print(f"amplitudes differ by {error:.1e} at most")
plt.show()
