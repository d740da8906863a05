"""
Physics: attenuation
====================

Sound in a straight tube is attenuated at the wall, by viscosity and heat conduction, and in the air
itself.
"""

# %%
import matplotlib.pyplot as plt
import numpy as np

from acoustube.air import air_at
from acoustube.waves import attenuation, axial_wavenumber, cut_on_frequency

AIR, DB = air_at(20.0), 20 / np.log(10)
frequency = np.linspace(3e3, 58e3, 300)
bores = np.linspace(3, 20, 60)

# %%
# By frequency in the default bore, and by bore
# ---------------------------------------------
# The attenuation of the plane mode is proportional to the root of the frequency and to the inverse
# of the bore. That of a higher mode is larger. It grows without bound towards the mode's cut-on,
# where its group velocity tends to zero.
losses = {}
for m, n in ((0, 0), (1, 1), (2, 1)):
    kz = axial_wavenumber(m, n, frequency, 3.95e-3, AIR)
    travels = frequency > 1.002 * cut_on_frequency(m, n, 3.95e-3, AIR.sound_speed)
    losses[m, n] = np.where(travels, -DB * kz.imag, np.nan)
by_bore = {
    f: np.array([DB * attenuation(0, 0, f, 0.5e-3 * b, AIR) for b in bores]) for f in (20e3, 42e3)
}
plane = DB * attenuation(0, 0, 42e3, 3.95e-3, AIR)
air_alone = float(DB * AIR.absorption(42e3))
print(f"plane mode at 42 kHz in 7.9 mm: {plane:.1f} dB/m, {air_alone:.1f} of it in the air")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for (m, n), loss in losses.items():
    left.plot(1e-3 * frequency, loss, label=f"({m},{n})")
left.plot(1e-3 * frequency, DB * AIR.absorption(frequency), "k:", label="air alone")
left.axvline(42, color="0.8", zorder=0)
left.set(xlabel="frequency (kHz)", ylabel="attenuation (dB/m)", ylim=(0, 60), title="bore 7.9 mm")
left.legend()
for f, loss in by_bore.items():
    right.plot(bores, loss, label=f"{1e-3 * f:.0f} kHz")
right.axvline(7.9, color="0.8", zorder=0)
right.set(xlabel="bore (mm)", ylabel="attenuation (dB/m)", title="plane mode")
right.legend()
plt.show()
