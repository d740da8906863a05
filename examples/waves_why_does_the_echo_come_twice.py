"""
Why does the echo come twice?
=============================

A pressure-driven source end reflects a returning wave with inverted sign (R = -1). At a probe 2 cm
away the echo is therefore followed, 0.12 ms later, by its own negative. The pulse lasts 0.26 ms, so
the two overlap. Here the recording with a pressure-release end is reconstructed from that with an
absorbing end, by the plane wave's delay alone.
"""

# %%
# One press, both ends
# --------------------
import matplotlib.pyplot as plt
import numpy as np

import acoustube

config = acoustube.load_config(indenter_mm=25, depth_mm=5, mesh="coarse", resolution=16)
run = acoustube.simulate(config)

# %%
# Reconstruct one from the other
# ------------------------------
# The reconstruction is the echo with the absorbing end, minus the same echo delayed by one round
# trip from the probe to the end.
time, probe, speed = run["time"].values, float(run["probe_position"]), float(run["sound_speed"])
absorbing = run["pressure"].sel(source_end="absorbing").values
release = run["pressure"].sel(source_end="release").values
delay = 2 * probe / speed
rebuilt = absorbing - np.interp(time - delay, time, absorbing, left=0)

# Compare the echo only: the send pulse leaves the driven end without any reflection.
echo = time > float(run["send_time"][0]) + 1.2 * float(run["pulse_duration"]) + delay
mismatch = np.linalg.norm((rebuilt - release)[echo]) / np.linalg.norm(release[echo])
distances_cm = 100 * run["estimated_distance"].values
print(f"rebuilt within {100 * mismatch:.1f} %; distances {np.round(distances_cm, 2)} cm")

# %%
# Both recordings
# ---------------
figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
axes.plot(1e3 * time[echo], release[echo], label="pressure-release source end")
axes.plot(1e3 * time[echo], rebuilt[echo], "--", label="rebuilt from the absorbing end")
axes.set(xlabel="time (ms)", ylabel="pressure (share of the pulse)")
axes.legend()
plt.show()
