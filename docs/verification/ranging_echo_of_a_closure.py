"""
Ranging: the echo of a closed tube
==================================

A rangefinder records a tube that is closed at one position after another. The attenuation over the
round trip is known in closed form where the boundary layers are thin compared with the bore
(Kirchhoff's wide tube).
"""

# %%
# Attenuation of the plane mode
# -----------------------------
# acoustube uses Zwikker and Kosten's solution, which holds for any bore. Kirchhoff's limit is
# alpha = sqrt(omega / 2) (sqrt(nu) + (gamma - 1) sqrt(nu_t)) / (R c).
import matplotlib.pyplot as plt
import numpy as np

from acoustube.air import air_at
from acoustube.ranging import IDEAL, blockage, response
from acoustube.waves import attenuation

AIR, RADIUS, CARRIER = air_at(20.0), 3.95e-3, 42e3
DB = 20 / np.log(10)


def kirchhoff(frequency, radius):
    """Return the attenuation of the wide tube in Np/m, with the air's own absorption."""
    layers = np.sqrt(AIR.viscous_diffusivity)
    layers += (AIR.heat_capacity_ratio - 1) * np.sqrt(AIR.thermal_diffusivity)
    wall = np.sqrt(np.pi * frequency) * layers / (radius * AIR.sound_speed)
    return wall + AIR.absorption(frequency)


frequency = np.geomspace(1e3, 60e3, 40)
bores = (4e-3, 7.9e-3, 20e-3)
exact = {b: np.array([attenuation(0, 0, f, b / 2, AIR) for f in frequency]) for b in bores}
at_carrier = attenuation(0, 0, CARRIER, RADIUS, AIR) / kirchhoff(CARRIER, RADIUS) - 1
print(f"at 42 kHz in 7.9 mm the two differ by {100 * at_carrier:+.2f} %")

# %%
# The echo's spectrum at the carrier, from closures every 20 cm
# -------------------------------------------------------------
# The sensor is ideal: it has no ring-down and no noise, and its face and the far end reflect
# nothing.
places = np.arange(0.3, 2.2, 0.2)
echoes = []
for place in places:
    time, closed = response([blockage(np.array([1e3, 1e5]), place)], IDEAL)
    _, untouched = response([], IDEAL)
    echo = closed - untouched
    echoes.append(np.abs(np.sum(echo * np.exp(-2j * np.pi * CARRIER * time))))
level = DB * np.log(np.array(echoes) / echoes[0])
expected = -DB * 2 * kirchhoff(CARRIER, RADIUS) * (places - places[0])
error = float(np.abs(level - expected).max())
print(f"over 1.8 m the echo falls by {-level[-1]:.1f} dB, within {error:.2f} dB of the law")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for b, colour in zip(bores, ("C2", "C0", "C1"), strict=True):
    left.loglog(1e-3 * frequency, DB * exact[b], color=colour, label=f"bore {1e3 * b:g} mm")
    left.loglog(1e-3 * frequency, DB * kirchhoff(frequency, b / 2), "k--", lw=1)
left.set(xlabel="frequency (kHz)", ylabel="attenuation (dB/m)")
left.legend(title="dashed: wide tube")
right.plot(1e2 * places, level, "o", label="recorded")
right.plot(1e2 * places, expected, "k--", lw=1, label="wide tube, there and back")
right.set(xlabel="position of the closure (cm)", ylabel="echo at 42 kHz (dB)")
right.legend()
plt.show()
