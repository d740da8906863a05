"""Self-test of an installation: small computations with known results.

Each stage computes as in a run, but on the coarsest possible grid or mesh. The tolerances are those
of these grids, not of the results of a run.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acoustube import signals
from acoustube.air import Air
from acoustube.base.types import Array
from acoustube.base.units import CM, KHZ
from acoustube.indentation import Indenter, MeshSize, indent
from acoustube.lumen import ring_faces
from acoustube.tube import Tube
from acoustube.waves import (
    CutCells,
    Pulse,
    cut_cells,
    cut_on_frequency,
    grid_spacing,
    scatter,
    section_cut_ons,
)

RADIUS = 3.95e-3
"""Radius of the bore in m."""
AIR = Air(sound_speed=343.2, density=1.204)
COARSE = MeshSize(through_wall=1, around=8, along=6)
"""Mesh of the test press."""
FORCE = 0.113604
"""Contact force in N of a rod of 25 mm that presses the default tube 0.2 mm deep, on `COARSE`.

Computed by acoustube 0.1.0 on Linux.
"""
FREQUENCY, REFLECTED = 12e3, 0.64041
"""Frequency in Hz, and modulus of the reflection coefficient of a narrowed bore.

The radius is reduced by up to 40 %, over a length of 16 mm.

Computed by a spectral method that is independent of the grid: case E of
``tests/data/scattering.csv``.
"""


class Outcome(NamedTuple):
    """Computed and expected value of a test.

    Attributes
    ----------
    name : str
    computed, expected, tolerance : float
        In `unit`; the tolerance is absolute. The computed value is nan if the test raised an error.
    unit : str
    seconds : float
        Computing time.
    problem : str
        Error message; empty if there was none.
    """

    name: str
    computed: float
    expected: float
    tolerance: float
    unit: str
    seconds: float
    problem: str = ""

    @property
    def passed(self) -> bool:
        """True if the computed value is within the tolerance."""
        return bool(abs(self.computed - self.expected) <= self.tolerance)


class Trial(NamedTuple):
    """A test: a function that returns a number, and the value that is expected of it.

    Attributes
    ----------
    name : str
    compute : callable
        Returns the computed value, in `unit`.
    expected, tolerance : float
        Expected value and largest absolute deviation from it, in `unit`.
    unit : str
        "1" for a pure number.
    """

    name: str
    compute: Callable[[], float]
    expected: float
    tolerance: float
    unit: str

    def run(self) -> Outcome:
        """Run the test; an exception that it raises becomes the `problem` of the outcome."""
        started, computed, problem = time.perf_counter(), np.nan, ""
        try:
            computed = float(self.compute())
        # An incomplete installation may raise any exception; the message is reported.
        except Exception as error:
            problem = f"{type(error).__name__}: {error}"
        seconds = time.perf_counter() - started
        name, _, expected, tolerance, unit = self
        return Outcome(name, computed, expected, tolerance, unit, seconds, problem)


def all_trials() -> tuple[Trial, ...]:
    """Return the tests, the quick ones first."""
    cut_on = KHZ * cut_on_frequency(1, 1, RADIUS, AIR.sound_speed)
    return (
        Trial("distance of a synthetic echo", _echo, 50.0, 0.1, "cm"),
        Trial("cut-on of mode (1,1), Bessel's zero", _cut_on, cut_on, 0.005 * cut_on, "kHz"),
        Trial("reflection of a narrowed bore", lambda: abs(_scattered()[0]), REFLECTED, 0.02, "1"),
        Trial(
            "reflected plus transmitted power",
            lambda: np.sum(np.abs(_scattered()) ** 2),
            1.0,
            1e-3,
            "1",
        ),
        Trial("force of a press of 0.2 mm", _force, FORCE, 1e-3 * FORCE, "N"),
    )


def _echo() -> float:
    """Return the estimated distance in cm of a synthetic echo at 50 cm."""
    pulse, time = Pulse(frequency=42e3), np.arange(6000) / 1e6
    delay = 2 * 0.5 / signals.speed_of_sound(20.0)
    pressure = np.asarray(pulse(time)) + 0.05 * np.asarray(pulse(time - delay))
    found = signals.process(time, pressure, pulse_duration=pulse.duration, temperature=20.0)
    return CM * float(found.distance)


def _cut_on() -> float:
    """Return the cut-on frequency of mode (1,1) in kHz on a grid of 16 cells across the bore."""
    cells = _bore(np.zeros(2), np.array([0.0, 1.5 * 2 * RADIUS / 16]), 16)
    return KHZ * float(section_cut_ons(cells, 1, AIR.sound_speed)[1])


def _scattered() -> NDArray[np.complex128]:
    """Return reflection and transmission coefficient of the narrowed bore at `FREQUENCY`, (2,)."""
    z = np.linspace(0.0, 0.04, 81)
    near = np.abs(z - 0.02) < 8e-3
    cells = _bore(np.where(near, 0.2 + 0.2 * np.cos(np.pi * (z - 0.02) / 8e-3), 0.0), z, 8)
    frequency = FREQUENCY + 1e3 * np.arange(2)
    found = scatter(cells, AIR, frequency, reference=(0.02, 0.02), lossy=False, symmetric_only=True)
    return np.asarray(found.s[0, :, 0, 0, 0])


def _bore(narrowing: Array, z: Array, resolution: int) -> CutCells:
    """Return the cut cells of a round bore narrowed by a fraction of its radius at each z, (n,)."""
    import trimesh

    angle = 2 * np.pi * np.arange(192) / 192
    radius = RADIUS * (1 - narrowing)[:, None]
    along = np.broadcast_to(z[:, None], (z.size, angle.size))
    rings = np.stack([radius * np.cos(angle), radius * np.sin(angle), along], axis=-1)
    surface = trimesh.Trimesh(rings.reshape(-1, 3), ring_faces(*rings.shape[:2]), process=False)
    return cut_cells(surface, grid_spacing(2 * RADIUS, resolution))


def _force() -> float:
    """Return the force in N of a press on a coarse mesh of the default tube."""
    pressed = indent(Tube(), Indenter(diameter=25e-3), depth=0.2e-3, mesh=COARSE)
    return float(pressed.contact_force[-1])
