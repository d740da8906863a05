"""
Physics: modes of the echo
==========================

A plane wave is incident on a press. The reflected wave is partly a plane wave and partly other
modes, which a piston transducer does not receive.
"""

# %%
import matplotlib.pyplot as plt
import numpy as np

import acoustube
from acoustube import pressed
from acoustube.air import air_at
from acoustube.lumen import pressed_part
from acoustube.runs.sound import scattering_of

config = acoustube.load_config(indenter_mm=25, depth_mm=6, support="free", mesh="coarse")
depths = 1e-3 * np.arange(1.0, 7.0)
press = pressed(config, depths)
part = pressed_part(press, press.rows_at(depths)[4])

# %%
# The scattering of a press of 5 mm, on a coarse grid
# ---------------------------------------------------
# Without losses the reflected and transmitted powers of all modes add up to one.
matrix, *_ = scattering_of(
    part, air_at(20.0), (20e3, 55e3), method="scattering", bore=7.9e-3, resolution=12, lossy=False
)
settled = matrix.settled[:, :, :, 0, 0].all(axis=(1, 2))
reflected = np.abs(matrix.s[:, 0, :, 0, 0]) ** 2
passed_on = np.abs(matrix.s[:, 1, :, 0, 0]) ** 2
balance = float(np.abs((reflected + passed_on).sum(axis=1)[settled] - 1).max())
band = settled & (np.abs(matrix.frequency - 42e3) < 2.5e3)
in_plane = float(reflected[band, 0].mean() / reflected[band].sum(axis=1).mean())
print(f"the powers add up to one within {balance:.4f}")
print(f"from 39.5 to 44.5 kHz {100 * in_plane:.0f} % of the reflected power is in the plane wave")

# %%
figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
for k, name in enumerate(matrix.modes[:3]):
    power = np.where(matrix.propagates[:, k], reflected[:, k], np.nan)
    axes.semilogy(1e-3 * matrix.frequency, 100 * power, label=f"({name[0]},{name[1]})")
axes.axvline(42, color="0.8", zorder=0)
axes.set(xlabel="frequency (kHz)", ylabel="power sent back (%)", ylim=(1e-3, 30))
axes.legend(title="as mode")
plt.show()
