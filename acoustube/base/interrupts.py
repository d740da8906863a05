"""Signal handling: an interrupt ends a computation at any moment, promptly and without loss."""

from __future__ import annotations

import math
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from types import CodeType, FrameType

REQUESTS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals that ask a process to stop: Ctrl-C, a batch system, and a terminal that was closed."""
RETRY = 0.05
"""Seconds after which an interrupt that could not be raised, or was lost, is raised again."""
GRACE, IMPATIENCE = 3.0, 1.0
"""Seconds that a command has to end after one interrupt, and after a second one."""
SENTENCE = "interrupted; no incomplete run is left"
HOOKS: set[CodeType] = set()
"""Code of the hooks that raise lost interrupts again."""
SHOW_CURSOR = b"\x1b[?25h"


class _Interrupt:
    """Signal handler that raises KeyboardInterrupt, but not while a module is being imported.

    While an extension module is being loaded, an interrupt becomes an ImportError or is lost. In
    the hook of `_raising_again`, an interrupt would only be reported. In both cases the handler
    therefore calls itself again after `RETRY` seconds.

    Attributes
    ----------
    number : int
        The last signal that asked to stop; 0 before the first.
    """

    def __init__(self) -> None:
        self.number = 0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if number in REQUESTS:
            self.number = number
        if _deaf(frame):
            self.again()
            return
        signal.setitimer(signal.ITIMER_REAL, 0)
        raise KeyboardInterrupt

    def again(self) -> None:
        """Schedule another call of this handler in `RETRY` seconds, by an alarm signal."""
        signal.signal(signal.SIGALRM, self)
        signal.setitimer(signal.ITIMER_REAL, RETRY)

    def check(self) -> None:
        """Raise KeyboardInterrupt if one was lost, or still waits for the end of an import."""
        if self.number:
            signal.setitimer(signal.ITIMER_REAL, 0)
            raise KeyboardInterrupt


def _deaf(frame: FrameType | None) -> bool:
    """Return whether a frame belongs to an import under way, or to the hook of this module."""
    while frame is not None:
        code = frame.f_code
        if code.co_filename.startswith("<frozen importlib") or code in HOOKS:
            return True
        frame = frame.f_back
    return False


@contextmanager
def watched_interrupts(
    before: Any = signal.default_int_handler,
) -> Iterator[Callable[[], None]]:
    """Delay interrupts until the end of an import, and raise lost ones again.

    Python ignores an exception, such as an interrupt, in a destructor, in a hook of the garbage
    collector (JAX has one) and in a function that a library such as VTK calls.

    Parameters
    ----------
    before : callable
        Signal handler. Signals that have this handler are watched, and get it back in the end;
        signals with other handlers are not watched.

    Yields
    ------
    callable
        Raises KeyboardInterrupt if there was an interrupt, lost or still waiting.
    """
    in_main = threading.current_thread() is threading.main_thread()
    found = {n: signal.getsignal(n) for n in REQUESTS if in_main}
    handler = next((h for h in found.values() if isinstance(h, _Interrupt)), None)
    if handler is not None:  # one for all, so that none is lost between two of them
        yield handler.check
        return
    handler = _Interrupt()
    replaced = [n for n, handles in found.items() if handles is before]
    for number in replaced:
        signal.signal(number, handler)
    ignored = sys.unraisablehook
    if replaced:
        sys.unraisablehook = _raising_again(handler, ignored)
    try:
        yield handler.check
    finally:
        sys.unraisablehook = ignored
        if replaced:
            signal.setitimer(signal.ITIMER_REAL, 0)
        for number in replaced:
            signal.signal(number, before)


def _raising_again(handler: _Interrupt, before: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return a `sys.unraisablehook` that raises interrupts again; `before` gets other errors.

    Errors after an interrupt are not reported: they are its consequences, for example in the
    destructor of a half-made object.
    """

    def hook(unraisable: Any) -> None:
        in_main = threading.current_thread() is threading.main_thread()
        if in_main and issubclass(unraisable.exc_type, KeyboardInterrupt):
            handler.again()
        elif not handler.number:
            before(unraisable)

    HOOKS.add(hook.__code__)
    return hook


def check() -> None:
    """Raise KeyboardInterrupt if one was lost; called before steps that must not follow one."""
    handler = signal.getsignal(signal.SIGINT)
    in_main = threading.current_thread() is threading.main_thread()
    if in_main and isinstance(handler, _Interrupt):
        handler.check()


def exit_code() -> int:
    """Return the exit code of an interrupted command: 128 plus the number of the signal."""
    handlers = (signal.getsignal(number) for number in REQUESTS)
    found = next((h.number for h in handlers if isinstance(h, _Interrupt)), 0)
    return 128 + (found or signal.SIGINT)


def end_in_time(clean: Callable[[], None]) -> None:
    """Start a thread that ends this process if an interrupt has not ended it in time.

    The time is `GRACE` after one interrupt, `IMPATIENCE` after a second. Python's own handler in C
    notifies the thread of a signal even if the main thread cannot stop: a library may block the
    main thread for minutes, or may have caught the exception.

    Parameters
    ----------
    clean : callable
        Called by the thread just before it ends the process.
    """
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    # Detached, so that the socket stays open until the process ends.
    signal.set_wakeup_fd(sender.detach(), warn_on_full_buffer=False)

    def watch() -> None:
        number, end = 0, math.inf
        while (left := end - time.monotonic()) > 0:
            receiver.settimeout(None if math.isinf(left) else left)
            with suppress(TimeoutError):
                received = receiver.recv(1)[0]
                if received in REQUESTS:
                    end = min(end, time.monotonic() + (IMPATIENCE if number else GRACE))
                    number = received
        clean()
        with suppress(OSError):
            os.write(2, SHOW_CURSOR * os.isatty(2) + f"acoustube: {SENTENCE}\n".encode())
        os._exit(128 + number)

    threading.Thread(target=watch, name="interrupts", daemon=True).start()
