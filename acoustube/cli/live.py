"""The command ``acoustube live``: distances from the cycles of a board, as they arrive."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from acoustube.base.console import REPORT_INTERVAL
from acoustube.base.errors import ConfigError, readable
from acoustube.base.rules import Number
from acoustube.base.units import CM
from acoustube.cli._options import WHOLE, Checked, Output, Ranging, check_files

if TYPE_CHECKING:
    from rich.console import Console

    from acoustube import signals
    from acoustube.runs.live import Show, Stream, Tally
    from acoustube.runs.live_contacts import Contacts

REFRESH = 0.1
"""Refresh interval of the panel in a terminal, in s."""
BARS, FLOOR_DB, TRACE = " ▁▂▃▄▅▆▇█", -40.0, 60
"""Trace of an envelope in text: characters from low to high, level of the lowest in dB relative to
the send pulse, and width in characters."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Line(Checked):
    """Options of the serial line.

    Attributes
    ----------
    temperature : float
        Air temperature in degC.
    rate : float
        Sampling rate in Hz.
    frame_bytes : int
        Bytes of a frame (one cycle), including two that state the pulse width.
    baud : int
        Bit rate of the line in bit/s.
    """

    temperature: Annotated[float, Number(-40, 85, "degC", "of the air")] = 20.0
    rate: Annotated[float, Number(1e3, 1e8, "Hz", "samples per second")] = 80e3
    frame_bytes: Annotated[
        int, WHOLE, Number(12, 1_000_000, "", "bytes of a frame", whole=True)
    ] = 2000
    baud: Annotated[
        int, WHOLE, Number(300, 100_000_000, "", "bits per second of the line", whole=True)
    ] = 1_000_000


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Inverted(Checked):
    """Options of the search for contacts by waveform inversion.

    Attributes
    ----------
    library : Path
        Folder that the command library wrote: each cycle is inverted, and distance, depth,
        force and probability of its contacts are shown in addition to the highest echo.
    sensor : Path
        TOML file with the parameters of the board's rangefinder, the tube's length_cm and a table
        [priors].
    rest : float
        Time in s at the start during which the tube is untouched and its clutter is estimated; 0
        for none.
    most : int
        Largest number of contacts.
    contacts : Path
        Table of contacts to write (CSV), which must be new; one row per contact and cycle.
    """

    library: Path | None = None
    sensor: Path | None = None
    rest: Annotated[float, Number(0, 3600, "s", "untouched")] = 3.0
    most: Annotated[int, WHOLE, Number(1, 8, "", "contacts", whole=True)] = 3
    contacts: Path | None = None


def live(
    *,
    port: str,
    ranging: Ranging = Ranging(),
    line: Line = Line(),
    inverted: Inverted = Inverted(),
    out: Path | None = None,
    duration: float | None = None,
    output: Output = Output(),
) -> None:
    """Estimate the distance of a press in each cycle that an EchoTube board sends, as it arrives.

    The command ends after the duration, when the connection ends, or at an interrupt (Ctrl-C).

    Parameters
    ----------
    port : str
        Serial port, such as /dev/ttyACM0.
    out : Path
        Table to write (CSV), which must be new; each row is written as its cycle arrives.
    duration : float
        Duration in s; by default no limit.
    """
    if duration is not None:
        Number(0, 1e9, "s", "duration of the stream").check("duration", duration)
    check_files(out=out, contacts=inverted.contacts)

    from acoustube.runs.live import Stream

    stream = Stream(port=port, **dataclasses.asdict(ranging), **dataclasses.asdict(line))
    contacts = _contacts(inverted)
    run_live(stream, output.console(), out=out, duration=duration, contacts=contacts)


def _contacts(inverted: Inverted) -> Contacts | None:
    """Return the settings of the search for contacts; None without a library."""
    given = dataclasses.asdict(inverted)
    folder, table = given["library"], given["contacts"]
    if folder is None:
        for name in ("sensor", "contacts"):
            if given[name] is not None:
                raise ConfigError(f"--{name} needs --library; name the folder of a library")
        return None

    from acoustube.runs.live_contacts import Contacts

    return Contacts(
        folder=folder, sensor=inverted.sensor, rest=inverted.rest, most=inverted.most, table=table
    )


def run_live(
    stream: Stream,
    console: Console,
    *,
    out: Path | None = None,
    duration: float | None = None,
    contacts: Contacts | None = None,
) -> Tally:
    """Process a board's cycles and show them: a panel in a terminal, else a line every 10 s.

    Parameters
    ----------
    stream : Stream
    console : rich.console.Console
        Console to show the cycles on.
    out, duration, contacts
        See :func:`acoustube.runs.live.follow`.

    Raises
    ------
    ConfigError
        If the calibration or the port cannot be used.
    SimulationError
        If the serial connection is lost.
    KeyboardInterrupt
        On Ctrl-C, with a message on the numbers of cycles and on the table, if any, with them.
    """
    from acoustube.runs.live import follow

    with _shown(console, stream.port) as show:
        tally, failure = follow(stream, show, out=out, duration=duration, contacts=contacts)
    console.print(tally.words(), soft_wrap=True)
    if failure is not None:
        raise failure
    return tally


@contextlib.contextmanager
def _shown(console: Console, port: str) -> Iterator[Show]:
    """Yield a function that shows the last cycle periodically, as a panel or as lines."""
    from rich.live import Live
    from rich.panel import Panel
    from rich.text import Text

    in_place = console.is_terminal and not console.quiet
    interval = REFRESH if in_place else REPORT_INTERVAL
    before = time.perf_counter()
    with contextlib.ExitStack() as stack:
        panel = Live(console=console, auto_refresh=False, transient=True) if in_place else None
        if panel is not None:
            stack.enter_context(panel)

        def show(tally: Tally, ranging: signals.Ranging | None) -> None:
            nonlocal before
            if time.perf_counter() - before < interval:
                return
            before = time.perf_counter()
            head = "nothing yet" if ranging is None else _found(ranging)
            lines = _contact_lines(tally, in_place=panel is not None)
            if panel is None:
                console.print("; ".join([head, *lines, tally.words()]), soft_wrap=True)
                return
            bars = "" if ranging is None else trace(ranging.envelope)
            text = "\n".join([head, bars, *lines, tally.words()])
            panel.update(Panel(text, title=Text(readable(port)), expand=False), refresh=True)

        yield show


def _contact_lines(tally: Tally, *, in_place: bool) -> list[str]:
    """Return lines on the contacts; in a panel, also a line that shows them on the tube."""
    if tally.learning:
        return ["recording the untouched tube; do not touch it"]
    if tally.found is None:
        return []
    from acoustube.runs.live_contacts import drawn, in_words

    lines = in_words(tally.found) or ["no contact"]
    return [drawn(tally.found, TRACE), *lines] if in_place else lines


def _found(ranging: signals.Ranging) -> str:
    """Return distance and amplitude of a cycle's highest echo in words."""
    if not ranging.detected:
        return "no echo"
    return f"{CM * float(ranging.distance):.1f} cm, amplitude {float(ranging.amplitude):.3f}"


def trace(envelope: Any, width: int = TRACE) -> str:
    """Return an envelope, (time,), as a text of bars; the lowest is 40 dB below the send pulse."""
    import numpy as np

    starts = np.linspace(0, envelope.size, width, endpoint=False).astype(int)
    highest = np.maximum.reduceat(np.nan_to_num(envelope), starts)
    level = 1 - 20 * np.log10(np.maximum(highest, 1e-9)) / FLOOR_DB
    index = np.clip(np.ceil(level * (len(BARS) - 1)), 0, len(BARS) - 1).astype(int)
    return "".join(BARS[i] for i in index)
