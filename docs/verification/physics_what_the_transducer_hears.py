"""
Physics: the recorded signal
============================

The default rangefinder records cycles on 2.5 m of the sleeve paper's tube. A cycle begins with the
ring-down of the transducer. Reflections of weak irregularities all along the tube follow, with the
echo of a closure among them.
"""

# %%
import matplotlib.pyplot as plt
import numpy as np

from acoustube import signals
from acoustube.ranging import Rangefinder, blockage, response

BAND = np.array([1e3, 1e5])
places = (None, 0.3, 1.0, 2.0)
sensor = Rangefinder()
heard = {
    place: response([] if place is None else [blockage(BAND, place)], sensor) for place in places
}
time = heard[None][0]

# %%
# The dead zone: how long the transducer rings
# --------------------------------------------
# The resonator's amplitude falls by a factor of e every Q / (pi f) seconds. The echo of a closure
# is detected once it exceeds the ringing.
envelopes = {
    place: signals.envelope(voltage, sensor.sampling_rate) for place, (_, voltage) in heard.items()
}
near = np.arange(0.06, 0.3, 0.01)
own = envelopes[None]
stands_out = []
for place in near:
    _, voltage = response([blockage(BAND, place)], sensor)
    arrival = 2 * place / float(signals.speed_of_sound(20.0)) + sensor.drive.duration
    at = np.argmin(np.abs(time - arrival))
    echo = signals.envelope(voltage, sensor.sampling_rate)[at : at + 40].max()
    stands_out.append(echo > 2 * own[at : at + 40].max())
dead_zone = float(near[np.argmax(stands_out)])
ring = sensor.quality_factor / (np.pi * sensor.resonance)
print(f"ring-down: a factor of e every {1e6 * ring:.0f} us")
print(f"closures stand out from {1e2 * dead_zone:.0f} cm on")

# %%
figure, axes = plt.subplots(figsize=(9, 4.5), layout="constrained")
for place in reversed(places):
    label = "untouched" if place is None else f"closed at {100 * place:.0f} cm"
    axes.semilogy(1e3 * time, np.maximum(envelopes[place], 1e-6), lw=1, label=label)
axes.axhline(sensor.full_scale / 2, color="0.5", ls="--", lw=1, label="converter's range")
axes.axhline(sensor.noise, color="0.5", ls=":", lw=1, label="noise of one sample")
axes.set(
    xlabel="time (ms)", ylabel="envelope before the converter (V)", ylim=(1e-5, 300), xlim=(0, 16)
)
distance = axes.secondary_xaxis("top", functions=(lambda t: 17.16 * t, lambda d: d / 17.16))
distance.set_xlabel("distance (cm)")
axes.legend(ncols=2)
plt.show()
