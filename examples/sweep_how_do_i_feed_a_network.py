"""
How do I feed a network?
========================

A small sweep is computed, and cycles of a rangefinder are recorded for each of its cases. They are
served in shuffled batches for a training loop, with NumPy, and as a PyTorch data set where PyTorch
is installed.
"""

# %%
# A sweep and a dataset
# ---------------------
# The sweep has four depths and the untouched tube, at three positions. The carrier of 20 kHz and
# the coarse grid save time. The workers are threads here. Without ``executor`` they are processes,
# and a script must then start the sweep under ``if __name__ == "__main__":``. The folder is
# temporary here; to keep the files, use another one.
import tempfile
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from acoustube import Recipe, load_plan, open_dataset, run_dataset, run_sweep

plan = load_plan(
    None,
    {
        "depth_mm": ["0", "3:6:1"], "position_cm": ["40", "80", "120"], "indenter_mm": ["10"],
        "frequency_khz": ["20"], "length_cm": ["200"], "mesh": ["coarse"], "resolution": ["8"],
    },
)  # fmt: skip
workers = ThreadPoolExecutor(2)
folder = tempfile.TemporaryDirectory()
sweep, cycles_folder = Path(folder.name) / "sweep", Path(folder.name) / "cycles"
run_sweep(plan, sweep, executor=workers)
run_dataset([sweep], cycles_folder, Recipe(n_cycles=16), executor=workers)
cycles = open_dataset(cycles_folder)  # nothing is read yet
print(cycles)


# %%
# Batches with NumPy
# ------------------
# Reading in the order of the file is faster. Each batch is therefore a random choice of cycles,
# read in the order of the file.
def batches(cycles, size, seed):
    """Yield signals (size, time) as fractions of full scale, and depths, in random order."""
    order = np.random.default_rng(seed).permutation(cycles.sizes["cycle"])
    for start in range(0, len(order), size):
        some = np.sort(order[start : start + size])
        batch = cycles.isel(cycle=some)
        yield batch["signal"].values / cycles.attrs["full_scale"], batch["depth"].values


means, labels = [], []
for signal, depth in batches(cycles, size=32, seed=1):
    means.append(signal.mean())
    labels.append(depth)
labels = np.concatenate(labels)
print(f"{len(means)} batches, {len(labels)} cycles")


# %%
# The same for PyTorch
# --------------------
# PyTorch needs only the methods ``__len__`` and ``__getitem__``.
class Cycles:
    """A map-style data set of signals and depths."""

    def __init__(self, cycles):
        self.cycles, self.depth = cycles, cycles["depth"].values.astype(np.float32)

    def __len__(self):
        return self.cycles.sizes["cycle"]

    def __getitem__(self, i):
        signal = self.cycles["signal"].isel(cycle=i).values / self.cycles.attrs["full_scale"]
        return signal.astype(np.float32), self.depth[i]


if find_spec("torch"):
    from torch.utils.data import DataLoader

    loader = DataLoader(Cycles(cycles), batch_size=32, shuffle=True)
    print(f"{len(loader)} batches of PyTorch, the first of shape {next(iter(loader))[0].shape}")

# %%
# One cycle of each depth
# -----------------------
# All cycles are of the nearest position, 40 cm. They are drawn one below the other. Each begins
# with the transducer's ring-down, which overdrives the ADC; the echo follows on the tail of the
# ring-down.
figure, axes = plt.subplots(figsize=(9, 5), layout="constrained")
time = 1e3 * cycles["time"].values
depths, places = np.unique(labels), cycles["true_distance"].values
for row, depth in enumerate(depths):
    some = (cycles["depth"].values == depth) & (np.isclose(places, 0.4) | (depth == 0))
    signal = cycles["signal"].isel(cycle=int(np.argmax(some))).values.astype(float)
    axes.plot(time, (signal - np.median(signal)).clip(-95, 95) - 200 * row, lw=0.6)
axes.set(
    xlabel="time (ms)", ylabel="counts of the ADC, a line for each depth", xlim=(1, 8),
    yticks=-200 * np.arange(len(depths)), yticklabels=[f"{1e3 * depth:g} mm" for depth in depths],
)  # fmt: skip
cycles.close()
folder.cleanup()
plt.show()
