"""Arrays of the compiled leapfrog scheme: columns of open cells, coefficients, state.

All arrays have the tube's axis z last. Coefficients and states have the same names as in
`operator`, `losses` and `pml`; a test lists the exceptions.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]
Integers = NDArray[np.integer[Any]]

CORE, CUT = 0, 1
"""Kinds of spans (successive cells along z): full cells without losses at the wall (core), and all
others (cut)."""


class Columns(NamedTuple):
    """Columns of open cells along z, and their spans: successive cells of one kind.

    Attributes
    ----------
    place : ndarray
        Indices x and y of each column, (n, 2).
    first : ndarray
        Index of the first span of each column, and at the end the number of spans, (n+1,).
    spans : ndarray
        First layer, last layer plus one, and `CORE` or `CUT`, (n_spans, 3).
    bounds : ndarray
        Index of the first column of each thread, and the number of columns, (n_threads+1,).
    """

    place: Integers
    first: Integers
    spans: Integers
    bounds: Integers


class Stencil(NamedTuple):
    """Coefficients of the spatial operator, as in `operator.Operator`.

    Attributes
    ----------
    weight : ndarray
        Inverse volume fraction times the time step squared, (nx, ny, nz).
    area_x, area_y, area_z, beta : ndarray
        See :class:`acoustube.waves.scheme.operator.Operator`; beta as (1,).
    full : ndarray
        Entries of `area_x`, `area_y` and `area_z` at full faces, times the time step squared, (3,).
    """

    weight: Array
    area_x: Array
    area_y: Array
    area_z: Array
    full: Array
    beta: Array


class LossCoefficients(NamedTuple):
    """Coefficients of the losses, as in `losses.Losses`; without losses all are empty or zero.

    Attributes
    ----------
    drag : Stencil
        Viscous drag, which acts in cut spans only.
    compliance, implicit_factor : ndarray
        As in `losses.Losses`, (nx, ny, nz).
    weight : ndarray
        Weight of the air's absorption in each layer, (nz,).
    decay, gain, wall, bulk : ndarray
        Coefficients of the relaxations, those of the air first, (n_poles,). `wall` is the factor of
        a relaxation in the half-integral's change over a step; `bulk` has the air's relaxations
        only.
    scalars : ndarray
        `response` and `rate` of `losses.Losses`, (2,).
    """

    drag: Stencil
    compliance: Array
    implicit_factor: Array
    weight: Array
    decay: Array
    gain: Array
    wall: Array
    bulk: Array
    scalars: Array


class Fields(NamedTuple):
    """State of a run.

    Attributes
    ----------
    ahead : ndarray
        Argument of the Laplacian, the pressure plus the terms of the air's absorption, at two
        times, (2, nx+2, ny+2, nz+4).
    change : ndarray
        Pressure change over the last step, (nx, ny, nz).
    pressure : ndarray
        Pressure, (nx+2, ny+2, nz+4); empty without losses, as are all the following arrays.
    relaxed : ndarray
        Memory variables of the losses (relaxations), (nx, ny, n_poles, nz).
    relaxing : ndarray
        Sum of the relaxations' contributions to the half-integral's next change, (nx, ny, nz).
    integral : ndarray
        Half-integral s^(-1/2) p of the pressure at two times, (2, nx+2, ny+2, nz+4).
    increment : ndarray
        Change of the half-integral over the last step, (nx, ny, nz).
    """

    ahead: Array
    change: Array
    pressure: Array
    relaxed: Array
    relaxing: Array
    integral: Array
    increment: Array


class AbsorberColumns(NamedTuple):
    """Coefficients and state of an absorber of n layers, as in `pml.Absorber`; n may be 0.

    Attributes
    ----------
    cells, faces : ndarray
        `decay`, `gain` and `inverse` of `pml.Stretch`, (3, n) and (3, n+3).
    transverse, velocity, face_memory, cell_memory : ndarray
        As in `pml.Absorber`: (nx, ny, n), (nx, ny, n+3), (nx, ny, n+3) and (nx, ny, n).
    """

    cells: Array
    faces: Array
    transverse: Array
    velocity: Array
    face_memory: Array
    cell_memory: Array


class SourceAndProbes(NamedTuple):
    """Source layer and probe weights.

    Attributes
    ----------
    shape : ndarray
        Shape of the source over its layer, (nx, ny).
    keep : ndarray
        Factor of the source layer's pressure, (1,): 0 if the source replaces the pressure, 1 if it
        is added to the pressure.
    layer : int
        Index of the source layer.
    planes : ndarray
        Probed layers, (n_planes,).
    plane_of : ndarray
        Index of the first probe of each plane, and the number of probes, (n_planes+1,).
    weights : ndarray
        (nx, ny, n_probes), the probes in the order of their planes.
    """

    shape: Array
    keep: Array
    layer: int
    planes: Integers
    plane_of: Integers
    weights: Array
