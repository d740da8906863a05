"""
Signals: distance in noise
==========================

Synthetic cycles of a send pulse and one echo are processed, each with its own noise. The spread of
the estimated distances is compared with the standard deviation that is stated with each of them,
and with the Cramér-Rao bound. No unbiased estimate from a pulse of unknown phase and height can
have a smaller deviation than this bound.
"""

# %%
# The cycles
# ----------
# The position of the echo varies by up to a millimetre, so that all offsets between samples occur.
import matplotlib.pyplot as plt
import numpy as np

from acoustube import signals
from acoustube.waves import Pulse

RATE, PLACE, HEIGHT, CYCLES = 200e3, 0.8, 0.3, 300
pulse = Pulse(frequency=42e3)
time = np.arange(4000) / RATE
speed = float(signals.speed_of_sound(20.0))
random = np.random.default_rng(4)
noise_levels = HEIGHT * np.geomspace(0.01, 0.1, 7)
places = PLACE + 1e-3 * random.uniform(-1, 1, CYCLES)
clean = pulse(time) + HEIGHT * pulse(time - 2 * places[:, None] / speed)

# %%
# With the matched filter, as recordings are processed, and without, as simulated signals are
# -------------------------------------------------------------------------------------------
matched = signals.Processing(prominence=0.1)
plain = signals.Processing(prominence=0.1, template_cycles=None, offset_cutoff=None)
table = {}
for name, how in (("matched", matched), ("plain", plain)):
    rows = []
    for noise in noise_levels:
        cycles = clean + noise * random.standard_normal(clean.shape)
        found = signals.locate(time, cycles, how)
        error = found.distance - places
        stated = np.sqrt(np.mean(found.distance_deviation**2))
        rows.append([error.mean(), error.std(), stated])
    table[name] = 1e3 * np.array(rows)

# %%
# The bound
# ---------
# The delay t of the echo has Var(t) >= 2 noise² / sum of (A g')², with the envelope A g of the
# echo. The distance is half of the path that sound travels in this delay.
moment = np.arange(0, pulse.duration, 1 / RATE) - pulse.duration / 2
envelope = np.exp(-0.5 * (moment / pulse.sigma) ** 2)
slope = HEIGHT * envelope * moment / pulse.sigma**2
bound = 1e3 * speed / 2 * np.sqrt(2) * noise_levels / np.sqrt(np.sum(slope**2))
for name, rows in table.items():
    ratio = rows[-1, 1] / rows[-1, 2]
    bias = np.abs(rows[:, 0]).max()
    print(f"{name}: spread over stated deviation {ratio:.2f}, bias up to {bias:.2f} mm")

# %%
# The stated deviation equals the spread. The noise is measured where there is no echo. There the
# noise alone is rectified, so that its deviation is sqrt(1 - 2 / pi) of that with an echo; the
# processing corrects this. The floor of 0.1 to 0.2 mm is that of the sampled absolute value.
figure, panels = plt.subplots(1, 2, figsize=(10, 4.2), sharey=True, layout="constrained")
share = 100 * noise_levels / HEIGHT
for axes, (name, rows) in zip(panels, table.items(), strict=True):
    axes.loglog(share, rows[:, 1], "o-", label=f"spread of {CYCLES} cycles")
    axes.loglog(share, rows[:, 2], "s--", label="stated deviation")
    axes.loglog(share, np.abs(rows[:, 0]), "^:", color="0.5", label="bias")
    axes.loglog(share, bound, "k--", lw=1, label="Cramér-Rao bound")
    filtered = "with" if name == "matched" else "without"
    axes.set(xlabel="rms noise (% of the echo's amplitude)", title=f"{filtered} the matched filter")
panels[0].set_ylabel("mm")
panels[0].legend()
plt.show()
