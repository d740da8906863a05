"""The command ``acoustube scatter``: the scattering matrix of a lumen, in a file."""

from __future__ import annotations

import functools
import time
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from acoustube.base import cache
from acoustube.base.console import ConsoleReporter, note
from acoustube.base.errors import ConfigError
from acoustube.base.files import check_netcdf_name, check_new_file, check_surface
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.rules import Number
from acoustube.base.units import KHZ, MM, UM, US
from acoustube.cli._options import FLAG, WHOLE, Checked, Output
from acoustube.runs.config import CELLS_PER_WAVELENGTH
from acoustube.runs.config.checks import MOST_CELLS

if TYPE_CHECKING:
    from rich.console import Console

    from acoustube.air import Air
    from acoustube.base.report import Reporter
    from acoustube.waves.grid.cells import CutCells
    from acoustube.waves.scattering import Scattering

HIGHEST_KHZ = 1000.0
"""Frequency above which Hz are suspected."""
NARROWEST_CELLS = 2
"""Least number of cells across the narrowest place."""


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
        """Return the number of steps.

        Raises
        ------
        ConfigError
            If the band does not increase, is given in Hz, or is not a multiple of the step.
        """
        (low, high), step = self.band, self.step
        if high > HIGHEST_KHZ:
            raise ConfigError(
                f"band = {low:g} {high:g} kHz goes beyond {HIGHEST_KHZ:g} kHz; give it in kHz, "
                "such as 5 60"
            )
        if not 0 < low < high:
            raise ConfigError(f"band = {low:g} {high:g} kHz must rise from over 0")
        count = (high - low) / step if step > 0 else 0.0
        if not (0.999 < count < 5000 and abs(count - round(count)) < 1e-6 * count):
            raise ConfigError(
                f"must divide the band of {high - low:g} kHz into 1 to 5000 whole parts",
                setting="step", value=step, unit="kHz",
                advice=f"use {(high - low) / max(1, round(min(count, 5000))):.6g}",
            )  # fmt: skip
        return round(count)

    def frequencies(self) -> Any:
        """Return the frequencies in Hz."""
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
        Losses at the wall and in the air left out.
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
        Grid cells across the ends.
    out : Path
        File to write (netCDF), which must be new.
    """
    check_surface(lumen)
    check_new_file(out)
    check_netcdf_name(out)
    band.n_steps()
    Number(8, 128, "", "grid cells across the ends", whole=True).check("resolution", resolution)

    from acoustube.base.netcdf import write_dataset
    from acoustube.runs.scattering_file import to_dataset

    started = time.perf_counter()
    console = output.console()
    report = ConsoleReporter(console)
    found, notes = _scattering(lumen, band.frequencies(), medium, resolution, report)
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
    _print(found, notes, console)
    elapsed = time.perf_counter() - started
    console.print(f"Written to {out} in {elapsed:.0f} s.", soft_wrap=True)


def _scattering(
    lumen: Path,
    frequency: Any,
    medium: Medium,
    resolution: int,
    report: Reporter,
) -> tuple[Scattering, list[str]]:
    """Return the scattering matrix of a lumen, and the notes on it."""
    import numpy as np

    from acoustube.air import air_at
    from acoustube.base.surfaces import read_lumen
    from acoustube.runs.scattering_file import keep, recall
    from acoustube.waves.grid.cells import cut_cells
    from acoustube.waves.scattering import Scattering
    from acoustube.waves.scattering import scatter as scattering

    state = medium.in_si()
    air = air_at(state.temperature, humidity=state.humidity, pressure=state.pressure)
    surface, start = read_lumen(lumen)
    across = float(_end_size(surface) / resolution)
    _check_grid(frequency[[0, -1]], across, air)
    # A whole number of layers, so that the grid of a lumen that is symmetric along z is so too.
    length = float(np.ptp(surface.bounds[:, 2]))
    spacing = across, across, length / np.ceil(length / across - 1e-6)
    _check_cells(float(np.prod(np.ptp(surface.bounds, axis=0) / spacing)), lumen)
    with watched_interrupts() as check, report.progress(check) as show:
        progress = functools.partial(show, "scattering")
        cells = cut_cells(surface, spacing)
        _check_width(cells, lumen)
        progress(0.0)
        name = _name(surface, start, frequency, medium, resolution)
        found = recall(name)
        if not isinstance(found, Scattering):
            found = scattering(
                cells, air, frequency, reference=(-start, -start), lossy=not medium.lossless,
                progress=progress,
            )  # fmt: skip
            keep(name, found, f"sound of {lumen.name}")  # a full disk does not cost it
    return found, _notes(cells, found, air)


def _name(surface: Any, start: float, frequency: Any, medium: Medium, resolution: int) -> str:
    """Return the name of the scattering matrix in the cache."""
    shape = sha256(surface.vertices.tobytes() + surface.faces.tobytes()).hexdigest()
    return cache.key(
        "scattering",
        {
            "surface": [shape, start],
            "frequency": frequency.tolist(),
            "medium": asdict(medium),
            "resolution": resolution,
        },
    )


def _end_size(surface: Any) -> float:
    """Return the larger of width and height of the ends, in m."""
    import numpy as np

    z = surface.vertices[:, 2]
    rim = surface.vertices[np.abs(z - z.min()) < 1e-9 + 1e-6 * np.ptp(z)]
    return float(np.ptp(rim[:, :2], axis=0).max())


def _check_grid(band: Any, spacing: float, air: Air) -> None:
    """Check that the grid resolves the shortest wavelength of a band in Hz."""
    low, high = KHZ * band
    finest = KHZ * air.sound_speed / (CELLS_PER_WAVELENGTH * spacing)
    if high > finest:
        raise ConfigError(
            f"band = {low:g} {high:g} kHz goes beyond {finest:.3g} kHz, where the grid of "
            f"{MM * spacing:.3g} mm has {CELLS_PER_WAVELENGTH} cells per wavelength; raise "
            "resolution or lower the band"
        )


def _check_cells(cells: float, path: Path) -> None:
    """Check that the grid of a lumen is not too large."""
    if cells > MOST_CELLS:
        raise ConfigError(
            f"{path} takes a grid of {cells:.3g} cells, over {MOST_CELLS:.0e}; give a shorter "
            "lumen (straight tube is added by acoustube simulate), or lower resolution"
        )


def _openings(cells: CutCells) -> Any:
    """Return the smaller of the largest height and the largest width of each layer, in m, (nz,)."""
    import numpy as np

    high, wide = (cells.volume_fraction.sum(axis=axis).max(axis=0) for axis in (1, 0))
    return np.asarray(np.minimum(high * cells.spacing[1], wide * cells.spacing[0]))


def _check_width(cells: CutCells, path: Path) -> None:
    """Check that there are enough cells across the narrowest place."""
    openings = _openings(cells)[1:-1]
    narrowest, place = float(openings.min()), int(openings.argmin())
    if narrowest < NARROWEST_CELLS * cells.spacing[1]:
        at = MM * (place + 1) * cells.spacing[2]
        raise ConfigError(
            f"{path} is {MM * narrowest:.3g} mm wide at {at:.3g} mm from its low end, under "
            f"{NARROWEST_CELLS} cells of {MM * cells.spacing[1]:.3g} mm; raise resolution"
        )


def _notes(cells: CutCells, found: Scattering, air: Air) -> list[str]:
    """Return a sentence for each assumption of the model that the run violates."""
    import numpy as np

    from acoustube.air import NARROW_GAP_LAYERS, viscous_thickness
    from acoustube.waves.grid.straight_part import straight_ends_cut

    low, high = found.frequency[[0, -1]]
    notes = []
    inside = [
        f"{name} at {KHZ * cut_on:.2f} kHz"
        for name, cut_on in zip(found.modes, found.cut_ons, strict=True)
        if low < cut_on < high
    ]
    if inside:
        notes.append(
            f"Modes cut on inside the band: {', '.join(inside)}. Within 1 % of these, small errors "
            "of size or temperature decide whether they propagate."
        )
    gap = float(_openings(straight_ends_cut(cells)).min())
    layers = gap / viscous_thickness(air, float(low))
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


def _print(found: Scattering, notes: list[str], console: Console) -> None:
    """Print the plane mode's coefficients, the grid and the notes."""
    import numpy as np
    from rich.table import Table

    plane = found.modes.index("00")
    s = found.s[:, :, plane, 0, plane]
    table = Table("kHz", "|R00|", "|T00|", box=None, pad_edge=False)
    for i in np.unique(np.linspace(0, len(s) - 1, 12).round().astype(int)):
        table.add_row(
            f"{KHZ * found.frequency[i]:.2f}", f"{abs(s[i, 0]):.4f}", f"{abs(s[i, 1]):.4f}"
        )
    console.print(table)
    nx, ny, nz = found.shape
    console.print(
        f"grid {nx} x {ny} x {nz}, {found.steps} steps of {US * found.time_step:.3g} us; "
        f"modes {', '.join(found.modes)}",
        soft_wrap=True,
    )
    high, over = float(found.frequency[-1]), 100 * np.mean(found.settled[_propagating(found)])
    across = found.sound_speed / (high * max(found.spacing))
    console.print(
        f"accuracy: {across:.0f} cells per wavelength at {KHZ * high:g} kHz, where 16 cells give "
        "R and T within 0.01, 32 within 0.003 (see the documentation); straight ends and absorbers "
        f"add no error; {over:.1f} % of the coefficients are settled",
        soft_wrap=True,
    )
    for words in notes:
        note(console, words)
