"""Scattering matrices in files, and the command ``acoustube scatter`` that writes them."""

from __future__ import annotations

import functools
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from acoustube.air import NARROW_GAP_LAYERS, Air, air_at, viscous_thickness
from acoustube.base.console import ConsoleReporter, note, watched_interrupts
from acoustube.base.errors import ConfigError
from acoustube.base.files import partial_file
from acoustube.base.netcdf import write_dataset
from acoustube.base.surfaces import read_lumen
from acoustube.runs.config import CELLS_PER_WAVELENGTH
from acoustube.runs.scattering_file import to_dataset
from acoustube.waves.grid.cells import CutCells, cut_cells
from acoustube.waves.grid.straight_part import straight_ends_cut
from acoustube.waves.scattering import Scattering, scatter

NARROWEST = 2
"""Cells across the narrowest place."""


def run_scatter(
    path: Path,
    out: Path,
    console: Console,
    *,
    band_khz: tuple[float, float],
    step_khz: float,
    temperature: float,
    humidity: float,
    pressure_kpa: float,
    lossy: bool,
    resolution: int,
) -> Path:
    """Compute the scattering matrix of a lumen and write it.

    Parameters
    ----------
    path : Path
        The lumen; see :func:`acoustube.base.surfaces.read_lumen`.
    out : Path
        The file to write.
    console : rich.console.Console
        Where to print.
    band_khz : tuple of float
        Lowest and highest frequency.
    step_khz : float
        Between two frequencies.
    temperature : float
        In degC.
    humidity : float
        Relative, in per cent.
    pressure_kpa : float
        Of the air at rest.
    lossy : bool
        With losses at the wall and in the air.
    resolution : int
        Cells across the wider of width and height of the ends.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ConfigError
        If the lumen or the band cannot be computed.
    """
    started = time.perf_counter()
    air = air_at(temperature, humidity=humidity, pressure=1e3 * pressure_kpa)
    surface, start = read_lumen(path)
    across = float(_end_size(surface) / resolution)
    _check_grid(band_khz, across, air)
    # A whole number of layers, so that the grid of a lumen that is symmetric along z is so too.
    length = float(np.ptp(surface.bounds[:, 2]))
    spacing = across, across, length / np.ceil(length / across - 1e-6)
    with watched_interrupts() as check, ConsoleReporter(console).progress(check) as report:
        progress = functools.partial(report, "scattering")
        cells = cut_cells(surface, spacing)
        _check_width(cells, path)
        progress(0.0)
        low, high = band_khz
        count = round((high - low) / step_khz)
        frequency = 1e3 * np.linspace(low, high, count + 1)
        found = scatter(
            cells, air, frequency, reference=(-start, -start), lossy=lossy, progress=progress
        )
    notes = _notes(cells, found, air)
    with partial_file(out) as partial:
        dataset = to_dataset(found)
        dataset.attrs |= {
            "lumen": path.name,
            "warnings": "\n".join(notes),
            "temperature": temperature,
            "humidity_percent": humidity,
            "pressure_kpa": pressure_kpa,
            "losses": "wall and air" if lossy else "none",
        }
        write_dataset(dataset, partial)
    _print(found, notes, console)
    elapsed = time.perf_counter() - started
    console.print(f"Written to [bold]{out}[/] in {elapsed:.0f} s.", soft_wrap=True)
    return out


def _end_size(surface: Any) -> float:
    """Return the larger of width and height of the ends, in m."""
    z = surface.vertices[:, 2]
    rim = surface.vertices[np.abs(z - z.min()) < 1e-9 + 1e-6 * np.ptp(z)]
    return float(np.ptp(rim[:, :2], axis=0).max())


def _check_grid(band_khz: tuple[float, float], spacing: float, air: Air) -> None:
    low, high = band_khz
    finest = 1e-3 * air.sound_speed / (CELLS_PER_WAVELENGTH * spacing)
    if high > finest:
        raise ConfigError(
            f"band = {low:g} {high:g} kHz goes beyond {finest:.3g} kHz, where the grid of "
            f"{1e3 * spacing:.3g} mm has {CELLS_PER_WAVELENGTH} cells per wavelength; raise "
            "resolution or lower the band"
        )


def _openings(cells: CutCells) -> NDArray[np.floating[Any]]:
    """Return the smaller of the largest height and the largest width of each layer, in m, (nz,)."""
    high, wide = (cells.volume_fraction.sum(axis=axis).max(axis=0) for axis in (1, 0))
    return np.asarray(np.minimum(high * cells.spacing[1], wide * cells.spacing[0]))


def _check_width(cells: CutCells, path: Path) -> None:
    openings = _openings(cells)[1:-1]
    narrowest, place = float(openings.min()), int(openings.argmin())
    if narrowest < NARROWEST * cells.spacing[1]:
        at = 1e3 * (place + 1) * cells.spacing[2]
        raise ConfigError(
            f"{path} is {1e3 * narrowest:.3g} mm wide at {at:.3g} mm from its low end, under "
            f"{NARROWEST} cells of {1e3 * cells.spacing[1]:.3g} mm; raise resolution"
        )


def _notes(cells: CutCells, found: Scattering, air: Air) -> list[str]:
    """Return one sentence for each way in which the run leaves the model's range."""
    low, high = found.frequency[[0, -1]]
    notes = []
    inside = [
        f"{name} at {1e-3 * cut_on:.2f} kHz"
        for name, cut_on in zip(found.modes, found.cut_ons, strict=True)
        if low < cut_on < high
    ]
    if inside:
        notes.append(
            f"Modes cut on inside the band: {', '.join(inside)}. Within 1 % of these, small errors "
            "of size or temperature decide what propagates."
        )
    gap = float(_openings(straight_ends_cut(cells)).min())
    layers = gap / viscous_thickness(air, float(low))
    if layers < NARROW_GAP_LAYERS:
        notes.append(
            f"The lumen is {1e6 * gap:.0f} um wide at its narrowest, {layers:.0f} viscous boundary "
            f"layers at {1e-3 * low:g} kHz: the losses there are more than first order."
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


def _propagating(found: Scattering) -> NDArray[np.bool_]:
    """Return whether both modes of each coefficient propagate, in the shape of `s`."""
    travels = found.propagates
    both = travels[:, None, :, None, None] & travels[:, None, None, None, :]
    return np.broadcast_to(both, found.s.shape)


def _print(found: Scattering, notes: list[str], console: Console) -> None:
    """Print the plane mode's coefficients, the grid and the notes."""
    plane = found.modes.index("00")
    s = found.s[:, :, plane, 0, plane]
    table = Table("kHz", "|R00|", "|T00|", box=None, pad_edge=False)
    for i in np.unique(np.linspace(0, len(s) - 1, 12).round().astype(int)):
        table.add_row(
            f"{1e-3 * found.frequency[i]:.2f}", f"{abs(s[i, 0]):.4f}", f"{abs(s[i, 1]):.4f}"
        )
    console.print(table)
    nx, ny, nz = found.shape
    console.print(
        f"grid {nx} x {ny} x {nz}, {found.steps} steps of {1e6 * found.time_step:.3g} us; "
        f"modes {', '.join(found.modes)}",
        soft_wrap=True,
    )
    high, over = float(found.frequency[-1]), 100 * np.mean(found.settled[_propagating(found)])
    across = found.sound_speed / (high * max(found.spacing))
    console.print(
        f"accuracy: {across:.0f} cells per wavelength at {1e-3 * high:g} kHz, where 16 cells give "
        "R and T within 0.01, 32 within 0.003 (see the documentation); straight ends and absorbers "
        f"add nothing; {over:.1f} % of the coefficients are settled",
        soft_wrap=True,
    )
    for words in notes:
        note(console, words)
