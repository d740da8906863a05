"""Sweeps: results do not depend on how they are computed, and survive interruption."""

import dataclasses
import json
import os
import random
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from commands import run_process
from matplotlib.figure import Figure
from scipy.interpolate import CubicSpline
from wave_lumens import BORE, pinched_tube

import acoustube
from acoustube.air import air_at
from acoustube.base import cache
from acoustube.base.errors import ConfigError, SimulationError
from acoustube.cli import main
from acoustube.indentation import PressError
from acoustube.lumen import pressed_part
from acoustube.reports.figures import sweep as sweep_figure
from acoustube.runs import sound
from acoustube.runs.config import Config, configured
from acoustube.runs.config.si import press_in_si, settings_in_si
from acoustube.runs.presses import pressed
from acoustube.runs.sweep import store
from acoustube.runs.sweep import tasks as sweep_tasks
from acoustube.runs.sweep.graph import Case, load_paths
from acoustube.runs.sweep.plan import load_plan
from acoustube.runs.sweep.run import run_sweep
from acoustube.waves import PlacedScatterer, cut_cells, scatter
from acoustube.waves.network import at_sound_speed

# Two shallow presses and the untouched tube, at a low frequency on a coarse grid: seconds each.
SMALL = ["--depth", "0", "0.3", "0.6", "--position", "15", "25", "--frequency", "20"]
SMALL += ["--resolution", "8", "--vary", "mesh=coarse"]
OVER = {
    "depth_mm": ["0", "0.3", "0.6"], "position_cm": ["15", "25"], "frequency_khz": ["20"],
    "resolution": ["8"], "mesh": ["coarse"],
}  # fmt: skip


def small_sweep(folder, over=None, **options):
    options.setdefault("executor", ThreadPoolExecutor(1))
    return run_sweep(load_plan(None, over or OVER), folder, **options)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep") / "small"
    assert small_sweep(folder)
    return folder


@pytest.fixture
def in_a_thread(monkeypatch):
    """Make the command compute in a thread, in tests that are not about processes."""

    def own(plan, out, **options):
        return run_sweep(plan, out, **options | {"executor": ThreadPoolExecutor(1)})

    monkeypatch.setattr("acoustube.runs.sweep.run.run_sweep", own)


def assert_same(one, other):
    """Compare the cases of two folders bit by bit."""
    a, b = (acoustube.open_dataset(folder).load() for folder in (one, other))
    xr.testing.assert_identical(a, b)


@pytest.mark.slow
def test_cases_are_what_simulate_computes(finished):
    """Equal to float32 with the same scattering; `simulate` limits the pulse's band more.

    The part that it leaves out is at -70 dB of the spectrum's peak and under 2e-3 of the pulse.
    """
    data = acoustube.open_dataset(finished)
    for case in (data.isel(press=i) for i in (4, 5)):
        config = configured(json.loads(str(case["configuration"].values)))
        settings = settings_in_si(config)
        press = pressed(config, [0.3e-3, 0.6e-3])
        row = press.rows_at([float(case["depth"])])[0]
        part = pressed_part(press, row)
        (group,) = load_paths([Case("a", config)])[0].groups
        matrix, _, _ = sound.scattering_of(
            part, settings.air, (group.band.low, group.band.high), method="scattering",
            bore=7.9e-3, resolution=8, lossy=True,
        )  # fmt: skip
        same = sound.joined_recordings(settings, [PlacedScatterer(matrix, settings.position)])
        alone, _, _ = sound.scattered_recordings(settings, part)
        for end in sound.SOURCE_ENDS:
            found = case["pressure"].sel(source_end=end).values
            assert np.abs(found - same[end].pressure[0]).max() < 1e-6
            assert np.abs(found - alone[end].pressure[0]).max() < 2e-3
        assert float(case["force"]) == pytest.approx(float(press.contact_force[row]))


@pytest.mark.slow
def test_labels_are_those_of_the_settings_and_the_press(finished):
    data = acoustube.open_dataset(finished)
    assert data.sizes["press"] == 6
    assert list(data["depth"].values) == [0.0, 0.3e-3, 0.6e-3] * 2
    assert list(data["true_distance"].values) == [0.15] * 3 + [0.25] * 3
    assert np.all(np.diff(data["force"].values[:3]) > 0.1)
    assert data["force"].values[0] == 0
    assert np.all(np.diff(data["lumen_area"].values[:3]) < 0)
    np.testing.assert_allclose(data["lumen_area"].values[0], np.pi * 3.95e-3**2, rtol=1e-12)
    # The deeper a press, the higher its echo. The signal of the untouched tube is the truncation of
    # the pulse's band, 70 dB below its peak and spread over the run.
    late = data["pressure"].sel(source_end="absorbing").isel(time=data["time"] > 0.8e-3)
    highest = np.abs(late).max("time").values[:3]
    assert highest[0] < 5e-5
    assert 10 * highest[0] < highest[1] < highest[2]
    for name, variable in data.variables.items():
        if name != "press":
            assert variable.attrs["units"], name
            assert variable.attrs["long_name"], name


@pytest.mark.slow
def test_a_repeat_computes_nothing(finished, capsys, monkeypatch):
    before = {path: path.stat().st_mtime_ns for path in finished.glob("cases-*")}
    monkeypatch.setattr(sweep_tasks, "press", None)
    monkeypatch.setattr("acoustube.runs.sweep.runner.simulate_cases", None)
    assert main(["sweep", *SMALL, "--out", str(finished)]) == 0
    assert "nothing to compute" in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in finished.glob("cases-*")} == before


@pytest.mark.slow
@pytest.mark.usefixtures("finished", "in_a_thread")
def test_pieces_are_computed_once_ever(tmp_path, capsys):
    """Other positions, temperatures and a longer tube need no new presses and matrices."""
    words = ["--depth", "0.3", "0.6", "--frequency", "20", "--resolution", "8"]
    words += ["--vary", "mesh=coarse", "--position", "30:60:5", "--length", "80"]
    words += ["--temperature", "20"]
    assert main(["sweep", *words, "--workers", "1", "--out", str(tmp_path / "more")]) == 0
    out = capsys.readouterr().out
    assert "load paths           1, 1 cached" in out
    assert "scattering matrices  2, 2 cached" in out
    assert "load paths: 0 computed, 1 reused; scattering: 0 computed, 2 reused; cases: 14" in out


SHARES = [[*SMALL, "--workers", "1", "--shard", f"{i}/2"] for i in (2, 1)]


@pytest.mark.long
def test_workers_do_not_matter(finished, tmp_path, monkeypatch):
    """Two processes compute all pieces anew."""
    monkeypatch.setenv("ACOUSTUBE_CACHE", str(tmp_path / "cache"))
    assert main(["sweep", *SMALL, "--workers", "2", "--quiet", "--out", "two"]) == 0
    assert_same(finished, tmp_path / "two")


@pytest.mark.long
@pytest.mark.parametrize("commands", [[[*SMALL, "--workers", "1"]], SHARES], ids=["one", "shares"])
def test_pieces_computed_anew_are_the_same(finished, tmp_path, monkeypatch, commands):
    monkeypatch.setenv("ACOUSTUBE_CACHE", str(tmp_path / "cache"))
    for words in commands:
        assert main(["sweep", *words, "--quiet", "--out", "anew"]) == 0
    assert_same(finished, tmp_path / "anew")


@contextmanager
def cluster(tmp_path, port, count):
    """Start a scheduler and workers as processes, and the command of a sweep on them."""
    own = {"ACOUSTUBE_CACHE": str(tmp_path / "cluster's"), "OMP_NUM_THREADS": "1"}
    start = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": os.environ | own}
    address, dask = f"tcp://127.0.0.1:{port}", [sys.executable, "-m", "dask"]
    place = ["--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    scheduler = subprocess.Popen([*dask, "scheduler", *place], **start)
    worker = [*dask, "worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
    workers = [subprocess.Popen(worker, **start) for _ in range(count)]
    command = [sys.executable, "-m", "acoustube", "sweep", *SMALL, "--dask", address]
    try:
        _await_workers(address, count)
        yield scheduler, workers, command
    finally:
        for process in (scheduler, *workers):
            process.kill()


@pytest.mark.long
def test_a_cluster_computes_the_same_and_survives_a_lost_worker(finished, tmp_path):
    with cluster(tmp_path, 18786, 2) as (_, workers, command):
        sweep = subprocess.Popen([*command, "--out", "cluster"])
        _await_first_press(tmp_path)
        workers[0].kill()
        assert sweep.wait(timeout=300) == 0
    assert_same(finished, tmp_path / "cluster")


def test_a_cluster_of_one_thread_computes_the_same(finished, tmp_path):
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp"
    ) as threads:
        address = threads.scheduler_address
        assert main(["sweep", *SMALL, "--dask", address, "--quiet", "--out", "one"]) == 0
        assert threads.workers[0].state.executed_count > 0
    assert_same(finished, tmp_path / "one")


@pytest.mark.long
def test_a_sweep_whose_scheduler_is_killed_is_finished_by_another(finished, tmp_path):
    with cluster(tmp_path, 18788, 1) as (scheduler, _, command):
        sweep = subprocess.Popen([*command, "--out", "cluster"], stderr=subprocess.PIPE, text=True)
        _await_first_press(tmp_path)
        scheduler.kill()
        _, error = sweep.communicate(timeout=300)
    assert sweep.returncode == 1
    assert "the workers or their scheduler are gone; start them and run the same" in error
    assert not store.contents(tmp_path / "cluster").damaged
    assert small_sweep(tmp_path / "cluster")
    assert_same(finished, tmp_path / "cluster")


def _await_workers(address, count):
    from distributed import Client

    with Client(address, timeout=60) as client:
        client.wait_for_workers(count, timeout=60)


def _await_first_press(tmp_path):
    """Wait until the cluster has cached its press and computes the scattering."""
    deadline = time.monotonic() + 240
    while not list((tmp_path / "cluster's").glob("*.npz")):
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_a_missing_cluster_is_reported(capsys, monkeypatch):
    import distributed

    real = distributed.Client
    monkeypatch.setattr(distributed, "Client", lambda address, **_: real(address, timeout=1))
    assert main(["sweep", *SMALL, "--out", "new", "--dask", "tcp://127.0.0.1:9"]) == 2
    assert "no scheduler answers there" in capsys.readouterr().err


def test_a_process_without_its_cluster_ends_with_the_sentence_alone():
    """No traceback of the library is printed, and no folder is made."""
    told = run_process("sweep", *SMALL, "--out", "new", "--dask", "tcp://127.0.0.1:9")
    assert told.returncode == 2
    assert told.stderr == (
        "acoustube: dask = tcp://127.0.0.1:9: no scheduler answers there; start one with `dask "
        "scheduler` and workers with `dask worker`\n"
    )
    assert not os.path.lexists("new")


@pytest.mark.long
def test_a_sweep_that_is_killed_goes_on_to_the_same_results(finished, tmp_path):
    """It is killed with all its workers at random moments; files are complete at any time."""
    moments = random.Random(5)
    environment = os.environ | {"ACOUSTUBE_CACHE": str(tmp_path / "cache")}
    command = [sys.executable, "-m", "acoustube", "sweep", *SMALL, "--out", "killed"]
    for _ in range(3):
        sweep = subprocess.Popen([*command, "--quiet"], env=environment, start_new_session=True)
        time.sleep(moments.uniform(4, 20))
        os.killpg(sweep.pid, signal.SIGKILL)
        sweep.wait()
        if (tmp_path / "killed").is_dir():
            assert not store.contents(tmp_path / "killed").damaged
    subprocess.run([*command, "--quiet"], env=environment, check=True, timeout=300)
    assert_same(finished, tmp_path / "killed")


@pytest.mark.slow
def test_workers_end_with_a_killed_sweep(tmp_path):
    environment = os.environ | {"ACOUSTUBE_CACHE": str(tmp_path / "cache")}
    command = [sys.executable, "-m", "acoustube", "sweep", *SMALL, "--workers", "1", "--quiet"]
    sweep = subprocess.Popen([*command, "--out", "killed"], env=environment)
    deadline = time.monotonic() + 60
    while not (children := _children(sweep.pid)) and time.monotonic() < deadline:
        time.sleep(0.2)
    time.sleep(3)
    children = _children(sweep.pid)
    sweep.kill()
    sweep.wait()
    deadline = time.monotonic() + 20
    while any(map(_alive, children)) and time.monotonic() < deadline:
        time.sleep(0.2)
    assert children
    assert not any(map(_alive, children))


def _children(pid):
    found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True)
    return [int(word) for word in found.stdout.split()]


def _alive(pid):
    found = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True)
    return bool(found.stdout.strip()) and not found.stdout.startswith("Z")


@pytest.mark.slow
def test_a_failed_case_is_recorded_and_stops_no_other(finished, tmp_path, monkeypatch, capsys):
    real = sound.locate

    def refuse(settings, recording):
        if (settings.position, settings.depth) == (0.25, 0.3e-3):
            raise ConfigError("this one does not work")
        return real(settings, recording)

    monkeypatch.setattr(sound, "locate", refuse)
    folder = tmp_path / "failing"
    assert not small_sweep(folder)
    (name,) = store.failures(folder)
    assert len(store.contents(folder).finished) == 5
    record = json.loads((folder / "failed" / f"{name}.json").read_text())
    assert record["reason"] == "this one does not work"
    assert record["configuration"]["indentation"]["position_cm"] == 25
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    # Not tried again unless asked to.
    assert main(["sweep", *SMALL, "--out", str(folder)]) == 1
    out = capsys.readouterr().err
    assert f"{name}: this one does not work" in " ".join(out.split())
    assert "--retry failed" in out
    assert small_sweep(folder, retry=True)
    assert store.failures(folder) == {}
    assert_same(finished, folder)


@pytest.mark.slow
def test_a_press_that_stops_fails_only_its_deeper_cases(tmp_path, monkeypatch):
    real = sweep_tasks.press

    def stop(settings, depths):
        done = real(settings, depths)
        at = {depth: value for depth, value in done.result.at.items() if depth < 0.5e-3}
        failed = dict.fromkeys(depths, "cannot go beyond 0.5 mm")
        return done._replace(result=sweep_tasks.PressPath(at, failed))

    monkeypatch.setattr(sweep_tasks, "press", stop)
    folder = tmp_path / "stopped"
    assert not small_sweep(folder)
    assert set(store.failures(folder).values()) == {"cannot go beyond 0.5 mm"}
    depths = acoustube.open_dataset(folder)["depth"].values
    assert sorted(depths) == [0.0, 0.0, 0.3e-3, 0.3e-3]


def test_depths_at_which_a_tube_is_bent_too_sharply_stop_no_other(monkeypatch):
    """Nor does one that is too deep. 2 mm are too sharp, 3 mm not reached, and 4 mm too deep."""
    found = SimpleNamespace(depth=np.array([0, 1e-3, 2e-3]), mesh=None, rows_at=lambda _: [1, 2])

    def stopping(_settings, depths):
        if 4e-3 in depths:
            raise ConfigError("into the floor")
        raise PressError("stopped at 2.5 mm", found)

    def measured(_found, row, _wall):
        if row == 2:
            raise SimulationError("bent too sharply")
        return "pressed"

    monkeypatch.setattr(sweep_tasks.press_runs, "press_to", stopping)
    monkeypatch.setattr(sweep_tasks, "inner_wall", lambda _: None)
    monkeypatch.setattr(sweep_tasks, "_pressed", measured)
    at, failed = sweep_tasks.press(press_in_si(Config()), [1e-3, 2e-3, 3e-3, 4e-3]).result
    assert at == {1e-3: "pressed"}
    reasons = {2e-3: "bent too sharply", 3e-3: "stopped at 2.5 mm", 4e-3: "into the floor"}
    assert failed == reasons
    assert sweep_tasks.press(press_in_si(Config()), [4e-3]).result == ({}, {4e-3: reasons[4e-3]})


@pytest.mark.slow
@pytest.mark.usefixtures("in_a_thread")
def test_a_damaged_file_is_computed_again_and_kept(finished, tmp_path, capsys):
    folder = tmp_path / "damaged"
    assert small_sweep(folder)
    path = sorted(folder.glob("cases-*.nc"))[0]
    path.write_bytes(path.read_bytes()[:5000])
    (folder / "notes.txt").write_text("mine")
    assert main(["sweep", *SMALL, "--out", str(folder), "--workers", "1"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert f"{path.name} is damaged; it is computed again" in out
    assert "notes.txt" in out
    assert (folder / f"{path.name}.damaged").stat().st_size == 5000
    assert (folder / "notes.txt").read_text() == "mine"
    assert_same(finished, folder)


@pytest.mark.slow
@pytest.mark.usefixtures("in_a_thread")
def test_a_changed_plan_is_reported_and_keeps_existing_cases(finished, tmp_path, capsys):
    folder = tmp_path / "grown"
    assert small_sweep(folder, OVER | {"position_cm": ["15"]})
    assert main(["sweep", *SMALL, "--out", str(folder), "--workers", "1"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "the plan has changed since grown was begun; 3 of its 6 cases are there already" in out
    assert_same(finished, folder)


@pytest.mark.slow
@pytest.mark.long
def test_two_sweeps_may_write_to_one_folder(finished, tmp_path):
    command = [sys.executable, "-m", "acoustube", "sweep", *SMALL, "--workers", "1", "--quiet"]
    both = [subprocess.Popen([*command, "--out", "shared"]) for _ in range(2)]
    assert [sweep.wait(timeout=300) for sweep in both] == [0, 0]
    assert_same(finished, tmp_path / "shared")


def test_folders_of_others_are_refused(tmp_path, capsys):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    for out, words in (("mine", "is not empty"), ("/proc/none", "cannot be written")):
        assert main(["sweep", *SMALL, "--out", out]) == 2
        assert words in capsys.readouterr().err
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["notes.txt"]


def test_missing_results_are_reported(tmp_path):
    with pytest.raises(ConfigError, match="holds no results of acoustube sweep or dataset"):
        acoustube.open_dataset(tmp_path)


@pytest.mark.parametrize(
    ("lossy", "tolerance"), [(False, 2e-6), pytest.param(True, 2e-3, marks=pytest.mark.long)]
)
def test_scattering_of_another_air_is_that_of_the_same_wavelengths(lossy, tolerance):
    """Exact without losses, on the grid too: the march itself scales with the speed of sound."""
    tube = pinched_tube(0.04, depth=0.5)
    cells = cut_cells(tube, 2 * BORE / 10)
    cold, warm = air_at(20.0), air_at(38.0)
    ratio = warm.sound_speed / cold.sound_speed
    frequency = np.arange(10e3, 24e3, 500.0)
    found = scatter(cells, cold, frequency, lossy=lossy, symmetric_only=True)
    direct = scatter(cells, warm, ratio * frequency, lossy=lossy, symmetric_only=True)
    moved = at_sound_speed(found, warm.sound_speed)
    np.testing.assert_allclose(moved.frequency, direct.frequency)
    assert np.abs(moved.s - direct.s).max() < tolerance
    # Unscaled frequencies give a larger error.
    above = frequency > direct.frequency[0]
    left = CubicSpline(direct.frequency, direct.s)(frequency[above])
    assert np.abs(found.s[above] - left).max() > 0.01


def test_scattering_is_cached_under_all_that_it_depends_on():
    (config,) = load_plan(None, {"depth_mm": ["2"]}).configs()
    band = sweep_tasks.Band(30e3, 50e3, 20.0)

    def name(config=config, depths=(1e-3, 2e-3), depth=2e-3, band=band):
        return sweep_tasks.scattering_key(settings_in_si(config), depths, depth, band)

    def varied(section, **values):
        part = dataclasses.replace(getattr(config, section), **values)
        return name(dataclasses.replace(config, **{section: part}))

    others = [
        name(depths=(2e-3,)), name(depth=1e-3), name(band=band._replace(high=51e3)),
        varied("waves", losses="off"), varied("waves", resolution=20),
        varied("waves", method="spectral"),
        varied("waves", humidity_percent=40.0), varied("tube", wall_mm=1.7),
        varied("indentation", support="free"),
    ]  # fmt: skip
    assert len({name(), *others}) == len(others) + 1
    assert name() == varied("indentation", position_cm=15.0) == varied("waves", frequency_khz=40.0)
    assert name() == varied("tube", length_cm=100.0)
    assert not cache.holds(name())


@pytest.mark.parametrize("depth", [0.9, 0.97, 0.995])
def test_lumen_narrower_than_a_cell_neither_makes_nor_loses_power(depth):
    """Down to a throat of a twentieth of a cell; without losses the grid conserves energy."""
    cells = cut_cells(pinched_tube(0.04, depth=depth), 2 * BORE / 10)
    found = scatter(cells, air_at(20.0), np.arange(12e3, 22e3, 500.0), lossy=False)
    plane = found.modes.index("00")
    power = (np.abs(found.s[:, :, plane, 0, plane]) ** 2).sum(axis=1)
    assert found.settled.all()
    np.testing.assert_allclose(power, 1.0, atol=3e-3)


@pytest.mark.parametrize("depths", [[4.0], [3.0, 4.0]])
def test_echoes_of_a_single_depth_are_drawn_too(depths, monkeypatch):
    """A row is 1 mm high, as the rows of depths 1 mm apart."""
    monkeypatch.setattr(
        sweep_figure, "envelope_of", lambda _: (np.linspace(0, 0.4, 9), np.full(9, 0.1))
    )
    numbers = {"tube_length": 0.4, "true_distance": 0.2, "estimated_distance": 0.2}
    cases = xr.Dataset(
        {name: ("press", np.full(len(depths), value)) for name, value in numbers.items()}
        | {"depth": ("press", 1e-3 * np.array(depths))}
    )
    image = sweep_figure.draw_echoes(Figure().subplots(), cases)
    rows = image.get_coordinates()[..., 1]
    assert [rows.min(), rows.max()] == pytest.approx([depths[0] - 0.5, depths[-1] + 0.5])
