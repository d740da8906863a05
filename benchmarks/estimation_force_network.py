"""Training time and held-out loss of the sleeve paper's force network, against other libraries.

143 250 rows as in the sleeve paper's flat table: peak amplitude and estimated distance of presses,
by a formula with noise, and their force. Ten folds, 100 epochs, batches of 32. For comparison, the
same network in PyTorch's plain loop and in scikit-learn's ``MLPRegressor``: one epoch of one fold,
scaled up, and 20 epochs of one fold on a tenth of the rows, for the held-out loss. PyTorch is left
out where it is not installed. The epochs of the first line can be given: ``OMP_NUM_THREADS=1 python
benchmarks/estimation_force_network.py [EPOCHS]``.
"""

from __future__ import annotations

import sys
import warnings
from time import perf_counter, process_time

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor

from acoustube.estimation import folds
from acoustube.estimation.network import batches, train

ROWS, FOLDS, EPOCHS, BATCH = 143_250, 10, 100, 32
SHORT = 20
"""Number of epochs for the comparison of losses."""
SEEDS = 3


def presses(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return amplitude and distance (row, 2), and force (row, 1), less noisy when near."""
    rng = np.random.default_rng(seed)
    distance, depth = rng.uniform(0.2, 2.1, count), rng.uniform(1, 8, count)
    force = 0.45 * depth + 0.012 * depth**3 * rng.normal(1, 0.03, count)
    sent_back = 0.02 * depth * (1 + 0.5 * np.sin(2 * depth))
    amplitude = sent_back * np.exp(-0.8 * distance) + rng.normal(0, 0.004, count)
    found = distance + rng.normal(0, 0.02, count)
    return np.stack([np.abs(amplitude), found], axis=-1), force[:, None]


def standard(x: np.ndarray, y: np.ndarray, fold: np.ndarray) -> list[np.ndarray]:
    """Return training and held-out rows of fold 0, standardised on the former, single precision."""
    kept = fold != 0
    parts = []
    for data in (x, y):
        mean, deviation = data[kept].mean(axis=0), data[kept].std(axis=0)
        whole = ((data - mean) / deviation).astype(np.float32)
        parts += [whole[kept], whole[~kept]]
    return parts


def with_torch(parts: list[np.ndarray], epochs: int, seed: int) -> tuple[float, float]:
    """Return the held-out loss, and seconds of processor time per epoch, of a plain loop."""
    import torch
    from torch import nn

    torch.set_num_threads(1)
    torch.manual_seed(seed)
    layers = [nn.Linear(2, 64), nn.LeakyReLU(), nn.Linear(64, 64), nn.LeakyReLU(), nn.Linear(64, 1)]
    for layer in layers[::2]:
        nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
        nn.init.zeros_(layer.bias)
    model = nn.Sequential(*layers)
    optimiser = torch.optim.Adam(model.parameters(), lr=1e-3, weight_decay=1e-5)
    x, held_x, y, held_y = (torch.from_numpy(part) for part in parts)
    start = process_time()
    for _ in range(epochs):
        order = torch.randperm(len(x))
        for first in range(0, len(x), BATCH):
            rows = order[first : first + BATCH]
            optimiser.zero_grad()
            nn.functional.mse_loss(model(x[rows]), y[rows]).backward()
            optimiser.step()
    seconds = (process_time() - start) / epochs
    with torch.no_grad():
        return float(nn.functional.mse_loss(model(held_x), held_y)), seconds


def with_sklearn(parts: list[np.ndarray], epochs: int, seed: int) -> tuple[float, float]:
    """Return the held-out loss, and processor time in s per epoch; its ReLU has no leak."""
    x, held_x, y, held_y = parts
    model = MLPRegressor(
        hidden_layer_sizes=(64, 64), batch_size=BATCH, alpha=1e-5 * BATCH, max_iter=epochs,
        random_state=seed, n_iter_no_change=10_000,
    )  # fmt: skip
    start = process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(x, y[:, 0])
    seconds = (process_time() - start) / epochs
    return float(np.mean((model.predict(held_x) - held_y[:, 0]) ** 2)), seconds


def main() -> None:
    """Print the tables."""
    epochs = int(sys.argv[1]) if len(sys.argv) > 1 else EPOCHS
    peers = {"scikit-learn": with_sklearn}
    try:
        import torch

        peers[f"PyTorch {torch.__version__}"] = with_torch
    except ImportError:
        print("PyTorch is not installed")
    x, y = presses(ROWS, 0)
    fold = folds(np.arange(ROWS), FOLDS)
    start, busy = perf_counter(), process_time()
    train(x, y, fold, epochs=epochs, batch_size=BATCH)
    wall, busy = perf_counter() - start, process_time() - busy
    steps = len(batches(np.random.default_rng(0), fold, FOLDS, BATCH))
    print(f"{FOLDS} folds of {ROWS} rows, {epochs} epochs of {steps} steps, compilation included:")
    print(f"acoustube: {wall:.0f} s, processor {busy:.0f} s")
    for name, run in peers.items():
        _, seconds = run(standard(x, y, fold), 1, 0)
        print(f"{name}: {seconds:.1f} s of processor per fold and epoch, "
              f"{FOLDS * epochs * seconds:.0f} s for all")  # fmt: skip
    x, y = presses(ROWS // 10, 1)
    fold = folds(np.arange(len(x)), FOLDS)
    print(f"held-out loss of fold 0 after {SHORT} epochs of {len(x)} rows, by seed:")
    own = [train(x, y, fold, epochs=SHORT, seed=s).validation[0, -1] for s in range(SEEDS)]
    print("acoustube:", *(f"{loss:.4f}" for loss in own))
    for name, run in peers.items():
        losses = [run(standard(x, y, fold), SHORT, seed)[0] for seed in range(SEEDS)]
        print(f"{name}:", *(f"{loss:.4f}" for loss in losses))


if __name__ == "__main__":
    main()
