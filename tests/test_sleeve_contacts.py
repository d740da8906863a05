"""Contacts followed through noisy cycles: swipes, presses, and both ends."""

import numpy as np
import pytest
from refusals import refused

from acoustube import signals
from acoustube.air import sound_speed
from acoustube.base.errors import ConfigError
from acoustube.signals import Processing
from acoustube.sleeve import ContactTracker, Helix, TrackingSettings, nearest, remove_ghost_echoes
from acoustube.waves import Pulse

CYCLE = 0.05
NOISE = 0.01


def noisy(random, places, *, heard=0.9, clutter=0.1):
    """Candidates of one cycle: some positions are missing, and some echoes are false."""
    places = np.asarray(places, float)
    seen = places[random.random(len(places)) < heard] + 0.0
    false = random.uniform(0.15, 2.15, random.poisson(clutter))
    return random.permutation(np.concatenate([seen + random.normal(0, NOISE, len(seen)), false]))


def followed(tracker, cycles, far=None):
    """The tracker's estimates for each cycle."""
    far = far or [()] * len(cycles)
    return [
        tracker.update(CYCLE * i, near, f)
        for i, (near, f) in enumerate(zip(cycles, far, strict=True))
    ]


def test_swipe_of_5_cm_per_second_is_one_contact_with_its_speed():
    random = np.random.default_rng(0)
    true = 0.8 + 0.05 * CYCLE * np.arange(120)
    contacts = followed(ContactTracker(), [noisy(random, [place]) for place in true])
    late = contacts[20:]
    assert all(0 in cycle.number for cycle in late)
    place = np.array([cycle.place[cycle.number == 0][0] for cycle in late])
    speed = np.array([cycle.speed[cycle.number == 0][0] for cycle in late])
    # Better than the 10 mm of the candidates.
    assert np.sqrt(np.mean((place - true[20:]) ** 2)) < 0.6 * NOISE
    assert np.mean(speed) == pytest.approx(0.05, abs=0.01)


def test_two_presses_20_cm_apart_keep_their_numbers():
    random = np.random.default_rng(1)
    contacts = followed(ContactTracker(), [noisy(random, [0.7, 0.9]) for _ in range(200)])
    for cycle in contacts[20:]:
        for number, true in ((0, 0.7), (1, 0.9)):
            nearby = cycle.place[np.abs(cycle.place - true) < 0.05]
            assert len(nearby) == 1, number
    numbers = np.concatenate([cycle.number[np.abs(cycle.place - 0.8) < 0.15] for cycle in contacts])
    assert set(numbers.tolist()) == {0, 1}


def test_stated_deviation_is_that_of_the_error():
    """Squared errors over stated variances have a mean of one if the filter's model is right."""
    squares = []
    for seed in range(60):
        random = np.random.default_rng(seed)
        true, speed = 1.0, random.normal(0, 0.1)
        tracker = ContactTracker(TrackingSettings(acceleration=0.5, gate=8))
        for i in range(40):
            push = random.normal(0, 0.5)
            true, speed = true + speed * CYCLE + push * CYCLE**2 / 2, speed + push * CYCLE
            found = tracker.update(CYCLE * i, [true + random.normal(0, NOISE)])
        squares.append(((found.place[0] - true) / found.deviation[0]) ** 2)
    # The mean of 60 of them has a deviation of 0.18.
    assert np.mean(squares) == pytest.approx(1, abs=0.55)


def test_clutter_alone_gives_no_contacts_and_released_ones_end():
    random = np.random.default_rng(2)
    contacts = followed(ContactTracker(), [noisy(random, []) for _ in range(400)])
    assert sum(len(cycle.number) for cycle in contacts) == 0
    tracker = ContactTracker()
    followed(tracker, [[1.0]] * 10)
    left = [len(tracker.update(1.0 + CYCLE * i, []).number) for i in range(10)]
    assert left == [1] * 7 + [0] * 3


def test_both_ends_reduce_the_error_and_detect_the_press_behind():
    random = np.random.default_rng(3)
    length, cycles = 2.4, 200
    near = [noisy(random, [0.7]) for _ in range(cycles)]
    # The near end detects the first press, the far end the last: neither detects both.
    far = [length - noisy(random, [1.5]) for _ in range(cycles)]
    both = followed(ContactTracker(length=length), near, far)
    assert all(np.any(np.abs(cycle.place - 1.5) < 0.05) for cycle in both[20:])
    assert all(np.any(np.abs(cycle.place - 0.7) < 0.05) for cycle in both[20:])
    one = [1.0 + random.normal(0, NOISE, 1) for _ in range(cycles)]
    other = [length - 1.0 + random.normal(0, NOISE, 1) for _ in range(cycles)]
    alone = followed(ContactTracker(), one)
    fused = followed(ContactTracker(length=length), one, other)
    error = [
        np.sqrt(np.mean([(cycle.place[0] - 1.0) ** 2 for cycle in run[30:]]))
        for run in (alone, fused)
    ]
    assert error[1] < 0.85 * error[0]


def test_swipe_along_the_arm_is_followed_across_loops():
    """A fingertip crosses a loop every half second; the arm's coordinate changes steadily."""
    random = np.random.default_rng(4)
    helix = Helix(radius=0.033, taper=0.06, length=0.25, loops=9, lead=0.15)
    height = 0.03 + 0.05 * CYCLE * np.arange(70)
    places = np.stack([helix.radius_at(height), 0 * height, height], axis=-1)
    beside = nearest([helix], places)
    jumps = np.abs(np.diff(beside.distance))
    assert np.max(jumps) > 0.2
    distance = beside.distance + random.normal(0, 0.02, len(height))
    # Within a loop the reading is constant: the coordinate is uncertain by half a pitch.
    tracker = ContactTracker(TrackingSettings(deviation=0.4 * helix.pitch, acceleration=0.1))
    contacts = followed(tracker, [[z] for z in helix.height(distance)])
    assert all(cycle.number.tolist() == [0] for cycle in contacts[5:])
    error = np.array([cycle.place[0] for cycle in contacts[20:]]) - height[20:]
    assert np.sqrt(np.mean(error**2)) < helix.pitch / 2


@pytest.mark.parametrize(
    ("echoes", "own"),
    [
        ({0.616: 1.0, 0.536: 0.09}, [0.616]),  # the low-pass's lobe before an echo
        ({0.616: 1.0, 0.716: 0.5}, [0.616]),  # trapped sound behind it
        ({0.616: 1.0, 0.716: 2.5}, [0.616, 0.716]),  # too high for that
        ({0.616: 1.0, 0.816: 0.08}, [0.616, 0.816]),  # another press
        ({0.6: 1.0, 0.8: 0.3, 1.01: 0.1}, [0.6, 0.8]),  # 2 x 0.8 - 0.6, a repeated reflection
        ({0.6: 1.0, 0.8: 0.1, 1.01: 0.2}, [0.6, 0.8, 1.01]),  # higher than the reflected one
        ({0.6: 1.0, 0.8: 0.3, 1.1: 0.1}, [0.6, 0.8, 1.1]),
        ({np.nan: 1.0}, []),
        ({-np.inf: 1.0, 0.6: 1.0, 0.9: 1.0, np.inf: 1.0}, [0.6, 0.9]),  # no places
        ({0.5: 1.0, 0.6: np.nan, 1.2: 1.0}, [0.5, 1.2]),  # no height
    ],
)
def test_ghost_echoes_are_removed(echoes, own):
    places, heights = np.array(list(echoes)), np.array(list(echoes.values()))
    for order in (slice(None), slice(None, None, -1)):
        np.testing.assert_allclose(remove_ghost_echoes(places[order], heights[order]), own)


def test_what_cannot_be_followed_is_refused():
    tracker = ContactTracker()
    refused(lambda: tracker.update(np.nan, [0.5]), setting="time")
    tracker.update(1.0, [0.5, np.nan])
    refused(lambda: tracker.update(1.0, [0.5]), setting="time", value=1.0)
    with pytest.raises(ConfigError, match="length between the sensors"):
        tracker.update(2.0, [], [0.4])
    refused(lambda: TrackingSettings(deviation=0), setting="deviation", value=0)


def test_swipe_beside_a_press_is_followed_from_raw_cycles():
    """Cycles at 200 kHz are processed like recordings, and their candidates are tracked."""
    random = np.random.default_rng(6)
    at = np.arange(4000) / 200e3
    pulse, c = Pulse(frequency=42e3, cycles=11), sound_speed(20.0)
    cycles, press = 60, 0.7
    swipe = 0.9 + 0.05 * CYCLE * np.arange(cycles)
    stage, tracker = signals.Tracker(at, Processing(prominence=0.02)), ContactTracker()
    found = []
    for i, place in enumerate(swipe):
        echoes = sum(0.1 * pulse(at - 2 * d / c) for d in (press, place))
        cycle = pulse(at) + echoes + 0.01 * random.standard_normal(len(at))
        ranging = stage.update(cycle)
        candidates = signals.distance(ranging.echoes.times - ranging.send_time, 20.0)
        found.append(tracker.update(CYCLE * i, candidates))
    last = found[-1]
    for true, speed in ((press, 0.0), (swipe[-1], 0.05)):
        i = np.argmin(np.abs(last.place - true))
        assert last.place[i] == pytest.approx(true, abs=0.02)
        assert last.speed[i] == pytest.approx(speed, abs=0.02)
    numbers = {tuple(cycle.number.tolist()) for cycle in found[10:]}
    assert len(numbers) == 1
