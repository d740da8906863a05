"""How right is the spectral solver on presses, and how honest its estimate?

    OMP_NUM_THREADS=1 python benchmarks/spectral_presses.py [--depths 2 4 7.8] [--march 24]

The 25 mm rod on the default tube, 8 to 60 kHz every 100 Hz, modes symmetric about x = 0, at the
default tolerance. The reference is a basis twice as rich: elements half as long, of degree 12 (14
from 7.8 mm on), with more shifts, and with losses more directly solved frequencies. Each row:
depth in mm, losses, processor seconds, largest difference of any coefficient (median, 95 %, maximum
over the band), the solver's estimate (the same), how many per cent of the frequencies exceed it,
and by how much at most. ``--march`` adds the differences of R00 and T00 from the time-domain solver
on grids of so many cells across, and its processor seconds, 0.3 kHz and more from the cut-ons.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import process_time
from typing import Any
from unittest.mock import patch

import numpy as np

from acoustube.air import air_at
from acoustube.base.units import MM
from acoustube.indentation import Indenter, indent
from acoustube.lumen import Lumen, pressed_part
from acoustube.tube import Tube
from acoustube.waves import Scattering, cut_cells, scatter
from acoustube.waves.spectral import (
    SpectralScattering,
    first_basis,
    lossy,
    reduction,
    scatter_spectral,
    solver,
    wall_of,
)
from acoustube.waves.spectral.first_basis import Basis

DEPTHS = (2.0, 4.0, 6.0, 7.0, 7.5, 7.8, 8.0)
FREQUENCY = np.arange(8e3, 60.05e3, 100.0)
AIR = air_at(20.0)
OFF_CUT_ON = 300.0
"""Distance in Hz from the cut-ons from which the two methods are compared."""
ALMOST_CLOSED = 7.8
"""Depth in mm from which the reference has a higher degree."""
N_SHIFTS = 26
"""Of the reference."""
QUANTILES = 0.5, 0.95, 1.0


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--depths", type=float, nargs="+", default=DEPTHS)
    parser.add_argument("--march", type=int, nargs="*", default=[], help="cells across the bore")
    parser.add_argument("--losses", choices=("off", "on", "both"), default="both")
    given = parser.parse_args()
    depths = sorted(given.depths)
    press = indent(Tube(), Indenter(diameter=25 / MM), depth=[depth / MM for depth in depths])
    lumens = [pressed_part(press, row) for row in press.rows_at([depth / MM for depth in depths])]
    print("depth losses seconds | error median 95% max | estimate | exceeded % by")
    for depth, lumen in zip(depths, lumens, strict=True):
        for losses in {"off": [False], "on": [True], "both": [False, True]}[given.losses]:
            found, seconds = timed(spectral_scattering, lumen, lossy=losses)
            with richer(degree=12 if depth < ALMOST_CLOSED else 14):
                reference, _ = timed(spectral_scattering, lumen, lossy=losses)
            error = np.abs(found.s - reference.s).max(axis=(1, 2, 3, 4))
            over = error / found.error
            print(
                f"{depth:g} {'on' if losses else 'off'} {seconds:.1f} | {spread(error)} | "
                f"{spread(found.error)} | {100 * np.mean(over > 1):.1f} {over.max():.1f}",
                flush=True,
            )
            for resolution in given.march:
                marched, seconds = timed(march, lumen, resolution, lossy=losses)
                print(f"   march {resolution}: {seconds:.0f} s | {apart(marched, reference)}")


def spectral_scattering(lumen: Lumen, *, lossy: bool) -> SpectralScattering:
    """Return the scattering matrix at the default tolerance."""
    wall = wall_of(lumen)
    return scatter_spectral(wall, AIR, FREQUENCY, lossy=lossy, symmetric_only=True)


def march(lumen: Lumen, resolution: int, *, lossy: bool) -> Scattering:
    """Return the scattering matrix by finite differences."""
    cells = cut_cells(lumen.surface, 2 * lumen.radius / resolution)
    return scatter(cells, AIR, FREQUENCY, lossy=lossy, symmetric_only=True)


@contextmanager
def richer(degree: int) -> Iterator[None]:
    """Let the spectral solver begin with a basis twice as rich."""

    def rich(*given: Any, **settings: Any) -> Basis:
        basis = first_basis.first_basis(*given, **settings)
        edges = np.sort([*basis.edges, *(basis.edges[1:] + basis.edges[:-1]) / 2])
        grade = first_basis.GRADING / 2
        low, high = basis.shifts[[0, -1]] ** grade
        return Basis(degree, edges, np.linspace(low, high, N_SHIFTS) ** (1 / grade))

    with (
        patch.object(solver, "first_basis", rich),
        patch.object(lossy, "SAMPLES_PER_RESONANCE", 4.0),
        patch.object(reduction, "SAMPLE_TOLERANCE", 1e-7),
    ):
        yield


def timed(work: Callable[..., Any], *given: Any, **settings: Any) -> tuple[Any, float]:
    """Return a result and its processor seconds."""
    start = process_time()
    found = work(*given, **settings)
    return found, process_time() - start


def apart(found: Scattering, reference: SpectralScattering) -> str:
    """Return the differences of R00 and of T00."""
    cut_ons = reference.cut_ons[reference.cut_ons > 0]
    off = (np.abs(FREQUENCY[:, None] - cut_ons) > OFF_CUT_ON).all(axis=1)
    pairs = ((0, "R00"), (1, "T00"))
    return ", ".join(
        f"{name} {spread(np.abs(found.s - reference.s)[off, port, 0, 0, 0])}"
        for port, name in pairs
    )


def spread(values: np.ndarray) -> str:
    """Return median, 95th percentile and maximum."""
    return " ".join(f"{value:.0e}" for value in np.quantile(values, QUANTILES))


if __name__ == "__main__":
    main()
