"""The command line: options in, one table or one sentence out.

Only light modules are imported here, so that ``--help`` and every refusal come at once; a command
imports its solvers when its settings have been accepted.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, CycloptsError, Parameter

from acoustube import __version__
from acoustube.config import load_config
from acoustube.errors import ConfigError, SimulationError
from acoustube.io import check_out, fresh_folder

app = App(
    name="acoustube",
    version=__version__,
    help="Simulate a silicone tube that carries ultrasound and is pressed by a cylinder.",
    default_parameter=Parameter(negative=()),
    # An interrupt must reach `main`, which says what became of the run.
    suppress_keyboard_interrupt=False,
)


@app.command
def simulate(
    *,
    indenter: float | None = None,
    depth: float | None = None,
    position: float | None = None,
    length: float | None = None,
    support: Literal["held", "free"] | None = None,
    frequency: float | None = None,
    temperature: float | None = None,
    # A float, because a whole number would be rounded from 3.5 without a word.
    resolution: float | None = None,
    source_end: Literal["release", "absorbing"] | None = None,
    config: Path | None = None,
    out: Path | None = None,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> None:
    """Press the tube once, and find the press by its echo.

    An option that is not given is taken from the file, then from the defaults: the paper's tube,
    pressed 4 mm deep in its middle by a 25 mm cylinder.

    Parameters
    ----------
    indenter : float
        Diameter of the pressing cylinder in mm.
    depth : float
        How far it is pressed in, in mm.
    position : float
        Distance of the press from the source end in cm.
    length : float
        Length of the tube in cm.
    support : {"held", "free"}
        Bottom line held down along its length, or resting on a floor with free ends.
    frequency : float
        Carrier of the sound pulse in kHz.
    temperature : float
        Temperature of the air in degC.
    resolution : int
        Grid cells across the bore.
    source_end : {"release", "absorbing"}
        What the source end does once the pulse has left.
    config : Path
        A TOML file with settings; the options above win over it.
    out : Path
        The folder to write, which must be new or empty.
    quiet : bool
        Print nothing.
    """
    settings = load_config(
        config,
        indenter_mm=indenter,
        depth_mm=depth,
        position_cm=position,
        length_cm=length,
        support=support,
        frequency_khz=frequency,
        temperature_c=temperature,
        resolution=resolution,
        source_end=source_end,
    )
    folder = check_out(out if out is not None else fresh_folder("simulate"))

    from rich.console import Console

    from acoustube.run import run

    run(settings, folder, Console(quiet=quiet))


def main(tokens: Sequence[str] | None = None) -> int:
    """Run a command.

    Parameters
    ----------
    tokens : sequence of str, optional
        The words after ``acoustube``; those of the shell by default.

    Returns
    -------
    int
        Exit code: 0 done, 1 a stage failed, 2 wrong usage, 130 interrupted.
    """
    try:
        app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
    except (ConfigError, CycloptsError) as error:
        return _refuse(str(error), 2)
    except (SimulationError, OSError) as error:
        return _refuse(str(error), 1)
    except KeyboardInterrupt:
        return _refuse("interrupted; nothing was written", 130)
    return 0


def _refuse(message: str, code: int) -> int:
    """Print one sentence on standard error and return the exit code."""
    # Several sentences, some of them cyclopts' own, are joined into one, on one line.
    joined = re.sub(r"[.?] ([A-Z])", lambda m: f"; {m[1].lower()}", " ".join(message.split()))
    print(f"acoustube: {joined}", file=sys.stderr)
    return code
