"""The flat table (section II-F, Figs. 4 and 5, Tables I and II): where, and how hard."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from scipy.ndimage import gaussian_filter

from acoustube import estimation
from acoustube.config import configured
from acoustube.datasets import run_dataset
from acoustube.estimation import Describing, Errors, Model
from acoustube.plot import CM
from acoustube.run import heard_interrupts, stage_progress
from acoustube.signals import Processing
from acoustube.studies.calibration import calibrated
from acoustube.studies.presses import swept
from acoustube.studies.report import Level, Row, Scale, Study
from acoustube.sweep.cycles import Recipe, seed_of
from acoustube.sweep.pieces import tube_of
from acoustube.trained import table_of

Array = NDArray[np.float64]
MM = 1e3
ROD = {"indenter_mm": ["25"], "length_cm": ["250"]}
DEPTHS = "0.5:8:0.5"
"""In mm: those of the simulations, which share their presses. The study itself begins at 1 mm."""
SHALLOWEST = 0.9e-3
"""In m, from which cases of the first dataset are recorded."""
PLACES, FEWER_PLACES, FEW_PLACES = "20:210:1", "20:210:5", "30:150:30"
SECOND_PLACES, SECOND_FEW = "20:160:35", "40:110:70"
SECOND_DEPTHS = [f"{depth:.4g}" for depth in np.linspace(0.4, 8.0, 60)]
CYCLES, FEWER_CYCLES = 50, 5
BIN, DEPTH_BIN = 0.05, 0.5e-3
"""Of the error map, in m."""
FALSE = 0.25
"""Error of the distance in m from which a detection is a false positive."""
RELIABLE = 0.5
"""Share of the cycles that must tell the distance to 25 cm for a contact to be reliable."""
NEAR, BEYOND = 0.60, 1.95
"""Distances in m for which the paper states the shallowest contact that is detected."""
OTHER = "echo"


def study(scale: Scale, work: Path, console: Console) -> Study:
    """Press everywhere and to every depth, find the presses, and learn their forces.

    Parameters
    ----------
    scale : Scale
    work : Path
        Where sweeps and cycles are kept.
    console : rich.console.Console

    Returns
    -------
    Study
    """
    first = recorded(scale.level, scale, work, console)
    second = recorded_again(scale.level, scale, work, console)
    coarser = None
    if scale.coarser is not None:
        coarser = recorded(scale.coarser, scale, work / "coarser", console, few=True)
    network = trained_network(first, scale, console)
    forces = estimation.estimate(network, second)
    rows = [
        *localisation_rows(first, coarser),
        *force_rows(second, forces, network),
    ]
    figures = {
        "True against estimated distance of single cycles, coloured by depth; dashed the window of "
        "the search.": _scatter(first),
        "Mean absolute error of the distance, and share of cycles told to 25 cm, over depth and "
        "distance; grey where nothing is detected.": _maps(first),
        "Highest peak (logarithm, smoothed) over depth and distance: first dataset (left) and "
        "second; grey where nothing is detected or the mean error is over 25 cm.": _amplitudes(
            first, second
        ),
        "Force against depth in the second dataset: truth (grey) and the network's, by distance "
        "(left); mean absolute relative error (right).": _forces(second, forces),
    }
    return Study(
        title="Flat table (Figs. 4 and 5, Tables I and II)", text=TEXT, rows=rows, figures=figures
    )


TEXT = """\
A 25 mm rod presses a 2.5 m tube at 191 places to 15 depths, and 50 cycles of each press are
recorded; then at five places to 60 depths. The presses are finite elements, the sound is scattered
by each and carried by the tube with its losses, and the default rangefinder records it. The cycles
are processed with the calibration of Fig. 3, made on the same tube.

The rangefinder's noise, clutter and ring-down are its defaults, set once from stated observations:
the dead zone, and that contacts are found only from about 2.5 mm near and 7 mm beyond 1.95 m.

The network learns force from the first dataset and is tried on the second, as published. What the
simulation cannot know: friction and play of the test machine, the tube's own irregularities at the
places that were pressed, and what the floor under it gave way."""


def recorded(
    level: Level, scale: Scale, work: Path, console: Console, *, few: bool = False
) -> xr.Dataset:
    """Return what the processing makes of the first dataset.

    Parameters
    ----------
    level : Level
    scale : Scale
    work : Path
    console : rich.console.Console
    few : bool
        At every fifth place, with five cycles of each press.

    Returns
    -------
    xarray.Dataset
        As of :func:`acoustube.estimation.described`, with the paper's features.
    """
    places = FEW_PLACES if scale.quick else FEWER_PLACES if few else PLACES
    depths = "2:8:2" if scale.quick else DEPTHS
    over = {**ROD, "depth_mm": [depths], "position_cm": [places]}
    n_cycles = FEWER_CYCLES if few or scale.quick else CYCLES
    table = _cycles(work / "first", over, level, scale, n_cycles, console)
    return table.isel(cycle=table["depth"].values > SHALLOWEST)


def recorded_again(level: Level, scale: Scale, work: Path, console: Console) -> xr.Dataset:
    """Return what the processing makes of the second dataset; see :func:`recorded`."""
    depths = ["3:7:2"] if scale.quick else SECOND_DEPTHS
    places = SECOND_FEW if scale.quick else SECOND_PLACES
    over = {**ROD, "depth_mm": depths, "position_cm": [places]}
    n_cycles = FEWER_CYCLES if scale.quick else CYCLES
    return _cycles(work / "second", over, level, scale, n_cycles, console)


def _cycles(
    work: Path,
    over: dict[str, list[str]],
    level: Level,
    scale: Scale,
    n_cycles: int,
    console: Console,
) -> xr.Dataset:
    """Sweep, record and process."""
    cases = swept(work / "sweep", over, level, scale, console)
    recipe = Recipe(n_cycles=n_cycles)
    run_dataset([work / "sweep"], work / "cycles", recipe, console, workers=scale.workers)
    describing = Describing(kind="paper", processing=processing_of(cases, recipe))
    with heard_interrupts() as check, stage_progress(console) as show:

        def report(stage: str, share: float) -> None:
            check()
            show(stage, share)

        return table_of(sorted((work / "cycles").glob("cycles-*.nc")), describing, report)


def processing_of(cases: xr.Dataset, recipe: Recipe) -> Processing:
    """Return the processing of the tube that a sweep presses, calibrated on that specimen."""
    config = configured(json.loads(str(cases["configuration"].values[0])))
    found, _ = calibrated(seed_of(f"{tube_of(config)}-0", recipe.seed))
    return found.processing


def trained_network(table: xr.Dataset, scale: Scale, console: Console) -> Model:
    """Return the paper's force network, trained on cycles.

    Parameters
    ----------
    table : xarray.Dataset
        From :func:`recorded`.
    scale : Scale
    console : rich.console.Console

    Returns
    -------
    Model
    """
    settings: dict[str, Any] = {"epochs": 5} if scale.quick else {}
    total = settings.get("epochs", 100)
    with heard_interrupts() as check, stage_progress(console) as show:

        def learned(step: float, *_losses: float) -> None:
            check()
            show("training", step / total)

        return estimation.train(table, "network", Describing(), progress=learned, **settings)


# ---------------------------------------------------------------------------------------------
# Numbers


def distance_errors(table: xr.Dataset) -> Errors:
    """Return the errors of the distance of cycles with an echo, in m."""
    return estimation.errors(table["true_distance"].values, found_distance(table))


def found_distance(table: xr.Dataset) -> Array:
    """Return the estimated distance of cycles in m; nan without an echo."""
    return np.asarray(table["features"].sel(feature="distance").values)


def told(table: xr.Dataset) -> NDArray[np.bool_]:
    """Return which cycles tell the distance to 25 cm."""
    return np.asarray(np.abs(found_distance(table) - table["true_distance"].values) < FALSE)


def shallowest(table: xr.Dataset, nearest: float, farthest: float) -> float:
    """Return the least depth in m from which all presses in a range are told reliably.

    nan if even the deepest are not.
    """
    place = table["true_distance"].values
    inside = table.isel(cycle=(place >= nearest) & (place <= farthest))
    depths, number = np.unique(inside["depth"].values.round(9), return_inverse=True)
    good = [np.mean(told(inside)[number == i]) > RELIABLE for i in range(len(depths))]
    if not good or not good[-1]:
        return float("nan")
    unreliable = np.flatnonzero(~np.array(good))
    return float(depths[unreliable[-1] + 1] if unreliable.size else depths[0])


def localisation_rows(table: xr.Dataset, coarser: xr.Dataset | None) -> list[Row]:
    """Return Table I and what the text says of reach."""
    ours = distance_errors(table)
    other = None if coarser is None else distance_errors(coarser)
    why = (
        "Our echoes are late by two values, 0 and 5 cm (trapped sound), where they rise over the "
        "tube's clutter; where they do not, the highest clutter is taken for them."
    )
    rows = [
        Row(
            quantity=f"distance: {words} absolute error", unit="cm", published=published,
            ours=CM * getattr(ours, name),
            coarser=None if other is None else CM * getattr(other, name), why=why,
        )
        for name, words, published in (
            ("median", "median", 5.23), ("rmse", "RMSE of the", 13.1), ("iqr", "IQR of the", 9.31),
        )
    ]  # fmt: skip
    deep = table["depth"].values > 6.5e-3
    off = np.abs(found_distance(table) - table["true_distance"].values)
    rows += [
        Row(
            quantity="cycles with an echo", unit="%", ours=100 * ours.n / table.sizes["cycle"],
            coarser=None if other is None or coarser is None
            else 100 * other.n / coarser.sizes["cycle"], why="Not published.",
        ),
        Row(
            quantity="depth from which contacts up to 0.6 m are reliable", unit="mm",
            published=2.5, ours=MM * shallowest(table, 0.0, NEAR),
            coarser=None if coarser is None else MM * shallowest(coarser, 0.0, NEAR),
            why="One of the observations that the sensor's clutter was set by.",
        ),
        Row(
            quantity="depth from which contacts beyond 1.95 m are reliable", unit="mm",
            published=7.0, ours=MM * shallowest(table, BEYOND, 3.0),
            coarser=None if coarser is None else MM * shallowest(coarser, BEYOND, 3.0),
            why="One of the observations that the sensor's noise was set by.",
        ),
        Row(
            quantity="distance: mean absolute error, deeper than 6.5 mm", unit="cm",
            ours=CM * float(np.nanmean(off[deep])),
            why="Published as lowest there, below 10 cm on the arm.",
        ),
    ]  # fmt: skip
    return rows


def force_rows(table: xr.Dataset, estimates: xr.Dataset, model: Model) -> list[Row]:
    """Return the flat row of Table II."""
    found = estimation.errors(table["force"].values, estimates["force"].values)
    constant = float(np.median(table["force"].values))
    guess = estimation.errors(table["force"].values, np.full(table.sizes["cycle"], constant))
    why = (
        "Forces of the finite-element press are lower than the paper's by its wall's stiffness and "
        "its floor; errors scale with them. A constant guess, the median, gives "
    )
    rows = [
        Row(
            quantity=f"force: {words} absolute error", unit=unit, published=published,
            ours=scale * getattr(found, name),
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
            why="Not published in the text; predictions cluster about 4 N there.",
        ),
        Row(
            quantity="cycles that the network was trained on", unit="1",
            ours=float(model.origin["trained"]), why="Those of the first dataset with an echo.",
        ),
    ]  # fmt: skip


# ---------------------------------------------------------------------------------------------
# Figures


def _scatter(table: xr.Dataset) -> Figure:
    sheet = Figure(figsize=(7.5, 6), layout="constrained")
    axes = sheet.subplots()
    some = table.isel(cycle=slice(None, None, max(1, table.sizes["cycle"] // 8000)))
    points = axes.scatter(
        CM * some["true_distance"].values, CM * found_distance(some), s=5,
        c=MM * some["depth"].values, cmap="viridis_r", lw=0,
    )  # fmt: skip
    axes.plot([15, 215], [15, 215], "k", lw=0.8)
    for bound in (15, 215):
        axes.axhline(bound, color="0.5", lw=0.8, ls="--")
    axes.set_xlabel("true distance (cm)")
    axes.set_ylabel("estimated distance (cm)")
    sheet.colorbar(points, ax=axes, label="depth (mm)")
    return sheet


def over_map(table: xr.Dataset, values: NDArray[Any]) -> tuple[Array, Array, Array]:
    """Return means of what is finite, and their bins of distance and depth.

    Returns
    -------
    places : array of shape (n + 1,)
        Edges in m.
    depths : array of shape (m,)
        In m.
    mean : array of shape (m, n)
        nan where there is none.
    """
    edges, column = estimation.bins(table["true_distance"].values, BIN)
    depths, row = np.unique(table["depth"].values.round(9), return_inverse=True)
    good = np.isfinite(values)
    shape = (len(depths), len(edges))
    number = np.ravel_multi_index((row[good], column[good]), shape)
    total = np.bincount(number, values[good], minlength=shape[0] * shape[1])
    count = np.bincount(number, minlength=shape[0] * shape[1])
    with np.errstate(invalid="ignore"):
        mean = (total / count).reshape(shape)
    return edges[:, 0], depths, mean


def _maps(table: xr.Dataset) -> Figure:
    sheet = Figure(figsize=(12, 4.5), layout="constrained")
    left, right = sheet.subplots(1, 2)
    size = np.abs(found_distance(table) - table["true_distance"].values)
    _draw_map(left, *over_map(table, CM * size), "mean absolute error (cm)", vmax=50)
    _draw_map(right, *over_map(table, 100.0 * told(table)), "cycles told to 25 cm (%)", vmax=100)
    return sheet


def _draw_map(
    axes: Axes, places: Array, depths: Array, values: Array, label: str, **colours: Any
) -> None:
    axes.set_facecolor("0.8")
    image = axes.pcolormesh(
        CM * (places + BIN / 2), MM * depths, values, shading="nearest", **colours
    )
    axes.set_xlabel("true distance (cm)")
    axes.set_ylabel("depth (mm)")
    axes.figure.colorbar(image, ax=axes, label=label)


def _amplitudes(first: xr.Dataset, second: xr.Dataset) -> Figure:
    sheet = Figure(figsize=(12, 4.5), layout="constrained")
    for axes, table in zip(sheet.subplots(1, 2), (first, second), strict=True):
        heights = np.asarray(table["features"].sel(feature="amplitude").values)
        wrong = np.abs(found_distance(table) - table["true_distance"].values)
        places, depths, mean = over_map(table, heights)
        mean[~(over_map(table, wrong)[2] <= FALSE)] = np.nan
        _draw_map(axes, places, depths, _smoothed(mean), "highest peak (share of the send pulse)",
                  norm=LogNorm(1e-3, 1.0))  # fmt: skip
    return sheet


def _smoothed(values: Array) -> Array:
    """Return the exponential of the smoothed logarithm, missing values left out."""
    known = np.isfinite(values)
    weight = gaussian_filter(known.astype(float), 1.0)
    total = gaussian_filter(np.where(known, np.log(np.where(known, values, 1.0)), 0.0), 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(known, np.exp(total / weight), np.nan)


def _forces(table: xr.Dataset, estimates: xr.Dataset) -> Figure:
    sheet = Figure(figsize=(12, 4.5), layout="constrained")
    left, right = sheet.subplots(1, 2)
    truth, found = table["force"].values, estimates["force"].values
    places = np.unique(table["true_distance"].values.round(9))
    depths = np.unique(table["depth"].values.round(9))
    by_depth = [truth[np.isclose(table["depth"].values, depth)][0] for depth in depths]
    left.plot(MM * depths, by_depth, color="0.5", lw=3, label="truth")
    for i, place in enumerate(places):
        mean = _means(table, found, place, depths)
        left.plot(MM * depths, mean, ".-", color=f"C{i}", lw=0.8, label=f"{CM * place:g} cm")
    left.set_xlabel("depth (mm)")
    left.set_ylabel("force (N)")
    left.set_ylim(bottom=0)
    left.legend(fontsize="small")
    relative = 100 * np.abs(found - truth) / np.maximum(truth, 1e-9)
    image = np.stack([_means(table, relative, place, depths) for place in places])
    right.set_facecolor("0.8")
    drawn = right.pcolormesh(MM * depths, CM * places, image, shading="nearest", vmin=0, vmax=100)
    right.set_xlabel("depth (mm)")
    right.set_ylabel("true distance (cm)")
    sheet.colorbar(drawn, ax=right, label="mean absolute relative error (%)")
    return sheet


def _means(table: xr.Dataset, values: Array, place: float, depths: NDArray[Any]) -> Array:
    """Return the mean at each depth of what is finite at a place."""
    here = np.isclose(table["true_distance"].values, place) & np.isfinite(values)
    at, depth = values[here], table["depth"].values[here]
    some = [at[np.isclose(depth, one)] for one in depths]
    return np.array([one.mean() if one.size else np.nan for one in some])
