"""
Can echoes tell depth?
======================

An estimator of position, depth and force is trained on labelled cycles of a simulated sensor. Its
errors and prediction intervals are evaluated on other presses.
"""

# %%
# Cycles of 160 presses
# ---------------------
# A 10 mm rod presses a tube of 1.5 m at random positions, to one of four depths. Three cycles are
# recorded of each press. The carrier is 20 kHz, at which the echo of this rod rises with depth.
# This carrier and the coarse grid keep the computation short.
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import acoustube
from acoustube import Recipe, estimation, load_plan, run_dataset, run_sweep
from acoustube.signals import Processing

plan = load_plan(
    None,
    {
        "position_cm": ["50:120"], "depth_mm": ["3", "4", "5", "6"], "indenter_mm": ["10"],
        "frequency_khz": ["20"], "length_cm": ["150"], "losses": ["on"], "mesh": ["coarse"],
        "resolution": ["8"],
    },
    count=160,
)  # fmt: skip
workers = ThreadPoolExecutor(2)
with tempfile.TemporaryDirectory() as folder:
    sweep, cycles_folder = Path(folder) / "sweep", Path(folder) / "cycles"
    run_sweep(plan, sweep, executor=workers)
    run_dataset([sweep], cycles_folder, Recipe(n_cycles=3), executor=workers)
    cycles = acoustube.open_dataset(cycles_folder).load()

# %%
# Train on three quarters of the presses
# --------------------------------------
# All cycles of a press belong to the same part, training or evaluation. The transducer rings twice
# as long at 20 kHz as at 42 kHz; the first 40 cm are therefore not searched.
how = Processing(frequency=20e3, nearest=0.4)
feature_settings = estimation.FeatureSettings(kind="echo", processing=how)
table = estimation.feature_table(cycles, feature_settings)
_, press = np.unique(table["press"].values, return_inverse=True)
learned, asked = estimation.split(press, share=0.25)
model = estimation.train(table.isel(cycle=learned), "echo", feature_settings, epochs=100)

# %%
# Evaluate on the others
# ----------------------
# Each median error is printed with that of a constant estimate, the median of the true values. The
# coverage of the intervals is above the nominal 90 %, because presses in a known tube are easy to
# estimate.
truth = table.isel(cycle=asked)
estimates = estimation.estimate(model, truth)
errors, constant = {}, {}
targets = (("distance", "true_distance", "cm", 100), ("depth", "depth", "mm", 1000))
for name, label, unit, scale in targets:
    values = truth[label].values
    errors[name] = estimation.errors(
        values, estimates[name], estimates[f"{name}_deviation"], estimates[f"{name}_half_width"]
    )
    constant[name] = float(np.median(np.abs(values - np.median(values))))
    print(
        f"{name}: median error {scale * errors[name].median:.2g} {unit}, of a constant "
        f"{scale * constant[name]:.2g} {unit}; 90 % intervals hold "
        f"{100 * errors[name].covered_wide:.0f} %"
    )

# %%
# Estimates and their intervals
# -----------------------------
# Each point is a cycle. Its bar is the prediction interval of nominally 90 %.
figure, panels = plt.subplots(1, 2, figsize=(10, 4.5), layout="constrained")
for axes, (name, label, unit, scale) in zip(panels, targets, strict=True):
    values = scale * truth[label].values
    axes.errorbar(
        values, scale * estimates[name], scale * estimates[f"{name}_half_width"],
        fmt=".", ms=5, lw=0.6, alpha=0.6, label="estimate, 90 % interval",
    )  # fmt: skip
    ends = [values.min(), values.max()]
    axes.plot(ends, ends, label="truth")
    axes.set(xlabel=f"true {name} ({unit})", ylabel=f"estimated {name} ({unit})")
panels[1].legend(loc="upper left")
plt.show()
