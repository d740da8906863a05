"""Runs that use a scattering matrix of the spectral solver, for a lumen that needs no press."""

import dataclasses

import numpy as np
import pytest
from test_spectral import AIR, RADIUS, rings

from acoustube.runs import sound
from acoustube.runs.scattering_file import from_dataset, to_dataset
from acoustube.waves.network import at_sound_speed
from acoustube.waves.spectral import SpectralScattering

BAND = 35e3, 36e3


@pytest.fixture(scope="module")
def matrix():
    return sound.spectral_scattering_of(rings("E"), AIR, BAND, lossy=True)


def test_matrix_is_that_of_the_solver_at_even_frequencies(matrix):
    steps = np.diff(matrix.frequency)
    np.testing.assert_allclose(steps, sound.FREQUENCY_STEP)
    assert matrix.frequency[[0, -1]] == pytest.approx(BAND)
    assert matrix.error.max() < 5e-3
    assert matrix.modes == ("00", "11c")


def test_stored_matrix_comes_back_with_its_error_and_its_solver(matrix):
    data = to_dataset(matrix)
    assert data.attrs["solver"] == "spectral"
    assert "settled" not in data
    found = from_dataset(data)
    assert isinstance(found, SpectralScattering)
    for name in ("s", "error", "frequency", "propagates"):
        np.testing.assert_array_equal(getattr(found, name), getattr(matrix, name))
    assert (found.degree, found.tolerance) == (matrix.degree, matrix.tolerance)


def test_matrix_in_other_air_is_that_of_the_same_wavelengths(matrix):
    warm = at_sound_speed(matrix, 1.02 * matrix.sound_speed)
    np.testing.assert_allclose(warm.frequency, 1.02 * matrix.frequency)
    assert warm.s is matrix.s


def test_budget_states_the_estimated_error(matrix):
    found = sound.spectral_budget(matrix, np.array([[1.0, 0.5, 0.1]]))
    assert found.spectral_error == pytest.approx(np.quantile(matrix.error, 0.95))
    assert f"{found.spectral_error:.1g}" in found.in_words(1.0)
    assert found.ringing == pytest.approx(-20.0)


def test_run_warns_of_an_estimated_error_above_the_tolerance(monkeypatch, matrix):
    """A warning at 5 times the default tolerance of the solver, and none within the tolerance."""
    for factor in (5.0, 0.5):
        error = np.full_like(matrix.error, factor * matrix.tolerance)
        known = dataclasses.replace(matrix, error=error)
        monkeypatch.setattr(sound, "scatter_spectral", lambda *_, known=known, **__: known)
        _, _, note = sound.scattering_of(
            rings("E"), AIR, BAND, method="spectral", bore=2 * RADIUS, resolution=16, lossy=True
        )
        n = len(error)
        expected = f"At {n} of {n} frequencies the estimated error of the scattering matrix, up to "
        assert note == (expected + "0.005, exceeds the tolerance of 0.001." if factor > 1 else "")


@pytest.mark.parametrize("change", ["unlike", "coarse"])
def test_unsuitable_lumen_takes_the_time_domain_with_a_note(monkeypatch, change):
    """The march is replaced by a stub: only its arguments are checked."""
    lumen = rings("E")
    lumen.surface = None
    if change == "unlike":
        lumen.rings[-2:, :, 0] *= 1.01
    else:
        monkeypatch.setattr(sound, "LARGEST_SPECTRAL_ERROR", 0.0)
    marched = []
    monkeypatch.setattr(sound, "cut_cells", lambda *_: "cells")
    monkeypatch.setattr(sound, "scatter", lambda *given, **_: marched.append(given) or "matrix")
    found = sound.scattering_of(
        lumen, AIR, BAND, method="spectral", bore=2 * RADIUS, resolution=16, lossy=True
    )
    assert found[:2] == ("matrix", "cells")
    words = "differ in section" if change == "unlike" else "error estimate"
    assert words in found[2]
    assert len(marched) == 1
