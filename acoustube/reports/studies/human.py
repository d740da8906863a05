"""The human arm (section II-G.2, Fig. 7, Table I): a sleeve on soft ground, pressed by hand."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from acoustube.base.report import Reporter
from acoustube.base.types import Array
from acoustube.base.units import CM, MM, PERCENT
from acoustube.reports.studies import human_figures, inverted, ranged
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
from acoustube.reports.studies.human_figures import LEVELS
from acoustube.reports.studies.presses import swept
from acoustube.reports.studies.report import Level, Row, Scale, Study, Tables, compared_row
from acoustube.reports.studies.swipe import resolved_pairs, swipe_figure, swipe_rows, swiped
from acoustube.runs import presses as press_runs
from acoustube.runs.by_force import ByForce, by_force
from acoustube.runs.config import Config, configured
from acoustube.waves.scattering import ModalScattering

STATES = np.array([1, 3, 5]) / 6
"""Forces in the course of one press, as fractions of the range of its level of force: the force of
a hand drifts."""
CYCLES = (14, 13, 13)
"""Number of cycles at each force of `STATES`: 2 s in all."""
SHIFT = -0.10
"""Offset in m of the positions on the second tube from those on the first."""
ARM = {"layer_mm": 20.0, "layer_mpa": 0.06}
"""Layer of soft tissue: 20 mm with a Young's modulus of 60 kPa; see :func:`ground`."""
SOFTER = {"layer_mm": 20.0, "layer_mpa": 0.03}
LIBRARY = "0.5:14:0.5"
"""Depths in mm of the library of the inversion."""
GRID = tuple(np.arange(0.5, 15.01, 0.5) / MM)
"""Depths in m of the load path on which a press is interpolated by force."""
RIGID_GRID = tuple(np.arange(0.5, 8.01, 0.5) / MM)
"""Depths in m of the load path on a rigid arm, on which a press is interpolated by force."""


def study(scale: Scale, work: Path, report: Reporter) -> Study:
    """Press a sleeve on a soft arm at three levels of force, and locate the presses."""
    table, presses, cycles = recorded(scale.level, scale, work / "arm", report)
    coarser = None
    if scale.coarser is not None:
        coarser = recorded(scale.coarser, scale, work / "coarser", report)[0]
    like = next(iter(presses.values()))[1]
    inversion = None
    if not scale.quick:
        inversion = _inverted(table, cycles, like, scale, work / "library", report)
    tables = Tables(table, coarser, inversion)
    report.line("a swipe, and two presses at once ...")
    tracks = swiped(presses, quick=scale.quick)
    pairs = resolved_pairs(presses, quick=scale.quick)
    paths = substrates(quick=scale.quick)
    figures = {
        "True against estimated distance of averaged cycles on the first (discs) and second "
        "(squares) tube, by force; circled: errors over 25 cm (left). Located presses by "
        "force and distance; grey: errors over 25 cm (right).": human_figures.distances(table),
        "Presses by force on several grounds: travel of the indenter (left), and loss of lumen "
        "height "
        "(right).": human_figures.grounds(paths),
        "A press that swipes along the tube at 5 cm/s (left), and two presses 20 cm apart (right): "
        "echoes, and the tracked contacts.": swipe_figure(tracks),
        **inverted.compared_figures(table, inversion),
    }
    drawn = human_figures.arm(table)
    if drawn is not None:
        figures["True and estimated places of the hardest presses on one tube."] = drawn
    return Study(
        title="Human arm (Fig. 7, Table I)",
        text=TEXT,
        rows=[*distance_rows(tables), *ground_rows(paths), *swipe_rows(tracks, pairs)],
        figures=figures,
    )


TEXT = """\
A 25 mm rod presses both tubes of the sleeve at seven places each, by 2-4, 4-6 and 6-8 N, on an arm
of soft tissue: a layer of 20 mm and 60 kPa on bone. Depth follows from force and ground. The force
of a hand drifts through its level in the 2 s of a press, 40 cycles, which are averaged before they
are processed, as published. Calibration: that of each tube when it is straight. Waveform inversion
is given five cycles of the middle of each press, 200 cycles of each wrapped tube without contact,
the shape of its helix, and a library of the rod on this tissue at depths of its own. The
rangefinder's parameters and the mean error of its thermometer are known to it.

The sleeve, the bends between the presses and the curved tube under the rod are those of the
mannequin.

Unknown to the simulation: the wearer's tissue and what lies under it, how the fabric
stretches, narrows and holds the tube (here it lies free on the arm, and rises beside the press),
how a hand trembles and tilts its tool, and how the two tubes differ but for their irregularities.
The sleeve paper does not describe the probe's tip."""


def ground(layer_mm: float | None = None, layer_mpa: float | None = None) -> Config:
    """Return the settings of a press on an arm.

    Parameters
    ----------
    layer_mm, layer_mpa : float, optional
        Thickness in mm and Young's modulus in MPa of the arm's tissue; None for a rigid arm.

    Notes
    -----
    A forearm's tissue between skin and bone is some 20 mm thick. Its modulus is not constant:
    indentation of limbs gives initial values from under 1 to 58 kPa, which rise steeply with
    compression [1]_; gluteal muscle has 62 kPa under 5 N and 440 kPa under 30 N [2]_; a forearm
    stiffens when its muscles act [3]_. 60 kPa suits muscle under the forces of these presses. The
    layer consists of independent columns (a Winkler foundation). Under the tube's footprint of 10
    by 40 mm they are as stiff as a half space of 0.6 times their modulus.

    References
    ----------
    .. [1] Zheng, Y. and Mak, A. F. T. (1999). Extraction of quasi-linear viscoelastic parameters
       for lower limb soft tissues from manual indentation experiment. Journal of Biomechanical
       Engineering 121, 330-339.
    .. [2] Isogai, K. et al. (2022). Young's moduli of subcutaneous tissues and muscles under
       different loads at the gluteal region calculated using ultrasonography. Journal of Physical
       Therapy Science 34, 777-783. doi:10.1589/jpts.34.777
    .. [3] Iivarinen, J. T. et al. (2011). Experimental and computational analysis of soft tissue
       stiffness in forearm using a manual indentation device. Medical Engineering and Physics 33,
       1245-1253. doi:10.1016/j.medengphy.2011.05.015
    """
    return configured(
        {}, indenter_mm=float(tool(sleeve()[0])), support="free", mesh="coarse", depth_mm=1.0,
        layer_mm=layer_mm, layer_mpa=layer_mpa,
    )  # fmt: skip


def forces_of(level: tuple[float, float]) -> Array:
    """Return the forces in N that sample a level, given its range in N; shape (3,)."""
    return level[0] + (level[1] - level[0]) * STATES


def recorded(
    level: Level, scale: Scale, work: Path, report: Reporter
) -> tuple[xr.Dataset, dict[float, tuple[xr.Dataset, ModalScattering]], list[xr.Dataset]]:
    """Record presses by hand; return the estimates, the computed presses, and some cycles.

    Returns
    -------
    table : xarray.Dataset
        Features of one averaged cycle per press, from :func:`acoustube.estimation.feature_table`,
        with ``level``, the lower end of the press's level of force in N, and ``number``, the index
        of the tube.
    presses : dict
        See :func:`acoustube.reports.studies.arm.by_depth`.
    cycles : list of xarray.Dataset
        Some cycles from the middle of each press, in the order of the table.

    Notes
    -----
    The depth for a force is interpolated on a load path of the coarse mesh. The cases are labelled
    with the forces of the sweep's own mesh, which differ from the prescribed forces by the coarse
    mesh's error.
    """
    report.line("depths of the presses by force on soft ground ...")
    levels = LEVELS[2:] if scale.quick else LEVELS
    wanted = np.concatenate([forces_of(each) for each in levels])
    found = by_force(press_runs.pressed(ground(**ARM), GRID), wanted)
    depths = np.round(MM * found.depth, 2)
    over = {
        "indenter_mm": [tool(sleeve()[0])], "length_cm": ["250"], "position_cm": ["100"],
        "support": ["free"], "depth_mm": [f"{depth:g}" for depth in depths],
    } | {name: [f"{value:g}"] for name, value in ARM.items()}  # fmt: skip
    swept(work, over, level, scale, report)
    presses = dict(sorted(by_depth(work).items()))
    states = list(presses.values())
    rows, kept = [], []
    for tube, helix in enumerate(sleeve()):
        places = (PLACES[::3] if scale.quick else PLACES) + tube * SHIFT
        report.line(f"cycles at {len(places)} places of tube {tube + 1} ...")
        for place in places:
            bends = bent_around(helix, float(place), states[0][1])
            for i, each in enumerate(levels):
                parts = [
                    cycles_of(
                        matrix, float(place), bends, tube=tube, n_cycles=n,
                        name=[float(place), each, j], labels={"force": float(case["force"])},
                    )
                    for j, ((case, matrix), n) in enumerate(
                        zip(states[3 * i : 3 * i + 3], CYCLES, strict=True)
                    )
                ]  # fmt: skip
                row = estimates_of(averaged(parts), tube)
                row = row.assign(level=("cycle", [each[0]]), number=("cycle", [tube]))
                rows.append(row)
                kept.append(parts[len(parts) // 2].isel(cycle=slice(inverted.GROUP)))
    return xr.concat(rows, "cycle", combine_attrs="drop_conflicts"), presses, kept


def _inverted(
    table: xr.Dataset,
    cycles: Sequence[xr.Dataset],
    like: ModalScattering,
    scale: Scale,
    folder: Path,
    report: Reporter,
) -> xr.Dataset:
    """Return estimates by inversion of each press's cycles, with the table's levels and tubes."""
    over = {
        "indenter_mm": [tool(sleeve()[0])], "support": ["free"],
        "depth_mm": [LIBRARY],
    } | {name: [f"{value:g}"] for name, value in ARM.items()}  # fmt: skip
    library = inverted.library_of(folder, over, scale.level, scale, report)
    parts = []
    for tube in range(len(sleeve())):
        some = table["number"].values == tube
        found = inverted.inverted_table(
            [one for one, is_there in zip(cycles, some, strict=True) if is_there],
            sleeve_inverter(library, tube, like), report,
        )  # fmt: skip
        parts.append(found.assign({n: table[n].isel(cycle=some) for n in ("level", "number")}))
    return xr.concat(parts, "cycle", combine_attrs="drop_conflicts")


def averaged(parts: list[xr.Dataset]) -> xr.Dataset:
    """Return the mean of cycles as one cycle of a dataset."""
    joined = xr.concat(parts, "cycle", combine_attrs="drop_conflicts")
    return joined.mean("cycle", keep_attrs=True).expand_dims("cycle").transpose("cycle", ...)


def substrates(*, quick: bool = False) -> dict[str, ByForce]:
    """Return presses at forces up to 8 N on several grounds, by the name of the ground."""
    paths = {"arm of 60 kPa": press_runs.pressed(ground(**ARM), GRID)}
    if not quick:
        paths["arm of 30 kPa"] = press_runs.pressed(ground(**SOFTER), GRID)
        paths["rigid arm"] = press_runs.pressed(ground(), RIGID_GRID)
    return {
        name: by_force(path, np.linspace(0, min(8.0, path.contact_force[-1]), 81))
        for name, path in paths.items()
    }


# ---------------------------------------------------------------------------------------------
# Numbers


def distance_rows(tables: Tables) -> list[Row]:
    """Return rows of the human arm's distance errors in Table I, counts, and errors over the skin.

    With an inversion, its force errors are added.
    """
    why = (
        "A wrapped tube delays echoes in proportion to their distance, and a press is located with "
        "that delay or missed; the sleeve paper adds a hand, whose place is itself known to some "
        "centimetres, and a sleeve that shifts on the skin."
    )
    rows = ranged.distance_rows(tables, (3.8, 14.5, 11.7), why)
    rows += [_counted(tables, low, f"{low:g}-{high:g} N") for low, high in LEVELS]
    return [
        *rows,
        compared_row(
            lambda cycles: float(ranged.false_positives(cycles).sum()), tables,
            quantity="errors over 25 cm (false positives)", unit="1", published=3.0,
            why="Ours are due to the clutter, which is random, with a seed for each tube.",
        ),
        compared_row(
            _reach, tables,
            quantity="farthest located press", unit="cm", published=150.0,
            why="The sleeve paper assumes that the tube's narrowing on the stretched sleeve "
            "shortens the reach; ours is not narrowed.",
        ),
        compared_row(
            lambda cycles: CM * float(np.nanmedian([*_skin(cycles, 0), *_skin(cycles, 1)])), tables,
            quantity="place on the skin: median absolute error", unit="cm",
            why=f"Over the skin two loops are {CM * sleeve()[0].pitch:.2g} cm apart.",
        ),
        *([] if tables.inversion is None else _force_rows(tables.inversion)),
    ]  # fmt: skip


def _force_rows(inversion: xr.Dataset) -> list[Row]:
    """Return rows of the inversion's force errors, which the sleeve paper does not publish."""
    found = ranged.force_errors(inversion)
    return [
        Row(quantity=f"force: {words}", unit=unit, ours=float("nan"), inversion=value,
            why="Not published. The library is that of the wall and tissue that were pressed.")
        for words, unit, value in (
            ("median absolute error", "N", found.median),
            ("median relative error", "%", PERCENT * found.relative),
        )
    ]  # fmt: skip


def _counted(tables: Tables, low: float, words: str) -> Row:
    """Return the row with the number of located presses of the force level from `low` in N."""
    return compared_row(
        lambda cycles: float((ranged.located(cycles) & (cycles["level"].values == low)).sum()),
        tables, quantity=f"located presses, {words}",
        unit=f"of {int((tables.ours['level'].values == low).sum())}",
        why="Published as a figure: fewer of the lower two levels, and fewer with distance.",
    )  # fmt: skip


def _reach(table: xr.Dataset) -> float:
    good = ranged.located(table)
    return CM * float(table["true_distance"].values[good].max()) if good.any() else float("nan")


def _skin(table: xr.Dataset, tube: int) -> Array:
    part = table.isel(cycle=table["number"].values == tube)
    return over_skin(sleeve()[tube], ranged.found_distance(part), part["true_distance"].values)


def ground_rows(paths: dict[str, ByForce]) -> list[Row]:
    """Return rows of the indenter's travel and the loss of lumen height at 5 N, by ground."""
    rows = []
    for name, path in paths.items():
        travel, closing = (np.interp(5.0, path.force, v) for v in (path.depth, path.closing))
        rows += [
            Row(quantity=f"travel of the indenter at 5 N, {name}", unit="mm",
                ours=MM * float(travel), why="The ground yields as well as the tube."),
            Row(quantity=f"loss of lumen height at 5 N, {name}", unit="mm",
                ours=MM * float(closing),
                why="The shape of the lumen follows from the force, almost whatever the ground."),
        ]  # fmt: skip
    return rows
