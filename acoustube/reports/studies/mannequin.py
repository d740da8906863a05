"""The mannequin's arm (section II-G.1, Fig. 6, Tables I and II): a wrapped tube on a rigid arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from acoustube import estimation
from acoustube.base.report import Reporter
from acoustube.base.types import Array
from acoustube.base.units import CM, MM
from acoustube.estimation import Model
from acoustube.reports.studies import flat, flat_figures, inverted, ranged
from acoustube.reports.studies.arm import (
    PLACES,
    bent_around,
    by_depth,
    cycles_of,
    estimates_of,
    over_skin,
    sleeve,
    sleeve_inverter,
    tool,
)
from acoustube.reports.studies.presses import swept
from acoustube.reports.studies.report import Level, Row, Scale, Study, Tables, compared_row
from acoustube.sleeve import Helix
from acoustube.waves.scattering import ModalScattering

DEPTHS, FEW_DEPTHS = "1:8:0.5", "2:8:3"
CYCLES, FEWER_CYCLES = 50, 5
TUBE = 0
"""Index of the pressed tube of the sleeve."""
SHAPES = ("straight", "wrapped", "flattened")
"""Shapes of the tube that are compared; the study's numbers are those of the wrapped tube."""


def study(scale: Scale, work: Path, report: Reporter) -> Study:
    """Press a sleeve on a rigid arm, locate the presses, and estimate their forces."""
    by_shape, cycles, like = recorded(scale.level, scale, work / "arm", SHAPES, report)
    coarser = None
    if scale.coarser is not None:
        others, _, _ = recorded(scale.coarser, scale, work / "coarser", SHAPES[1:2], report)
        coarser = others["wrapped"]
    network = flat_network(scale, work / "flat", report)
    table = by_shape["wrapped"]
    helix = sleeve()[TUBE]
    forces = estimation.estimate(network, table)
    inversion = None
    if not scale.quick:
        over = {"indenter_mm": [tool(helix)]}
        library = inverted.library_of(work / "library", over, scale.level, scale, report)
        inversion = inverted.inverted_table(cycles, sleeve_inverter(library, TUBE, like), report)
    tables = Tables(table, coarser, inversion)
    rows = [*distance_rows(tables, helix), *force_rows(tables, network), *shape_rows(by_shape)]
    return Study(
        title="Mannequin's arm (Fig. 6, Tables I and II)",
        text=TEXT,
        rows=rows,
        figures={
            "True against estimated distance of single cycles, coloured by depth; dashed the "
            "search window (left). Mean absolute error of each press, along the tube and over "
            "the skin (right).": _places(table, helix),
            "Force against depth: truth and the network's estimates, by distance (left); mean "
            "absolute relative error of each press (right).": flat_figures.forces(table, forces),
            "Highest peak of presses 5 mm (left) and 8 mm deep at each place: straight tube, "
            "wrapped, and wrapped and flattened.": _heights(by_shape),
            **inverted.compared_figures(table, inversion, (table["force"], forces["force"])),
        },
    )


TEXT = """\
A 25 mm rod presses one tube of a sleeve at seven places to 15 depths, and 50 cycles of each are
recorded. The sleeve is a helix of 9 loops on a cone of the size of a forearm, which takes 250 cm of
tube. The arm is rigid, and the sleeve's pocket holds the tube on it. The tube bends away from the
rod, which is as if a thinner rod pressed a straight tube. Between the presses the tube is bent: its
curvature and torsion convert the plane wave into (1,1) and back, so that the incident sound depends
on the place of the press on the arm.

As published, calibration and force network are those of a straight tube: the calibration of this
specimen before it was wrapped, the network of the 25 mm rod on the flat table, from every fifth of
its places and five cycles of each press.

Waveform inversion is given five cycles of each press, 200 cycles of the wrapped tube without
contact, the shape of its helix, and a library of the rod at depths of its own. Its model has the
modes of the bent tube; the recordings are simulated with the bends in series, joined by all their
modes. The rangefinder's parameters and the mean error of its thermometer are known to it.

Unknown to the simulation: how the fabric stretches and narrows the tube, how much of a free tube's
flattening it allows (the last rows state the effect of all of it), how the tubes differ, where the
test machine's rod slid, and how the arm's curved surface took the deep presses."""


def flat_network(scale: Scale, work: Path, report: Reporter) -> Model:
    """Return the force network trained on the flat table's study, with every fifth position."""
    table = flat.recorded(scale.level, scale, work, report, few=True)
    return flat.trained_network(table, scale, report)


def recorded(
    level: Level, scale: Scale, work: Path, shapes: tuple[str, ...], report: Reporter
) -> tuple[dict[str, xr.Dataset], list[xr.Dataset], ModalScattering]:
    """Record presses on the sleeve; return estimates, some cycles, and a scattering matrix.

    Parameters
    ----------
    level : Level
    scale : Scale
    work : Path
    shapes : tuple of str
        Shapes from :data:`SHAPES`.
    report : Reporter

    Returns
    -------
    estimates : dict of xarray.Dataset
        Distances and labels by shape, from :func:`acoustube.estimation.feature_table`.
    cycles : list of xarray.Dataset
        The first cycles of each press of the wrapped tube; empty if `shapes` does not include it.
    matrix : ModalScattering
        Scattering matrix of the shallowest press.
    """
    helix = sleeve()[TUBE]
    over = {
        "indenter_mm": [tool(helix)], "length_cm": ["250"], "position_cm": ["100"],
        "depth_mm": [FEW_DEPTHS if scale.quick else DEPTHS],
    }  # fmt: skip
    swept(work, over, level, scale, report)
    presses = by_depth(work)
    places = PLACES[::3] if scale.quick else PLACES
    report.line(f"cycles at {len(places)} places on the sleeve, tube {', '.join(shapes)} ...")
    found: dict[str, list[xr.Dataset]] = {shape: [] for shape in shapes}
    like = next(iter(presses.values()))[1]
    kept = []
    for place in places:
        for shape in shapes:
            bends = [] if shape == "straight" else bent_around(
                helix, float(place), like, flattened=shape == "flattened"
            )  # fmt: skip
            for depth, (case, matrix) in presses.items():
                n_cycles = CYCLES if shape == "wrapped" and not scale.quick else FEWER_CYCLES
                cycles = cycles_of(
                    matrix, float(place), bends, tube=TUBE, n_cycles=n_cycles,
                    name=[shape, float(place), depth],
                    labels={"depth": depth, "force": float(case["force"])},
                )  # fmt: skip
                found[shape].append(estimates_of(cycles, TUBE))
                if shape == "wrapped":
                    kept.append(cycles.isel(cycle=slice(inverted.GROUP)))
    estimates = {
        shape: xr.concat(parts, "cycle", combine_attrs="drop_conflicts")
        for shape, parts in found.items()
    }
    return estimates, kept, like


# ---------------------------------------------------------------------------------------------
# Numbers


def distance_rows(tables: Tables, helix: Helix) -> list[Row]:
    """Return rows of the mannequin's distance errors in Table I, and of errors over the skin."""
    why = (
        "A wrapped tube delays echoes in proportion to their distance, and more so those of "
        "shallow presses, which arrive by the slow mode (1,1); echoes below the clutter are "
        "missed, not misplaced. The sleeve paper's arm adds the effect of its fabric on the tube."
    )
    rows = ranged.distance_rows(tables, (8.48, 14.0, 12.9), why)

    def skin(cycles: xr.Dataset) -> Array:
        return over_skin(helix, ranged.found_distance(cycles), cycles["true_distance"].values)

    return [
        *rows,
        compared_row(
            ranged.error_of_deep, tables,
            quantity="distance: mean absolute error, deeper than 6.5 mm", unit="cm",
            why="Published as below 10 cm on average.",
        ),
        compared_row(
            lambda cycles: CM * float(np.nanmedian(skin(cycles))), tables,
            quantity="place on the skin: median absolute error", unit="cm",
            why=f"Over the skin, neighbouring loops are {CM * helix.pitch:.2g} cm apart: an error "
            "of a whole loop along the tube is only this large there.",
        ),
        compared_row(
            lambda cycles: CM * float(np.sqrt(np.nanmean(skin(cycles) ** 2))), tables,
            quantity="place on the skin: RMSE", unit="cm", why="Not published.",
        ),
        *ranged.detection_rows(tables),
        compared_row(
            lambda cycles: CM * farthest(cycles), tables,
            quantity="farthest located press", unit="cm", published=210.0,
            why=f"Presses are {CM * (PLACES[1] - PLACES[0]):g} cm apart; as published, only the "
            "deepest are located so far away.",
        ),
    ]  # fmt: skip


def farthest(table: xr.Dataset) -> float:
    """Return the largest distance in m at which a press is located in most cycles; nan if none."""
    good = [
        place
        for place in np.unique(table["true_distance"].values)
        for depth in np.unique(table["depth"].values)
        for here in [(table["true_distance"].values == place) & (table["depth"].values == depth)]
        if np.mean(ranged.located(table)[here]) > ranged.RELIABLE_FRACTION
    ]
    return max(good, default=float("nan"))


def force_rows(tables: Tables, network: Model) -> list[Row]:
    """Return rows of the mannequin's force errors in Table II."""

    def learned(table: xr.Dataset) -> estimation.Errors:
        estimates = estimation.estimate(network, table)
        return estimation.errors(table["force"].values, estimates["force"].values)

    found = learned(tables.ours)
    coarser = None if tables.coarser is None else learned(tables.coarser)
    inversion = None if tables.inversion is None else ranged.force_errors(tables.inversion)
    largest = float(tables.ours["force"].max())
    why = (
        f"Simulated forces end at {largest:.3g} N; the sleeve paper's are larger where its rod met "
        "the arm. As published, the network trained on the flat table estimates them poorly."
    )
    return [
        Row(
            quantity=f"force: {words} absolute error", unit=unit, published=published,
            ours=scale * getattr(found, name),
            coarser=None if coarser is None else scale * getattr(coarser, name),
            inversion=None if inversion is None else scale * getattr(inversion, name), why=why,
        )
        for name, words, unit, published, scale in (
            ("median", "median", "N", 2.19, 1.0), ("rmse", "RMSE of the", "N", 5.61, 1.0),
            ("iqr", "IQR of the", "N", 2.79, 1.0),
            ("relative", "median relative", "%", 59.2, 100.0),
        )
    ]  # fmt: skip


def shape_rows(tables: dict[str, xr.Dataset]) -> list[Row]:
    """Return rows of the effects of wrapping and of flattening the tube on the highest peak."""
    straight = peaks(tables["straight"])
    rows = []
    for shape, words in (("wrapped", "wrapped"), ("flattened", "wrapped and flattened")):
        change = 20 * np.log10(peaks(tables[shape]) / straight)
        rows += [
            Row(
                quantity=f"highest peak, {words} against straight: median", unit="dB",
                ours=float(np.nanmedian(change)), why="Of presses located in both tubes.",
            ),
            Row(
                quantity=f"highest peak, {words} against straight: median absolute deviation",
                unit="dB", ours=float(np.nanmedian(np.abs(change - np.nanmedian(change)))),
                why="From that median: the amplitude of (1,1) at a press depends on its phase.",
            ),
        ]  # fmt: skip
    return rows


def peaks(table: xr.Dataset) -> Array:
    """Return the mean height of the highest peak of each press, (press,).

    The mean is over cycles with a distance error below 25 cm, nan without one. Heights are relative
    to the send pulse.
    """
    presses = _presses(table)
    heights = table["features"].sel(feature="amplitude").values
    good = ranged.located(table)
    return np.array([heights[p & good].mean() if (p & good).any() else np.nan for p in presses])


def _presses(table: xr.Dataset) -> list[NDArray[np.bool_]]:
    """Return the mask of the cycles of each press, in order of place and then of depth."""
    place, depth = table["true_distance"].values, table["depth"].values
    return [
        (place == z) & (depth == d) for z in np.unique(place) for d in np.unique(depth)
    ]  # fmt: skip


# ---------------------------------------------------------------------------------------------
# Figures


def _places(table: xr.Dataset, helix: Helix) -> Figure:
    sheet = Figure(figsize=(12, 5), layout="constrained")
    left, right = sheet.subplots(1, 2)
    found, true = ranged.found_distance(table), table["true_distance"].values
    flat_figures.draw_distances(left, table)
    along, skin = np.abs(found - true), over_skin(helix, found, true)
    _histogram(right, table, {"along the tube": along, "over the skin": skin})
    return sheet


def _histogram(axes: Axes, table: xr.Dataset, errors: dict[str, Array]) -> None:
    """Draw histograms of the mean absolute errors of presses.

    `errors` are the absolute errors of the cycles in m, by their name in the legend.
    """
    edges = np.arange(0, 41, 2.0)
    means = [
        [CM * np.mean(e[p & np.isfinite(e)]) for p in _presses(table) if np.isfinite(e[p]).any()]
        for e in errors.values()
    ]
    axes.hist([np.clip(m, 0, 39.9) for m in means], list(edges), label=list(errors))
    axes.set(
        xlabel="mean absolute error of a press (cm); 38 and more in the last", ylabel="presses"
    )
    axes.legend()


def _heights(tables: dict[str, xr.Dataset]) -> Figure:
    sheet = Figure(figsize=(11, 4.5), layout="constrained")
    places, depths = (
        np.unique(tables["wrapped"][name].values) for name in ("true_distance", "depth")
    )
    middle = int(np.argmin(np.abs(depths - 5e-3)))
    for axes, column in zip(sheet.subplots(1, 2, sharey=True), (middle, -1), strict=True):
        for (shape, table), marker in zip(tables.items(), "os^", strict=True):
            height = peaks(table).reshape(len(places), len(depths))[:, column]
            axes.semilogy(CM * places, height, marker + "-", ms=5, lw=0.8, label=shape)
        axes.set(xlabel="true distance (cm)", title=f"{MM * depths[column]:g} mm deep")
        axes.set_ylabel("highest peak (fraction of the send pulse)")
        axes.legend()
    return sheet
