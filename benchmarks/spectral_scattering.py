"""How long does the spectral solver take for one scattering matrix, and how accurate is it?

    PYTHONPATH=tests OMP_NUM_THREADS=1 python benchmarks/spectral_scattering.py

Lumens A and E of tests/test_spectral.py, with all modes symmetric about x = 0 of 8 to 60 kHz, every
100 Hz. Each row: tolerance, processor time in s (best of three), the error of R00 and T00 at the
frequencies of the independent reference, the solver's error estimate for all modes, and the sizes
chosen.
"""

from __future__ import annotations

from time import process_time

import numpy as np
from test_spectral import AIR, plane, reference, wall

from acoustube.waves import spectral


def main() -> None:
    """Print the table."""
    print("lumen tolerance seconds error estimate degree elements shifts fields")
    frequency = np.arange(8e3, 60.05e3, 100.0)
    for case in "AE":
        known, *exact = reference(case)
        for tolerance in (1e-2, 1e-3, 1e-4, 1e-5):
            seconds = np.inf
            for _ in range(3):
                start = process_time()
                found = spectral.scatter_spectral(
                    wall(case),
                    AIR,
                    frequency,
                    tolerance=tolerance,
                    lossy=False,
                    symmetric_only=True,
                )
                seconds = min(seconds, process_time() - start)
            at = np.searchsorted(frequency, known - 1.0)
            error = max(np.abs(a[at] - b).max() for a, b in zip(plane(found), exact, strict=True))
            print(
                f"{case} {tolerance:.0e} {seconds:.2f} {error:.1e} {found.error.max():.1e} "
                f"{found.degree} {found.n_elements} {found.n_shifts} {found.n_fields}"
            )


if __name__ == "__main__":
    main()
