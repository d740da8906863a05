"""Time to process 143 250 cycles of 4000 samples, the number in the sleeve paper's flat table.

They are made and written to a netCDF file piece by piece, and then read and processed as by
`acoustube process`. Printed are the time in s and the largest memory of the process, those of a
plain loop of SciPy calls over some of the cycles, and the largest difference of the
two. Some minutes and 1.2 GB of disk: ``python benchmarks/signals_many_cycles.py [N]``.
"""

from __future__ import annotations

import resource
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import h5netcdf
import numpy as np
from scipy import signal

from acoustube import recordings
from acoustube.runs.recordings import CHUNK, located
from acoustube.signals import Processing, TimeGain, template

RATE, CARRIER, SPEED = 200e3, 42e3, 343.2415
TIME = np.arange(4000) / RATE
HOW = Processing(gain=TimeGain(-0.25, 2.0, 0.9, 0.42), prominence=0.02)
PLAIN = 2000
"""Number of cycles of the plain loop."""


def cycles(count: int, seed: int) -> np.ndarray:
    """Return cycles in counts of 12 bits: a send pulse, one echo, noise."""
    rng = np.random.default_rng(seed)
    delay = 2 * rng.uniform(0.2, 2.0, count)[:, None] / SPEED

    def burst(since: np.ndarray) -> np.ndarray:
        width = 11 / CARRIER / 6
        return np.exp(-0.5 * (since / width) ** 2) * np.sin(2 * np.pi * CARRIER * since)

    middle = 5.5 / CARRIER
    clean = burst(TIME - middle) + 0.2 * burst(TIME - middle - delay)
    noise = rng.normal(0, 0.002, clean.shape)
    return np.round(2048 + 1500 * (clean + noise)).astype(np.uint16)


def write(path: Path, count: int) -> None:
    """Write a recording of that many cycles."""
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"cycle": count, "time": TIME.size}
        samples = file.create_variable("signal", ("cycle", "time"), np.uint16)
        for start in range(0, count, 10 * CHUNK):
            part = min(10 * CHUNK, count - start)
            samples[start : start + part] = cycles(part, start)
        samples.attrs["units"], samples.attrs["long_name"] = "1", "counts"
        for name, dims, values, units in (
            ("temperature", ("cycle",), np.full(count, 20.0), "degC"),
            ("time", ("time",), TIME, "s"),
        ):
            variable = file.create_variable(name, dims, float, data=values)
            variable.attrs["units"], variable.attrs["long_name"] = units, name
        file.attrs["sampling_rate"] = RATE


def plain_loop(samples: np.ndarray) -> list[float]:
    """Return the distances by plain calls of SciPy, cycle by cycle."""
    slow = signal.butter(2, 100.0, fs=RATE, output="sos")
    low = signal.butter(2, 10e3, fs=RATE, output="sos")
    wave, middle, found = template(RATE, CARRIER), 5.5 / CARRIER, []
    level = HOW.gain.level(SPEED * np.maximum(TIME - middle, 0.0) / 2)  # type: ignore[union-attr]
    for cycle in samples:
        x = cycle - np.mean(cycle)
        x = x - signal.sosfiltfilt(slow, x, padtype="even", padlen=x.size - 1)
        x = np.abs(np.convolve(x / level, wave, mode="same"))
        x = np.pi / 2 * signal.sosfiltfilt(low, x, padtype="even", padlen=60)
        sent = int(np.argmax(x[:100]))
        first = sent + int(2 * 0.15 / SPEED * RATE)
        peaks, _ = signal.find_peaks(x[first:] / x[sent], prominence=HOW.prominence)
        best = first + peaks[np.argmax(x[first:][peaks])]
        found.append(SPEED * (best - sent) / RATE / 2)
    return found


def main() -> None:
    """Print the table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 143_250
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "many.nc"
        write(path, count)
        start = perf_counter()
        data = recordings.read(path)
        distances = np.concatenate([ranging.distance for _, ranging in located(data, HOW)])
        seconds = perf_counter() - start
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        some = data["signal"].values[:PLAIN]
        start = perf_counter()
        loop = plain_loop(some)
        each = (perf_counter() - start) / len(some)
        apart = np.abs(distances[: len(loop)] - loop)
        print(
            f"{count} cycles: {seconds:.0f} s, {1e3 * seconds / count:.2f} ms each, {memory:.1f} GB"
        )
        print(f"plain loop: {1e3 * each:.2f} ms each, {each * count:.0f} s for as many")
        print(f"distances apart: median {1e3 * np.median(apart):.2f} mm (a sample is 0.86 mm)")


if __name__ == "__main__":
    main()
