"""Scattering of a press by finite elements and by the march, against the spectral solver.

    PYTHONPATH=tests OMP_NUM_THREADS=1 python benchmarks/spectral_against_finite_elements.py

The 25 mm rod at 4 and 7.5 mm, without losses: R00 and T00 of quadratic hexahedra on meshes of
51 000 and 117 000 unknowns, extrapolated (tests/lumen_elements.py), and of the march at 16 and 24
cells, each less those of the spectral solver at a tolerance of 1e-5. The last columns are the
additional path by the phase of T00. Ten minutes. Needs scikit-fem.
"""

from __future__ import annotations

import numpy as np
from lumen_elements import extrapolated

from acoustube.air import Air
from acoustube.indentation import Indenter, indent
from acoustube.lumen import pressed_part
from acoustube.tube import Tube
from acoustube.waves import cut_cells, scatter, spectral

AIR = Air(sound_speed=343.2, density=1.204)
DEPTHS = 4e-3, 7.5e-3
FREQUENCIES = np.array([10e3, 20e3, 30e3, 41e3, 42e3])
MESHES = [(3, 2e-3 / 3), (4, 0.5e-3)]
CELLS = 16, 24


def main() -> None:
    """Print a row for each method, depth and frequency."""
    press = indent(Tube(), Indenter(diameter=25e-3), depth=list(DEPTHS), support="held")
    print(
        "| depth mm | kHz | method | dR00 | dT00 | path um | its own change |\n"
        "|---|---|---|---|---|---|---|"
    )
    for row, depth in zip(press.rows_at(DEPTHS), DEPTHS, strict=True):
        part = pressed_part(press, row)
        wall = spectral.wall_of(part)
        known = plane(
            spectral.scatter_spectral(
                wall, AIR, FREQUENCIES, lossy=False, symmetric_only=True, tolerance=1e-5
            ).s
        )
        *elements, change = extrapolated(wall, FREQUENCIES, AIR.sound_speed, MESHES)
        show(depth, "elements", elements, known, change)
        for cells in CELLS:
            size, length = Tube().inner_diameter / cells, 2 * part.position
            grid = cut_cells(part.surface, (size, size, length / np.ceil(length / size)))
            marched = scatter(
                grid, AIR, FREQUENCIES, reference=(part.position,) * 2, lossy=False,
                symmetric=True, symmetric_only=True,
            )  # fmt: skip
            show(depth, f"march, {cells} cells", plane(marched.s), known, np.nan * change)


def plane(s: np.ndarray) -> list[np.ndarray]:
    """Return R00 and T00."""
    return [s[:, 0, 0, 0, 0], s[:, 1, 0, 0, 0]]


def show(
    depth: float, name: str, found: list[np.ndarray], known: list[np.ndarray], change: np.ndarray
) -> None:
    """Print the rows of one method."""
    late = -np.angle(found[1] / known[1]) / (2 * np.pi * FREQUENCIES / AIR.sound_speed)
    for i, frequency in enumerate(FREQUENCIES):
        off = [abs(a[i] - b[i]) for a, b in zip(found, known, strict=True)]
        print(
            f"| {1e3 * depth:g} | {frequency / 1e3:g} | {name} | {off[0]:.1e} | {off[1]:.1e} | "
            f"{1e6 * late[i]:.2f} | {change[i]:.1e} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
