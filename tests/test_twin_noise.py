"""Noise of a twin's echoes: its density from residuals, and the covariance of the score."""

import numpy as np
import pytest

from acoustube.inversion.twin import Band
from acoustube.inversion.twin.fit import Data, Point, Prior, maximise, normal_equations
from acoustube.inversion.twin.model import LOCAL, SHARED, EchoModel
from acoustube.inversion.twin.noise import score_of, with_variances
from acoustube.inversion.twin.posterior import _given, posterior

CLUTTER, WHITE = 2e-4, 1e-3
"""Noise: its share of the echo's power density, and its white variance."""
PLACES = np.linspace(0.4, 1.6, 9)


@pytest.fixture(scope="module")
def closures():
    """Model, parameters, echoes without noise, and segments about them."""
    band = Band(200e3, 0.0, 4000, 42e3, 0.8e-3)
    model = EchoModel(band, PLACES, np.full(len(PLACES), 20.0), 1.2)
    shared = np.zeros(len(SHARED))
    for name, value in (("log_quality", np.log(18.0)), ("drive_cycles", 11.0), ("log_gain", 14.0)):
        shared[SHARED.index(name)] = value
    point = Point(shared, np.zeros((len(PLACES), len(LOCAL))))
    arrival = (2 * PLACES / 343.2)[:, None]
    inside = (band.time > arrival - 0.3e-3) & (band.time < arrival + 2e-3)
    return model, point, model(*point).value, inside.astype(int)


def density_of(model, value, segments):
    """Power of the echoes, and noise variance of the transform at each frequency, (n, n_t).

    The ends of the band are tapered, and with them the white noise.
    """
    power = np.abs(np.fft.fft(np.where(segments == 1, value, 0), axis=1, norm="ortho")) ** 2
    white = model.band.taper**2
    return power, CLUTTER * power + WHITE * white / white.mean()


def noise_of(density, random, *draws):
    """Complex stationary noise of a given density."""
    parts = random.normal(size=(2, *draws, *density.shape))
    return np.fft.ifft((parts[0] + 1j * parts[1]) * np.sqrt(density / 2), axis=-1, norm="ortho")


def data_of(values, segments, variance, clutter=0.0):
    both = np.stack([variance, np.ones_like(variance)], axis=1)
    return Data(values, segments, both, np.full_like(both, clutter))


def test_variance_of_noise_is_that_of_residuals_without_what_the_fit_takes(closures):
    """The mean ratio over 12 draws is 0.93, as the median of the closures is less than their mean.

    The fit absorbs a third of the residuals' power; the mean of the draws is accurate to 4 %.
    """
    model, point, value, segments = closures
    power, density = density_of(model, value, segments)
    true = (density * power).sum(axis=1) / power.sum(axis=1)
    random, ratios, plain = np.random.default_rng(3), [], []
    deviation = np.full(len(SHARED), 1e-4)
    for name in ("log_radius", "temperature_offset", "log_resonance", "log_quality", "log_gain"):
        deviation[SHARED.index(name)] = 0.3
    local = np.tile([1e-2, 0.5, 10.0], (len(PLACES), 1))
    prior = Prior(point.shared, deviation, local)
    for _ in range(12):
        data = data_of(value + noise_of(density, random), segments, true)
        best, _, _ = maximise(model, data, prior, point)
        found = with_variances(model, data, prior, best, np.full(len(PLACES), WHITE))
        ratios.append(found.variances[:, 0] / true)
        left = np.where(segments == 1, data.values - model(*best).value, 0)
        seen = np.abs(np.fft.fft(left, axis=1, norm="ortho")) ** 2 * power
        plain.append(seen.sum(axis=1) / power.sum(axis=1) / (segments.mean(axis=1) * true))
    assert np.mean(ratios) == pytest.approx(0.93, abs=0.12)
    assert np.mean(plain) < 0.75 * np.mean(ratios)


def test_covariance_of_the_score_is_that_of_draws(closures):
    """Diagonals agree within 4.5 standard errors of a variance from 3000 draws, 2.6 % each."""
    model, point, value, segments = closures
    power, density = density_of(model, value, segments)
    variance = (density * power).sum(axis=1) / power.sum(axis=1)
    data = data_of(value, segments, variance, CLUTTER)
    score, echoes = score_of(model, data, point), model(*point)
    noise = noise_of(density, np.random.default_rng(4), 3000)
    for slopes, found in (
        (echoes.by_shared, score.shared), (echoes.by_local, score.local),
    ):  # fmt: skip
        weighted = slopes.conj() * data.weights[:, None]
        drawn = np.einsum("npt,dnt->dnp", weighted, noise, optimize=True).real
        expected = np.diagonal(found, axis1=1, axis2=2)
        assert (drawn**2).mean(axis=0) == pytest.approx(expected, rel=4.5 * 0.026)


@pytest.fixture
def white(closures, monkeypatch):
    """Score and normal equations for white noise: the ends of the band are not tapered."""
    model, point, value, segments = closures
    data = data_of(value, segments, np.linspace(1.0, 3.0, len(PLACES)))
    monkeypatch.setattr(model.band, "taper", np.ones_like(model.band.taper))
    return score_of(model, data, point), normal_equations(model, data, point)


def test_score_of_white_noise_has_the_covariance_of_the_normal_equations(white):
    score, normal = white
    for found, expected in (
        (score.shared.sum(axis=0), normal.shared), (score.local, normal.local),
    ):  # fmt: skip
        root = np.sqrt(np.diagonal(expected, axis1=-2, axis2=-1))
        scale = root[..., :, None] * root[..., None, :]
        assert found / scale == pytest.approx(expected / scale, rel=0, abs=1e-9)
    assert score.mixed == pytest.approx(normal.mixed, rel=1e-6, abs=1e-6 * normal.mixed.max())


def test_covariance_with_that_score_is_the_posteriors(closures, white):
    """With weights of the noise the sandwich covariance is the inverse of the information.

    To 1e-3: products with the inverse of a matrix of condition 1e7, when scaled, lose digits.
    """
    _, point, _, _ = closures
    score, normal = white
    deviation = np.full(len(SHARED), 0.1)
    prior = Prior(point.shared, deviation, np.tile([1e-2, 0.5, 10.0], (len(PLACES), 1)))
    levels = np.zeros(len(PLACES))
    with_score = posterior(normal, prior, point, levels, score)
    without = posterior(normal, prior, point, levels)
    scale = np.sqrt(np.diag(without.covariance))
    scale = scale[:, None] * scale
    assert with_score.covariance / scale == pytest.approx(without.covariance / scale, abs=1e-3)


def test_covariance_of_estimates_under_clutter_is_that_of_draws(closures):
    """Variances of linear estimates of 2000 draws agree within 4.5 standard errors, 3.2 % each."""
    model, point, value, segments = closures
    power, density = density_of(model, value, segments)
    variance = (density * power).sum(axis=1) / power.sum(axis=1)
    data = data_of(value, segments, variance, CLUTTER)
    normal, score, echoes = (
        normal_equations(model, data, point),
        score_of(model, data, point),
        model(*point),
    )
    local = np.tile([1e-2, 1e-9, 1e-9], (len(PLACES), 1))
    prior = Prior(point.shared, np.full(len(SHARED), 0.01), local)
    _, _, covariance, _, _ = _given(normal, prior, point, score)
    noise = noise_of(density, np.random.default_rng(6), 2000)
    weighted = noise * data.weights
    shared = np.einsum("npt,dnt->dnp", echoes.by_shared.conj(), weighted, optimize=True).real.sum(
        axis=1
    )
    own = np.einsum("nlt,dnt->dnl", echoes.by_local.conj(), weighted, optimize=True).real
    random = np.random.default_rng(7)
    shared += random.normal(size=shared.shape) / prior.deviation
    own += random.normal(size=own.shape) / prior.local
    inverse = np.linalg.inv(normal.local + (prior.local**-2.0)[:, :, None] * np.eye(len(LOCAL)))
    passed = normal.mixed @ inverse
    schur = (
        normal.shared
        + np.diag(prior.deviation**-2.0)
        - np.einsum("npl,nql->pq", passed, normal.mixed)
    )
    found = np.linalg.solve(schur, (shared - np.einsum("npl,dnl->dp", passed, own)).T)
    assert (found**2).mean(axis=1) == pytest.approx(np.diag(covariance), rel=4.5 * 0.032)
