"""The loss model against sound in viscous, heat-conducting air, in two dimensions.

The reference (tests/thermoviscous.py) is stored for channels of 4 mm that are narrowed over 8 mm;
its error is that of its mesh, below 5e-4.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from thermoviscous import (
    AIR,
    Channel,
    by_layers,
    meshed,
    narrowed,
    scattered,
    spectral_scattering,
    uniform_wavenumber,
)

REFERENCE = Path(__file__).parent / "data" / "thermoviscous_channels.csv"


@cache
def reference():
    """Return (frequencies, R and T (n, 2)) by the type of channel and its least width in m."""
    found = {}
    for row in np.loadtxt(REFERENCE, delimiter=","):
        found.setdefault((bool(row[0]), row[1]), []).append(row[2:])
    rows = {key: np.array(part) for key, part in found.items()}
    return {key: (part[:, 0], part[:, 1::2] + 1j * part[:, 2::2]) for key, part in rows.items()}


@pytest.mark.parametrize("height", [20e-6, 0.2e-3])
def test_wavenumber_in_a_slit_is_that_of_viscous_air(height):
    """Measured 1.5e-5 and 3.6e-4, mostly the bulk's absorption, which the layers lack."""
    slit = Channel(height, height, 1e-3, 1e-3)
    found = uniform_wavenumber(slit, 20e3, AIR, along=40, across=8)
    model = slit.wavenumber(20e3, height, AIR)
    assert model.real == pytest.approx(found.real, rel=1e-3)
    assert model.imag == pytest.approx(found.imag, rel=1e-3)


@pytest.mark.parametrize(("least", "error"), [(20e-6, 1e-3), (0.1e-3, 8e-4), (1e-3, 8e-4)])
def test_layers_as_an_impedance_scatter_as_viscous_air(least, error):
    """Channels between planes.

    Measured: 7e-4, 5e-4 and 5e-4, where the mesh's own error is 5e-4.
    """
    frequency, expected = reference()[False, least]
    channel = narrowed(least, is_round=False)
    mesh = meshed(channel, across=10)
    found = [scattered(by_layers, channel, f, AIR, mesh=mesh) for f in frequency]
    np.testing.assert_allclose(found, expected, atol=error)


@pytest.mark.parametrize("least", [0.1e-3, 0.5e-3, 1e-3])
def test_spectral_solver_scatters_as_viscous_air(least):
    """A round channel. Measured: 4e-4, where the mesh's error is 5e-4; T to 0.23 % of itself."""
    frequency, expected = reference()[True, least]
    found = spectral_scattering(narrowed(least, is_round=True), frequency)
    np.testing.assert_allclose(found, expected, atol=8e-4)
    np.testing.assert_allclose(np.array(found)[:, 1], expected[:, 1], rtol=4e-3)
