"""
Where did the recording echo?
=============================

The processing is the same for simulated and recorded signals. Here it is applied to a synthetic
recording with noise, of 200 kHz and 12 bit. The recording contains a send pulse and one echo from
75 cm, attenuated to 5 % by a lossy tube.
"""

# %%
# A recording
# -----------
import matplotlib.pyplot as plt
import numpy as np

from acoustube import signals
from acoustube.air import sound_speed
from acoustube.waves import Pulse

TEMPERATURE, DISTANCE = 24.0, 0.75
pulse = Pulse(frequency=42e3, cycles=11)
time = np.arange(1600) / 200e3
delay = 2 * DISTANCE / sound_speed(TEMPERATURE)
noise = 0.002 * np.random.default_rng(1).standard_normal(time.size)
recording = np.round(2047 * (pulse(time) + 0.05 * pulse(time - delay) + noise)).astype(int)

# %%
# Process it
# ----------
ranging = signals.process(
    time, recording, pulse_duration=pulse.duration, temperature=TEMPERATURE, nearest=0.15
)
error = float(ranging.distance) - DISTANCE
print(f"{100 * float(ranging.distance):.2f} cm, error {1e3 * error:+.2f} mm")

# %%
# The recording, its envelope and the echo
# ----------------------------------------
figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
axes.plot(1e3 * time, recording / float(ranging.send_amplitude), lw=0.5, color="0.7")
axes.plot(1e3 * time, ranging.envelope)
axes.plot(1e3 * float(ranging.return_time), float(ranging.amplitude), "o")
axes.set(xlabel="time (ms)", ylabel="fraction of the send pulse", ylim=(-0.12, 0.12))
plt.show()
