"""The application ``acoustube``: its commands, and how an error becomes one line and an exit code.

A command is loaded when it is called or when help is printed, and imports its solvers only after
its options have been accepted, so that ``--help`` and every error of usage appear at once.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

from cyclopts import App, CoercionError, CycloptsError, Parameter, UnusedCliTokensError

from acoustube.base import cache
from acoustube.base.errors import LONGEST_SENTENCE, ConfigError, SimulationError, readable
from acoustube.base.foreign.limits import VARIABLE
from acoustube.base.interrupts import SENTENCE, exit_code, watched_interrupts
from acoustube.base.version import __version__
from acoustube.base.writing import FULL, DiskFullError

COMMANDS = (
    "simulate", "sweep", "dataset", "library", "show", "export", "indent", "scatter", "process",
    "live", "calibrate", "twin", "invert", "design", "train", "evaluate", "reproduce", "sleeve",
    "check", "cite",
)  # fmt: skip
"""Commands; each is a function in the module of its name in this package."""
SETTLED = ("simulate", "indent", "sweep")
"""Commands that take settings, including settings without an option of their own."""

app = App(
    name="acoustube",
    version=__version__,
    help="Simulate soft acoustic-waveguide touch sensors: silicone tubes that carry ultrasound, in "
    "which a press echoes.",
    default_parameter=Parameter(negative=(), json_list=False, json_dict=False),
    # An interrupt must reach `main`, which reports what is kept of the run.
    suppress_keyboard_interrupt=False,
)
for command in COMMANDS:
    app.command(f"acoustube.cli.{command}:{command}", name=command)
app.command("acoustube.cli.cache:app", name="cache")
app.register_install_completion_command(help="Let the shell complete commands and options.")


def main(tokens: Sequence[str] | None = None) -> int:
    """Run a command.

    Parameters
    ----------
    tokens : sequence of str, optional
        The words after ``acoustube``; those of the shell by default.

    Returns
    -------
    int
        Exit code: 0 done, 1 a stage failed, 2 wrong usage, 130 interrupted, 143 terminated.
    """
    words = sys.argv[1:] if tokens is None else tokens
    try:
        with watched_interrupts() as check, _limits_of_one_command():
            if not words or words[0] not in (*COMMANDS, "cache"):
                for name in (*COMMANDS, "cache"):  # loaded, so that their list has descriptions
                    app[name]
            try:
                code = app(
                    tokens, exit_on_error=False, print_error=False, result_action="return_value"
                )
                sys.stdout.flush()
            except Exception:
                check()  # a library may have turned an interrupt into its own error
                raise
            check()
    except CycloptsError as error:
        return _fail(_in_one_sentence(error), 2)
    except ConfigError as error:
        return _fail(str(error), 2)
    except BrokenPipeError:  # the reader, such as head, has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except DiskFullError as error:
        return _fail(f"{error}; {_kept()}", 1)
    except SimulationError as error:
        return _fail(str(error), 1)
    except OSError as error:
        return _fail(_about_file(error), 1)
    except KeyboardInterrupt as error:
        return _fail(str(error) or SENTENCE, exit_code())
    return code if isinstance(code, int) else 0


@contextmanager
def _limits_of_one_command() -> Iterator[None]:
    """Restore the environment variable for limits of files at the end; ``--limits`` changes it."""
    before = os.environ.get(VARIABLE)
    try:
        yield
    finally:
        os.environ.pop(VARIABLE, None)
        if before is not None:
            os.environ[VARIABLE] = before


def _in_one_sentence(error: CycloptsError) -> str:
    """Return the message of an error of usage, with advice, as one sentence."""
    command = " ".join(["acoustube", *(error.command_chain or ())])
    if isinstance(error, UnusedCliTokensError):
        surplus = error.unused_tokens or ()
        arguments = "argument" if len(surplus) == 1 else "arguments"
        return f'unexpected {arguments} "{" ".join(surplus)}"; see {command} --help'
    # Several sentences are joined into one.
    words = re.sub(r"[.?] ([A-Z])", lambda m: f"; {m[1].lower()}", " ".join(str(error).split()))
    words = re.sub(r"(?<!\.)\.$", "", words)
    given = r'^Command "(.*)" parameter (\S+) requires '
    words = re.sub(f"{given}an argument", r"\1 needs \2 and its value", words)
    words = re.sub(rf"{given}(\d+) positional arguments", r"\1 \2 needs \3 values", words)
    if option := re.match(r"Unknown option: --([a-z-]+)", words):
        with suppress(ConfigError):
            return _advice_on_setting(option[1], command)
    if "did you mean" in words or "choose from" in words:
        return words
    if isinstance(error, CoercionError):
        words = re.sub(r'unable to convert (".*") into (float|int)', r"\1 is not a number", words)
        return f"{words}; give a number without a unit"
    return f"{words}; see {command} --help"


def _advice_on_setting(option: str, command: str) -> str:
    """Return the advice on an unknown option that is the name of a setting.

    Raises
    ------
    ConfigError
        If the option is not a setting, or the command takes no settings.
    """
    from acoustube.cli._options import SETTINGS
    from acoustube.runs.config import section_of

    if command.split()[-1] not in SETTLED:
        raise ConfigError(f"{command} takes no settings")
    name = option.replace("-", "_")
    given = SETTINGS.get(name, name)
    name = given if section_of(given) == "tube" else name
    file = f"--config FILE with {name} in [{section_of(name)}]"
    how = f"--vary {name}=VALUE" if command.endswith("sweep") else file
    return f"--{option} is not an option, but {name} is a setting; give {how}"


def _kept() -> str:
    """Return the advice for a full disk, which says whether results were cached."""
    again, kept = "make room and repeat the command", cache.has_kept()
    if kept is None:
        return again
    if kept:
        return f"{again}; its presses and scattering matrices are in the cache"
    return f"{again}; the cache could not be written either, so that all is computed again"


def _about_file(error: OSError) -> str:
    """Return a system error with the file that it concerns, where that is known."""
    if error.errno in FULL:
        return f"{error.filename or 'standard output'}: {FULL[error.errno]}; make room"
    return str(error) if error.filename is None else f"{error.filename}: {error.strerror}"


def _fail(message: str, code: int) -> int:
    """Print one line on standard error and return the exit code."""
    with suppress(OSError):  # standard error is closed, or a pipe that nobody reads
        sentence = readable(" ".join(message.split()), LONGEST_SENTENCE)
        print(f"acoustube: {sentence}", file=sys.stderr, flush=True)
    return code
