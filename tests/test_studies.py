"""The studies' arithmetic on synthetic data, their report, and the command that runs them."""

import csv
import dataclasses
import shutil
from io import StringIO
from typing import get_args

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from matplotlib.figure import Figure
from refusals import refused
from rich.console import Console
from test_inversion import press, tool

from acoustube.base.console import ConsoleReporter
from acoustube.base.errors import ConfigError
from acoustube.base.report import SILENT
from acoustube.cli._app import app, main
from acoustube.cli.reproduce import STUDIES, run_reproduce
from acoustube.inversion import Library
from acoustube.ranging import record
from acoustube.recordings import write as write_cycles
from acoustube.reports.studies import (
    calibration,
    echotube,
    flat,
    flat_figures,
    inverted,
    ranged,
    simulation,
    simulation_cases,
)
from acoustube.reports.studies.report import COLUMNS, Row, Scale, Study, Tables, page, write
from acoustube.signals import Echoes, Ranging


def table(presses):
    """Return processed cycles from tuples of true distance, depth and estimate in m."""
    true, depth, found = np.array(presses, float).T
    features = np.stack([np.where(np.isfinite(found), 0.01, np.nan), found], axis=-1)
    return xr.Dataset(
        {
            "features": (("cycle", "feature"), features),
            "true_distance": ("cycle", true),
            "depth": ("cycle", depth),
        },
        {"feature": ["amplitude", "distance"]},
    )


# ---------------------------------------------------------------------------------------------
# The report


def test_row_states_difference_and_change():
    row = Row(quantity="a", unit="cm", ours=4.0, published=5.0, coarser=5.0)
    assert row.difference == pytest.approx(-0.2)
    assert row.change == pytest.approx(-0.25)
    alone = Row(quantity="a", unit="cm", ours=4.0)
    assert np.isnan(alone.difference)
    assert np.isnan(alone.change)


def test_report_holds_all_numbers_and_marks_what_is_far_off(tmp_path):
    rows = [
        Row(
            quantity="near",
            unit="cm",
            ours=4.0,
            published=5.0,
            coarser=4.2,
            inversion=0.0125,
            why="<why>",
        ),
        Row(quantity="far", unit="N", ours=2.0, published=5.0),
        Row(quantity="missing", unit="N", ours=float("nan"), published=5.0),
    ]
    figure = Figure(figsize=(1, 1))
    study = Study(title="A & B", text="One.\n\nTwo.", rows=rows, figures={"it's": figure})
    write(study, "some", tmp_path)
    with (tmp_path / "table.csv").open(encoding="utf-8", newline="") as file:
        written = list(csv.DictReader(file))
    assert tuple(written[0]) == COLUMNS
    assert [line["quantity"] for line in written] == ["near", "far", "missing"]
    assert float(written[0]["difference_percent"]) == pytest.approx(-20)
    assert float(written[0]["change_percent"]) == pytest.approx(-5)
    assert float(written[0]["inversion"]) == 0.0125
    assert written[1]["inversion"] == written[2]["ours"] == ""
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert text.count("<tr class=far>") == 1
    assert text.count("<p>") == 3
    assert "A &amp; B" in text
    assert "<td>0.0125</td>" in text
    assert "&lt;why&gt;" in text
    assert "http" not in text
    assert (tmp_path / "figure-1.png").read_bytes()[:4] == b"\x89PNG"


def test_measures_are_those_of_each_table_that_there_is():
    """Errors of 4 cm on the usual level, 1 cm on the coarser one, a millimetre by inversion."""
    given = [table([(0.5, 1e-3, 0.5 + off)]) for off in (0.04, 0.01, 1e-3)]
    (row, *_) = ranged.distance_rows(Tables(*given), (5.0, None, None), "")
    assert (row.ours, row.coarser, row.inversion) == pytest.approx((4.0, 1.0, 0.1))
    (row, *_) = ranged.distance_rows(Tables(given[0]), (5.0, None, None), "")
    assert (row.coarser, row.inversion) == (None, None)


@pytest.mark.slow
def test_recordings_of_a_study_are_inverted():
    """Positions within 0.3 mm and forces within 5 %, as by the inversion itself.

    The force of the synthetic tool is 2 N/mm^2.
    """
    inverter = inverted.inverter_of(Library([tool()]), [], session_seed=3, tube_seed=7)
    cycles = []
    for number, (place, depth) in enumerate([(0.53, 3e-3), (0.91, 5e-3), (1.2, 0.0)]):
        one = record(
            [press(depth, place)] if depth else [], n_cycles=inverted.GROUP, tube_seed=7,
            session_seed=3, seed=number,
        )  # fmt: skip
        labels = {"true_distance": place, "depth": depth, "force": 2e6 * depth**2}
        cycles.append(
            one.assign({n: ("cycle", np.full(inverted.GROUP, v)) for n, v in labels.items()})
        )
    found = inverted.inverted_table(cycles, inverter, SILENT)
    np.testing.assert_allclose(ranged.found_distance(found), [0.53, 0.91, np.nan], atol=3e-4)
    np.testing.assert_allclose(found["estimated_force"], [18, 50, np.nan], rtol=0.05)
    assert ranged.force_errors(found).n == 2
    np.testing.assert_array_equal(ranged.located(found), [True, True, False])


def test_share_of_small_errors_counts_what_is_not_found_as_large():
    """Errors of 1 and 10 cm in two of four recordings, the others without an echo: up to a half."""
    sheet = inverted.errors_figure(
        {"peak": ([0.5, 0.5, 0.5, 0.5], [0.51, 0.6, np.nan, np.nan])}, {}
    )
    (axes,) = sheet.axes
    (line,) = axes.lines
    np.testing.assert_allclose(line.get_xdata(), [1, 10])
    np.testing.assert_allclose(line.get_ydata(), [25, 50])


def test_presses_of_the_study_are_chosen_by_their_places(tmp_path):
    """Every second position, without the presses of 0.5 mm, and the first cycles of each press."""
    for i, (place, depth) in enumerate([(z, d) for z in (0.3, 0.4, 0.5) for d in (0.5e-3, 2e-3)]):
        cycles = record([], n_cycles=7, seed=i)
        known = {"true_distance": place, "depth": depth, "force": 1.0}
        cycles = cycles.assign({n: ("cycle", np.full(7, v)) for n, v in known.items()})
        write_cycles(cycles, tmp_path / f"cycles-{i}.nc")
    found = flat.every_nth(tmp_path, "true_distance", 2)
    assert [float(one["true_distance"][0]) for one in found] == pytest.approx([0.3, 0.5])
    assert {one.sizes["cycle"] for one in found} == {inverted.GROUP}
    assert all(one["depth"].values == pytest.approx(2e-3) for one in found)


@pytest.mark.parametrize("network", [False, True])
def test_figure_compares_the_inversion_with_what_there_is(network):
    cycles = table([(0.5, 1e-3, 0.51), (0.5, 1e-3, np.nan)]).assign(force=("cycle", [1.0, 2.0]))
    by_inversion = cycles.assign(estimated_force=("cycle", [1.1, 2.0]))
    assert inverted.compared_figures(cycles, None) == {}
    forces = (cycles["force"], np.array([2.0, 2.0])) if network else None
    ((caption, sheet),) = inverted.compared_figures(cycles, by_inversion, forces).items()
    assert ("network" in caption) is network
    names = [line.get_label() for axes in sheet.axes for line in axes.lines]
    places, pressed = ["highest peak", "waveform inversion"], ["waveform inversion"]
    assert names == places + ["force network"] * network + pressed


def test_page_without_figures_is_a_page():
    assert "<img" not in page(Study(title="a", text="b", rows=[]), {})


# ---------------------------------------------------------------------------------------------
# Arithmetic


def test_contacts_are_reliable_from_the_depth_beyond_which_none_is_missed():
    """Located at 1 mm by chance, not at 2 mm, then always: reliable from 3 mm."""
    near = [(0.3, d, 0.3 + off) for d, off in ((1e-3, 0.0), (2e-3, 0.5), (3e-3, 0.1), (4e-3, 0.0))]
    far = [(2.0, d, np.nan) for d in (1e-3, 2e-3, 3e-3, 4e-3)]
    cycles = table(near + far)
    assert ranged.shallowest(cycles, 0.0, 0.6) == pytest.approx(3e-3)
    assert np.isnan(ranged.shallowest(cycles, 1.95, 3.0))


def test_errors_of_the_distance_leave_out_what_is_not_detected():
    found = ranged.distance_errors(
        table([(0.5, 1e-3, 0.54), (0.5, 1e-3, 0.46), (1.0, 1e-3, np.nan)])
    )
    assert found.n == 2
    assert found.rmse == pytest.approx(0.04)


def test_a_press_of_six_and_a_half_millimetres_is_not_deeper_than_that():
    """Its depth in m as the sum of steps is larger by a rounding error."""
    depth = 6.5e-3 + 1e-18
    assert depth > 6.5e-3
    cycles = table([(0.5, depth, 0.9), (0.5, 7e-3, 0.51)])
    assert ranged.error_of_deep(cycles) == pytest.approx(1.0)


def test_map_averages_each_press_in_its_bin():
    cycles = table([(0.21, 1e-3, 0.3), (0.24, 1e-3, 0.3), (0.26, 1e-3, 0.3), (0.21, 2e-3, 0.3)])
    places, depths, mean = flat_figures.over_map(cycles, np.array([1.0, 3.0, 7.0, np.nan]))
    np.testing.assert_allclose(places, [0.20, 0.25])
    np.testing.assert_allclose(depths, [1e-3, 2e-3])
    np.testing.assert_array_equal(mean, [[2.0, 7.0], [np.nan, np.nan]])


def test_smoothing_keeps_a_constant_and_what_is_missing():
    values = np.full((6, 6), 0.02)
    values[2, 3] = np.nan
    found = flat_figures.smoothed(values)
    assert np.isnan(found[2, 3])
    np.testing.assert_allclose(found[np.isfinite(values)], 0.02)


def test_rising_counts_steps_and_missing_echoes_as_none():
    assert simulation.rising(np.array([np.nan, 0.1, 0.2, 0.1])) == pytest.approx(2 / 3)


def test_late_share_of_a_pulse_and_its_weaker_repetition():
    """An echo at the expected time and one of half its amplitude 1 ms later: a fifth is late.

    20 cm there and 18 back at 343.2 m/s take 1.1072 ms, half of 11 cycles 0.1310 ms.
    """
    time = np.arange(0, 4e-3, 1e-6)
    middle = 1.2382e-3
    signal = np.exp(-(((time - middle) / 3e-5) ** 2))
    signal += 0.5 * np.exp(-(((time - middle - 1e-3) / 3e-5) ** 2))
    cases = xr.Dataset(
        {
            "pressure": (("press", "source_end", "time"), signal[None, None]),
            "true_distance": ("press", [0.2]),
            "temperature": ("press", [20.0]),
        },
        {"source_end": ["absorbing"], "time": time},
    )
    assert simulation_cases.late_fraction(cases) == pytest.approx([0.2], rel=1e-6)


def test_reach_is_where_the_loss_there_and_back_is_the_dynamic_range():
    """Kirchhoff: 13.35 dB/m at the wall of 7.9 mm; ISO 9613-1: 1.39 dB/m in air of 50 %."""
    assert echotube.attenuation(7.9) == pytest.approx(13.35 + 1.39, abs=0.05)
    plain = echotube.reach(8.0, 60.0, coupled=False)
    assert 2 * plain * echotube.attenuation(8.0) == pytest.approx(60.0)
    assert echotube.reach(8.0, 60.0, coupled=True) == pytest.approx(plain)
    # A quarter of the area, passed twice: 24 dB.
    narrow = echotube.reach(4.0, 60.0, coupled=True)
    assert 2 * narrow * echotube.attenuation(4.0) == pytest.approx(60.0 - 40 * np.log10(4))


def test_two_presses_are_the_highest_peaks_near_their_places():
    times = 2 * np.array([0.61, 0.66, 0.9, 1.3]) / 343.2
    peaks = np.array([0.01, 0.02, 0.01, 0.3])
    blank = np.array(np.nan)
    ranging = Ranging(
        envelope=np.zeros(3), send_time=np.array(0.0), send_amplitude=np.array(1.0),
        echoes=Echoes(times, peaks, peaks), return_time=blank, amplitude=blank, prominence=blank,
        distance=blank, distance_deviation=blank, detected=np.array(True),
    )  # fmt: skip
    offsets = echotube.both(ranging, (0.6, 0.8, 2.0))
    assert offsets[0] == pytest.approx(0.06, abs=1e-3)
    assert np.isnan(offsets[2])
    assert np.isnan(offsets[1])
    none = dataclasses.replace(ranging, echoes=Echoes(*3 * [np.empty(0)]))
    assert np.isnan(echotube.both(none, (0.6, 0.8))).all()


@pytest.mark.slow
def test_dead_zone_is_that_of_the_ring_down():
    """For 13 cycles sent and a ring-down with Q = 14 it ends between 10 and 16 cm."""
    assert 0.10 < echotube.dead_zone(8.0) < 0.16


@pytest.mark.slow
@pytest.mark.long
def test_calibration_is_that_of_the_tube_with_few_false_detections():
    found, factor = calibration.calibrated(3)
    assert found.slope.value == pytest.approx(1.0, abs=3e-3)
    assert found.false_alarms < calibration.FALSE_ALARMS
    # White noise needs a factor of 2.8 or more; the published asymptotes within 5 %.
    assert factor > 2.8
    gain = found.processing.gain
    assert gain.c4 - gain.c1 == pytest.approx(0.635, rel=0.05)
    assert gain.c4 + gain.c1 == pytest.approx(0.104, rel=0.1)
    assert calibration.calibrated(3)[0] is found


# ---------------------------------------------------------------------------------------------
# The command


@pytest.mark.slow
def test_command_writes_pages_and_a_table_and_goes_on(tmp_path):
    out = tmp_path / "studies"
    said = StringIO()
    run_reproduce(
        ["calibration"], out, Scale(quick=True), ConsoleReporter(Console(file=said, width=200))
    )
    for name in ("index.html", "table.csv", "calibration/index.html", "calibration/figure-1.png"):
        assert (out / name).is_file(), name
    rows = pd.read_csv(out / "table.csv", index_col="quantity")
    slope = rows.loc[[name for name in rows.index if "slope" in name]]
    assert slope["ours"].to_numpy() == pytest.approx(1.0, abs=3e-3)
    # Results of an earlier command stay in the list and in the table.
    shutil.copytree(out / "calibration", out / "echotube")
    assert f"{slope['published'].iloc[0]:g}" in said.getvalue()
    run_reproduce(["calibration"], out, Scale(quick=True), ConsoleReporter(Console(quiet=True)))
    assert len(pd.read_csv(out / "table.csv")) == 2 * len(rows)
    assert 'href="echotube/index.html"' in (out / "index.html").read_text(encoding="utf-8")
    refused(
        lambda: run_reproduce(["calibration"], out, Scale(), ConsoleReporter(Console(quiet=True))),
        setting="out", value=out, advice="name a new folder",
    )  # fmt: skip


def test_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ConfigError, match="is not empty and nothing is overwritten"):
        run_reproduce(["calibration"], tmp_path, Scale(), ConsoleReporter(Console(quiet=True)))
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_unreadable_mark_is_reported(tmp_path):
    (tmp_path / "reproduce.json").write_text("{")
    with pytest.raises(ConfigError, match=r"reproduce.json is damaged"):
        run_reproduce(["calibration"], tmp_path, Scale(), ConsoleReporter(Console(quiet=True)))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "reproduce needs the name of a study, or all"),
        (["flatt"], "flatt"),
        (
            ["flat", "--workers", "0"],
            "workers = 0 is out of range; use a whole number from 1 to 1024",
        ),
    ],
)
def test_wrong_words_are_refused(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", *words]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.iterdir())


def test_every_study_can_be_named():
    arguments = app["reproduce"].assemble_argument_collection()
    (words,) = (argument for argument in arguments if argument.name == "STUDY")
    assert {*STUDIES, "all"} == set(get_args(get_args(words.hint)[0]))
