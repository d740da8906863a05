"""The commands process and calibrate on files."""

import csv
import errno
import re
from pathlib import Path

import numpy as np
import pytest
from commands import run_here
from test_calibration import PLACES, blocked, untouched
from test_pipeline import RATE, TIME, cycles_at

from acoustube import signals
from acoustube.base import writing
from acoustube.cli import main
from acoustube.runs import recordings

DISTANCES = np.linspace(0.3, 1.9, 7)


def save(name, cycles, **extra):
    np.savez(name, signal=cycles.astype(np.uint16), rate=RATE, temperature=20.0, **extra)
    return name


def rows_of(text):
    return list(csv.DictReader(text.splitlines()))


def test_one_row_per_cycle_has_its_distance():
    save("a.npz", cycles_at(DISTANCES, noise=0.002))
    result = run_here("process", "a.npz", "--out", "t.csv", "--prominence", "0.05")
    assert result.returncode == 0, result.stderr
    assert "7 cycles, echoes in 7" in result.stdout
    rows = rows_of(Path("t.csv").read_text())
    assert list(rows[0])[:7] == [
        "cycle", "time_of_flight_ms", "distance_cm", "amplitude", "prominence", "n_peaks",
        "detected",
    ]  # fmt: skip
    assert [int(row["cycle"]) for row in rows] == list(range(7))
    found = np.array([float(row["distance_cm"]) for row in rows])
    # The board's temperature gives 343.24 m/s, the cycles have 343.2: 0.2 mm at 1.9 m.
    assert found == pytest.approx(100 * DISTANCES, abs=0.1)
    assert all(row["detected"] == "1" and row["file"] == "a.npz" for row in rows)
    flight = [float(row["time_of_flight_ms"]) for row in rows]
    assert flight == pytest.approx(2e3 * DISTANCES / 343.2, abs=5e-3)


def test_labels_stand_beside_what_is_found():
    """The second file has no labels."""
    depth = np.where(DISTANCES > 1, 3e-3, np.nan)
    save("a.npz", cycles_at(DISTANCES), true_distance=DISTANCES, depth=depth)
    save("b.npz", cycles_at(DISTANCES))
    rows = rows_of(run_here("process", "a.npz", "b.npz", "--prominence", "0.05").stdout)
    true = [float(row["true_distance_cm"]) for row in rows[:7]]
    assert true == pytest.approx(100 * DISTANCES, rel=1e-5)
    assert [row["depth_mm"] for row in rows[:7]] == ["", "", "", "3", "3", "3", "3"]
    assert {row["force_n"] for row in rows} == {""}
    assert {row["true_distance_cm"] for row in rows[7:]} == {""}


def test_table_goes_to_standard_output_and_many_cycles_are_those_of_one():
    """600 cycles are processed in three pieces on two threads, and written in order."""
    distances = np.linspace(0.3, 1.9, 600)
    cycles = cycles_at(distances, noise=0.002).astype(np.uint16)
    save("a.npz", cycles)
    result = run_here("process", "a.npz", "--prominence", "0.05", "--quiet")
    rows = rows_of(result.stdout)
    assert result.stderr == ""
    alone = signals.locate(TIME, cycles, signals.Processing(prominence=0.05))
    found = [float(row["distance_cm"]) for row in rows]
    assert found == pytest.approx(100 * alone.distance, rel=1e-5)
    assert [float(row["amplitude"]) for row in rows] == pytest.approx(alone.amplitude, rel=1e-5)


def test_bad_files_are_reported_and_the_others_processed():
    Path("runs").mkdir()
    save("runs/a.npz", cycles_at(DISTANCES))
    broken = cycles_at(DISTANCES)
    broken[2, 7] = np.nan
    np.savez("runs/b.npz", signal=broken, rate=RATE, temperature=20.0)
    np.savez("runs/c.npz", signal=cycles_at(DISTANCES).astype(np.uint16), rate=RATE)
    Path("runs/d.wav").write_bytes(b"\xff\xd8\xff\xe0 this is a picture")
    Path("runs/e.npz").write_bytes(Path("runs/a.npz").read_bytes()[:5000])
    save("runs/f.npz", cycles_at(DISTANCES)[:, :40])
    save("runs/g.npz", cycles_at(DISTANCES))
    result = run_here("process", "runs", "--out", "t.csv")
    assert result.returncode == 1
    rows = rows_of(Path("t.csv").read_text())
    assert {Path(row["file"]).name for row in rows} == {"a.npz", "g.npz"}
    assert len(rows) == 14
    told = " ".join((result.stdout + result.stderr).split())
    for name in "bcdef":
        assert f"{name}.{'wav' if name == 'd' else 'npz'}" in told
    assert "5 files could not be processed" in told
    assert "Traceback" not in result.stderr


def test_names_with_brackets_and_cycles_that_begin_elsewhere():
    """Brackets are no markup; a missing send pulse is suspected from the height of an echo."""
    save("y[left].npz", cycles_at(DISTANCES, height=0.5)[:, 80:])
    Path("z[").mkdir()
    np.savez(
        Path("z[") / "b].npz", signal=np.zeros((2, 4000), np.uint16), rate=RATE, temperature=20.0
    )
    words = "process y[left].npz z[/b].npz --prominence 0.05 --out t.csv"
    result = run_here(*words.split())
    told = " ".join((result.stdout + result.stderr).split())
    assert result.returncode == 1
    assert "y[left].npz: an echo is" in told
    assert "z[/b].npz" in told
    assert "Traceback" not in result.stderr
    assert len(rows_of(Path("t.csv").read_text())) == 7


def test_recordings_that_begin_at_different_times_are_calibrated_on_one_axis():
    """Of the closures, every second begins 0.5 ms before the send pulse, by its axis of time."""
    cycles, time = blocked().astype(np.uint16), np.arange(4000) / RATE
    early = np.concatenate([np.full((len(cycles), 500), cycles[0, -1]), cycles[:, :-500]], axis=1)
    save("whole.npz", cycles, true_distance_m=PLACES)
    np.savez("a.npz", signal=cycles[::2], time=time, temperature=20.0, true_distance_m=PLACES[::2])
    np.savez(
        "b.npz", signal=early[1::2], time=time - 500 / RATE, temperature=20.0,
        true_distance_m=PLACES[1::2],
    )  # fmt: skip
    np.savez("past.npz", signal=cycles, time=time - 0.03, temperature=20.0)
    save("free.npz", untouched())
    one = run_here("calibrate", "whole.npz", "--untouched", "free.npz", "--out", "w")
    assert one.returncode == 0, one.stderr
    made = run_here("calibrate", "b.npz", "a.npz", "--untouched", "free.npz", "--out", "ab")
    assert made.returncode == 0, made.stderr
    whole, both = signals.load("w"), signals.load("ab")
    assert both.distance_rmse < 1.5 * whole.distance_rmse
    assert both.slope.value == pytest.approx(whole.slope.value, abs=1e-3)
    assert both.processing.prominence == pytest.approx(whole.processing.prominence, rel=0.05)
    apart = run_here("calibrate", "whole.npz", "--untouched", "past.npz", "--out", "l")
    assert apart.returncode == 2
    assert "no time in common" in " ".join(apart.stderr.split())


def test_calibration_beside_its_recording_is_no_sidecar(tmp_path):
    save("closed.npz", blocked(), true_distance_m=PLACES)
    save("free.npz", untouched())
    made = run_here("calibrate", "closed.npz", "--untouched", "free.npz", "--out", "closed.toml")
    assert made.returncode == 0, made.stderr
    used = run_here("process", "closed.npz", "--calibration", "closed.toml", "--quiet")
    assert used.returncode == 0, used.stderr
    text = Path("closed.toml").read_text()
    for old, new, part in (
        ("cutoff = 10000.0", "cutoff = 0.0", "cutoff = 0 is out of range"),
        ("prominence = ", "prominence = -", "is out of range"),
        ("frequency = 42000.0", 'frequency = "x"', "is not a number"),
    ):
        (tmp_path / "edited.toml").write_text(text.replace(old, new, 1))
        refused = run_here("process", "closed.npz", "--calibration", str(tmp_path / "edited.toml"))
        assert refused.returncode == 2
        assert part in " ".join(refused.stderr.split())


def test_record_that_begins_before_its_trigger_keeps_its_time():
    """A record from 2 ms before the trigger, as of an oscilloscope, gives the same distances."""
    cycles = cycles_at(DISTANCES)
    early = np.concatenate([np.full((7, 400), 2048.0), cycles], axis=1)
    time = (np.arange(4400) - 400) / RATE
    np.savez("early.npz", signal=early.astype(np.uint16), time=time, temperature=20.0)
    result = run_here("process", "early.npz", "--prominence", "0.05", "--quiet")
    found = np.array([float(row["distance_cm"]) for row in rows_of(result.stdout)])
    assert found == pytest.approx(100 * DISTANCES, abs=0.1)


def test_nothing_to_process_is_refused():
    Path("empty").mkdir()
    assert run_here("process").returncode == 2
    for words, part in (
        (["empty"], "empty"),
        (["missing.npz"], "missing.npz"),
        (["a.npz", "--calibration", "nobody"], "nobody is neither a file nor the name"),
        (["a.npz", "--calibration", "."], ". is neither a file nor the name"),
        (["a.npz", "--prominence", "3"], "prominence = 3 is out of range"),
        (["a.npz", "--out", "a.npz"], "nothing is overwritten"),
        (["a.npz", "--figure", "a.xyz"], "figure = a.xyz must end in one of .png"),
    ):
        save("a.npz", cycles_at(DISTANCES))
        result = run_here("process", *words)
        assert result.returncode != 0, words
        assert part in " ".join(result.stderr.split()), words
        assert "Traceback" not in result.stderr


@pytest.fixture
def recorded():
    save("closed.npz", blocked(), true_distance_m=PLACES)
    save("free.npz", untouched())


@pytest.mark.usefixtures("recorded")
def test_calibration_is_written_and_applied():
    result = run_here(
        "calibrate", "closed.npz", "--untouched", "free.npz", "--out", "c.toml", "--figure",
        "c.png", "--sigmas", "8",
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert "111 of 111 closures used: slope 0.99" in result.stdout
    assert "0 % of the untouched cycles show an echo" in " ".join(result.stdout.split())
    assert Path("c.png").stat().st_size > 10_000
    plain, calibrated = (
        rows_of(run_here("process", "closed.npz", *words, "--quiet").stdout)
        for words in ([], ["--calibration", "c.toml", "--figure", "p.png"])
    )
    before, after = (
        np.array([float(row["distance_cm"]) for row in rows]) for rows in (plain, calibrated)
    )
    # The line's intercept of 3 cm is corrected, its slope of 0.99 remains.
    assert np.median(before - 99 * PLACES) == pytest.approx(3.0, abs=0.1)
    assert np.median(after - 99 * PLACES) == pytest.approx(0.0, abs=0.1)
    assert Path("p.png").stat().st_size > 10_000


@pytest.mark.usefixtures("recorded")
@pytest.mark.parametrize("what", ["picture", "table"])
@pytest.mark.parametrize(
    "words",
    [
        ("process", "closed.npz", "--out", "t.csv", "--figure", "p.png"),
        ("calibrate", "closed.npz", "--untouched", "free.npz", "--out", "t", "--figure", "p.png"),
    ],
)
def test_full_disk_leaves_nothing_that_blocks_the_repeated_command(words, what, monkeypatch):
    """The error names the file; the picture is written after the table, and neither remains."""
    before, put = sorted(Path().iterdir()), writing._to_disk

    def full(path, content):
        if content.startswith(b"\x89PNG") is (what == "picture"):
            raise OSError(errno.ENOSPC, "full")
        put(path, content)

    with monkeypatch.context() as patched:
        patched.setattr(writing, "_to_disk", full)
        refused = run_here(*words)
    assert refused.returncode == 1
    assert re.search(
        rf"^acoustube: {'p.png' if what == 'picture' else words[-3]}: no space left on the "
        r"device; .* MB", refused.stderr, re.M,
    )  # fmt: skip
    assert sorted(Path().iterdir()) == before
    assert run_here(*words).returncode == 0
    assert Path("p.png").exists()


@pytest.mark.usefixtures("recorded")
def test_named_calibration_is_found_by_its_name(tmp_path):
    home = {"XDG_DATA_HOME": str(tmp_path / "data"), "HOME": str(tmp_path)}
    made = run_here("calibrate", "closed.npz", "--untouched", "free.npz", "--name", "left", **home)
    assert made.returncode == 0, made.stderr
    used = run_here("process", "closed.npz", "--calibration", "left", "--quiet", **home)
    assert used.returncode == 0, used.stderr
    again = run_here("calibrate", "closed.npz", "--untouched", "free.npz", "--name", "left", **home)
    assert again.returncode == 2
    assert "left.toml exists and nothing is overwritten" in "".join(again.stderr.split("\n"))
    other = run_here("process", "closed.npz", "--calibration", "right", **home)
    assert "known are left" in " ".join(other.stderr.split())


@pytest.mark.usefixtures("recorded")
def test_calibrations_that_cannot_be_are_refused():
    save("places.npz", blocked())
    save("few.npz", blocked()[:9], true_distance_m=PLACES[:9])
    save("slow.npz", untouched()[:, ::2])
    for words, part in (
        (["closed.npz", "--untouched", "free.npz"], "either a file with --out or a name"),
        (["places.npz", "--untouched", "free.npz", "--out", "c.toml"], "no label true_distance"),
        (["few.npz", "--untouched", "free.npz", "--out", "c.toml"], "3 different places"),
        (["closed.npz", "--untouched", "slow.npz", "--out", "c.toml"], "same number of samples"),
        (["closed.npz", "--untouched", "free.npz", "--name", "a/b"], "name = a/b must be"),
    ):
        result = run_here("calibrate", *words)
        assert result.returncode == 2, words
        assert part in " ".join(result.stderr.split()), words
        assert not Path("c.toml").exists()


@pytest.mark.parametrize("names", [["a.npz"], ["b.npz", "a.npz"]])
def test_recording_that_fails_in_a_later_piece_leaves_no_rows(names, monkeypatch, capsys):
    """There is not even a header where no other file is processed."""
    whole, fails = signals.locate, cycles_at(DISTANCES)
    fails[-1] *= 0.5

    def locate(time, cycles, *words, **options):
        if np.array_equal(cycles, fails[5:].astype(np.uint16)):
            raise ValueError("the gain is negative")
        return whole(time, cycles, *words, **options)

    monkeypatch.setattr(signals, "locate", locate)
    monkeypatch.setattr(recordings, "CHUNK", 5)
    save("a.npz", fails)
    save("b.npz", cycles_at(DISTANCES))
    alone = len(names) == 1
    assert main(["process", *names, "--quiet"]) == (2 if alone else 1)
    captured = capsys.readouterr()
    assert "a.npz" in captured.err
    rows = rows_of(captured.out)
    assert {row["file"] for row in rows} == (set() if alone else {"b.npz"})
    assert len(rows) == (0 if alone else len(DISTANCES))
    assert (captured.out == "") is alone


def with_lead(cycles, lead, noise=0.0):
    """The same cycles from a recorder that starts `lead` samples before the send pulse."""
    random = np.random.default_rng(3)
    quiet = np.median(cycles) + noise * np.ptp(cycles) * random.standard_normal((len(cycles), lead))
    return np.concatenate([quiet, cycles], axis=1)[:, : cycles.shape[1]]


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("lead", [1, 60, 333, 1000])
@pytest.mark.parametrize("how", ["given", "auto"])
def test_send_pulse_is_found_where_the_recorder_started_before_it(lead, noise, how):
    """Distances are right to a sample (0.9 mm), and the lead to half a carrier cycle."""
    places = DISTANCES[DISTANCES < 1.2]
    cycles = cycles_at(places, noise=noise)
    save("a.npz", cycles)
    save("b.npz", with_lead(cycles, lead, noise))
    start = f"{1e3 * lead / RATE}" if how == "given" else "auto"
    words = ("process", "a.npz", "--prominence", 0.1)
    known = [float(row["distance_cm"]) for row in rows_of(run_here(*words).stdout)]
    told = run_here("process", "b.npz", "--prominence", 0.1, "--pulse-at", start)
    assert told.returncode == 0, told.stderr
    found = [float(row["distance_cm"]) for row in rows_of(told.stdout)]
    assert found == pytest.approx(known, abs=100 * 343 / 2 / RATE)
    (at,) = re.findall(r"b.npz: the send pulse starts ([-\d.]+) ms after the first", told.stderr)
    assert float(at) == pytest.approx(1e3 * lead / RATE, abs=0.5e3 / 42e3)


def test_missing_lead_is_reported_with_the_option_to_give():
    save("b.npz", with_lead(cycles_at(DISTANCES, height=2.0), 1000))
    told = run_here("process", "b.npz", "--prominence", 0.1)
    assert "if the recorder starts before that pulse, give --pulse-at MS" in " ".join(
        told.stderr.split()
    )


def test_lead_that_cannot_be_is_refused():
    cycles = cycles_at(DISTANCES)
    apart = [with_lead(one[None], 100 * i)[0] for i, one in enumerate(cycles)]
    save("apart.npz", np.array(apart))
    save("late.npz", cycles[:, 35:])
    save("a.npz", cycles)
    for name, start, words in (
        ("apart.npz", "auto", "% of the cycles, so the send pulse cannot be found; state its time"),
        ("late.npz", "auto", "before the first sample; record earlier"),
        ("a.npz", "30", "pulse-at = 30 is after the last sample; use less than 19.995 ms"),
        ("a.npz", "-1", "pulse-at = -1 is out of range; use 0 to 1e+06 ms"),
        ("a.npz", "soon", "--pulse-at"),
    ):
        told = run_here("process", name, "--pulse-at", start)
        assert told.returncode == 2
        assert words in " ".join(told.stderr.split())
