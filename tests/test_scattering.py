"""Scattering by pinched lumens against an independent frequency-domain solution."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from acoustube.air import Air
from acoustube.lumen import ring_faces
from acoustube.waves import cut_cells, grid_spacing, propagate

REFERENCE = Path(__file__).with_name("data") / "scattering.csv"
AIR = Air(sound_speed=343.2, density=1.204)
RADIUS, MIDDLE, PROBES = 3.95e-3, 0.06, (0.02, 0.10)

pytestmark = pytest.mark.slow


def pinched(case):
    """Lumens of the reference: A flattened from above by 30 %, E narrowed all round by 40 %.

    None gives the straight bore. The area of 166 facets is 2.4e-4 too small, which changes R by
    less.
    """
    h, width = {"A": (0.30, 12e-3), "E": (0.40, 8e-3), None: (0.0, 1e-3)}[case]
    z = np.union1d(np.linspace(0, 2 * MIDDLE, 241), MIDDLE + np.linspace(-12.5e-3, 12.5e-3, 167))
    angle = 2 * np.pi * np.arange(166) / 166
    zz, tt = np.meshgrid(z, angle, indexing="ij")
    x, y = RADIUS * np.cos(tt), RADIUS * np.sin(tt)
    s = np.where(np.abs(zz - MIDDLE) < width, 0.5 + 0.5 * np.cos(np.pi * (zz - MIDDLE) / width), 0)
    if case == "A":
        x, y = x * (1 + 0.45 * h * s), (y + RADIUS) * (1 - h * s) - RADIUS
    else:
        x, y = x * (1 - h * s), y * (1 - h * s)
    rings = np.stack([x, y, zz], axis=-1)
    return trimesh.Trimesh(rings.reshape(-1, 3), ring_faces(*rings.shape[:2]), process=False)


def click(time):
    """A pulse with energy from 4 to 60 kHz."""
    since = time - 60e-6
    return np.exp(-0.5 * (since / 7e-6) ** 2) * np.sin(2 * np.pi * 33e3 * since)


def scattered(case, resolution, frequencies):
    """R00 and T00 from broadband runs of the lumen and of the straight bore on one grid."""
    spacing = grid_spacing(2 * RADIUS, resolution)
    settings = {"duration": 12e-3, "probes": PROBES, "source_end": "absorbing"}
    with_pinch = propagate(cut_cells(pinched(case), spacing, half=True), AIR, click, **settings)
    straight = propagate(
        cut_cells(pinched(None), spacing, half=True),
        AIR,
        click,
        time_step=with_pinch.time_step,
        **settings,
    )
    kernel = np.exp(-2j * np.pi * np.outer(frequencies, straight.time))
    incident, onward = kernel @ straight.pressure.T[:, 0], kernel @ straight.pressure.T[:, 1]
    back = kernel @ (with_pinch.pressure - straight.pressure)[0]
    path = MIDDLE - straight.probes[0]
    turn = np.exp(2j * 2 * np.pi * frequencies / AIR.sound_speed * path)
    return back / incident * turn, kernel @ with_pinch.pressure[1] / onward


@pytest.mark.parametrize(("case", "tolerance"), [("A", 0.004), ("E", 0.01)])
def test_pinched_lumen_scatters_as_the_spectral_solution(case, tolerance):
    """Complex R00 and T00, 8 to 56 kHz, at 16 cells per bore.

    Largest errors measured at 16 and 32 cells: of R 0.0019 and 0.0006 (A), 0.0048 and 0.0010 (E);
    of T 0.0039 and 0.0013, 0.0101 and 0.0026: they tend to zero at second order. The excerpt leaves
    out 42 kHz, 0.2 kHz below the (2,1) cut-on, which the grid shifts by 0.6 %.
    """
    table = np.genfromtxt(REFERENCE, delimiter=",", names=True, dtype=None, skip_header=5)
    rows = table[table["case"] == case]
    reflection, transmission = scattered(case, 16, rows["f_hz"].astype(float))
    assert np.abs(reflection - (rows["R_re"] + 1j * rows["R_im"])).max() < tolerance
    assert np.abs(transmission - (rows["T_re"] + 1j * rows["T_im"])).max() < tolerance
