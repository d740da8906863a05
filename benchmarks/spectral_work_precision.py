"""Cost of a scattering matrix, by its precision, and by bore, band and press.

    PYTHONPATH=tests NUMBA_NUM_THREADS=1 python benchmarks/spectral_work_precision.py

First, lumens A and E of tests/test_spectral.py without losses, modes symmetric about x = 0: each
row a method and its setting, processor time in s of the matrix (compiled before; the march every
400 Hz, the spectral solver every 100 Hz), and the 95 % quantile and the maximum of the error of R00
and T00 against the independent reference, 0.3 kHz and more from the cut-ons. A figure has both
methods on one axis. Then the spectral solver with losses at its default tolerance on lumen E of
other bores, bands and lengths. Five minutes.
"""

from __future__ import annotations

from pathlib import Path
from time import process_time

import matplotlib.pyplot as plt
import numpy as np
from test_scattering import MIDDLE, RADIUS, pinched
from test_spectral import AIR, CASES, plane, reference, shape, wall

from acoustube.waves import cut_cells, scatter, spectral

TOLERANCES = 1e-1, 1e-2, 1e-3, 1e-4, 1e-5
CELLS = 10, 12, 16, 24, 32
AWAY = 300.0
Row = tuple[str, str, float, float, float]


def precision(case: str) -> list[Row]:
    """Return a row for each setting of both methods."""
    known, *exact = reference(case)
    cut_ons = spectral.scatter_spectral(wall(case), AIR, known[-1:], symmetric_only=True).cut_ons
    far = np.abs(known[:, None] - cut_ons).min(axis=1) > AWAY
    rows: list[Row] = []

    def add(method: str, setting: str, seconds: float, found: list[np.ndarray]) -> None:
        error = np.max([np.abs(a - b) for a, b in zip(found, exact, strict=True)], axis=0)[far]
        rows.append((method, setting, seconds, float(np.quantile(error, 0.95)), error.max()))
        print(case, *rows[-1], flush=True)

    band = np.union1d(np.arange(8e3, 60.05e3, 100.0), known)
    at = np.searchsorted(band, known)
    for tolerance in TOLERANCES:
        start = process_time()
        found = spectral.scatter_spectral(
            wall(case), AIR, band, tolerance=tolerance, lossy=False, symmetric_only=True
        )
        add("spectral", f"{tolerance:.0e}", process_time() - start, [s[at] for s in plane(found)])
    surface = pinched(case)
    marched = np.union1d(np.arange(8e3, 60.05e3, 400.0), known)
    at = np.searchsorted(marched, known)
    for n in CELLS:
        cells = cut_cells(surface, 2 * RADIUS / n)
        options = {"reference": (MIDDLE, MIDDLE), "lossy": False, "symmetric_only": True}
        scatter(cells, AIR, marched, longest=1e-4, **options)
        start = process_time()
        found = scatter(cells, AIR, marched, **options)
        add("march", f"{n} cells", process_time() - start, [s[at] for s in plane(found)])
    return rows


def scaled(bore: float, half_length: float) -> spectral.Wall:
    """Return lumen E with another bore and length, in m."""
    radius, length = bore / 2 / RADIUS, half_length / CASES["E"][1]

    def lines(z: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, ...]:
        x, y, x_z, y_z = shape("E")(z / length, t)
        return radius * x, radius * y, radius / length * x_z, radius / length * y_z

    ends = (-half_length, half_length)
    return spectral.analytic_wall(lines, ends=ends, radius=bore / 2, reversible=True)


def cost(bore: float, half_length: float, band: tuple[float, float]) -> str:
    """Return time in s, estimate and sizes of a matrix with losses, every 100 Hz."""
    frequency = np.arange(*band, 100.0)
    start = process_time()
    found = spectral.scatter_spectral(
        scaled(bore, half_length), AIR, frequency, symmetric_only=True
    )
    return (
        f"{process_time() - start:.2f} s, estimate {found.typical_error:.0e}, degree "
        f"{found.degree}, {found.n_elements} elements, {found.n_fields} fields, "
        f"{len(found.modes)} modes"
    )


def main() -> None:
    """Print the tables and draw the figure."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 4), sharey=True, layout="constrained")
    for case, panel in zip("AE", axes, strict=True):
        rows = precision(case)
        for method, marker in (("spectral", "o-"), ("march", "s-")):
            mine = [row for row in rows if row[0] == method]
            panel.loglog([row[3] for row in mine], [row[2] for row in mine], marker, label=method)
        panel.set(title=f"lumen {case}", xlabel="error of R00 and T00 (95 %)")
    axes[0].set_ylabel("processor time in s")
    axes[0].legend()
    figure.savefig(Path("spectral-work-precision.png"), dpi=120)
    for bore in (4e-3, 6e-3, 8e-3, 12e-3, 16e-3, 20e-3):
        print(f"bore {1e3 * bore:g} mm:", cost(bore, 2 * bore, (8e3, 60.05e3)), flush=True)
    for high in (20e3, 40e3, 60e3, 80e3):
        print(f"8 to {high / 1e3:g} kHz:", cost(8e-3, 16e-3, (8e3, high)), flush=True)
    for half in (8e-3, 16e-3, 32e-3, 64e-3):
        print(f"{2e3 * half:g} mm long:", cost(8e-3, half, (8e3, 60.05e3)), flush=True)


if __name__ == "__main__":
    main()
