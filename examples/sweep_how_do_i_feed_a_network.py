"""How do I feed a network?

A small sweep, cycles of a rangefinder for each of its cases, and batches of these, shuffled, as any
training loop wants them: with NumPy, and as a PyTorch data set where PyTorch is installed. The
presses are shallow and the grid is coarse, so that it takes a minute.
"""

# %% A sweep and a dataset
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

import acoustube
from acoustube.datasets import run_dataset
from acoustube.sweep.cycles import Recipe
from acoustube.sweep.plan import load_plan
from acoustube.swept import run_sweep


def main():
    """Make the data, iterate over them, and draw a batch."""
    over = {
        "depth_mm": ["0", "1", "2"], "position_cm": ["40", "80", "120"], "length_cm": ["200"],
        "resolution": ["11"],
    }  # fmt: skip
    run_sweep(load_plan(None, over), "small-sweep", Console(), executor=ThreadPoolExecutor(1))
    recipe, folder = Recipe(n_cycles=16), Path("small-dataset")
    run_dataset([Path("small-sweep")], folder, recipe, Console(), workers=1)
    cycles = acoustube.open_dataset(folder)  # nothing is read yet

    # %% Batches with NumPy
    means, labels = [], []
    for signal, depth in batches(cycles, size=32, seed=1):
        means.append(signal.mean())
        labels.append(depth)
    labels = np.concatenate(labels)

    # %% The same for PyTorch
    if find_spec("torch"):
        from torch.utils.data import DataLoader

        loader = DataLoader(Cycles(cycles), batch_size=32, shuffle=True)
        print(f"{len(loader)} batches of PyTorch, the first of shape {next(iter(loader))[0].shape}")

    # %% Draw
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots()
    time = 1e3 * cycles["time"].values
    for depth in np.unique(labels):
        signal = cycles["signal"].isel(cycle=int(np.argmax(cycles["depth"].values == depth)))
        axes.plot(time, signal.values, lw=0.5, label=f"{1e3 * depth:g} mm deep")
    axes.set(xlabel="time (ms)", ylabel="counts of the ADC", ylim=(1900, 2200))
    axes.legend()
    figure.savefig("sweep_how_do_i_feed_a_network.png", dpi=120)
    return cycles, labels, means


def batches(cycles, size, seed):
    """Yield signals (size, time) as shares of full scale, and depths, in random order."""
    order = np.random.default_rng(seed).permutation(cycles.sizes["cycle"])
    for start in range(0, len(order), size):
        some = np.sort(order[start : start + size])  # reading is faster in the order of the file
        batch = cycles.isel(cycle=some)
        yield batch["signal"].values / cycles.attrs["full_scale"], batch["depth"].values


class Cycles:
    """A map-style data set: PyTorch asks for no more than these two methods."""

    def __init__(self, cycles):
        self.cycles, self.depth = cycles, cycles["depth"].values.astype(np.float32)

    def __len__(self):
        return self.cycles.sizes["cycle"]

    def __getitem__(self, i):
        signal = self.cycles["signal"].isel(cycle=i).values / self.cycles.attrs["full_scale"]
        return signal.astype(np.float32), self.depth[i]


if __name__ == "__main__":  # workers import this file too
    cycles, labels, means = main()
