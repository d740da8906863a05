"""Parts of the spectral solver's error estimate."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from acoustube.waves import spectral
from acoustube.waves.spectral import layers
from acoustube.waves.spectral.discretisation import discretise, respond
from acoustube.waves.spectral.truncation import missing_along

RADIUS, WAVENUMBER = 4e-3, 700.0


def wrinkled(z, t):
    """Return a tube with four wrinkles of 1.2 mm about its middle."""
    inside = np.abs(z) < 2.4e-3
    angle = 2 * np.pi * z / 1.2e-3
    window = np.where(inside, np.cos(np.pi * z / 4.8e-3) ** 2, 0.0)
    slope = np.where(inside, -np.pi / 4.8e-3 * np.sin(2 * np.pi * z / 4.8e-3), 0.0)
    size = 1 + 0.01 * window * np.cos(angle)
    change = 0.01 * (slope * np.cos(angle) - window * 2 * np.pi / 1.2e-3 * np.sin(angle))
    around, up = RADIUS * np.sin(t), -RADIUS * np.cos(t)
    return size * around, size * up, change * around, change * up


def test_wrinkles_of_the_wall_are_missed_by_one_degree_more_and_found_by_six():
    """The reference is degree 13 on the same elements of 2.4 mm, which resolves the wrinkles."""
    wall = spectral.analytic_wall(wrinkled, ends=(-2.4e-3, 2.4e-3), radius=RADIUS, reversible=True)
    edges = np.array([0.0, 2.4e-3, 4.4e-3])
    coarse, fine = (discretise(wall, edges, 6, order, False, WAVENUMBER) for order in (7, 13))
    shift = WAVENUMBER**2
    response = respond(coarse, shift, 1)
    whole = respond(fine, shift, 1)[0].impedance - response[0].impedance
    found = missing_along(coarse, {shift: response})[shift][0].sum(axis=0)
    shown = response[0].by_element.sum(axis=0)
    assert found[0, 0] == pytest.approx(whole[0, 0], rel=0.5)
    assert np.abs(shown[0, 0]) < 0.5 * np.abs(whole[0, 0])


def test_walls_pass_smoothly_from_sealed_to_open():
    """The share is 1, 1/2 and 0 within `SEALING_WIDTH` of the sealing gap, and decreases."""
    gap, half = 20e-6, layers.SEALING_WIDTH / 2
    share = layers.sealing_weight(gap * np.array([0.0, 1 - half, 1.0, 1 + half, 5.0]), gap)
    assert_allclose(share, [1.0, 1.0, 0.5, 0.0, 0.0], atol=1e-12)
    around = layers.sealing_weight(gap * np.linspace(1 - 2 * half, 1 + 2 * half, 101), gap)
    assert np.all(np.diff(around[25:76]) < 0)
    # The slope has no jump, as that of a linear ramp would, which quadrature does not resolve.
    assert np.abs(np.diff(around, 2)).max() < 0.1 * np.abs(np.diff(around)).max()
    assert not layers.sealing_weight(gap * np.ones(3), 0.0).any()
