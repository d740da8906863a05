"""
Physics: modes of the bore
==========================

Sound propagates along a bore in modes, each above its own cut-on frequency. This page shows the
modes of the sleeve paper's bore on the grid of the time-domain solver (FDTD), and where the carrier
lies among their cut-ons.
"""

# %%
# The five lowest modes of a layer of cells
# -----------------------------------------
import matplotlib.pyplot as plt
import numpy as np
import trimesh

from acoustube.air import air_at
from acoustube.waves import Pulse, cut_cells, cut_on_frequency
from acoustube.waves.modes.grid_modes import duct_modes, labels
from acoustube.waves.scheme.problem import prepare

RADIUS, AIR = 3.95e-3, air_at(20.0)
h = 2 * RADIUS / 40
bore = trimesh.creation.cylinder(1.0, 1.0, sections=256)
bore.apply_translation([0, 0, 0.5])
bore.apply_transform(np.diag([RADIUS, RADIUS, 8e-3, 1.0]))
setup = prepare(cut_cells(bore, h), AIR, probes=(4e-3,), source_end="rigid", far_end="rigid")
volume = setup.cells.volume_fraction
modes = duct_modes(setup.scheme, volume, 10, 56e3, whole=True)
names = labels(modes, RADIUS, AIR.sound_speed)
cut_ons = dict(zip(names, 1e-3 * modes.cut_ons, strict=True))
print({name: f"{cut_on:.2f} kHz" for name, cut_on in cut_ons.items()})

# %%
figure, axes = plt.subplots(1, len(names), figsize=(2 * len(names), 2.6), layout="constrained")
inside = volume[:, :, 10].T > 0
half = 1e3 * h * np.array(inside.shape) / 2
for name, shape, panel in zip(names, modes.shapes, axes, strict=True):
    picture = np.where(inside, shape.T, np.nan)
    limit = np.nanmax(np.abs(picture))
    panel.imshow(
        picture, cmap="RdBu_r", vmin=-limit, vmax=limit, origin="lower",
        extent=(-half[1], half[1], -half[0], half[0]),
    )  # fmt: skip
    where = "all frequencies" if name == "00" else f"from {cut_ons[name]:.1f} kHz"
    panel.set_title(f"({name[0]},{name[1]}){name[2:]}\n{where}", fontsize=10)
    panel.set_axis_off()
plt.show()

# %%
# Why the carrier sits at a cut-on
# --------------------------------
# Cut-ons are proportional to the speed of sound, which depends on the temperature. The cut-on of
# (2,1) equals the carrier of 42 kHz at 16.7 degC. It lies in the pulse's band at all temperatures
# of a room.
temperature = np.linspace(0, 40, 81)
speed = np.array([air_at(t).sound_speed for t in temperature])
band = 1e-3 * np.array(Pulse(frequency=42e3).band())
crossing = float(np.interp(42e3, [cut_on_frequency(2, 1, RADIUS, c) for c in speed], temperature))
print(
    f"(2,1) cuts on at 42 kHz in air of {crossing:.1f} degC; band of the pulse: {band.round(1)} kHz"
)

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
axes.axhspan(*band, color="0.92", label="band of the pulse, to -20 dB")
axes.axhline(42, color="0.5", ls="--", label="carrier")
for m, n in ((1, 1), (2, 1), (0, 1)):
    line = [1e-3 * cut_on_frequency(m, n, RADIUS, c) for c in speed]
    axes.plot(temperature, line, label=f"cut-on of ({m},{n})")
axes.set(xlabel="temperature of the air (°C)", ylabel="frequency (kHz)", ylim=(14, 58))
axes.legend(loc="lower center", ncols=2)
plt.show()
