"""Compilation in a background thread, while the calling thread prepares the first calls."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from threading import Thread


def compile_ahead(compilations: Iterable[Callable[[], None]]) -> Thread:
    """Start compilations in a thread of their own, one after the other in the order given.

    A call of a function that is being compiled waits for the compilation, since numba compiles one
    function at a time.

    Parameters
    ----------
    compilations : iterable of callable
        Each compiles functions by calling them with arguments of the types of later calls.
        Exceptions are dropped: what fails here fails again, and is reported, where it is needed.

    Returns
    -------
    Thread
    """

    def run() -> None:
        for compilation in compilations:
            with suppress(Exception):
                compilation()

    thread = Thread(target=run, name="compilation")
    thread.start()
    return thread
