"""Tasks on workers that fail, die or disconnect; damaged files; a full disk."""

import os
import signal
import time
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from multiprocessing import get_context

import numpy as np
import pytest
import xarray as xr

from acoustube.base.errors import SimulationError
from acoustube.runs.sweep import store
from acoustube.runs.sweep import workers as sweep_workers
from acoustube.runs.sweep.workers import ATTEMPTS, Task, process_pool, run_tasks, worker_pool


def square(x):
    return x * x


def refuse(x):
    raise ValueError(f"cannot square {x}")


def die(_):
    os.kill(os.getpid(), signal.SIGKILL)


def die_once(x, flag):
    """Kill the worker at the first call, and work at the second."""
    if not flag.exists():
        flag.touch()
        die(x)
    return x * x


def threads_of_numba():
    """Return the number of numba's threads, after it has started them and compiled something."""
    import numba

    before = numba.get_num_threads()
    assert numba.njit(square)(3) == 9
    return before


class Record:
    """Results and failures of tasks."""

    def __init__(self):
        self.results, self.failures = {}, {}

    def task(self, name, work, *arguments, follow=()):
        def then(result):
            self.results[name] = result
            return [self.task(*more) for more in follow]

        def failed(reason):
            self.failures[name] = reason

        return Task(work, arguments, then, failed, 1.0)


@pytest.fixture
def threads():
    with ThreadPoolExecutor(2) as pool:
        yield pool


@pytest.fixture
def processes():
    with worker_pool(2) as workers:
        yield workers


def test_tasks_and_what_follows_from_them_are_all_run(threads):
    record, ticks = Record(), []
    tasks = [record.task("a", square, 2, follow=[("b", square, 3), ("c", square, 4)])]
    run_tasks(tasks, threads, 2, lambda: ticks.append(1))
    assert record.results == {"a": 4, "b": 9, "c": 16}
    assert ticks


def test_a_failed_task_is_reported_and_the_others_go_on(threads):
    record = Record()
    tasks = [record.task(i, refuse if i == 3 else square, i) for i in range(8)]
    run_tasks(tasks, threads, 2, lambda: None)
    assert record.failures == {3: "cannot square 3"}
    assert record.results == {i: i * i for i in range(8) if i != 3}


def test_no_more_tasks_are_handed_over_than_asked_for():
    at_once, most = [], []

    def work(x):
        at_once.append(x)
        most.append(len(at_once))
        time.sleep(0.01)
        at_once.remove(x)
        return x

    record = Record()
    with ThreadPoolExecutor(8) as pool:
        run_tasks([record.task(i, work, i) for i in range(20)], pool, 3, int)
    assert len(record.results) == 20
    assert max(most) <= 3


@pytest.mark.slow
def test_task_of_a_killed_worker_is_repeated(processes, tmp_path):
    record = Record()
    tasks = [record.task(i, die_once, i, tmp_path / "died") for i in range(6)]
    run_tasks(tasks, processes, 2, lambda: None)
    assert record.results == {i: i * i for i in range(6)}
    assert record.failures == {}


@pytest.mark.slow
def test_a_task_that_always_kills_its_worker_fails_alone(processes):
    record = Record()
    tasks = [record.task(i, die if i == 2 else square, i) for i in range(6)]
    run_tasks(tasks, processes, 2, lambda: None)
    assert list(record.failures) == [2]
    assert f"died {ATTEMPTS} times" in record.failures[2]
    assert record.results == {i: i * i for i in range(6) if i != 2}


@pytest.mark.slow
def test_an_interrupt_ends_the_run_and_what_its_workers_do(processes):
    def interrupt():
        raise KeyboardInterrupt

    process = processes.pool().submit(os.getpid).result()
    with pytest.raises(KeyboardInterrupt):
        run_tasks([Record().task("a", time.sleep, 600)], processes, 1, interrupt)
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)


@pytest.mark.slow
def test_workers_stay_for_the_next_run_unless_they_are_lost_in_between(processes):
    found = []
    for i in range(3):
        record = Record()
        run_tasks([record.task("a", os.getpid)], processes, 1, lambda: None)
        found.append(record.results["a"])
        if i == 1:
            for process in processes.pool()._processes:
                os.kill(process, signal.SIGKILL)
            time.sleep(0.2)
    assert found[0] == found[1] != found[2]


class GoneExecutor(ThreadPoolExecutor):
    """An executor whose scheduler is gone, as a Dask cluster's may be."""

    def submit(self, *_):
        future = Future()
        future.set_exception(CancelledError())
        return future


def test_a_lost_scheduler_ends_the_run_with_an_error():
    with pytest.raises(SimulationError, match=r"scheduler are gone; .* run the same command again"):
        run_tasks([Record().task("a", square, 2)], GoneExecutor(), 1, int)


class BrokenPool(ThreadPoolExecutor):
    """An executor whose workers are lost, as reported by a pool of processes."""

    def submit(self, *_):
        raise BrokenExecutor


def test_somebody_elses_pool_that_breaks_is_not_tried_for_ever():
    record = Record()
    with pytest.raises(SimulationError, match=r"the workers or their scheduler are gone"):
        run_tasks([record.task("a", square, 2)], BrokenPool(), 1, int)
    assert record.failures == {}


def test_somebody_elses_pool_is_left_running():
    with ThreadPoolExecutor(1) as pool:
        run_tasks([Record().task("a", square, 2)], pool, 1, int)
        assert pool.submit(square, 3).result() == 9


@pytest.mark.slow
def test_a_bound_on_threads_that_the_user_has_set_stays(monkeypatch):
    # numba refuses to compile once the variable differs from what it has started with.
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    with process_pool(1) as pool:
        assert pool.submit(threads_of_numba).result() == 1


def test_workers_that_cannot_start_fail_no_task(monkeypatch, processes):
    record = Record()

    def refused(workers):
        return ProcessPoolExecutor(workers, get_context("spawn"), initializer=refuse)

    monkeypatch.setattr(sweep_workers, "process_pool", refused)
    with pytest.raises(SimulationError, match=r"no worker can start: .*__main__"):
        run_tasks([record.task("a", square, 2)], processes, 1, int)
    assert record.failures == {}


def results(*names):
    rng = np.random.default_rng(0)
    pressure = rng.normal(size=(len(names), 2, 900)).astype(np.float32)
    return xr.Dataset(
        {"pressure": (("press", "source_end", "time"), pressure)}, {"press": list(names)}
    )


def test_results_come_back_as_they_were_written(tmp_path):
    matrix = xr.Dataset({"s": ("frequency", np.arange(4.0))})
    path = store.write(tmp_path, results("a", "b"), matrix)
    data, again = store.read(path)
    assert list(data["press"].values) == ["a", "b"]
    np.testing.assert_array_equal(data["pressure"], results("a", "b")["pressure"])
    np.testing.assert_array_equal(again["s"], matrix["s"])
    assert store.contents(tmp_path).finished == {"a": path, "b": path}
    assert store.write(tmp_path, results("b", "a"), None) == path


@pytest.mark.parametrize("place", np.linspace(0.02, 0.98, 25))
def test_a_changed_byte_or_a_cut_is_noticed(tmp_path, place):
    path = store.write(tmp_path, results("a"), None)
    good = path.read_bytes()
    at = int(place * len(good))
    path.write_bytes(good[:at] + bytes([good[at] ^ 0x55]) + good[at + 1 :])
    names = store.intact(path)
    # A byte of HDF5's free space may not matter; then the content is unchanged.
    if names is not None:
        assert names == ["a"]
        np.testing.assert_array_equal(store.read(path)[0]["pressure"], results("a")["pressure"])
    else:
        assert store.contents(tmp_path).damaged == [path]
    path.write_bytes(good[:at])
    assert store.intact(path) is None
    aside = store.set_aside(path)
    assert store.contents(tmp_path) == store.Contents({}, [], [])
    assert aside.name == f"{path.name}.damaged"


def test_damage_of_the_samples_is_noticed(tmp_path):
    """The bytes in the middle of a large file are compressed samples."""
    path = store.write(tmp_path, results(*"abcdefgh"), None)
    good = path.read_bytes()
    at = len(good) // 2
    path.write_bytes(good[:at] + bytes([good[at] ^ 0x55]) + good[at + 1 :])
    assert store.intact(path) is None


def test_foreign_files_are_reported_and_left(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "cases-mine.nc").write_text("mine")
    path = store.write(tmp_path, results("a"), None)
    found = store.contents(tmp_path)
    assert [p.name for p in found.foreign] == ["cases-mine.nc", "notes.txt"]
    assert found.finished == {"a": path}


def test_a_full_disk_leaves_the_folder_intact(tmp_path):
    """A limit on the size of files interrupts a write, as a full disk does."""
    resource = pytest.importorskip("resource")
    good = store.write(tmp_path, results("a"), None)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, before[1]))
    try:
        with pytest.raises(
            SimulationError, match=r"cases-\w+.nc: .* MB are needed; everything in .* is intact"
        ):
            store.write(tmp_path, results("b"), None)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == [good]
    assert store.contents(tmp_path).finished == {"a": good}


def test_failures_are_recorded_with_their_reason_and_forgotten(tmp_path):
    store.record_failure(tmp_path, "a", "did not converge", {"tube": {}})
    store.record_failure(tmp_path, "b", "no", {})
    (tmp_path / store.FAILURES / "c.json").write_text("{")
    assert store.failures(tmp_path) == {"a": "did not converge", "b": "no"}
    store.delete_failures(tmp_path, ["a", "c", "never"])
    assert store.failures(tmp_path) == {"b": "no"}
    store.delete_failures(tmp_path, ["b"])
    assert store.failures(tmp_path) == {}
