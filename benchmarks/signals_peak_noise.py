"""Constants of the stated deviation of a distance: noise at an echo and at rest, and sampling.

Run: python benchmarks/signals_peak_noise.py

Synthetic cycles at 200 kHz: a send pulse of 42 kHz and one echo, with and without white noise.
Printed with and without the matched filter, for :mod:`acoustube.signals.localise`: the standard
deviation of the envelope's slope at rest (``NORMAL_MEDIAN`` times the median of its size) over that
at the echo's peak, and the standard deviation of the peak's time in samples, without noise, over
the offsets of the echo between samples.
"""

from __future__ import annotations

import numpy as np

from acoustube import signals
from acoustube.signals.localise import NORMAL_MEDIAN
from acoustube.waves import Pulse

RATE, PLACE, HEIGHT, NOISE, CYCLES = 200e3, 0.8, 0.3, 5e-3, 1500


def main() -> None:
    """Print the constants."""
    pulse, rng = Pulse(frequency=42e3), np.random.default_rng(0)
    time = np.arange(4000) / RATE
    speed = float(signals.speed_of_sound(20.0))
    # Delays over a whole period of the carrier, 4.76 samples.
    delay = 2 * PLACE / speed + np.linspace(0, 100 / RATE, CYCLES, endpoint=False)
    clean = pulse(time) + HEIGHT * pulse(time - delay[:, None])
    noisy = clean + NOISE * rng.standard_normal(clean.shape)
    print("| | slope's noise at rest over that on an echo | time of the peak, samples |")
    print("|---|---|---|")
    for name, cycles in (("rectified", None), ("matched", 10)):
        settings = signals.Processing(prominence=0.1, template_cycles=cycles, offset_cutoff=None)
        exact, found = (signals.locate(time, c, settings) for c in (clean, noisy))
        # In units of the noiseless send pulse, so that its noise has no effect.
        slopes = np.diff(found.envelope * (found.send_amplitude / exact.send_amplitude)[:, None])
        ideal = np.diff(exact.envelope)
        peak = np.round(exact.return_time * RATE).astype(int)[:, None]
        on_echo = np.std(np.take_along_axis(slopes - ideal, peak, axis=1))
        at_rest = NORMAL_MEDIAN * np.median(np.abs(slopes[:, 2500:3500]))
        wrong = (exact.return_time - exact.send_time - delay) * RATE
        print(f"| {name} | {at_rest / on_echo:.2f} | {np.std(wrong):.2f} |")


if __name__ == "__main__":
    main()
