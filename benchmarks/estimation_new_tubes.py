"""Errors of estimators in tubes that were not in their training data.

Six tubes, bores of 7.6, 7.9 and 8.2 mm and 30 and 40 Shore A, each with its own irregularities,
at 17, 22 and 27 °C; a 25 mm rod, seven depths, seventeen positions, two cycles each. Each split
holds out a part: every third cycle, the narrowest bore, the hardest wall, the warmest air. Listed
are errors of the sleeve paper's highest peak and force network, of the whole-echo networks and of
boosting, up to 1.2 m, as a table in Markdown. Sweeps and cycles are kept in the folder.

    python benchmarks/estimation_new_tubes.py FOLDER
"""

import argparse
import time
from pathlib import Path

import numpy as np

import acoustube
from acoustube import Recipe, estimation, load_plan, run_dataset, run_sweep
from acoustube.estimation import FeatureSettings
from acoustube.estimation.model import TARGETS
from acoustube.reports.studies.flat import processing_of
from acoustube.runs.training import DISPLAY_UNITS

OVER = {
    "indenter_mm": ["25"], "depth_mm": ["1:7:1"], "position_cm": ["20:180:10"],
    "inner_diameter_mm": ["7.6:8.2:0.3"], "shore_a": ["30:40:10"], "temperature_c": ["17:27:5"],
    "length_cm": ["250"], "resolution": ["12"], "mesh": ["coarse"],
}  # fmt: skip
FARTHEST = 1.2
KINDS = {"network": "paper", "echo": "echo", "boosting": "echo"}
ENDS = "", "_deviation", "_half_width"


def recorded(folder):
    """Return the cycles, and the cases that they belong to."""
    plan, recipe = load_plan(None, OVER), Recipe(n_cycles=2)
    if not run_sweep(plan, folder / "sweep"):
        raise SystemExit("a case failed")
    run_dataset([folder / "sweep"], folder / "cycles", recipe)
    cases = acoustube.open_dataset(folder / "sweep")
    usual = (cases["inner_diameter"] > 7.8e-3) & (cases["inner_diameter"] < 8e-3)
    how = processing_of(cases.isel(press=np.flatnonzero(usual.values)), recipe)
    return acoustube.open_dataset(folder / "cycles").load(), how


def splits(cycles):
    """Return which cycles are held out, by the property that is new in them."""
    bore, modulus = cycles["inner_diameter"].values, cycles["shear_modulus"].values
    return {
        "cycles": np.arange(cycles.sizes["cycle"]) % 3 == 0,
        "bore": np.isclose(bore, bore.min()),
        "hardness": np.isclose(modulus, modulus.max()),
        "temperature": cycles["air_temperature"].values > 24.5,
    }


def line(new, by, target, found):
    """Print a row of the table."""
    unit, scale = DISPLAY_UNITS[target]
    sizes = [f"{scale * value:.3g}" for value in (found.median, found.rmse, found.iqr)]
    shares = [
        "" if np.isnan(value) else f"{100 * value:.0f} %"
        for value in (found.relative, found.covered, found.covered_wide)
    ]
    print(
        "| " + " | ".join([new, by, f"{TARGETS[target]}, {unit}", *sizes, *shares]) + " |",
        flush=True,
    )


def main():
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    cycles, how = recorded(parser.parse_args().folder)
    describings = {kind: FeatureSettings(kind=kind, processing=how) for kind in ("paper", "echo")}
    tables = {kind: estimation.feature_table(cycles, each) for kind, each in describings.items()}
    near = cycles["true_distance"].values < FARTHEST
    print("| new | by | target | median | RMSE | IQR | relative | in 68 % | in 90 % |")
    print("|---|---|---|---|---|---|---|---|---|")
    for new, held in splits(cycles).items():
        tested = held & near
        peak = tables["paper"]["features"].sel(feature="distance").values[tested]
        truth = cycles["true_distance"].values[tested]
        seen = np.isfinite(peak)
        by = f"highest peak, in {100 * seen.mean():.0f} % of cycles"
        line(new, by, "true_distance", estimation.errors(truth, peak))
        for target in ("depth", "force"):
            values = cycles[target].values
            constant = np.full(tested.sum(), np.median(values[~held]))
            line(new, "a constant", target, estimation.errors(values[tested], constant))
        for name, kind in KINDS.items():
            table, start = tables[kind], time.perf_counter()
            model = estimation.train(table.isel(cycle=~held), name, describings[kind])
            seconds = time.perf_counter() - start
            told = estimation.estimate(model, table.isel(cycle=tested))
            for target in model.targets:
                columns = [told[TARGETS[target] + end].values for end in ENDS]
                true = cycles[target].values[tested]
                by = f"{name} ({seconds:.0f} s)"
                line(new, by, target, estimation.errors(true, *columns))
                if target == "true_distance":
                    of_seen = [values[seen] for values in (true, *columns)]
                    line(new, f"{by}, of these cycles", target, estimation.errors(*of_seen))


if __name__ == "__main__":
    main()
