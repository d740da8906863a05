"""Study of a tube pressed on a table (section II-F, Figs. 4 and 5, Tables I and II)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from acoustube import estimation
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.report import Reporter
from acoustube.base.units import MM
from acoustube.estimation import FeatureSettings, Model
from acoustube.estimation.model import TARGETS
from acoustube.ranging import Rangefinder
from acoustube.reports.studies import flat_figures, inverted, ranged, whole_echo
from acoustube.reports.studies.calibration import calibrated
from acoustube.reports.studies.presses import swept
from acoustube.reports.studies.ranged import FIRST_DATASET_DEPTH, found_distance, shallowest
from acoustube.reports.studies.report import Level, Row, Scale, Study, Tables, compared_row
from acoustube.runs.config import configured
from acoustube.runs.inverted_cycles import alike
from acoustube.runs.opening import open_dataset
from acoustube.runs.recordings import read_cycles
from acoustube.runs.sweep.cycles import Recipe, in_session, seed_of
from acoustube.runs.sweep.dataset import run_dataset
from acoustube.runs.sweep.plan import tube_name
from acoustube.runs.training import table_of
from acoustube.signals import Processing

ROD = {"indenter_mm": ["25"], "length_cm": ["250"]}
DEPTHS, FEW_DEPTHS = "0.5:8:0.5", "2:8:2"
"""Depths in mm in full and in quick runs. The full ones are those of the simulation study, so that
its cached presses are used again; cycles at 0.5 mm are recorded, but left out of the dataset."""
PLACES, FEWER_PLACES, FEW_PLACES = "20:210:1", "20:210:5", "30:150:30"
SECOND_PLACES, SECOND_FEW = "20:160:35", "40:110:70"
SECOND_DEPTHS = [f"{depth:.4g}" for depth in np.linspace(0.4, 8.0, 60)]
CYCLES, FEWER_CYCLES = 50, 5
PLACE_STRIDE, DEPTH_STRIDE = 10, 3
"""Waveform inversion analyses recordings at every 10th position of the first dataset, and at every
3rd depth of the second."""
NEAR, BEYOND = 0.60, 1.95
"""Distances in m: the smallest reliable depth is given for presses up to NEAR, and beyond BEYOND.

The sleeve paper states 7 mm beyond 1.95 m, and 2.5 mm without a distance; up to 0.6 m its
amplitudes rise with depth.
"""


def study(scale: Scale, work: Path, report: Reporter) -> Study:
    """Press at many positions and depths, locate the presses, and estimate their forces."""
    first = recorded(scale.level, scale, work, report)
    second = recorded_again(scale.level, scale, work, report)
    coarser = None
    if scale.coarser is not None:
        coarser = recorded(scale.coarser, scale, work / "coarser", report, few=True)
    network = trained_network(first, scale, report)
    forces = estimation.estimate(network, second)
    detected = np.isfinite(found_distance(second))
    places, pressed_again = (
        (None, None) if scale.quick else recordings_inverted(work, scale, report)
    )
    rows = [
        *localisation_rows(Tables(first, coarser, places)),
        *force_rows(second, forces, network, pressed_again),
        *whole_echo.rows(work, echo_features_of(work), detected, scale, report),
    ]
    figures = {
        "True against estimated distance of single cycles, coloured by depth; dashed the window of "
        "the search.": flat_figures.distances(first),
        "Mean absolute error of the distance, and fraction of located cycles, over depth and "
        "distance; grey where nothing is detected.": flat_figures.maps(first),
        "Highest peak (logarithm, smoothed) over depth and distance: first dataset (left) and "
        "second; grey where nothing is detected or the mean error is over 25 cm.":
        flat_figures.amplitudes(first, second),
        "Force against depth in the second dataset: truth (grey) and the network's, by distance "
        "(left); mean absolute relative error (right).": flat_figures.forces(second, forces),
        **inverted.compared_figures(
            first, places, (second["force"], forces["force"]), pressed_again
        ),
    }  # fmt: skip
    return Study(
        title="Flat table (Figs. 4 and 5, Tables I and II)", text=TEXT, rows=rows, figures=figures
    )


TEXT = """\
A 25 mm rod presses a 2.5 m tube at 191 places to 15 depths, and 50 cycles of each press
are recorded; then at five places to 60 depths. The presses are computed by finite elements. Each
scatters the sound, which propagates along the tube with losses. The default rangefinder records it.
The cycles are processed with the calibration of Fig. 3, made on the same tube. A cycle is located
if the error of its distance is below 25 cm.

The rangefinder's noise, clutter and ring-down are its defaults, chosen from published observations:
the dead zone, and that contacts are found only from about 2.5 mm near and 7 mm beyond 1.95 m.

The coarser level has every fifth place and five cycles of each press.

The network is trained on the forces of the first dataset and tested on the second, as published; so
are the networks whose input is the whole echo, with a tenth of the cycles.

Waveform inversion is given five cycles of each press at every tenth position of the first dataset
and at every third depth of the second, 200 cycles without contact, from which it learns the
clutter, and a library of the same tool, tube and mesh at depths of its own. The rangefinder's
parameters and the mean error of its thermometer are known to it.

Unknown to the simulation: friction and play of the test machine, the tube's own irregularities at
the places that were pressed, and the yielding of the floor."""


def recorded(
    level: Level, scale: Scale, work: Path, report: Reporter, *, few: bool = False
) -> xr.Dataset:
    """Record the first dataset, and return its features and labels.

    Parameters
    ----------
    level : Level
    scale : Scale
    work : Path
    report : Reporter
    few : bool
        Whether to record every fifth position only, and five cycles of each press.

    Returns
    -------
    xarray.Dataset
        Table of :func:`acoustube.estimation.feature_table`, with the sleeve paper's features.
    """
    places = FEW_PLACES if scale.quick else FEWER_PLACES if few else PLACES
    depths = FEW_DEPTHS if scale.quick else DEPTHS
    over = {**ROD, "depth_mm": [depths], "position_cm": [places]}
    n_cycles = FEWER_CYCLES if few or scale.quick else CYCLES
    table = _cycles(work / "first", over, level, scale, n_cycles, report)
    return table.isel(cycle=table["depth"].values > FIRST_DATASET_DEPTH)


def recorded_again(level: Level, scale: Scale, work: Path, report: Reporter) -> xr.Dataset:
    """Record the second dataset, and return its features and labels; see :func:`recorded`."""
    depths = [FEW_DEPTHS] if scale.quick else SECOND_DEPTHS
    places = SECOND_FEW if scale.quick else SECOND_PLACES
    over = {**ROD, "depth_mm": depths, "position_cm": [places]}
    n_cycles = FEWER_CYCLES if scale.quick else CYCLES
    return _cycles(work / "second", over, level, scale, n_cycles, report)


def echo_features_of(work: Path) -> FeatureSettings:
    """Return the settings of whole-echo features, calibrated for the tube of the study."""
    cases = open_dataset(work / "first" / "sweep")
    return FeatureSettings(kind="echo", processing=processing_of(cases, Recipe()))


def recordings_inverted(
    work: Path, scale: Scale, report: Reporter
) -> tuple[xr.Dataset, xr.Dataset]:
    """Invert some recordings of both datasets, given the study's folder.

    Returns
    -------
    first, second : xarray.Dataset
        In the format of :func:`acoustube.reports.studies.inverted.inverted_table`.
    """
    over = {name: words for name, words in ROD.items() if name != "length_cm"}
    library = inverted.library_of(work / "library", over, scale.level, scale, report)
    cases, recipe = open_dataset(work / "first" / "sweep"), Recipe()
    tube = f"{_tube_of(cases)}-0"
    session = seed_of(tube, 0, recipe.seed)
    inverter = inverted.inverter_of(
        library, [], session_seed=session, tube_seed=seed_of(tube, recipe.seed),
        rangefinder=in_session(Rangefinder(), session, recipe),
    )  # fmt: skip
    first = every_nth(work / "first" / "cycles", "true_distance", PLACE_STRIDE)
    second = every_nth(work / "second" / "cycles", "depth", DEPTH_STRIDE)
    return (
        inverted.inverted_table(first, inverter, report),
        inverted.inverted_table(second, inverter, report),
    )


def every_nth(folder: Path, label: str, stride: int) -> list[xr.Dataset]:
    """Return the first cycles of each press at every n-th value of a label.

    Presses up to :data:`~acoustube.reports.studies.ranged.FIRST_DATASET_DEPTH` are left out.
    """
    presses = [
        part.isel(cycle=slice(inverted.GROUP)).copy(deep=True)  # not a view of the whole file
        for _, data in read_cycles([folder])
        for part, _ in alike(data, list(TARGETS), CYCLES)
        if part["depth"].values[0] > FIRST_DATASET_DEPTH
    ]
    values = np.array([float(part[label].values[0]) for part in presses]).round(9)
    chosen = np.isin(values, np.unique(values)[::stride])
    return [part for part, is_chosen in zip(presses, chosen, strict=True) if is_chosen]


def _tube_of(cases: xr.Dataset) -> str:
    """Return the name of the tube that a sweep presses."""
    return tube_name(configured(json.loads(str(cases["configuration"].values[0]))))


def _cycles(
    work: Path,
    over: dict[str, list[str]],
    level: Level,
    scale: Scale,
    n_cycles: int,
    report: Reporter,
) -> xr.Dataset:
    """Run a sweep, record its cycles, and return their features and labels."""
    cases = swept(work / "sweep", over, level, scale, report)
    recipe = Recipe(n_cycles=n_cycles)
    run_dataset([work / "sweep"], work / "cycles", recipe, report=report, workers=scale.workers)
    feature_settings = FeatureSettings(kind="paper", processing=processing_of(cases, recipe))
    with watched_interrupts() as check, report.progress(check) as show:
        recordings = read_cycles(sorted((work / "cycles").glob("cycles-*.nc")))
        return table_of(recordings, feature_settings, show)


def processing_of(cases: xr.Dataset, recipe: Recipe) -> Processing:
    """Return the signal processing calibrated on the specimen of the tube that a sweep presses."""
    found, _ = calibrated(seed_of(f"{_tube_of(cases)}-0", recipe.seed))
    return found.processing


def trained_network(table: xr.Dataset, scale: Scale, report: Reporter) -> Model:
    """Return the sleeve paper's force network, trained on cycles.

    Parameters
    ----------
    table : xarray.Dataset
        From :func:`recorded`.
    scale : Scale
    report : Reporter
    """
    settings: dict[str, Any] = {"epochs": 5} if scale.quick else {}
    total = settings.get("epochs", 100)
    with watched_interrupts() as check, report.progress(check) as show:

        def learned(step: float, *_losses: float) -> None:
            show("training", step / total)

        return estimation.train(table, "network", FeatureSettings(), progress=learned, **settings)


# ---------------------------------------------------------------------------------------------
# Numbers


def localisation_rows(tables: Tables) -> list[Row]:
    """Return rows of Table I, of detection, and of the smallest reliable depths."""
    why = (
        "Our errors are of two kinds: small ones, and those of several centimetres where sound "
        "trapped near the rod is the highest peak. In the sleeve paper even complete closures "
        "scatter by 3.6 cm about a line (Fig. 3), far more than ours do: most of its error comes "
        "from its tube and bench, not from the presses."
    )
    rows = ranged.distance_rows(tables, (5.23, 13.1, 9.31), why)
    rows += [
        *ranged.detection_rows(tables),
        compared_row(
            lambda cycles: MM * shallowest(cycles, 0.0, NEAR), tables,
            quantity="depth from which contacts up to 0.6 m are reliable", unit="mm", published=2.5,
            why="The clutter was chosen to give this, on a specimen with other irregularities.",
        ),
        compared_row(
            lambda cycles: MM * shallowest(cycles, BEYOND, 3.0), tables,
            quantity="depth from which contacts beyond 1.95 m are reliable", unit="mm",
            published=7.0,
            why="The noise was chosen to give this; only the deepest presses close the lumen.",
        ),
        compared_row(
            ranged.error_of_deep, tables,
            quantity="distance: mean absolute error, deeper than 6.5 mm", unit="cm",
            why="Published as lowest there, below 10 cm on the arm.",
        ),
    ]  # fmt: skip
    return rows


def force_rows(
    table: xr.Dataset, estimates: xr.Dataset, model: Model, inversion: xr.Dataset | None
) -> list[Row]:
    """Return rows of the force errors in the paper's Table II for the tube on a flat table.

    Parameters
    ----------
    table, estimates : xarray.Dataset
        Second dataset, and the network's estimates for it.
    model : Model
        The force network.
    inversion : xarray.Dataset or None
        Estimates by waveform inversion, from :func:`recordings_inverted`.
    """
    found = estimation.errors(table["force"].values, estimates["force"].values)
    other = None if inversion is None else ranged.force_errors(inversion)
    constant = float(np.median(table["force"].values))
    guess = estimation.errors(table["force"].values, np.full(table.sizes["cycle"], constant))
    why = (
        "Here force follows from depth alone, and a press has the same echo in both datasets; the "
        "sleeve paper's test platforms added significant variance. As in that paper, estimates "
        "cluster at medium depths, where the amplitude is not monotonic. A constant estimate, the "
        "median, gives "
    )
    rows = [
        Row(
            quantity=f"force: {words} absolute error", unit=unit, published=published,
            ours=scale * getattr(found, name),
            inversion=None if other is None else scale * getattr(other, name),
            why=f"{why}{scale * getattr(guess, name):.3g} {unit}.",
        )
        for name, words, unit, published, scale in (
            ("median", "median", "N", 1.49, 1.0), ("rmse", "RMSE of the", "N", 2.95, 1.0),
            ("iqr", "IQR of the", "N", 2.09, 1.0),
            ("relative", "median relative", "%", 41.8, 100.0),
        )
    ]  # fmt: skip
    return [
        *rows,
        Row(
            quantity="force: largest in the second dataset", unit="N",
            ours=float(table["force"].max()),
            why="Not published in the text.",
        ),
        Row(
            quantity="cycles that the network was trained on", unit="1",
            ours=float(model.origin["trained"]), why="Those of the first dataset with an echo.",
        ),
    ]  # fmt: skip
