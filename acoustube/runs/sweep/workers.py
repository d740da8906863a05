"""Tasks on many worker processes; a task or a worker that fails stops no other."""

from __future__ import annotations

import logging
import os
import socket
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from acoustube.base.checks import Either, Optional
from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.rules import Number


def dask_executor(address: str) -> tuple[Executor, int]:
    """Return the executor of a running Dask cluster, and the number of tasks to submit at a time.

    Parameters
    ----------
    address : str
        Address of its scheduler, such as ``tcp://127.0.0.1:8786``.

    Raises
    ------
    ConfigError
        If the package is not installed, no scheduler answers, or the cluster has no workers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise ConfigError(
            "dask needs the package distributed; run pip install 'acoustube[dask]'"
        ) from error
    try:
        _reach(address)
        client = _connected(Client, address)
    except (OSError, ValueError, TimeoutError) as error:
        raise ConfigError(
            f"dask = {address}: no scheduler answers there; start one with `dask scheduler` and "
            "workers with `dask worker`"
        ) from error
    threads = sum(client.nthreads().values())
    if not threads:
        raise ConfigError(
            "has no workers", setting="dask", value=address, advice="start some with `dask worker`",
        )  # fmt: skip
    return client.get_executor(), 2 * threads


def _connected(client: Callable[..., Any], address: str) -> Any:
    """Return a client of a scheduler; raise its error, or TimeoutError if it does not answer.

    If a server of another kind answers, a client waits for ever, and so it is made on a thread.
    """
    found: Future[Any] = Future()

    def connect() -> None:
        try:
            found.set_result(client(address, timeout=SCHEDULER_TIMEOUT, set_as_default=False))
        except Exception as error:
            found.set_exception(error)

    log = logging.getLogger("distributed")
    before = log.level
    log.setLevel(logging.CRITICAL)  # failures are reported by messages of this module
    threading.Thread(target=connect, daemon=True).start()
    scheduler = found.result(1.5 * SCHEDULER_TIMEOUT)
    log.setLevel(before)
    return scheduler


def _reach(address: str) -> None:
    """Test the connection to a scheduler, since a client reports a failure twice, and late."""
    place = urlsplit(address if "//" in address else f"//{address}")
    if place.scheme in ("", "tcp", "tls"):
        socket.create_connection((place.hostname, place.port or 8786), SCHEDULER_TIMEOUT).close()


SCHEDULER_TIMEOUT = 10.0
"""Seconds in which a scheduler has to answer."""
ATTEMPTS = 3
"""Number of lost workers at which a task counts as failed."""
POLL_INTERVAL = 0.2
"""Seconds between polls of the workers."""
GONE = "the workers or their scheduler are gone; start them and run the same command again"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Environment variables that limit the threads of a process."""


@dataclass(frozen=True, eq=False)
class Task:
    """A task, and the callbacks for its result.

    Attributes
    ----------
    work : callable
        Function that a worker calls; it is importable from a module.
    arguments : tuple
        Arguments of `work`.
    then : callable
        Called in this process with the result of `work`; returns the tasks that can follow.
    failed : callable
        Called in this process with the reason of a failure.
    cost : float
        Expected time in s.
    """

    work: Callable[..., Any]
    arguments: tuple[Any, ...]
    then: Callable[[Any], Iterable[Task]]
    failed: Callable[[str], None]
    cost: float


class Workers:
    """Pool of local processes, started on demand, and restarted when one is lost.

    The processes persist until :meth:`end`, so that later runs reuse imported modules and compiled
    code.

    Parameters
    ----------
    count : int
        Number of processes.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool: Executor | None = None

    def pool(self) -> Executor:
        """Return an executor on the processes, which are started if they do not run.

        Raises
        ------
        SimulationError
            If no worker can start.
        """
        if self._pool is None:
            self._pool = process_pool(self.count)
            try:
                self._pool.submit(int).result()
            except BrokenExecutor as error:
                self.end()
                raise SimulationError(
                    "no worker can start: a script that runs a sweep must do so under "
                    'if __name__ == "__main__":, since workers import it too'
                ) from error
        return self._pool

    def end(self) -> None:
        """End the processes without waiting for their tasks."""
        if self._pool is None:
            return
        processes = list((getattr(self._pool, "_processes", None) or {}).values())
        self._pool.shutdown(wait=False)
        for process in processes:
            process.terminate()
        for process in processes:
            process.join(timeout=5)
        self._pool = None


WORKERS = Optional(Either((Workers,), Number(1, 1024, "processes", whole=True)))
"""Rule of arguments `workers`: a number of processes, a pool, or None for one per core."""


@contextmanager
def worker_pool(workers: int | Workers | None) -> Iterator[Workers]:
    """Yield the workers that are given, or new ones, which are ended afterwards.

    Parameters
    ----------
    workers : int, Workers or None
        Number of processes, None for one per core; or an existing pool.
    """
    if isinstance(workers, Workers):
        yield workers
        return
    new = Workers(count_of(workers))
    try:
        yield new
    finally:
        new.end()


def count_of(workers: int | Workers | None) -> int:
    """Return the number of workers that :func:`worker_pool` yields."""
    return workers.count if isinstance(workers, Workers) else workers or cores()


def run_tasks(
    tasks: Iterable[Task], workers: Workers | Executor, width: int, tick: Callable[[], None]
) -> None:
    """Run tasks and their follow-up tasks.

    Parameters
    ----------
    tasks : iterable of Task
    workers : Workers or concurrent.futures.Executor
        Workers, which are left running. If an error or an interrupt ends the run, Workers are
        ended, but not another executor.
    width : int
        Largest number of tasks that the workers have at a time.
    tick : callable
        Called several times a second; an exception that it raises ends the run.

    Raises
    ------
    SimulationError
        If the executor has shut down, or its workers are lost or cannot start.

    Notes
    -----
    A task whose worker is lost is tried again. The last attempt runs alone, so that a task which
    kills its worker does not affect others. Follow-up tasks precede waiting ones, so that results
    are written as soon as possible.
    """
    waiting: deque[Task] = deque(tasks)
    running: dict[Future[Any], Task] = {}
    lost: Counter[Task] = Counter()
    own, pool = (workers, workers.pool()) if isinstance(workers, Workers) else (None, workers)
    try:
        while waiting or running:
            broken = not _hand_over(pool, waiting, running, width, lost)
            finished, _ = wait(running, timeout=POLL_INTERVAL, return_when=FIRST_COMPLETED)
            tick()
            for future in finished:
                broken |= _settle(future, running.pop(future), waiting, lost)
            if broken:
                if own is None:
                    raise SimulationError(GONE)
                for task in running.values():
                    _again(task, waiting, lost)
                running.clear()
                own.end()
                pool = own.pool()
    except BaseException:
        for future in running:
            future.cancel()
        if own is not None:
            own.end()
        raise


def _settle(future: Future[Any], task: Task, waiting: deque[Task], lost: Counter[Task]) -> bool:
    """Pass on the result or failure of a finished task; return whether its worker was lost."""
    try:
        result = future.result()
    except CancelledError as error:
        raise SimulationError(GONE) from error
    except BrokenExecutor:
        _again(task, waiting, lost)
        return True
    except Exception as error:
        task.failed(" ".join(f"{error}".split()) or type(error).__name__)
    else:
        waiting.extendleft(reversed(list(task.then(result))))
    return False


def _hand_over(
    pool: Executor,
    waiting: deque[Task],
    running: dict[Future[Any], Task],
    width: int,
    lost: Counter[Task],
) -> bool:
    """Submit waiting tasks until `width` are running; return False if the workers are lost."""
    while waiting and len(running) < width:
        last_try = lost[waiting[0]] == ATTEMPTS - 1 or any(
            lost[task] == ATTEMPTS - 1 for task in running.values()
        )
        if last_try and running:
            break
        task = waiting.popleft()
        try:
            running[pool.submit(task.work, *task.arguments)] = task
        except BrokenExecutor:
            waiting.appendleft(task)
            return False
        except RuntimeError as error:  # the pool was shut down
            raise SimulationError(GONE) from error
    return True


def _again(task: Task, waiting: deque[Task], lost: Counter[Task]) -> None:
    """Queue again a task that has lost its worker; it fails after ATTEMPTS lost workers."""
    lost[task] += 1
    if lost[task] < ATTEMPTS:
        waiting.appendleft(task)
    else:
        task.failed(
            f"its worker process died {ATTEMPTS} times (often: out of memory); use fewer workers"
        )


def process_pool(workers: int) -> Executor:
    """Return a pool of new processes, each limited to its share of the cores."""
    import multiprocessing

    return ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),  # JAX deadlocks in forked processes
        initializer=_start,
        initargs=(max(1, cores() // workers),),
    )


def cores() -> int:
    """Return the number of cores available to this process."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _start(threads: int) -> None:
    """Prepare a worker: limit its threads, ignore interrupts, and end with its parent."""
    import multiprocessing
    import signal
    import threading

    for name in THREADS:  # a limit that the user has set stays
        os.environ.setdefault(name, str(threads))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
