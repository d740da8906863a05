"""
What does a sensor record?
==========================

A rangefinder filters the echo by its own resonance, adds noise, and quantises it. Here a recording
of a press is simulated, written to a file like that of a real sensor, read back and processed. The
result is compared with the same cycle of an ideal rangefinder.
"""

# %%
# A press
# -------
# The scattering matrix of the press is computed once, and placed 40 cm into a tube of 1.2 m. The
# band covers the spectrum of the rangefinder's burst of 42 kHz.
import dataclasses
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import acoustube
from acoustube import pressed, ranging, recordings, signals
from acoustube.air import air_at
from acoustube.lumen import pressed_part
from acoustube.runs.sound import scattering_of
from acoustube.waves import PlacedScatterer

TRUE_DISTANCE, LENGTH, BORE = 0.4, 1.2, 7.9e-3
config = acoustube.load_config(indenter_mm=10, depth_mm=5, mesh="coarse")
part = pressed_part(pressed(config, [5e-3]))
matrix, *_ = scattering_of(
    part, air_at(20.0), (27e3, 57e3), method="scattering", bore=BORE, resolution=11, lossy=True
)
press = PlacedScatterer(matrix, TRUE_DISTANCE)

# %%
# The recording, and the clean cycle
# ----------------------------------
# ``rangefinder.to_json()`` lists the parameters of a rangefinder; each effect can be switched off.
# Fifty cycles are written to a file with the metadata that a sensor's software records: the
# sampling rate, the temperature that the board reports, and the true distance as a label.
rangefinder = ranging.Rangefinder()
clean = dataclasses.replace(
    rangefinder, noise=0.0, clutter=0.0, drift=0.0, bits=16, temperature_bias=0.0
)
tube = {"radius": BORE / 2, "length": LENGTH, "temperature": 20.0}
noisy = ranging.record([press], rangefinder, n_cycles=50, seed=1, **tube)
ideal = ranging.record([press], clean, **tube)

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "press.npz"
    np.savez(
        path,
        signal=noisy["signal"].values,
        sampling_rate=rangefinder.sampling_rate,
        temperature=noisy["temperature"].values,
        true_distance=np.full(50, TRUE_DISTANCE),
    )
    recording = recordings.read(path).load()
print(recording)

# %%
# The same processing
# -------------------
# ``acoustube process press.npz`` processes every cycle of a file in the same way.
how = signals.Processing(prominence=0.002)
time = recording["time"].values
located = signals.locate(
    time, recording["signal"].values, how, temperature=recording["temperature"].values
)
simulated = signals.locate(time, ideal["signal"].values[0], how, temperature=20.0)
spread = float(np.std(located.distance))
difference = float(np.median(located.distance) - simulated.distance)
print(f"recording: {100 * np.median(located.distance):.2f} cm, +- {1e3 * spread:.2f} mm from noise")
print(f"simulated without noise: {100 * float(simulated.distance):.2f} cm")

# %%
# Both distances are 4 cm too large, because their common offset is not calibrated: the send pulse
# overdrives the ADC, which shifts the pulse's apparent middle. ``acoustube calibrate`` corrects
# this offset. The contributions of noise, quantisation and the tube's irregularities are small
# here.
place = 100 * signals.distance(time - np.median(located.send_time), 20.0)
seen = (place > 25) & (place < 110)
figure, (above, below) = plt.subplots(2, 1, figsize=(8, 6), layout="constrained")
counts = recording["signal"].values[0]
above.plot(1e3 * time, counts, lw=0.6)
above.set(xlabel="time (ms)", ylabel="counts", xlim=(0, 8), title="one cycle of the recording")
below.plot(place[seen], 100 * located.envelope[:, seen].T, color="0.8", lw=0.5)
below.plot(place[seen], 100 * located.envelope[0, seen], color="C0", label="recording")
below.plot(place[seen], 100 * simulated.envelope[seen], "--", color="C1", label="without noise")
below.axvline(100 * TRUE_DISTANCE, color="0.5", ls=":", label="the press")
below.set(xlabel="distance (cm)", ylabel="envelope (% of the send pulse)")
below.legend()
plt.show()
