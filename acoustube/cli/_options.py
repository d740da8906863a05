"""Options that several commands share, in groups, with their ranges and their help."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin, get_type_hints

from cyclopts import CoercionError, Parameter

from acoustube.base.console import ConsoleReporter, plain_console
from acoustube.base.errors import ConfigError
from acoustube.base.files import check_new_file, check_out, fresh_folder
from acoustube.base.foreign.limits import VARIABLE
from acoustube.base.rules import Number
from acoustube.runs.config import describe, is_whole
from acoustube.runs.sweep.plan import DEFAULTS

if TYPE_CHECKING:
    from rich.console import Console

SETTINGS = {
    "indenter": "indenter_mm", "shape": "shape", "depth": "depth_mm", "steps": "steps",
    "position": "position_cm", "offset": "offset_mm", "yaw": "yaw_deg", "support": "support",
    "length": "length_cm", "bore": "inner_diameter_mm", "hardness": "shore_a", "tube": "surface",
    "frequency": "frequency_khz", "temperature": "temperature_c", "resolution": "resolution",
    "source_end": "source_end", "losses": "losses", "method": "method",
}  # fmt: skip
"""Names of settings, by the names of their options."""
PICTURES = (".png", ".pdf", ".svg")
"""File name extensions of pictures."""


def whole(kind: Any, tokens: Sequence[Any]) -> int | float:  # noqa: ARG001
    """Return the whole number that a word of the command line states; 1e6 and 16.0 are whole too.

    Parameters
    ----------
    kind : type
        Type of the option, unused: cyclopts requires the argument.
    tokens : sequence of cyclopts.Token
        The word, with the option that it belongs to.

    Returns
    -------
    int or float
        A number that is not whole is returned as it is. The check of the option then rejects it and
        states the range.

    Raises
    ------
    CoercionError
        If the word is not a number.
    """
    with suppress(ValueError):
        return int(tokens[0].value)
    try:
        number = float(tokens[0].value)
    except ValueError as error:
        raise CoercionError(token=tokens[0], target_type=int) from error
    return int(number) if number.is_integer() else number


WHOLE = Parameter(converter=whole)
"""Annotation of an option that takes a whole number."""
FLAG = Parameter(show_default=False)
"""Annotation of an option without a value."""


def setting(name: str) -> Parameter:
    """Return an option whose help is the meaning, default and range of a setting."""
    converter = whole if is_whole(SETTINGS[name]) else None
    return Parameter(help=describe(SETTINGS[name]), show_default=False, converter=converter)


def axis(name: str) -> Parameter:
    """Return an option of several values with the help of :func:`setting`, for sweeps."""
    words = describe(SETTINGS[name], DEFAULTS["waves"].get(SETTINGS[name]))
    return Parameter(help=words, show_default=False, consume_multiple=True)


def settings_of(*groups: Any) -> dict[str, Any]:
    """Return the values of settings, by name, that groups of options give; None if not given."""
    return {
        SETTINGS[field.name]: getattr(group, field.name)
        for group in groups
        for field in dataclasses.fields(group)
    }


class Checked:
    """Group of options that are checked; the annotation of each states its range and unit."""

    def __post_init__(self) -> None:
        for name, rule in self._rules():
            if getattr(self, name) is not None:
                rule.check(name.replace("_", "-"), getattr(self, name))

    def in_si(self) -> SimpleNamespace:
        """Return the options by name, in SI units."""
        from acoustube.runs.config.si import to_si

        names = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}  # type: ignore[arg-type]
        numbers = {name: to_si(names[name], rule.unit) for name, rule in self._rules()}
        return SimpleNamespace(**names | numbers)

    def _rules(self) -> Iterator[tuple[str, Number]]:
        """Yield the name of each numeric option, and the rule of its annotation."""
        for name, hint in get_type_hints(type(self), include_extras=True).items():
            rules = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
            yield from ((name, rule) for rule in rules if isinstance(rule, Number))


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Limits(Checked):
    """Option of every command that reads files.

    Attributes
    ----------
    limits : float
        Factor by which the limits on the sizes of input files, and on counts in them, are
        multiplied.
    """

    limits: Annotated[float | None, Number(1e-3, 1e6, "", "factor")] = None

    def __post_init__(self) -> None:
        """Check the options, and set the limits until :func:`main` ends."""
        super().__post_init__()
        if self.limits is not None:
            os.environ[VARIABLE] = str(self.limits)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Output(Limits):
    """Options of every command.

    Attributes
    ----------
    quiet : bool
        Print nothing but errors.
    """

    quiet: Annotated[bool, FLAG] = False

    def console(self, *, stderr: bool = False) -> Console:
        """Return the console to print on."""
        return plain_console(quiet=self.quiet, stderr=stderr)

    def reporter(self, *, stderr: bool = False) -> ConsoleReporter:
        """Return the reporter that prints on :meth:`console`."""
        return ConsoleReporter(self.console(stderr=stderr))


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Tool:
    """Settings of the indenter, and of the ground under the tube."""

    indenter: Annotated[float | None, setting("indenter")] = None
    shape: Annotated[Literal["rod", "punch", "sphere"] | None, setting("shape")] = None
    depth: Annotated[float | None, setting("depth")] = None
    support: Annotated[Literal["held", "free"] | None, setting("support")] = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Run:
    """Files of a single run: settings and results.

    Attributes
    ----------
    config : Path
        TOML file with settings, which options override.
    out : Path
        Folder to write, new or empty; COMMAND-1, COMMAND-2 and so on if not given.
    """

    config: Path | None = None
    out: Path | None = None

    def folder(self, command: str) -> Path:
        """Return the folder to write, checked, by default named after the command."""
        return checked_folder(self.out, command)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Workers(Checked):
    """Number of worker processes.

    Attributes
    ----------
    workers : int
        Worker processes; as many as there are cores if not given.
    """

    workers: Annotated[int | None, WHOLE, Number(1, 1024, "", "processes", whole=True)] = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Ranging(Checked):
    """Options of the localisation of echoes.

    Attributes
    ----------
    calibration : str
        Calibration to use: a file that ``calibrate`` or ``twin`` wrote, or a name.
    prominence : float
        Least prominence of a detected echo, as a fraction of the send pulse, in place of the
        calibration's.
    """

    calibration: str | None = None
    prominence: Annotated[float | None, Number(1e-6, 1, "", "fraction of the send pulse")] = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Recording(Checked):
    """Options of the reading of recordings.

    Attributes
    ----------
    rate : float
        Sampling rate in Hz, in place of that in the files.
    temperature : float
        Air temperature in degC, in place of that in the files.
    channel : int
        Channel to read, from 0.
    samples : int
        Samples per cycle, for files that are one long record of many cycles.
    """

    rate: Annotated[float | None, Number(1e3, 1e7, "Hz", "samples per second")] = None
    temperature: float | None = None
    channel: Annotated[int | None, WHOLE, Number(0, 1e6, "", "from 0", whole=True)] = None
    samples: Annotated[int | None, WHOLE, Number(2, 1e12, "", "per cycle", whole=True)] = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Lead:
    """Start of the send pulse in each cycle, for a recorder that starts before that pulse.

    Attributes
    ----------
    pulse_at : float or "auto"
        Time in ms from the first sample to the start of the send pulse; auto estimates it, the same
        for all cycles; by default the pulse starts at time zero of the recording.
    """

    pulse_at: Literal["auto"] | float | None = None

    def __post_init__(self) -> None:
        """Check the start of the send pulse."""
        if self.pulse_at not in (None, "auto"):
            Number(0, 1e6, "ms", "from the first sample").check("pulse-at", self.pulse_at)


def checked_folder(out: Path | None, command: str) -> Path:
    """Return the folder to write, checked, by default named after the command."""
    return check_out(out if out is not None else fresh_folder(command))


def check_files(**files: Path | None) -> None:
    """Check that files can be written, before anything is computed.

    Parameters
    ----------
    **files : Path or None
        New files by the names of their options; a ``figure`` must be a picture.

    Raises
    ------
    ConfigError
        If a file exists, cannot be written, or is not a picture, or two options name one file.
    """
    named: dict[Path, str] = {}
    for name, path in files.items():
        if path is not None:
            other = named.setdefault(path.absolute(), name)
            if other != name:
                raise ConfigError(f"{other} and {name} name the same file, {path}; name two files")
            check_new_file(path, name)
            if name == "figure":
                check_picture(path, name)


def check_picture(picture: Path, name: str) -> None:
    """Check the name of a picture.

    Raises
    ------
    ConfigError
        If it ends in none of :data:`PICTURES`.
    """
    if picture.suffix.lower() not in PICTURES:
        raise ConfigError(f"{name} = {picture} must end in one of {', '.join(PICTURES)}")
