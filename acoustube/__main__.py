"""The command ``acoustube``, also as ``python -m acoustube``."""

import io
import os
import signal
import sys
from contextlib import suppress
from typing import Any, NoReturn


def entry() -> NoReturn:
    """Run the command line and leave with its exit code.

    An interrupt at any moment, also while modules are being loaded, ends the command with a
    one-line message. SIGTERM and SIGHUP are handled like an interrupt, so that a batch system
    leaves no half-written folder either.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        # In the background of a script, or under nohup, signals are ignored and stay so.
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _leave)
    _keep_streams()
    code: Any = 1
    try:
        from acoustube.base.interrupts import end_in_time, exit_code, watched_interrupts
        from acoustube.base.writing import discard

        with watched_interrupts(_leave):
            end_in_time(discard)
            try:
                code = _run()
            except KeyboardInterrupt:  # a second one, while the first was being handled
                code = _interrupted(exit_code())
            except SystemExit as error:  # freeing its frames may lose an interrupt, watched here
                code = error.code
    except KeyboardInterrupt:
        code = _interrupted(128 + signal.SIGINT)
    except SystemExit as error:
        code = error.code
    # A normal exit of Python would wait for compiled code that still runs, or free its memory.
    discard()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code if isinstance(code, int) else 1)


def _run() -> int:
    """Run the command line; return its exit code."""
    if not sys.warnoptions:  # libraries' warnings are for developers; notes inform the users
        os.environ["PYTHONWARNINGS"] = "ignore"
        import warnings

        warnings.simplefilter("ignore")
    from acoustube.base.cache import keep_compiled_code
    from acoustube.base.compilation import compile_quickly

    keep_compiled_code()
    compile_quickly()
    from acoustube.cli._app import main

    try:
        return main()
    except Exception:  # a defect, which its traceback shows best
        sys.excepthook(*sys.exc_info())
        return 1


def _keep_streams() -> None:
    """Open the standard streams that are closed, and let any character be written to them.

    Otherwise the next file that is opened would get the file descriptor of a closed stream, and
    output to this stream would be written to that file.
    """
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            number = os.open(os.devnull, os.O_RDWR)
            setattr(sys, name, os.fdopen(number, "r" if name == "stdin" else "w"))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _leave(number: int, _frame: object) -> None:
    """Handle a signal before the command has begun, or after its end: exit."""
    os._exit(_interrupted(128 + number))


def _interrupted(code: int) -> int:
    """Print that the command was interrupted; return its exit code."""
    with suppress(OSError):
        os.write(2, b"acoustube: interrupted; no incomplete run is left\n")
    return code


if __name__ == "__main__":
    entry()
