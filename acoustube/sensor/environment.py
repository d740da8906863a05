"""Gymnasium environment: press a tube at a given place and force, observing its cycles alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.base.checks import Optional, Reals, check_argument, checked
from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.sensor.contacts import HALF_PRESS, Contact
from acoustube.sensor.tube_sensor import TubeSensor

try:
    import gymnasium
except ImportError:
    gymnasium = None

LONGEST_MOVE, LARGEST_CHANGE = 0.02, 0.05
"""Largest move of the finger in a step, in m, and largest change of its force, relative to the
largest force."""
NEAR, ALIKE = 5e-3, 0.05
"""Distance in m, and difference of force relative to the largest force, below both of which the
goal is reached."""
LONGEST_EPISODE = 200
"""Number of steps after which an episode is truncated."""


class PressAtPlace(gymnasium.Env if gymnasium else object):  # type: ignore[misc]
    """Gymnasium environment: press a tube at a given place and force, observing its cycles alone.

    Parameters
    ----------
    sensor : TubeSensor
        Sensor whose library has one tool, which is the finger.
    reach : tuple of float, optional
        Nearest and farthest place in m; by default the part of the sensor's ``span`` from 0.3 m to
        :data:`acoustube.sensor.contacts.HALF_PRESS` before its end.

    Attributes
    ----------
    action_space : gymnasium.spaces.Box
        Move along the tube and change of the force, each from -1 to 1, in units of
        :data:`LONGEST_MOVE` and :data:`LARGEST_CHANGE`.
    observation_space : gymnasium.spaces.Dict
        ``cycle``, the counts divided by full scale, (n_samples,) from 0 to 1; ``goal``, the place
        and the force to be reached, as fractions of their ranges from 0 to 1.

    Raises
    ------
    ConfigError
        If gymnasium is missing, the sensor's library has several tools, or `reach` is not within
        the sensor's ``span``.

    Notes
    -----
    The reward of a step is minus the sum of the distance to the goal in units of 10 cm and the
    difference of force relative to the largest force. An episode ends at the goal, and is truncated
    after :data:`LONGEST_EPISODE` steps. ``info`` holds the true contact: ``place`` in m, ``force``
    in N, ``depth`` in m.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    @checked(sensor=TubeSensor, reach=Optional(Reals(0, 1e3, "m", ndim=1, last=2)))
    def __init__(self, sensor: TubeSensor, reach: tuple[float, float] | None = None) -> None:
        if gymnasium is None:
            raise ConfigError(
                "the environment needs the package gymnasium; run pip install 'acoustube[robot]'"
            )
        if len(sensor.tables.diameters) > 1:
            raise ConfigError(
                "the library has several indenters; give the sensor that of the finger"
            )
        nearest, farthest = sensor.span
        middle = (nearest + farthest) / 2
        usual = float(np.clip(0.3, nearest, middle)), max(farthest - HALF_PRESS, middle)
        low, high = (float(one) for one in (usual if reach is None else reach))
        if not nearest <= low < high <= farthest:
            raise ConfigError(
                "is not on the tube", setting="reach", value=str((low, high)),
                advice=f"use {nearest:g} to {farthest:g} m, rising",
            )  # fmt: skip
        self.sensor, self.reach = sensor, (low, high)
        self.largest = float(sensor.tables.forces[0][np.isfinite(sensor.tables.forces[0])][-1])
        box = gymnasium.spaces.Box
        self.action_space = box(-1.0, 1.0, (2,), np.float32)
        cycle = box(0.0, 1.0, (sensor.rangefinder.n_samples,), np.float32)
        self.observation_space = gymnasium.spaces.Dict(
            {"cycle": cycle, "goal": box(0.0, 1.0, (2,), np.float32)}
        )
        self.state, self.goal, self.noise, self.steps = np.zeros(2), np.zeros(2), 0, 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, float]]:
        """Start an episode at a random place and force; return first observation and ``info``.

        Parameters
        ----------
        seed : int, optional
            Seed of all random numbers.
        options : dict, optional
            ``goal``: place in m and force in N; by default at random.

        Raises
        ------
        ConfigError
            If the goal is not two non-negative numbers.
        """
        super().reset(seed=seed)
        low, high = [self.reach[0], 0.1 * self.largest], [self.reach[1], 0.9 * self.largest]
        self.state, self.goal = self.np_random.uniform(low, high, (2, 2))
        if options and "goal" in options:
            check_argument("goal", options["goal"], Reals(0, 1e9, "m and N", ndim=1, last=2))
            self.goal = np.asarray(options["goal"], float)
        self.noise, self.steps = int(self.np_random.integers(2**31)), 0
        return self._observed(), self._contact()

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[dict[str, NDArray[np.float32]], float, bool, bool, dict[str, float]]:
        """Take a step; return observation, reward, whether at goal, whether truncated, ``info``.

        Parts of the action outside -1 to 1 are clipped.

        Raises
        ------
        ConfigError
            If the action is not two numbers.
        """
        check_argument("action", action, Reals(ndim=1, last=2))
        most = np.array([LONGEST_MOVE, LARGEST_CHANGE * self.largest])
        moved = self.state + most * np.clip(np.asarray(action, float), -1, 1)
        self.state = np.clip(moved, [self.reach[0], 0.0], [self.reach[1], self.largest])
        self.steps += 1
        distance, difference = np.abs(self.state - self.goal) / (1.0, self.largest)
        reward = -float(distance / 0.1 + difference)
        reached = bool(distance < NEAR and difference < ALIKE)
        return (
            self._observed(), reward, reached, self.steps >= LONGEST_EPISODE, self._contact()
        )  # fmt: skip

    def _observed(self) -> dict[str, NDArray[np.float32]]:
        place, force = self.state
        r = self.sensor.rangefinder
        contact = Contact(place=float(place), force=float(force))
        counts = self.sensor.read([contact], cycle=self.steps, seed=self.noise)
        return {
            "cycle": np.clip(counts / 2.0**r.bits, 0, 1).astype(np.float32),
            "goal": np.clip(self._shares(self.goal), 0, 1).astype(np.float32),
        }

    def _shares(self, state: Array) -> Array:
        low, high = self.reach
        return np.array([(state[0] - low) / (high - low), state[1] / self.largest])

    def _contact(self) -> dict[str, float]:
        place, force = map(float, self.state)
        return {"place": place, "force": force, "depth": self.sensor.depth_of(force)}
