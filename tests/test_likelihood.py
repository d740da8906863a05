"""Likelihood of a cycle, its derivatives, and the candidate positions of presses.

Fast forms that the inversion uses are compared with direct computations.
"""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from test_inversion import FREQUENCY, MODES, RADIUS, matrices, press, tool

from acoustube.inversion import (
    Baseband,
    ForwardModel,
    Inverter,
    Library,
    Priors,
    baseband_of,
    doubt,
    estimate,
    measured_clutter,
    other_maxima,
)
from acoustube.inversion.clutter import Reflectors
from acoustube.inversion.doubt import doubted
from acoustube.inversion.fit import Fits, _follow, maximise
from acoustube.inversion.hypotheses import Builder, Hypothesis
from acoustube.inversion.likelihood import deviance_of, echo_of, weights, whitened
from acoustube.inversion.other_maxima import other_depths
from acoustube.inversion.parameters import cost_of_press, split
from acoustube.inversion.peeling import peeled
from acoustube.inversion.search import Templates, front_of
from acoustube.inversion.tables import ToolTable
from acoustube.ranging import Burst, Rangefinder, record

LENGTH, TUBE = 1.2, 7
FOLDED = Rangefinder(sampling_rate=80e3)
PRESS = np.array([0.6, 4e-3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def model_of(rangefinder, *, learned, **priors):
    base = baseband_of(rangefinder, RADIUS, LENGTH, 20.0, MODES)
    clutter = None
    if learned:
        free = record([], rangefinder, n_cycles=100, tube_seed=TUBE, seed=11, length=LENGTH)
        clutter = measured_clutter(base, free["signal"].values)
    return ForwardModel(Library((tool(0.5e-3),)), base, clutter, Priors(**priors))


@pytest.fixture(scope="module")
def model():
    return model_of(Rangefinder(), learned=True)


def covariance_of(model, noise, error, echo, spread):
    """Return the covariance of the baseband from its definition, in double precision."""
    variance = noise + model.clutter.variance + error**2 * echo.power
    variance = variance + (spread * np.abs(echo.value).max()) ** 2
    found = np.diag(variance).astype(complex)
    if model.clutter.shapes is not None:
        found += model.clutter.shapes @ model.clutter.shapes.conj().T
    if echo.by_losses is not None:
        found += np.outer(echo.by_losses, echo.by_losses.conj())
    return found


RANGEFINDERS = pytest.mark.parametrize(
    "rangefinder", [Rangefinder(), FOLDED], ids=["complex", "folded"]
)
LEARNED = pytest.mark.parametrize("learned", [True, False], ids=["learned", "unknown"])
ERRORS = pytest.mark.parametrize(
    ("error", "spread", "losses"), [(0.003, 0.0, 4e-4), (0.2, 1e-3, 4e-4), (0.2, 1e-3, 0.0)]
)


@LEARNED
@RANGEFINDERS
@ERRORS
@pytest.mark.parametrize("quiet", [1.0, 1e-6], ids=["noise", "quiet"])
def test_deviance_is_that_of_the_covariance(rangefinder, learned, quiet, error, spread, losses):
    """Deviances by weights that are kept and by weights that are used once, against the definition.

    The unknown clutter's variance is a thousand times the noise and more, or 1e9 times.
    """
    model = model_of(rangefinder, learned=learned, losses=losses)
    noise = quiet * model.base.noise(20)
    echo = echo_of(model, (0,), PRESS)
    factor = np.linalg.cholesky(covariance_of(model, noise, error, echo, spread))
    white = np.exp(1j * np.arange(len(factor)) ** 2)
    rest, freedom = factor @ white, model.base.freedom
    determinant = 2 * np.log(np.diag(factor).real).sum()
    expected = 2 * freedom * (np.sum(np.abs(white) ** 2) + determinant)
    known = weights(model, noise, error, echo, spread)
    found = 2 * np.sum(np.abs(known(rest)) ** 2) + 2 * known.log_determinant
    assert found == pytest.approx(expected, abs=2e-3)
    found = deviance_of(model, noise, [0.5, error], echo, [0.0, spread], rest)[1]
    assert found == pytest.approx(expected, abs=2e-3)
    once, size = whitened(model, noise, error, echo, spread, np.stack([rest, 2 * rest]))
    for one, scale in zip(once, (1, 2), strict=True):
        square = np.sum(np.abs(one) ** 2) / scale**2
        assert 2 * (square + size) == pytest.approx(expected, abs=2e-3)


@LEARNED
@RANGEFINDERS
@ERRORS
def test_weights_are_the_root_of_the_inverse_covariance(
    rangefinder, learned, error, spread, losses
):
    """All products with the precision matrix, for all samples and for the first 30."""
    model = model_of(rangefinder, learned=learned, losses=losses)
    noise = model.base.noise(1)
    echo = echo_of(model, (0,), PRESS)
    covariance = covariance_of(model, noise, error, echo, spread)
    whole = weights(model, noise, error, echo, spread)
    rng, n = np.random.default_rng(2), len(covariance)
    for count in (n, 30):
        some = whole.until(count)
        assert some.n_samples == count
        precision = model.base.freedom * np.linalg.inv(covariance[:count, :count])
        samples = rng.normal(size=(3, n)) + 1j * rng.normal(size=(3, n))
        size = np.abs(precision).max()
        weighted = samples[:, :count] @ precision.T
        np.testing.assert_allclose(some.weighted(samples), weighted, atol=1e-6 * size)
        np.testing.assert_allclose(some.sample_precision, np.diag(precision).real, rtol=1e-6)
        np.testing.assert_allclose(some(samples), whole(samples)[:, :count], rtol=1e-9)
        rough = some.of_derivatives(samples)
        np.testing.assert_allclose(rough, some(samples), atol=1e-5 * np.abs(rough).max())
        ranges = np.array([[5, 20], [12, count]])
        none = np.zeros((2, 2), int)
        assert not np.any(some.energies(samples[None].repeat(2, 0).astype(np.complex64), none))
        given = np.stack([samples, samples[::-1]]).astype(np.complex64)
        found = some.energies(given, ranges)
        for part, (start, stop), energies in zip(given, ranges, found, strict=True):
            product = part[:, start:stop] @ precision[start:stop, start:stop].T
            expected = np.sum(part[:, start:stop].conj() * product, axis=1).real
            np.testing.assert_allclose(energies, expected, rtol=1e-4)
    assert whole.until(30).log_determinant == whole.log_determinant
    assert whole.until(0)(samples).shape == (3, 0)


@LEARNED
def test_clutter_beyond_a_position_is_the_sum_over_reflectors(learned):
    """Of random reflectors, at four temperatures; the table is interpolated over temperature."""
    base = baseband_of(Rangefinder(), RADIUS, LENGTH, 20.0, MODES)
    rng = np.random.default_rng(4)
    places = np.sort(rng.uniform(0.0, LENGTH + 0.015 * learned, 700))
    strength = rng.normal(size=(2, 700)).T @ [1.0, 1j]
    clutter = Reflectors(places, strength, np.zeros(len(base.used), complex), 1.0).clutter(base)
    phase, heated = base.path.plane(places)
    for position, warmer in ((0.0, -1.5), (0.2, -0.93), (0.84, 0.0), (1.1, 1.47)):
        waves = strength * np.exp(-2j * (phase + warmer * heated))
        beyond = places >= position - 1e-12
        found, _, slope = clutter.beyond(np.array([position]), np.array([warmer]))
        expected = waves[:, beyond].sum(axis=1)
        size = np.abs(waves).sum(axis=1).max()
        assert np.abs(found[0] - expected).max() < 3e-5 * size
        expected = (-2j * heated * waves)[:, beyond].sum(axis=1)
        assert np.abs(slope[0] - expected).max() < 1e-3 * size * 2 * np.abs(heated).max()


def test_starting_points_follow_the_best_one_at_the_same_parameters():
    """In a chain each follows the next better one; one without a finite cost follows none."""
    leader, cost = np.arange(5), np.array([3.0, 2.0, 1.0, np.inf, 0.0])
    near = np.abs(np.subtract.outer(leader, leader)) <= 1
    near[4], near[:, 4] = False, False
    near[4, 4] = True
    _follow(leader, near, cost)
    assert leader.tolist() == [1, 2, 2, 3, 4]


def test_starting_points_that_meet_have_one_maximum(model):
    """Each ends at the maximum of its own, in the order given; one at the known maximum stops."""
    whiten = weights(model, model.base.noise(20), 0.003, echo_of(model, (0,), PRESS))
    samples = model.baseband((0,), *split(PRESS[None]))[0][0]
    start = np.tile(PRESS, (5, 1))
    start[:, 0] += [0.4e-3, 0.1, 0.0, 0.0, -0.4e-3]
    alone = [maximise(model, (0,), one[None], samples, whiten) for one in start]
    fits = maximise(model, (0,), start, samples, whiten)
    for i, one in enumerate(alone):
        if i != 1:  # the echo 10 cm away fits no better anywhere near, and is given up
            assert fits.cost[i] == pytest.approx(one.cost[0], abs=0.1)
            assert fits.parameters[i, :2] == pytest.approx(PRESS[:2], abs=5e-6)
    assert abs(fits.parameters[1, 0] - PRESS[0]) > 0.05
    with_known = maximise(model, (0,), start, samples, whiten, known=alone[2])
    np.testing.assert_array_equal(with_known.parameters[[2, 3]], start[[2, 3]])


@pytest.mark.parametrize("depth", [2.8e-3, 3.5e-3, 3.6e-3])
def test_other_depth_of_nearly_the_same_echo_is_found(depth):
    """Also where depths tried between the two descend to the known one within two iterations.

    The echo of the other depth is the same but for interpolation: its place in depth is exact to a
    tenth of the step of the library, and its cost to 1, the change that counts as converged.
    """
    one = tool(0.5e-3)
    heard = np.minimum(one.depth, 8e-3 - 0.98 * one.depth)
    alike = dataclasses.replace(one, s=matrices(heard, FREQUENCY))
    base = baseband_of(Rangefinder(), RADIUS, LENGTH, 20.0, MODES)
    model = ForwardModel(Library((alike,)), base, None, Priors())
    at = np.array([0.6, depth, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    samples = model.baseband((0,), *split(at[None]))[0][0]
    whiten = weights(model, base.noise(1), 0.003, echo_of(model, (0,), at))
    known = maximise(model, (0,), at[None], samples, whiten)
    found = other_depths(model, known, (0,), samples, whiten)
    near = np.abs(found.parameters[:, 1] - (8e-3 - depth) / 0.98) < 0.1e-3
    assert near.any()
    assert found.cost[near].min() < known.cost[0] + 1


@pytest.mark.parametrize(("presses", "judged"), [(1, 1), (2, 3)])
def test_further_fits_are_judged_only_if_the_first_has_an_error(
    model, monkeypatch, presses, judged
):
    """Three fits of one press, which explains all samples or lacks a second press."""
    places, depths = np.array([[0.6, 1.0]]), np.array([[4e-3, 5e-3]])
    samples = model.baseband(
        (0,) * presses, places[:, :presses], depths[:, :presses], np.zeros((1, 7))
    )[0][0]
    builder = Builder(model, [], samples, model.base.noise(20))
    start = np.repeat(PRESS[None], 3, axis=0)
    start[:, 0] += [0.0, 1e-4, -1e-4]
    alone, calls = Builder._alone, []
    monkeypatch.setattr(Builder, "_alone", lambda *words: calls.append(1) or alone(*words))
    found = builder._fitted((0,), Fits(start, np.zeros(3), np.tile(np.eye(9), (3, 1, 1))))
    assert len(calls) == judged
    assert found.best[0] == pytest.approx(0.6, abs=5e-3)


def test_half_wavelengths_are_tried_about_other_depths_one_press_at_a_time(model, monkeypatch):
    at = np.array([0.6, 4e-3, 1.0, 5e-3, 0, 0, 0, 0, 0, 0, 0])
    known = Fits(at[None], np.zeros(1), np.eye(11)[None])
    other, unlikely = at.copy(), at.copy()
    other[3] -= 1e-3
    unlikely[1] += 1e-3
    sharp = np.tile(1e12 * np.eye(11), (2, 1, 1))
    others = Fits(np.array([other, unlikely]), np.array([1.0, 9.0]), sharp)
    tried = []

    def maximise(*words):
        start = words[2]
        tried.append(start)
        return Fits(start, np.zeros(len(start)), np.zeros((len(start), 11, 11)))

    monkeypatch.setattr(other_maxima, "maximise", maximise)
    found = other_maxima.beside(model, known, (0, 0), others, np.zeros(1), None)
    off = (tried[0] - other) / model.base.half_wavelength
    shifts = [-3, -2, -1, 1, 2, 3]
    assert off[:6, 0] == pytest.approx(shifts)
    assert off[6:, 2] == pytest.approx(shifts)
    assert np.count_nonzero(np.abs(off) > 1e-9) == 12
    assert len(found.cost) == 2 + 12


def test_several_sets_of_parameters_give_what_each_gives(model):
    """Value and Jacobian of two presses with learned clutter, at three places and temperatures."""
    at = np.tile([0.5, 4e-3, 0.9, 5e-3, 0.1, 0.02, -0.03, 1e-3, 0.01, 1e-3, 2e-3], (3, 1))
    at[:, [0, 2]] += [[0.0, 0.1], [0.03, 0.0], [0.2, 0.4]]
    at[:, 4] += [0.0, -0.3, 0.2]
    together = model.baseband((0, 0), *split(at))
    for i in range(3):
        for one, other in zip(model.baseband((0, 0), *split(at[i : i + 1])), together, strict=True):
            np.testing.assert_allclose(one[0], other[i], atol=1e-6 * np.abs(one).max())


def test_starting_points_that_still_fall_have_the_known_maximum(model):
    """After one iteration from another depth, unless they are better than the known one."""
    whiten = weights(model, model.base.noise(1), 0.05, echo_of(model, (0,), PRESS))
    samples = model.baseband((0,), *split(PRESS[None]))[0][0]
    known = maximise(model, (0,), PRESS[None], samples, whiten)
    start = PRESS[None] + np.array([0.0, 0.7e-3, 0, 0, 0, 0, 0, 0, 0])
    early = maximise(model, (0,), start, samples, whiten, 1)
    assert early.cost[0] > known.cost[0] + 1
    assert abs(early.parameters[0, 1] - start[0, 1]) > 0.1e-3
    np.testing.assert_array_equal(
        maximise(model, (0,), start, samples, whiten, 1, known, np.inf).cost, early.cost
    )
    replaced = maximise(model, (0,), start, samples, whiten, 1, known)
    np.testing.assert_array_equal(replaced.parameters, known.parameters)
    assert replaced.cost == known.cost
    # Its cost is lower than that of a known maximum that is worse.
    worse = dataclasses.replace(known, cost=early.cost + 1)
    kept = maximise(model, (0,), start, samples, whiten, 1, worse)
    np.testing.assert_array_equal(kept.parameters, early.parameters)


def test_information_is_positive_where_place_and_temperature_are_one_delay():
    """The information matrix is positive definite for a loud echo without learned clutter.

    Position and temperature are distinguished by the prior only, a difference of numbers 1e7 times
    as large. Products in single precision would make the matrix indefinite.
    """
    model = model_of(Rangefinder(), learned=False)
    noise = 1e-3 * model.base.noise(20)
    echo = echo_of(model, (0,), PRESS)
    whiten = weights(model, noise, 0.0, None)
    fit = maximise(model, (0,), PRESS[None], echo.value + model.clutter.ring, whiten, 0)
    _, jacobian = model.baseband((0,), *split(PRESS[None]))
    slopes = whiten(jacobian)[0]
    expected = 2 * (slopes.conj() @ slopes.T).real
    expected[2:, 2:] += np.diag(1 / model.priors.deviations**2)
    sizes = np.sqrt(np.diag(expected))
    found = np.linalg.eigvalsh(fit.information[0] / np.outer(sizes, sizes))
    assert found[0] > 0
    least = np.linalg.eigvalsh(expected / np.outer(sizes, sizes))[0]
    assert found[0] == pytest.approx(least, rel=0.05)


@RANGEFINDERS
def test_adjoint_is_that_of_the_first_samples_too(rangefinder):
    base = baseband_of(rangefinder, RADIUS, LENGTH, 20.0, MODES)
    rng, n = np.random.default_rng(3), len(base.bins)
    spectrum = rng.normal(size=n) + 1j * rng.normal(size=n)
    full = base.transformed(spectrum)
    rough = base.transformed(spectrum.astype(np.complex64))
    assert rough.dtype == np.complex64
    np.testing.assert_allclose(rough, full, atol=1e-6 * np.abs(full).max())
    for count in (len(full), 30):
        field = rng.normal(size=count) + 1j * rng.normal(size=count) * (base.freedom == 1)
        product = np.vdot(field, full[:count])
        other = np.vdot(base.adjoint(field), spectrum)
        assert other.real == pytest.approx(product.real, rel=1e-9)


@pytest.mark.parametrize("lead", [0.0, 1.5e-3])
def test_echoes_lie_within_their_range_of_samples(lead):
    """The range holds 99.9 % of the energy of an echo, and fewer than all samples."""
    device = dataclasses.replace(Rangefinder(), lead=lead)
    model = model_of(device, learned=False)
    for place in (0.4, 0.9):
        echo = echo_of(model, (0,), np.array([place, *PRESS[1:]])).value
        ((start, stop),) = model.base.echo_ranges(np.array([place]), 1e-3, 5e-3, len(echo))
        power = np.abs(echo) ** 2
        assert power[start:stop].sum() > 0.999 * power.sum()
        assert stop - start < len(echo)
    beyond = model.base.echo_ranges(np.array([-1.0, 50.0]), 1e-3, 5e-3, len(echo))
    assert np.all(np.diff(beyond, axis=1) >= 2)
    assert beyond.min() >= 0
    assert beyond.max() <= len(echo)
    for few in (0, 1, 2):
        assert np.array_equal(model.base.echo_ranges(np.array([0.4]), 1e-3, 5e-3, few), [[0, few]])


@pytest.mark.parametrize("drive", [{"lead": 3e-3}, {"drive": Burst(cycles=60)}])
def test_a_first_press_is_sought_where_its_echo_begins(drive):
    """For a rangefinder that records for 3 ms before it sends, and one that sends for 1.4 ms."""
    device = dataclasses.replace(Rangefinder(), **drive)
    model = model_of(device, learned=True)
    cycles = record([press(4.1e-3, 0.62)], device, n_cycles=20, tube_seed=TUBE, seed=5,
                    length=LENGTH)["signal"].values  # fmt: skip
    templates = [Templates(model, 0)]
    builder = Builder(model, templates, *model.base.of_cycles(cycles))
    ((first, *_), *_) = peeled(builder, 1)
    assert first.best[0] == pytest.approx(0.62, abs=0.01)
    ((contact,)) = Inverter(model)(cycles).contacts
    assert contact.distance.value == pytest.approx(0.62, abs=1e-3)


def test_search_finds_nothing_outside_its_range_or_under_its_least_gain(model):
    echo = echo_of(model, (0,), PRESS).value
    whiten = weights(model, model.base.noise(1), 0.0, None)
    templates = Templates(model, 0)
    silent = front_of(model, (), np.zeros(0), np.zeros(0), np.zeros(7))
    found = templates.search(echo, whiten, silent)
    assert found.place[0] == pytest.approx(PRESS[0], abs=1e-3)
    assert not len(templates.search(echo, whiten, silent, least=1.1 * found.gain[0]).gain)
    assert len(templates.search(echo, whiten, silent, least=0.5 * found.gain[0]).gain)
    elsewhere = templates.search(echo, whiten, silent, within=(0.9, 1.0))
    assert not len(elsewhere.gain) or elsewhere.gain[0] < 0.1 * found.gain[0]
    assert np.all((elsewhere.place > 0.88) & (elsewhere.place < 1.02))


@RANGEFINDERS
def test_few_frequencies_give_the_baseband_repeated(rangefinder):
    """A spectrum at every m-th frequency repeats the samples, and m leaves room for an echo."""
    base = baseband_of(rangefinder, RADIUS, LENGTH, 20.0, MODES)
    n = len(base.bins)
    rng = np.random.default_rng(5)
    spectrum = rng.normal(size=n) + 1j * rng.normal(size=n)
    every = base.every(0.3 * n * base.interval)
    assert every == 3
    whole = np.fft.ifft(2 * n * base.step * base.taper * spectrum)
    repeated = np.tile(whole.reshape(every, -1).sum(axis=0), every)[base.used]
    if base.freedom < 1:
        repeated = (repeated * (-1.0) ** base.used).real
    found = base.transformed(spectrum[::every])
    np.testing.assert_allclose(found, repeated, atol=1e-12 * np.abs(whole).max())
    assert base.every(1.01 * n * base.interval) == 1


@pytest.mark.parametrize("learned", [False, True])
def test_gain_of_a_candidate_is_the_decrease_of_the_cost(learned):
    """Of one press, and of one behind another, at a place and a depth of the templates.

    Templates leave out multiple reflections and the clutter that the press attenuates, and leave
    out or alias sound later than 5 ms: 3 % of the energy.
    """
    model = model_of(Rangefinder(), learned=learned)
    templates, quiet = Templates(model, 0), np.zeros((1, 7))
    whiten = weights(model, model.base.noise(1), 0.0, None)
    depths, places = templates.depths[[20, 24]], templates.places[[100, 190]]
    given = [
        model.baseband((0,) * n, places[None, :n], depths[None, :n], quiet)[0][0] for n in (0, 1, 2)
    ]
    for n in (0, 1):
        echo = given[n + 1] - given[n]
        fronts = front_of(model, (0,) * n, places[:n], depths[:n], quiet[0])
        found = templates.search(echo, whiten, fronts)
        assert (found.place[0], found.depth[0]) == pytest.approx((places[n], depths[n]), abs=1e-6)
        cost = 2 * float(np.sum(np.abs(whiten(echo)) ** 2))
        assert found.gain[0] == pytest.approx(cost, rel=0.04)


@pytest.mark.parametrize("step", [3e-3, 0.05])
def test_modes_propagate_to_evenly_spaced_places_as_to_single_ones(step):
    """In single precision, from behind a press and from the face, on 100 places."""
    path = model_of(Rangefinder(), learned=False).path
    for origin in (0.0, 0.6):
        places = origin + 0.031 + step * np.arange(100)
        phase = path.phases(places, 0.3) - path.phases(np.array([origin]), 0.3, behind=True)
        expected = np.exp(-1j * phase).swapaxes(1, 2)
        found = path.propagated(origin, places, 0.3, path.modes)
        assert found.dtype == np.complex64
        np.testing.assert_allclose(found, expected, atol=1e-5)
        plane = path.propagated(origin, places, 0.3, 1)
        np.testing.assert_array_equal(plane, found[:, :1])


@pytest.mark.parametrize("modes", [1, 2, 3])
def test_front_of_a_press_is_its_reflection_and_transmission(modes):
    base = Baseband(Rangefinder(), RADIUS, LENGTH, 20.0, MODES)
    table = ToolTable(tool(0.5e-3), base.frequency, modes)
    depth, stretch = np.array([2.3e-3, 5.1e-3]), np.array([0.0, 1e-3])
    whole, heard = table(depth, stretch), table.front(depth, stretch)
    for one, part in zip(whole, heard, strict=True):
        expected = np.zeros((2, len(base.frequency), 3, 3), complex)
        expected[:, :, :modes, :modes] = one[:, :, 0, :, 0, :]
        np.testing.assert_array_equal(part[..., :9].reshape(expected.shape), expected)
    for one, other in zip(whole.transmission(), heard.transmission(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_press_is_credited_beyond_an_error_of_the_model_that_is_small_with_it(model, monkeypatch):
    """A faint third press is accepted, although without it the error of the model seems to be 0.1.

    With that error of the model the third press would have a negative evidence; with the press the
    model is exact.
    """
    pressed = [press(5e-3, 0.4), press(4e-3, 0.6), press(2.6e-3, 0.85)]
    cycles = record(pressed, n_cycles=20, tube_seed=TUBE, seed=6, length=LENGTH)["signal"].values
    builder = Builder(model, [Templates(model, 0)], *model.base.of_cycles(cycles))
    three = np.array([0.4, 5e-3, 0.6, 4e-3, 0.85, 2.6e-3, *PRESS[2:]])
    start = Fits(three[None], np.zeros(1), np.eye(len(three))[None])
    more = builder.settled(Hypothesis((0,) * 3, start, 0.0, builder.quiet, 0.0, 0.0))
    fewer = builder.pruned(more)[-1]
    assert more.error <= doubt.FALL * fewer.error
    assert fewer.deviance - doubted(builder, fewer, more).deviance > cost_of_press(3)
    monkeypatch.setattr(doubt, "FALL", 0.0)
    assert fewer.deviance - doubted(builder, fewer, more).deviance < 0


def hypothesis(number, deviance, error):
    fits = Fits(np.zeros((1, 2 * number + 7)), np.zeros(1), np.eye(2 * number + 7)[None])
    return Hypothesis((0,) * number, fits, error, None, deviance, 1.0)


@pytest.mark.parametrize(
    ("without", "with_it", "taken"), [(0.1, 0.03, 0.03), (0.1, 0.06, 0.1), (0.06, 0.06, 0.06)]
)
def test_error_of_the_model_is_that_with_a_press_if_it_is_well_below(
    monkeypatch, without, with_it, taken
):
    """A press that lowers it from 0.1 to 0.06 may fit an error of the model of the others."""
    seen = []
    monkeypatch.setattr(doubt, "doubt_weights", lambda *given: seen.append(given[-1].error))
    monkeypatch.setattr(doubt, "maximise", lambda *_: None)
    monkeypatch.setattr(doubt, "evidence", lambda *_: [0.0])
    builder = SimpleNamespace(model=None, noise=0.0, samples=None, own_deviance=lambda _: 0.0)
    doubted(builder, hypothesis(2, 0.0, without), hypothesis(3, 0.0, with_it))
    assert seen == [taken]


def test_presses_found_in_time_are_judged_although_fewer_are_unlikely(monkeypatch):
    """Three presses of which two explain less than one, as if no second one were there."""
    one, two, three = (
        hypothesis(1, 0.0, 0.4), hypothesis(2, 500.0, 0.4), hypothesis(3, -9e3, 0.01)
    )  # fmt: skip
    builder = SimpleNamespace(
        untouched=lambda: hypothesis(0, 1e5, 0.0), settled=lambda one: one,
        shifted=lambda one: one, extended=lambda _: [], replaced=lambda *_: [],
        own_deviance=lambda one: one.deviance, pruned=lambda _: [hypothesis(2, 600.0, 0.4)],
        searched=lambda one: one,
    )  # fmt: skip
    monkeypatch.setattr(estimate, "doubted", lambda _builder, _fewer, more: more)
    for in_time, onset, expected in (
        ([[one], [two], [three]], 90, 4),
        ([[one], [two]], 90, 3),
        ([[one], [two], [three]], None, 2),  # one press leaves no onset of an echo
    ):
        monkeypatch.setattr(estimate, "peeled", lambda *_, found=in_time: iter(found))
        monkeypatch.setattr(estimate, "onset_behind", lambda *_, index=onset: index)
        chain = Inverter._chain(SimpleNamespace(most=3), builder)
        assert [len(known.tools) for known in chain] == list(range(expected))


def test_press_that_the_first_part_of_its_echo_misplaces_is_sought_in_the_whole(monkeypatch):
    """Its model error is then large; a likelier one takes its place, and no more are sought."""
    wrong, right = hypothesis(1, 0.0, 0.2), hypothesis(1, -500.0, 0.003)
    sought = []

    def replaced(known, number):
        sought.append((known, number))
        return [right]

    builder = SimpleNamespace(
        untouched=lambda: hypothesis(0, 1e5, 0.0), settled=lambda one: one,
        shifted=lambda one: one, extended=lambda _: [], replaced=replaced,
        own_deviance=lambda one: one.deviance, searched=lambda one: one,
    )  # fmt: skip
    monkeypatch.setattr(estimate, "peeled", lambda *_: iter([[wrong]]))
    monkeypatch.setattr(
        estimate, "onset_behind", lambda _builder, known: None if known is right else 90
    )
    chain = Inverter._chain(SimpleNamespace(most=3), builder)
    assert chain[1:] == [right]
    assert sought == [(wrong, 0)]
