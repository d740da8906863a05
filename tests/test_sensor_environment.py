"""The gymnasium environment of the fast sensor; without the package, one sentence."""

import sys

import numpy as np
import pytest
from test_inversion import tool

from acoustube.base.errors import ConfigError
from acoustube.inversion import Library
from acoustube.sensor import TubeSensor, environment
from acoustube.sensor.environment import PressAtPlace


@pytest.fixture(scope="module")
def sensor():
    return TubeSensor(Library((tool(0.5e-3),)), length=1.5, most_contacts=1)


def test_without_the_package_the_sentence_names_the_extra(sensor, monkeypatch):
    monkeypatch.setattr(environment, "gymnasium", None)
    with pytest.raises(ConfigError, match=r"gymnasium; run pip install 'acoustube\[robot\]'"):
        PressAtPlace(sensor)


def test_gymnasium_accepts_the_environment(sensor):
    pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    check_env(PressAtPlace(sensor), skip_render_check=True)
    assert "gymnasium" in sys.modules


def test_finger_that_goes_to_the_goal_ends_the_episode_there(sensor):
    pytest.importorskip("gymnasium")
    world = PressAtPlace(sensor, reach=(0.4, 1.2))
    _, info = world.reset(seed=3, options={"goal": (1.0, 20.0)})
    most = np.array([environment.LONGEST_MOVE, environment.LARGEST_CHANGE * world.largest])
    rewards = []
    for _ in range(environment.LONGEST_EPISODE):
        action = (np.array([1.0, 20.0]) - (info["place"], info["force"])) / most
        seen, reward, reached, late, info = world.step(np.clip(action, -1, 1))
        assert world.observation_space.contains(seen)
        rewards.append(reward)
        if reached or late:
            break
    assert reached
    assert abs(info["place"] - 1.0) < environment.NEAR
    assert info["depth"] == pytest.approx(sensor.depth_of(info["force"]))
    assert rewards[-1] > rewards[0]
    # The library's force is 2e6 N/m2 times the depth squared, 98 N at 7 mm.
    assert world.largest == pytest.approx(98, rel=1e-6)


def test_observation_is_the_cycle_of_the_contact_with_its_noise(sensor):
    pytest.importorskip("gymnasium")
    world = PressAtPlace(sensor)
    first, _ = world.reset(seed=5)
    again, info = world.reset(seed=5)
    assert np.array_equal(first["cycle"], again["cycle"])
    counts = again["cycle"] * 2**sensor.rangefinder.bits
    assert np.allclose(counts, np.rint(counts), atol=1e-3)
    from acoustube.sensor import Contact

    quiet = sensor.read([Contact(place=info["place"], force=info["force"])])
    drift = np.median(counts[1500:] - quiet[1500:])
    assert np.std((counts - quiet)[1500:] - drift) < 1.0


def test_nonsense_is_named(sensor):
    pytest.importorskip("gymnasium")
    for reach in ((0.4,), (0.4, 0.8, 1.2), "ab"):
        with pytest.raises(ConfigError, match="reach"):
            PressAtPlace(sensor, reach=reach)
    world = PressAtPlace(sensor)
    with pytest.raises(ConfigError, match="goal"):
        world.reset(seed=0, options={"goal": [np.nan, 1.0]})
    world.reset(seed=0)
    for action in (np.full(2, np.nan), np.zeros(3), None):
        with pytest.raises(ConfigError, match="action"):
            world.step(action)


def test_reach_beyond_the_tube_is_refused(sensor):
    pytest.importorskip("gymnasium")
    with pytest.raises(ConfigError, match="is not on the tube"):
        PressAtPlace(sensor, reach=(0.4, 1.6))
    two = Library((tool(0.5e-3, diameter=10e-3), tool(0.5e-3)))
    with pytest.raises(ConfigError, match="several indenters"):
        PressAtPlace(TubeSensor(two, length=1.5, most_contacts=1))
