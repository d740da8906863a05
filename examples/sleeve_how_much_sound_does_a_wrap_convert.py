"""
How much sound does a wrap convert?
===================================

A plane wave enters a tube that is wrapped around an arm. The curvature couples it to mode (1,1),
which propagates at 42 kHz. The two exchange power, with a beat length of a few centimetres.
"""

# %%
# The wrap
# --------
# The tube has the sleeve paper's bore and is wound around a radius of 4 cm with a pitch of 3.5 cm.
import matplotlib.pyplot as plt
import numpy as np

from acoustube.air import air_at
from acoustube.sleeve import Helix
from acoustube.waves import bend

air, bore = air_at(20.0), 3.95e-3
helix = Helix(radius=0.04, length=0.035, loops=1)
curvature, torsion = (float(value) for value in helix.bend(0.0))
loop = helix.tube_length
frequency = 1e3 * np.array([20.0, 25.6, 30.0, 42.0])

# %%
# Power in each mode after every few millimetres of one loop
# ----------------------------------------------------------
along = np.linspace(0.01, 1, 100) * loop
power = np.array(
    [
        np.abs(
            bend(
                air, frequency, radius=bore, bend_radius=1 / curvature, torsion=torsion,
                angle=curvature * length, lossy=False, modes=("00", "11c", "11s"), highest=8.0,
            ).s[:, :, :, 0, 0]
        )
        ** 2
        for length in along
    ]
)  # fmt: skip
onward, converted = power[:, :, 1, 0], power[:, :, 1, 1:].sum(axis=-1)
most = dict(zip(1e-3 * frequency, converted.max(axis=0), strict=True))
reflected_db = dict(
    zip(1e-3 * frequency, 10 * np.log10(power[:, :, 0, 0].max(axis=0)), strict=True)
)
peaks = along[1:-1][
    (converted[1:-1, 3] > converted[2:, 3]) & (converted[1:-1, 3] > converted[:-2, 3])
]
beat = float(np.mean(np.diff(peaks)))
print(f"bend radius {100 / curvature:.2f} cm, torsion {torsion:.2f} 1/m, loop {100 * loop:.1f} cm")
for i, khz in enumerate(most):
    print(
        f"{khz:g} kHz: at most {100 * most[khz]:.2f} % in (1,1), {100 * converted[-1, i]:.2f} % "
        f"after a loop; at most {reflected_db[khz]:.0f} dB of the power come back"
    )
print(f"beat at 42 kHz: {100 * beat:.1f} cm")

# %%
# The beat
# --------
figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
for i, khz in enumerate(most):
    axes.plot(100 * along, 100 * converted[:, i], label=f"{khz:g} kHz")
axes.set(
    xlabel="along the tube (cm)", ylabel="power in (1,1) (%)", ylim=(0, 22),
    xlim=(0, 100 * loop), title="A plane wave enters a wrapped tube",
)  # fmt: skip
axes.legend(loc="upper center", ncols=4)
plt.show()
