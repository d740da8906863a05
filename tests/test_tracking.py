"""Contacts tracked from cycle to cycle: the update, and fingers that land, move and lift."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import trapezoid
from test_inversion import MODES, RADIUS, press, tool

from acoustube.inversion import (
    Baseband,
    ContactTracker,
    ForwardModel,
    Library,
    Motion,
    baseband_of,
    measured_clutter,
    tracking,
)
from acoustube.inversion.births import new_deviations
from acoustube.inversion.cycle import Known
from acoustube.inversion.fewer import one_for_two, refitted
from acoustube.inversion.fit import maximise
from acoustube.inversion.likelihood import echo_of, weights
from acoustube.inversion.motion import Branches, at_rest, predicted, updated
from acoustube.inversion.parameters import joined
from acoustube.inversion.proposals import Proposals
from acoustube.ranging import Rangefinder, digitise, record, response

LENGTH, TUBE = 2.0, 7


@pytest.fixture(scope="module")
def model():
    base = Baseband(Rangefinder(), RADIUS, LENGTH, 20.0, MODES)
    free = record([], n_cycles=100, tube_seed=TUBE, seed=11, length=LENGTH)["signal"].values
    return ForwardModel(Library((tool(),)), base, measured_clutter(base, free))


def counts(presses, number=0):
    """Return one cycle with presses (place, depth) of the exact scattering."""
    placed = [press(depth, place) for place, depth in presses]
    _, voltage = response(placed, Rangefinder(), length=LENGTH, tube_seed=TUBE)
    return digitise(voltage, Rangefinder(), np.array([number]), 3)[0]


def finger(number, first, last, place, slide, depth):
    """Return position and depth in a cycle of a finger that lands, slides and lifts, or nothing."""
    u = (number - first) / (last - first)
    if not 0 < u < 1:
        return []
    rise = np.clip(min(number - first, last - number) / 10, 0, 1)
    return [(place + slide * u, depth * np.sin(np.pi / 2 * rise) ** 2)]


def followed(model, hands, n):
    tracker = ContactTracker(model)
    return [tracker.update(counts(hands(i), i)) for i in range(n)]


def test_fingers_are_followed_while_they_land_slide_and_lift(model):
    """Two contacts that overlap in time; positions within 0.3 mm, depths within 5 %.

    The echo of this scattering is as the cube of the depth, so that a gain known to 5 % leaves the
    depth to 1.7 %; three times that is allowed.
    """

    def hands(i):
        near = finger(i, 2, 44, 0.55, 0.02, 4.5e-3)
        return near + finger(i, 18, 80, 0.97, -0.01, 5.5e-3)

    found = followed(model, hands, 54)
    ages: dict[int, int] = {}
    for i, one in enumerate(found):
        truth = [pair for pair in hands(i) if pair[1] > 2e-3]
        settled = (12 < i < 20) or (30 < i < 38) or i > 49
        if settled:
            assert len(one.contacts) == len(truth), i
            assert one.fits
            for contact, (place, depth) in zip(one.contacts, truth, strict=True):
                assert contact.distance.value == pytest.approx(place, abs=3e-4)
                assert contact.depth.value == pytest.approx(depth, rel=0.05)
        for number in one.numbers:
            ages[number] = ages.get(number, 0) + 1
    # The two fingers keep their numbers; false contacts are short.
    assert min(sorted(ages.values())[-2:]) >= 29
    assert sum(sorted(ages.values())[:-2]) < 10
    assert found[-1].numbers == found[37].numbers[1:]
    assert found[16].contacts[0].force.value == pytest.approx(2e6 * 4.5e-3**2, rel=0.1)


def test_untouched_tube_stays_without_contact(model):
    assert not any(one.contacts for one in followed(model, lambda _: [], 12))


def test_contact_that_is_there_from_the_start_is_found_in_some_cycles(model):
    found = followed(model, lambda _: [(0.812, 4.03e-3)], 6)
    assert found[1].contacts[0].distance.value == pytest.approx(0.812, abs=6e-3)
    assert found[-1].contacts[0].distance.value == pytest.approx(0.812, abs=3e-4)
    low, high = found[-1].contacts[0].depth.intervals[0.9]
    assert low < 4.03e-3 < high


def test_update_from_a_wide_prior_is_the_maximum_likelihood(model):
    """Mean and covariance are those of Levenberg and Marquardt's method, with fixed nuisances."""
    samples, noise = model.base.of_cycles(counts([(0.7, 4e-3)])[None])
    whiten = weights(model, noise, 0.01, None)
    start = joined(np.array([[0.7004]]), np.array([[4.05e-3]]), np.zeros((1, 7)))
    known = maximise(model, (0,), start, samples, whiten, 20)
    deviations = np.concatenate([[1.0, 1.0], model.priors.deviations, [1.0, 1.0]])
    prior = Branches(
        (0,), np.append(start, [[0.0, 0.0]], 1), np.diag(deviations**2)[None], np.zeros(1)
    )
    found = updated(model, prior, samples, whiten, iterations=20)
    scale = 1 / np.sqrt(np.diag(known.information[0]))
    off = (found.branches.mean[0, :9] - known.parameters[0]) / scale
    # Both stop when the cost falls by less than 0.1.
    assert np.abs(off[:2]).max() < 0.3
    covariance = np.linalg.inv(known.information[0])
    assert found.branches.covariance[0, :2, :2] == pytest.approx(covariance[:2, :2], rel=0.05)


def test_prediction_keeps_the_stationary_distribution(model):
    """For velocities and nuisances; a position changes by the integral of the velocity."""
    motion, priors = Motion(), model.priors
    deviations = np.array([1e-4, 1e-4, motion.slide, motion.sink])
    start = at_rest(priors).added(0, 0, np.array([0.5]), np.array([3e-3]), deviations)
    start.mean[0, -2] = 0.02
    once = predicted(start, motion, priors, 0.05)
    twice = predicted(predicted(start, motion, priors, 0.025), motion, priors, 0.025)
    decay = np.exp(-0.05 / motion.memory)
    moved = 0.02 * motion.memory * (1 - decay)
    assert once.mean[0, 0] == pytest.approx(0.5 + moved, abs=1e-9)
    for found in (once, twice):
        variance = np.diag(found.covariance[0])
        assert np.sqrt(variance[-2:]) == pytest.approx(deviations[2:], rel=1e-9)
        assert np.sqrt(variance[2:9]) == pytest.approx(priors.deviations, rel=1e-9)
        assert np.linalg.eigvalsh(found.covariance[0]).min() > 0
    # Two halves make the whole.
    assert once.covariance[0] == pytest.approx(twice.covariance[0], rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("x", [1e-7, 9.9e-4, 1.1e-3, 0.125, 1.0, 30.0])
def test_noise_of_a_position_is_that_of_the_velocitys_process(model, x):
    """The integrals over a step, x times the correlation time; over a short one, powers of x."""
    motion, still = Motion(), np.array([1e-15, 1e-15, 1e-15, 1e-15])
    start = at_rest(model.priors).added(0, 0, np.array([0.5]), np.array([3e-3]), still)
    found = predicted(start, motion, model.priors, x * motion.memory).covariance[0]
    spread = found[0, 0] / (motion.slide * motion.memory) ** 2
    shared = found[0, -2] / (motion.slide**2 * motion.memory)
    t = np.linspace(0, x, 20001)
    passed = -np.expm1(-t)  # the way by which a change of velocity a time t ago moves the position
    assert spread == pytest.approx(trapezoid(2 * passed**2, t), rel=1e-4)
    assert shared == pytest.approx(trapezoid(2 * passed * np.exp(-t), t), rel=1e-4)
    if x < 1e-2:
        assert (spread, shared) == pytest.approx((2 / 3 * x**3, x**2), rel=2 * x)
    assert found[0, -2] ** 2 < found[0, 0] * found[-2, -2]


def test_contact_that_is_added_and_taken_away_leaves_the_others():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(1, 15, 15))
    start = Branches((0, 1), rng.normal(size=(1, 15)), root @ root.swapaxes(1, 2), np.zeros(1))
    more = start.added(1, 2, np.array([0.4, 0.5]), np.array([1e-3, 2e-3]), np.ones(4))
    assert more.tools == (0, 2, 1)
    assert more.mean[:, 2:4] == pytest.approx(np.array([[0.4, 1e-3], [0.5, 2e-3]]))
    fewer = more.without(1)
    assert fewer.tools == (0, 1)
    assert np.array_equal(fewer.mean[1], start.mean[0])
    assert np.array_equal(fewer.covariance[1], start.covariance[0])


def of_contacts(model, contacts):
    """Return the distribution of new contacts (place, depth)."""
    start = at_rest(model.priors)
    for i, (place, depth) in enumerate(contacts):
        start = start.added(i, 0, np.array([place]), np.array([depth]), new_deviations(Motion()))
    return start


def cycle_of(model, presses):
    """Return the baseband of a cycle, and weights with an error of the model of 3 %."""
    samples, noise = model.base.of_cycles(counts(presses)[None])
    places, depths = np.array(presses).T[:, None]
    nuisances = np.zeros((1, len(model.priors.deviations)))
    echo = echo_of(model, (0,) * len(presses), joined(places, depths, nuisances)[0])
    return samples, weights(model, noise, 0.03, echo)


def loss(whiten, fewer, more):
    """Return by how much the log-likelihood of a fit is below that of another one."""
    rest = whiten(np.stack([fewer.rest[0], more.rest[0]]))
    return float(np.diff(-np.sum(np.abs(rest) ** 2, axis=1))[0])


def test_false_contact_beside_a_misplaced_one_has_no_evidence_after_a_refit(model):
    """A misplaced contact returns to its true position when a false one behind it is removed.

    The contact is half a wavelength off. Without a refit the removal of the false contact reduces
    the likelihood; after the refit it does not. The evidence of a true second press is hundreds,
    however the first is fitted.
    """
    samples, whiten = cycle_of(model, [(0.62, 4.5e-3)])
    start = of_contacts(model, [(0.616, 3.9e-3), (0.66, 3e-3)])
    both = updated(model, start, samples, whiten, iterations=5)
    best = both.branches.take(np.arange(1))
    assert best.mean[0, 0] == pytest.approx(0.616, abs=0.3e-3)
    alone = refitted(model, best.without(1), samples, whiten)
    as_it_stands = updated(model, best.without(1), samples, whiten, iterations=0)
    assert loss(whiten, as_it_stands, both) > 10
    assert loss(whiten, alone, both) < 0
    assert alone.branches.mean[0, 0] == pytest.approx(0.62, abs=0.3e-3)

    samples, whiten = cycle_of(model, [(0.62, 4.5e-3), (0.95, 5e-3)])
    both = updated(model, of_contacts(model, [(0.62, 4.5e-3), (0.95, 5e-3)]), samples, whiten)
    alone = refitted(model, both.branches.take(np.arange(1)).without(1), samples, whiten)
    assert loss(whiten, alone, both) > 100


def test_one_contact_takes_the_place_of_two_at_any_depth(model):
    """A press represented by two contacts of too small depths becomes one of its own depth."""
    samples, whiten = cycle_of(model, [(0.62, 4.5e-3)])
    proposals = [Proposals(model, 0, model.base.noise(1))]
    start = of_contacts(model, [(0.612, 3e-3), (0.65, 2.5e-3)])
    both = updated(model, start, samples, whiten, iterations=5)
    best = both.branches.take(np.arange(1))
    alone = one_for_two(proposals, Motion(), best, 0, samples, whiten)
    assert alone.branches.tools == (0,)
    assert alone.branches.mean[0, 0] == pytest.approx(0.62, abs=0.3e-3)
    assert alone.branches.mean[0, 1] == pytest.approx(4.5e-3, rel=0.05)  # gain, as above
    assert loss(whiten, alone, both) < 0
    silent, quiet = cycle_of(model, [(1.4, 1e-3)])
    assert one_for_two(proposals, Motion(), best, 0, silent, quiet) is None


def test_tracker_drops_a_contact_beside_a_misplaced_one(model):
    """Three quarters of a second after a press is given as two contacts it is one."""
    tracker = ContactTracker(model)
    for i in range(20):
        tracker.update(counts([(0.62, 4.5e-3)], i))
    track = tracker.track
    wrong = of_contacts(model, [(0.616, 3.9e-3), (0.66, 3e-3)])
    track.branches, track.known = wrong, [Known(0, 12.0, age=2), Known(1, 12.0, age=5)]
    track.numbers = 2
    for i in range(20, 35):
        found = tracker.update(counts([(0.62, 4.5e-3)], i))
    assert [one.distance.value for one in found.contacts] == pytest.approx([0.62], abs=0.3e-3)
    assert [one.depth.value for one in found.contacts] == pytest.approx([4.5e-3], rel=0.05)
    assert found.numbers == [1]  # that of the older one
    assert len(tracker.track.known) == 1


def test_contact_is_followed_without_searches(model):
    """As where cycles wait; a finger that slides at 1.5 cm/s, within the 0.3 mm of a search."""
    tracker = ContactTracker(model)
    for i in range(40):
        ((place, depth),) = finger(i + 1, 0, 80, 0.7, 0.06, 4.5e-3)
        found = tracker.update(counts([(place, depth)], i), search=i < 16)
        if i > 14:
            (contact,) = found.contacts
            assert contact.distance.value == pytest.approx(place, abs=3e-4)
            assert contact.depth.value == pytest.approx(depth, rel=0.05)
            assert found.numbers == [0]
    assert tracker.n_searches == 16


def test_landing_in_cycles_without_a_search_does_not_mislead_the_known_contact(model):
    """Its echo changes behind the new one; both are found once contacts are sought again."""
    tracker = ContactTracker(model)
    for i in range(16):
        tracker.update(counts([(0.97, 5.5e-3)], i))
    for i in range(16, 20):
        found = tracker.update(counts([(0.55, 4.5e-3), (0.97, 5.5e-3)], i), search=False)
        (contact,) = found.contacts
        assert contact.distance.value == pytest.approx(0.97, abs=1e-3)
        assert contact.depth.value == pytest.approx(5.5e-3, rel=0.05)
        assert not found.fits
    for i in range(20, 24):
        found = tracker.update(counts([(0.55, 4.5e-3), (0.97, 5.5e-3)], i))
    assert [one.distance.value for one in found.contacts] == pytest.approx([0.55, 0.97], abs=5e-4)
    assert found.fits


def test_contacts_are_sought_in_the_first_cycle_of_all(model):
    """Where cycles wait already when the tracker begins, and the tube is touched."""
    tracker = ContactTracker(model)
    for i in range(2):
        found = tracker.update(counts([(0.7, 4.5e-3)], i), search=False)
    assert tracker.n_searches == 1
    (contact,) = found.contacts
    assert contact.distance.value == pytest.approx(0.7, abs=5e-3)


def test_contacts_are_sought_from_the_last_settled_state(model):
    """A known contact that was misled is put back by the search for another in front of it."""
    tracker = ContactTracker(model, most=2)
    for i in range(16):
        tracker.update(counts([(0.97, 5.5e-3)], i))
    known = tracker.track.branches
    shift = np.zeros(known.mean.shape[1])
    shift[:2] = 0.04, -2e-3
    tracker.track.branches = dataclasses.replace(known, mean=known.mean + shift)
    for i in range(16, 18):
        found = tracker.update(counts([(0.55, 4.5e-3), (0.97, 5.5e-3)], i))
    assert [one.distance.value for one in found.contacts] == pytest.approx([0.55, 0.97], abs=5e-4)
    assert found.fits


def test_misfit_is_that_of_reported_contacts(model, monkeypatch):
    """A contact that is followed but not reported has none: here none is probable enough."""
    tracker = ContactTracker(model)
    found = [tracker.update(counts([(0.7, 4e-3)], i)) for i in range(4)][-1]
    assert len(found.contacts) == 1
    assert found.misfit < 0.2
    monkeypatch.setattr(tracking, "TOLD", 1.1)
    found = tracker.update(counts([(0.7, 4e-3)], 4))
    assert tracker.track.known
    assert not found.contacts
    assert np.isnan(found.misfit)
    assert found.fits


def test_cycle_of_another_length_is_refused(model):
    with pytest.raises(ValueError, match="a cycle has 100 samples and the model's 4000"):
        ContactTracker(model).update(np.zeros(100))


ECHOTUBE = Rangefinder(sampling_rate=80e3, n_samples=1600, bits=8, noise=1e-3, lead=0.0)
FINE = Rangefinder(sampling_rate=240e3, n_samples=4800, noise=1e-3)
"""The same cycle at three times the rate, at which the carrier is below the Nyquist frequency."""


def folded(presses, number=0, rangefinder=ECHOTUBE):
    """Return one cycle of EchoTube's board: every third sample of a filtered voltage."""
    placed = [press(depth, place) for place, depth in presses]
    _, voltage = response(placed, FINE, length=LENGTH, tube_seed=TUBE)
    return digitise(voltage[::3].copy(), rangefinder, np.array([number]), 3)[0]


@pytest.fixture(scope="module")
def undersampled():
    base = baseband_of(ECHOTUBE, RADIUS, LENGTH, 20.0, MODES)
    free = np.array([folded([], i) for i in range(60)])
    return ForwardModel(Library((tool(),)), base, measured_clutter(base, free))


def test_folded_baseband_is_that_of_undersampled_cycles():
    """At 80 kHz the band about 42 kHz is folded about 40; without noise, clutter and far end."""
    changes = {"clutter": 0.0, "noise": 0.0, "drift": 0.0, "quantised": False,
               "far_reflection": 0.0}  # fmt: skip
    silent = dataclasses.replace(ECHOTUBE, **changes)
    base = baseband_of(silent, RADIUS, LENGTH, 20.0, MODES)
    placed = [press(5.03e-3, 0.8)]
    _, voltage = response(placed, dataclasses.replace(FINE, **changes), length=LENGTH)
    given, _ = base.of_cycles(digitise(voltage[::3].copy(), silent, np.array([0]), 3))
    place, depth = np.array([[0.8]]), np.array([[5.03e-3]])
    found, _ = ForwardModel(Library((tool(),)), base).baseband((0,), place, depth, np.zeros((1, 7)))
    # As at 200 kHz, by the side lobes of the taper.
    assert np.abs(found[0] - given).max() < 5e-3 * np.abs(given).max()
    assert not given.imag.any()


def test_noise_of_a_folded_baseband_is_that_of_its_samples():
    plain = dataclasses.replace(ECHOTUBE, quantised=False)
    base = baseband_of(plain, RADIUS, LENGTH, 20.0, MODES)
    rng, sigma = np.random.default_rng(1), plain.noise * base.per_volt
    cycles = sigma * rng.standard_normal((60, base.n_samples))
    variance = np.mean([base.of_cycles(one[None])[0].real ** 2 for one in cycles])
    # The mean of 60 times 120 squares, less the part removed by the taper of the band.
    assert variance == pytest.approx(base.noise(1) * np.mean(base.taper**2), rel=0.05)


def test_contact_is_followed_in_cycles_of_80_khz_and_8_bits(undersampled):
    tracker = ContactTracker(undersampled)
    for i in range(24):
        ((place, depth),) = finger(i + 1, 0, 60, 0.7, 0.02, 6e-3)
        found = tracker.update(folded([(place, depth)], i))
        if i > 14:
            (contact,) = found.contacts
            # Rounding to 8 bits leaves 25 times the noise of 12.
            assert contact.distance.value == pytest.approx(place, abs=5e-3)
            assert contact.depth.value == pytest.approx(depth, rel=0.06)
