"""The command ``acoustube scatter``: the scattering matrix of a lumen, in a file."""

from __future__ import annotations

import functools
import time
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from acoustube.base import cache
from acoustube.base.console import ConsoleReporter
from acoustube.base.errors import ConfigError
from acoustube.base.files import check_netcdf_name, check_new_file, check_surface
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.rules import Number
from acoustube.base.units import KHZ, UM, US
from acoustube.cli._options import FLAG, WHOLE, Checked, Output

if TYPE_CHECKING:
    from collections.abc import Callable

    from acoustube.air import Air
    from acoustube.base.report import Reporter
    from acoustube.runs.scattering_file import StoredScattering
    from acoustube.waves.grid.cells import CutCells
    from acoustube.waves.scattering import ModalScattering, Scattering
    from acoustube.waves.spectral import SpectralScattering

HIGHEST_KHZ = 1000.0
"""Frequency in kHz above which a band is taken to be stated in Hz."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Band:
    """Frequencies of the scattering matrix.

    Attributes
    ----------
    band : tuple of float
        Lowest and highest frequency in kHz.
    step : float
        Frequency step in kHz.
    """

    band: tuple[float, float] = (5.0, 60.0)
    step: float = 0.1

    def n_steps(self) -> int:
        """Return the number of frequency steps in the band.

        Raises
        ------
        ConfigError
            If the band does not increase, seems to be in Hz, or is not 1 to 5000 whole steps wide.
        """
        (low, high), step = self.band, self.step
        if high > HIGHEST_KHZ:
            raise ConfigError(
                f"band = {low:g} {high:g} kHz is above {HIGHEST_KHZ:g} kHz; give it in kHz, "
                "such as 5 60"
            )
        if not 0 < low < high:
            raise ConfigError(f"band = {low:g} {high:g} kHz is invalid; use 0 < low < high")
        count = (high - low) / step if step > 0 else 0.0
        if not (0.999 < count < 5000 and abs(count - round(count)) < 1e-6 * count):
            raise ConfigError(
                f"must divide the band of {high - low:g} kHz into 1 to 5000 equal steps",
                setting="step", value=step, unit="kHz",
                advice=f"use {(high - low) / max(1, round(min(count, 5000))):.6g}",
            )  # fmt: skip
        return round(count)

    def frequencies(self) -> Any:
        """Return the frequencies in Hz, (n,), both ends of the band included."""
        import numpy as np

        from acoustube.runs.config.si import KILO

        return KILO * np.linspace(*self.band, self.n_steps() + 1)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Medium(Checked):
    """State of the air, and its losses.

    Attributes
    ----------
    temperature : float
        Air temperature in degC.
    humidity : float
        Relative humidity of the air in per cent.
    pressure : float
        Air pressure in kPa.
    lossless : bool
        Omit the losses at the wall and in the air.
    """

    temperature: Annotated[float, Number(-20, 60, "degC", "of the air")] = 20.0
    humidity: Annotated[float, Number(0, 100, "%", "of the air")] = 50.0
    pressure: Annotated[float, Number(10, 200, "kPa", "of the air")] = 101.325
    lossless: Annotated[bool, FLAG] = False


def scatter(
    lumen: Path,
    /,
    *,
    band: Band = Band(),
    medium: Medium = Medium(),
    resolution: Annotated[int, WHOLE] = 32,
    method: Literal["march", "spectral"] = "march",
    tolerance: float = 1e-3,
    out: Path,
    output: Output = Output(),
) -> None:
    """Compute the scattering matrix of a lumen between its straight ends, over a band.

    Parameters
    ----------
    lumen : Path
        Air space as a closed surface in mm along z (STL, PLY, OBJ, VTP), with two straight ends of
        the same section.
    resolution : int
        Grid cells across the ends, for the method march.
    method : {"march", "spectral"}
        Solver: march, FDTD on a grid in the time domain; or spectral, which takes seconds and
        estimates its error. A lumen outside the range of spectral is computed by march.
    tolerance : float
        Largest error of a scattering coefficient that the method spectral aims at.
    out : Path
        File to write (netCDF), which must be new.
    """
    check_surface(lumen)
    check_new_file(out)
    check_netcdf_name(out)
    band.n_steps()
    Number(8, 128, "", "grid cells across the ends", whole=True).check("resolution", resolution)
    Number(1e-6, 0.1, "", "of the spectral solver").check("tolerance", tolerance)

    from acoustube.base.netcdf import write_dataset
    from acoustube.runs.scattering_file import to_dataset

    started = time.perf_counter()
    report = output.reporter()
    task = _Task(lumen, band.frequencies(), medium, resolution, tolerance)
    found, notes = _scattering(task, method, report)
    dataset = to_dataset(found)
    dataset.attrs |= {
        "lumen": lumen.name.encode("utf-8", "backslashreplace").decode(),
        "warnings": "\n".join(notes),
        "temperature": medium.temperature,
        "humidity_percent": medium.humidity,
        "pressure_kpa": medium.pressure,
        "losses": "none" if medium.lossless else "wall and air",
    }
    write_dataset(dataset, out)
    _print(found, notes, report)
    report.line(f"Written to {out} in {time.perf_counter() - started:.0f} s.")


@dataclass(frozen=True, eq=False)
class _Task:
    """Validated arguments of the command; frequencies in Hz."""

    path: Path
    frequency: Any
    medium: Medium
    resolution: int
    tolerance: float


def _scattering(task: _Task, method: str, report: Reporter) -> tuple[StoredScattering, list[str]]:
    """Return the scattering matrix of a lumen, and the notes on it."""
    from acoustube.air import air_at
    from acoustube.base.surfaces import read_lumen

    state = task.medium.in_si()
    air = air_at(state.temperature, humidity=state.humidity, pressure=state.pressure)
    surface, start = read_lumen(task.path)
    unsuitable = []
    with watched_interrupts() as check, report.progress(check) as show:
        progress = functools.partial(show, "scattering")
        if method == "spectral":
            try:
                return _spectral(task, air, surface, start, progress)
            except ConfigError as reason:
                cause = str(reason).partition(";")[0]
                unsuitable.append(
                    "The time-domain solver (march) computed the scattering, since the spectral "
                    f"solver cannot: {cause}"
                )
        found, notes = _marched(task, air, surface, start, progress)
    return found, [*unsuitable, *notes]


def _spectral(
    task: _Task, air: Air, surface: Any, start: float, progress: Callable[[float], None]
) -> tuple[SpectralScattering, list[str]]:
    """Return the scattering matrix by the spectral solver, and the notes on it."""
    from acoustube.runs.surface_scattering import spectral_of_surface

    progress(0.0)
    found = spectral_of_surface(
        surface, start, air, task.frequency, tolerance=task.tolerance,
        lossy=not task.medium.lossless,
    )  # fmt: skip
    return found, [*_cut_on_notes(found), *([found.excess] if found.excess else [])]


def _marched(
    task: _Task, air: Air, surface: Any, start: float, progress: Callable[[float], None]
) -> tuple[Scattering, list[str]]:
    """Return the scattering matrix by the time-domain solver, and the notes on it."""
    from acoustube.runs.scattering_file import keep, recall
    from acoustube.runs.surface_scattering import cells_of_surface
    from acoustube.waves.scattering import Scattering
    from acoustube.waves.scattering import scatter as scattering

    highest = float(task.frequency[-1])
    cells = cells_of_surface(surface, task.path, task.resolution, highest, air)
    progress(0.0)
    name = _name(surface, start, task)
    found = recall(name)
    if not isinstance(found, Scattering):
        found = scattering(
            cells, air, task.frequency, reference=(-start, -start),
            lossy=not task.medium.lossless, progress=progress,
        )  # fmt: skip
        keep(name, found, f"sound of {task.path.name}")  # skipped if the disk is full
    return found, _notes(cells, found, air)


def _name(surface: Any, start: float, task: _Task) -> str:
    """Return the cache key of the matrix; the surface in the file begins at z = `start` in m."""
    shape = sha256(surface.vertices.tobytes() + surface.faces.tobytes()).hexdigest()
    return cache.key(
        "scattering",
        {
            "surface": [shape, start],
            "frequency": task.frequency.tolist(),
            "medium": asdict(task.medium),
            "resolution": task.resolution,
        },
    )


def _cut_on_notes(found: ModalScattering) -> list[str]:
    """Return a sentence on the modes that cut on inside the band; an empty list if none does."""
    low, high = found.frequency[[0, -1]]
    inside = [
        f"{name} at {KHZ * cut_on:.2f} kHz"
        for name, cut_on in zip(found.modes, found.cut_ons, strict=True)
        if low < cut_on < high
    ]
    words = (
        f"Modes cut on inside the band: {', '.join(inside)}. Within 1 % of these, small errors "
        "of size or temperature decide whether they propagate."
    )
    return [words] if inside else []


def _notes(cells: CutCells, found: Scattering, air: Air) -> list[str]:
    """Return a sentence for each assumption of the time-domain model that the lumen violates."""
    import numpy as np

    from acoustube.air import NARROW_GAP_LAYERS, viscous_thickness
    from acoustube.runs.surface_scattering import openings
    from acoustube.waves.grid.straight_part import straight_ends_cut

    low = float(found.frequency[0])
    notes = _cut_on_notes(found)
    gap = float(openings(straight_ends_cut(cells)).min())
    layers = gap / viscous_thickness(air, low)
    if layers < NARROW_GAP_LAYERS:
        notes.append(
            f"The lumen is {UM * gap:.0f} um wide at its narrowest, {layers:.0f} viscous boundary "
            f"layers at {KHZ * low:g} kHz: there the first-order model of losses is not valid."
        )
    n = len(found.frequency)
    ringing = np.any((~found.settled & _propagating(found)).reshape(n, -1), axis=1)
    if ringing.any():
        above = found.frequency[ringing, None] / np.maximum(found.cut_ons, 1.0) - 1
        farthest = float(np.max(np.min(np.abs(above), axis=1)))
        notes.append(
            f"{ringing.sum()} of {n} frequencies, up to {100 * farthest:.1f} % from a cut-on, were "
            "still ringing in some mode; see the variable settled."
        )
    return notes


def _propagating(found: Scattering) -> Any:
    """Return whether both modes of each coefficient propagate, in the shape of `s`."""
    import numpy as np

    travels = found.propagates
    both = travels[:, None, :, None, None] & travels[:, None, None, None, :]
    return np.broadcast_to(both, found.s.shape)


def _print(found: StoredScattering, notes: list[str], report: ConsoleReporter) -> None:
    """Print the plane mode's coefficients, the discretisation and the notes."""
    import numpy as np
    from rich.table import Table

    plane = found.modes.index("00")
    s = found.s[:, :, plane, 0, plane]
    table = Table("kHz", "|R00|", "|T00|", box=None, pad_edge=False)
    for i in np.unique(np.linspace(0, len(s) - 1, 12).round().astype(int)):
        table.add_row(
            f"{KHZ * found.frequency[i]:.2f}", f"{abs(s[i, 0]):.4f}", f"{abs(s[i, 1]):.4f}"
        )
    report.console.print(table)
    for line in _quality(found):
        report.line(line)
    for words in notes:
        report.note(words)


def _quality(found: StoredScattering) -> tuple[str, str]:
    """Return a line on the discretisation, and one on the accuracy of the coefficients."""
    import numpy as np

    from acoustube.waves.spectral import SpectralScattering

    if isinstance(found, SpectralScattering):
        solver = (
            f"spectral solver: degree {found.degree}, {found.n_elements} elements, "
            f"{found.n_shifts} shifts, {found.n_fields} fields; modes {', '.join(found.modes)}"
        )
        accuracy = (
            f"estimated error of the coefficients: {found.typical_error:.1g} at 95 % of the "
            f"frequencies, {found.error.max():.1g} at most (see the variable error)"
        )
        return solver, accuracy
    nx, ny, nz = found.shape
    high, over = float(found.frequency[-1]), 100 * np.mean(found.settled[_propagating(found)])
    across = found.sound_speed / (high * max(found.spacing))
    solver = (
        f"grid {nx} x {ny} x {nz}, {found.steps} steps of {US * found.time_step:.3g} us; "
        f"modes {', '.join(found.modes)}"
    )
    accuracy = (
        f"accuracy: {across:.0f} cells per wavelength at {KHZ * high:g} kHz, where 16 cells give "
        "R and T within 0.01, 32 within 0.003 (see the documentation); straight ends and absorbers "
        f"add no error; {over:.1f} % of the coefficients are settled"
    )
    return solver, accuracy
