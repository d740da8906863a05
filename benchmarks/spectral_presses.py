"""How accurate is the spectral solver on presses, and how reliable is its error estimate?

    OMP_NUM_THREADS=1 python benchmarks/spectral_presses.py [--depths 2 4 7.8]
    OMP_NUM_THREADS=1 python benchmarks/spectral_presses.py --march 24 32 --rows march.jsonl

The 25 mm rod on the default tube, 8 to 60 kHz every 100 Hz, modes symmetric about x = 0, at the
default tolerance. The reference has a basis twice as rich: elements half as long, of degree 12 (14
from 7.8 mm on), with more shifts, and with losses more directly solved frequencies and one more
response to the layers. Each row:
depth in mm, losses, processor time in s (least of ``--runs``), largest error of any coefficient
(median, 95 %, maximum over the band), the solver's estimate (the same), the percentage of
frequencies at which the error exceeds it, and the largest excess.

``--march`` gives the differences of R00 and T00 of the time-domain solver from the same reference
instead, on grids of given numbers of cells across, 0.3 kHz and more from the cut-ons: over the band
and over 36 to 48 kHz, with its processor time and the number of frequencies that are not settled.
Each row is appended to ``--rows`` as soon as it is known, and existing rows are not computed again.
``--keep FOLDER`` writes the matrices of the march there, as ``march_32_lossy_7.5.nc``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import process_time
from typing import Any
from unittest.mock import patch

import numpy as np

from acoustube.air import air_at
from acoustube.base.netcdf import to_netcdf
from acoustube.base.units import MM
from acoustube.indentation import Indenter, indent
from acoustube.lumen import Lumen, pressed_part
from acoustube.runs.config.si import MESH_SIZES
from acoustube.runs.scattering_file import to_dataset
from acoustube.tube import Tube
from acoustube.waves import Scattering, cut_cells, scatter
from acoustube.waves.spectral import (
    SpectralScattering,
    first_basis,
    lossy,
    scatter_spectral,
    solver,
    wall_of,
)
from acoustube.waves.spectral.first_basis import Basis

DEPTHS = (2.0, 4.0, 6.0, 7.0, 7.5, 7.8, 8.0)
FREQUENCY = np.arange(8e3, 60.05e3, 100.0)
AIR = air_at(20.0)
OFF_CUT_ON = 300.0
"""Least distance in Hz from the cut-ons at which the two methods are compared."""
ALMOST_CLOSED = 7.8
"""Depth in mm from which the reference has a higher degree."""
MIDDLE_BAND = 36e3, 48e3
"""Band in Hz around the carrier of EchoTube."""
N_SHIFTS = 26
"""Number of shifts of the reference."""
QUANTILES = 0.5, 0.95, 1.0


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--depths", type=float, nargs="+", default=DEPTHS)
    parser.add_argument("--march", type=int, nargs="*", default=[], help="cells across the bore")
    parser.add_argument("--rows", type=Path, default=Path("march.jsonl"), help="of the march")
    parser.add_argument("--keep", type=Path, help="folder for the matrices of the march")
    parser.add_argument("--losses", choices=("off", "on", "both"), default="both")
    parser.add_argument("--mesh", choices=MESH_SIZES, default="usual", help="of the wall")
    parser.add_argument("--runs", type=int, default=1, help="of which the fastest is timed")
    given = parser.parse_args()
    depths = sorted(given.depths)
    press = indent(
        Tube(), Indenter(diameter=25 / MM), depth=[depth / MM for depth in depths],
        mesh=MESH_SIZES[given.mesh],
    )  # fmt: skip
    rows = press.rows_at([depth / MM for depth in depths])
    lumens = {depth: pressed_part(press, row) for depth, row in zip(depths, rows, strict=True)}
    losses = {"off": [False], "on": [True], "both": [False, True]}[given.losses]
    if given.march:
        compare_march(lumens, losses, given.march, given.rows, given.keep)
    else:
        compare_estimate(lumens, losses, given.runs)


def compare_estimate(lumens: dict[float, Lumen], losses: list[bool], runs: int) -> None:
    """Print the error of the solver and its estimate."""
    print("depth losses seconds | error median 95% max | estimate | exceeded % by")
    for depth, lumen in lumens.items():
        for lossy_wall in losses:
            all_runs = [timed(spectral_scattering, lumen, lossy=lossy_wall) for _ in range(runs)]
            found, seconds = all_runs[0][0], min(seconds for _, seconds in all_runs)
            reference = reference_of(depth, lumen, lossy=lossy_wall)
            error = np.abs(found.s - reference.s).max(axis=(1, 2, 3, 4))
            over = error / found.error
            print(
                f"{depth:g} {'on' if lossy_wall else 'off'} {seconds:.2f} | {spread(error)} | "
                f"{spread(found.error)} | {100 * np.mean(over > 1):.1f} {over.max():.1f}",
                flush=True,
            )


def compare_march(
    lumens: dict[float, Lumen],
    losses: list[bool],
    resolutions: list[int],
    path: Path,
    folder: Path | None,
) -> None:
    """Print and store the differences of the march from the reference."""
    stored = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    rows = {(row["lossy"], row["cells"], row["depth"]): row for row in stored}
    references: dict[tuple[bool, float], SpectralScattering] = {}
    for lossy_wall, cells in [(a, b) for a in losses for b in resolutions]:
        for depth, lumen in lumens.items():
            key = lossy_wall, cells, depth
            if key not in rows:
                if (lossy_wall, depth) not in references:
                    references[lossy_wall, depth] = reference_of(depth, lumen, lossy=lossy_wall)
                # Compiles, so that only the method is timed in the second run.
                march(lumen, cells, lossy=lossy_wall, longest=1e-4)
                marched, seconds = timed(march, lumen, cells, lossy=lossy_wall)
                if folder is not None:
                    keep(marched, folder, key)
                rows[key] = {
                    "lossy": lossy_wall, "cells": cells, "depth": depth, "seconds": seconds,
                    **apart(marched, references[lossy_wall, depth]),
                }  # fmt: skip
                with path.open("a") as file:
                    file.write(json.dumps(rows[key]) + "\n")
            print(" ".join(f"{name}={shown(value)}" for name, value in rows[key].items()))


def keep(marched: Scattering, folder: Path, key: tuple[bool, int, float]) -> None:
    """Write a matrix of the march to a file named after losses, cells and depth."""
    lossy_wall, cells, depth = key
    name = f"march_{cells}_{'lossy' if lossy_wall else 'lossless'}_{depth:g}.nc"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(to_netcdf(to_dataset(marched)))


def reference_of(depth: float, lumen: Lumen, *, lossy: bool) -> SpectralScattering:
    """Return the scattering matrix in a basis twice as rich; depth in mm."""
    with richer(degree=12 if depth < ALMOST_CLOSED else 14):
        return spectral_scattering(lumen, lossy=lossy)


def spectral_scattering(lumen: Lumen, *, lossy: bool) -> SpectralScattering:
    """Return the scattering matrix at the default tolerance."""
    wall = wall_of(lumen)
    return scatter_spectral(wall, AIR, FREQUENCY, lossy=lossy, symmetric_only=True)


def march(lumen: Lumen, resolution: int, **options: Any) -> Scattering:
    """Return the scattering matrix by finite differences."""
    size, length = Tube().inner_diameter / resolution, 2 * lumen.position
    cells = cut_cells(lumen.surface, (size, size, length / np.ceil(length / size)))
    reference = (lumen.position, lumen.position)
    return scatter(
        cells, AIR, FREQUENCY, reference=reference, symmetric=True, symmetric_only=True, **options
    )


@contextmanager
def richer(degree: int) -> Iterator[None]:
    """Make the spectral solver start with a basis twice as rich."""

    def rich(*given: Any, **settings: Any) -> Basis:
        basis = first_basis.first_basis(*given, **settings)
        edges = np.sort([*basis.edges, *(basis.edges[1:] + basis.edges[:-1]) / 2])
        grade = first_basis.GRADING / 2
        low, high = basis.shifts[[0, -1]] ** grade
        shifts = np.linspace(low, high, N_SHIFTS) ** (1 / grade)
        return Basis(degree, edges, shifts, basis.flat)

    with (
        patch.object(solver, "first_basis", rich),
        patch.object(lossy, "SAMPLES_PER_RESONANCE", 4.0),
        patch.dict(lossy.LAYER_BLOCKS, {False: 3, True: 4}),
        patch.object(lossy, "SAMPLE_TOLERANCE", 1e-7),
    ):
        yield


def timed(work: Callable[..., Any], *given: Any, **settings: Any) -> tuple[Any, float]:
    """Return a result and its processor time in s."""
    start = process_time()
    found = work(*given, **settings)
    return found, process_time() - start


def apart(found: Scattering, reference: SpectralScattering) -> dict[str, Any]:
    """Return the spread of the differences of R00 and of T00, and the number not settled."""
    cut_ons = reference.cut_ons[reference.cut_ons > 0]
    off = (np.abs(FREQUENCY[:, None] - cut_ons) > OFF_CUT_ON).all(axis=1)
    low, high = MIDDLE_BAND
    within = (FREQUENCY - low) * (FREQUENCY - high) <= 0
    difference = np.abs(found.s - reference.s)
    both: dict[str, Any] = {
        f"{name}{where}": np.quantile(difference[here, port, 0, 0, 0], QUANTILES).tolist()
        for port, name in ((0, "R00"), (1, "T00"))
        for where, here in (("", off), (" 36-48", off & within))
    }
    unsettled = ~found.settled[:, :, 0, 0, 0].all(axis=1)
    return both | {"unsettled": int(unsettled.sum())}


def shown(value: Any) -> str:
    """Return a value of a row."""
    if isinstance(value, list):
        return "/".join(f"{number:.1e}" for number in value)
    return f"{value:.4g}"


def spread(values: np.ndarray) -> str:
    """Return median, 95th percentile and maximum."""
    return " ".join(f"{value:.0e}" for value in np.quantile(values, QUANTILES))


if __name__ == "__main__":
    main()
