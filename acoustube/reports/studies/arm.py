"""Common parts of the studies on an arm: the sleeve, presses on it, and their cycles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from acoustube import estimation
from acoustube.air import air_at
from acoustube.base.types import Array
from acoustube.base.units import MM
from acoustube.estimation import FeatureSettings
from acoustube.inversion import Library
from acoustube.ranging import Rangefinder, record
from acoustube.reports.studies.calibration import LENGTH, RADIUS, TEMPERATURE, calibrated
from acoustube.reports.studies.inverted import inverter_of
from acoustube.reports.studies.presses import matrices
from acoustube.runs.inversion import RecordingInverter
from acoustube.runs.sweep.cycles import seed_of
from acoustube.runs.wrap import wrap_of
from acoustube.signals import Processing
from acoustube.sleeve import Helix, between_bends, design, windings
from acoustube.tube import Tube
from acoustube.waves.network import at_sound_speed
from acoustube.waves.scattering import ModalScattering, PlacedScatterer

SLEEVE, GIRTHS, LOOPS = 0.26, (0.18, 0.266), 9
"""Length of the sleeve and circumferences of the forearm at wrist and elbow, in m, and number of
loops. The sleeve paper states no sizes; with these a tube of 250 cm makes 9 loops."""
PLACES = np.array([0.30, 0.60, 0.90, 1.20, 1.50, 1.80, 2.10])
"""Distances in m of the presses along a tube: seven, spread over the reach."""
ROD = 25e-3
"""Diameter in m of the indenter."""
REACH = 0.03
"""Half length in m of the part of the tube that a press deforms and that scatters: 29 mm from the
middle of a 25 mm rod the lumen has 99 % of its area."""
TUBE_SEEDS = (0, 1)
"""Seeds of the irregularities of the sleeve's tubes."""


def sleeve() -> tuple[Helix, ...]:
    """Return the two tubes of the sleeve; the sensors are at the wrist."""
    return tuple(design(SLEEVE, GIRTHS, loops=LOOPS))


def rod_on_a_bend(diameter: float, curvature: float) -> float:
    """Return the equivalent diameter, on a straight tube, of a rod that presses a bent tube.

    Parameters
    ----------
    diameter : float
        Diameter in m of the rod across a tube.
    curvature : float
        Curvature in 1/m of the tube, which is bent away from the rod.

    Returns
    -------
    float
        Diameter in m.

    Notes
    -----
    At a distance z along the tube the gap between rod and tube is z^2/2 (2/d + kappa). It equals
    that between a straight tube and a rod of the diameter 1 / (1/d + kappa/2), to second order in
    z, as in Hertz's contact theory.
    """
    return 1 / (1 / diameter + curvature / 2)


def tool(tube: Helix) -> str:
    """Return, as a setting in mm, the diameter of the rod's equivalent on a straight tube.

    See :func:`rod_on_a_bend`; the curvature is that at the middle of the sleeve.
    """
    curvature = float(tube.bend(tube.length / 2)[0])
    return f"{MM * rod_on_a_bend(ROD, curvature):.1f}"


def processing_of(tube: int) -> Processing:
    """Return the signal processing of a tube, given its index, calibrated on the straight tube."""
    return calibrated(TUBE_SEEDS[tube])[0].processing


def by_depth(folder: Path) -> dict[float, tuple[xr.Dataset, ModalScattering]]:
    """Return the first case and the scattering matrix of each press of a sweep, by depth in m.

    The matrix is converted to the air of the studies, at `TEMPERATURE`.
    """
    speed = air_at(TEMPERATURE).sound_speed
    return {
        round(float(cases["depth"].values[0]), 7): (
            cases.isel(press=0),
            at_sound_speed(matrix, speed),
        )
        for cases, matrix in matrices(folder)
    }


def bent_around(
    helix: Helix, place: float | None, like: ModalScattering, *, flattened: bool = False
) -> list[PlacedScatterer]:
    """Return the bends of a wrapped tube that is pressed at one place.

    Parameters
    ----------
    helix : Helix
    place : float or None
        Distance of the press from the sensor in m; None for a tube without a press.
    like : ModalScattering
        Scattering of a press, whose band and modes are used.
    flattened : bool
        Whether bending flattens the cross-section, as in a tube that no fabric holds.
    """
    return windings(
        helix, air_at(TEMPERATURE), like.frequency, [] if place is None else [place],
        reach=REACH, radius=RADIUS, modes=like.modes, tube=Tube() if flattened else None,
    )  # fmt: skip


def cycles_of(
    matrix: ModalScattering,
    place: float,
    bends: Sequence[PlacedScatterer],
    *,
    tube: int,
    n_cycles: int,
    name: object,
    labels: Mapping[str, float] | None = None,
) -> xr.Dataset:
    """Return simulated recordings (cycles) of a press.

    Parameters
    ----------
    matrix : ModalScattering
        Scattering of the press.
    place : float
        Distance of the press in m.
    bends : sequence of PlacedScatterer
        From :func:`bent_around`; empty for a straight tube.
    tube : int
        Index of the tube of the sleeve.
    n_cycles : int
    name : object
        Any values that identify the recording; the seed of its noise is derived from them.
    labels : mapping of str to float, optional
        Labels to add to all cycles, besides ``true_distance``.

    Returns
    -------
    xarray.Dataset
        In the format of :func:`acoustube.ranging.record`, with labels.
    """
    press = PlacedScatterer(matrix, place)
    found = record(
        [*bends, between_bends(press, REACH)] if bends else [press], Rangefinder(), radius=RADIUS,
        length=LENGTH, temperature=TEMPERATURE, n_cycles=n_cycles, seed=seed_of(tube, name),
        session_seed=tube, tube_seed=TUBE_SEEDS[tube],
    )  # fmt: skip
    known = {"true_distance": place} | dict(labels or {})
    return found.assign({k: ("cycle", np.full(n_cycles, v)) for k, v in known.items()})


def estimates_of(cycles: xr.Dataset, tube: int) -> xr.Dataset:
    """Return labels and features of a tube's cycles, by the sleeve paper's processing."""
    return estimation.feature_table(cycles, FeatureSettings(processing=processing_of(tube)))


def over_skin(helix: Helix, there: ArrayLike, here: ArrayLike) -> Array:
    """Return the distance over the skin between two positions on a tube.

    Parameters
    ----------
    helix : Helix
    there, here : array_like
        Distances from the sensor in m, of one shape.

    Returns
    -------
    array
        Distance in m on the unrolled cone; nan where a position is not on the sleeve.

    Notes
    -----
    An error of a whole loop along the tube is an error of one pitch over the skin.
    """
    z = np.stack([helix.height(there), helix.height(here)])
    turn = np.mod(np.diff(helix.angle(z), axis=0)[0] + np.pi, 2 * np.pi) - np.pi
    slant = np.hypot(1.0, helix.taper)
    # The cone unrolls to a sector of radius r / sin, whose angle is sin times that on the cone.
    sine = helix.taper / slant
    across = np.sqrt(np.prod(helix.radius_at(z), axis=0)) * 2 * _half_chord(turn, sine)
    return np.hypot(slant * np.diff(z, axis=0)[0], across)


def _half_chord(turn: Array, sine: float) -> Array:
    """Return half the chord between two points of an unrolled cone, divided by their radius.

    The radius is that about the cone's axis. The result is sin(turn sine / 2) / sine, given the
    angle `turn` about the axis in rad and the sine of the cone's half angle; turn / 2 for a
    cylinder, whose sine is zero.
    """
    return np.asarray(turn / 2 * np.sinc(turn * sine / 2 / np.pi))


def sleeve_inverter(library: Library, tube: int, like: ModalScattering) -> RecordingInverter:
    """Return the inversion of the recordings of a tube of the sleeve.

    Parameters
    ----------
    library : Library
    tube : int
        Index of the tube of the sleeve.
    like : ModalScattering
        Scattering of a press, whose band and modes are used.
    """
    helix = sleeve()[tube]
    return inverter_of(
        library, bent_around(helix, None, like), session_seed=tube, tube_seed=TUBE_SEEDS[tube],
        wrap=wrap_of(helix),
    )  # fmt: skip
