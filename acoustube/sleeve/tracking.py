"""Tracking of several contacts over cycles, from the candidate echoes of one or both ends.

Each contact has a place and a speed along one coordinate: the distance along the tube or, where a
hand swipes across loops, the height along the arm. Candidates are assigned to contacts so that the
sum of squared distances, in standard deviations, is least; pairs beyond a gate are not assigned
(global nearest neighbour). A candidate outside all gates starts a tentative contact, which is
confirmed after a number of detections and deleted after a number of misses.

References
----------
Bar-Shalom, Y., Li, X. R. and Kirubarajan, T. (2001). Estimation with Applications to Tracking and
Navigation. Wiley. doi:10.1002/0471221279 (sections 6.2.2 and 6.3.2: white noise acceleration)

Blackman, S. and Popoli, R. (1999). Design and Analysis of Modern Tracking Systems. Artech House
(chapter 6: global nearest neighbour, gates, M of N).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment

from acoustube.base.checks import LENGTH, Instance, Optional, check_argument, check_fields
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array

TIME = Number(-1e12, 1e12, "s")
"""Rule for the time of a cycle, which may be that of a clock."""


@dataclass(frozen=True, kw_only=True)
class TrackingSettings:
    """Settings of the contact tracker.

    Parameters
    ----------
    deviation : float
        Standard deviation of a candidate's place in m.
    acceleration : float
        Standard deviation of a contact's acceleration, which is constant between cycles, in m/s2.
    speed : float
        Standard deviation of a contact's initial speed, in m/s.
    gate : float
        Distance of a candidate from a contact's predicted place, in standard deviations of this
        distance, beyond which the candidate is not assigned to the contact.
    hits : int
        Number of cycles with an assigned candidate after which a contact is confirmed.
    misses : int
        Number of consecutive cycles without a candidate after which a contact is deleted; a
        tentative one is deleted after two.

    Raises
    ------
    ConfigError
        If a setting is not positive, or `hits` or `misses` is not a whole number.
    """

    deviation: float = 0.01
    acceleration: float = 0.5
    speed: float = 0.1
    gate: float = 4.0
    hits: int = 4
    misses: int = 8

    def __post_init__(self) -> None:
        positive, count = Number(1e-9, 1e6), Number(1, 1e9, "cycles", whole=True)
        check_fields(
            self, deviation=positive, acceleration=positive, speed=positive, gate=positive,
            hits=count, misses=count,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Contacts:
    """The contacts of one cycle, in order of their numbers.

    Attributes
    ----------
    number : ndarray of int
        (n,), from 0, in the order of confirmation; numbers are not reused.
    place, speed : ndarray
        In m and m/s, (n,).
    deviation : ndarray
        Standard deviation of the places in m, (n,).
    """

    number: NDArray[np.int64]
    place: Array
    speed: Array
    deviation: Array


class ContactTracker:
    """Track contacts through a stream of cycles.

    Parameters
    ----------
    settings : TrackingSettings, optional
    length : float, optional
        Distance in m between the sensors at both ends, which converts distances from the far sensor
        to places from the near one; required for candidates of a far end.

    Notes
    -----
    Each contact has a Kalman filter; the states of all contacts are kept in arrays. The two ends
    are processed in turn: a contact hidden behind another from one end is still tracked by the
    other end. A candidate within the gate of a contact that has a nearer candidate is taken for a
    ripple of the same echo: two presses are resolved only if they are farther apart than the gate,
    4 cm or more for a deviation of 1 cm.
    """

    def __init__(self, settings: TrackingSettings | None = None, *, length: float | None = None):
        check_argument("settings", settings, Optional(Instance((TrackingSettings,))))
        check_argument("length", length, Optional(LENGTH))
        self.settings = settings or TrackingSettings()
        self.length = length
        self._time: float | None = None
        self._begun = 0
        self._number = np.empty(0, np.int64)
        self._state = np.empty((0, 2))
        self._covariance = np.empty((0, 2, 2))
        self._hits = np.empty(0, np.int64)
        self._misses = np.empty(0, np.int64)

    def update(self, time: float, near: ArrayLike, far: ArrayLike = ()) -> Contacts:
        """Update the contacts with a cycle's candidates.

        Parameters
        ----------
        time : float
            Time of the cycle in s, later than that of the previous cycle.
        near : array_like
            Places of the near sensor's candidates in m, any number of them; nan is ignored.
        far : array_like
            Distances of the far sensor's candidates in m, from the far sensor; nan is ignored.

        Returns
        -------
        Contacts
            The confirmed contacts.

        Raises
        ------
        ConfigError
            If the time is not finite or does not increase, or the far end has candidates and no
            length was given.
        """
        time = check_argument("time", time, TIME)
        near, far = (_candidates(values) for values in (near, far))
        if len(far) and self.length is None:
            raise ConfigError("far candidates need the length between the sensors; give length")
        self._predict(time)
        detected = self._take_in(near)
        if len(far):
            assert self.length is not None
            # A far candidate may be assigned to a contact that a near one has just started.
            both = self._take_in(self.length - far)
            both[: len(detected)] |= detected
            detected = both
        self._hits += detected
        self._misses = np.where(detected, 0, self._misses + 1)
        confirmed = self._hits >= self.settings.hits
        self._keep(self._misses < np.where(confirmed, self.settings.misses, 2))
        return self._confirmed()

    def _predict(self, time: float) -> None:
        """Predict the contacts at a time (Kalman prediction)."""
        if self._time is not None and not time > self._time:
            raise ConfigError(
                f"does not follow {self._time:g} s", setting="time", value=time, unit="s",
                advice="times must increase",
            )  # fmt: skip
        step = 0.0 if self._time is None else time - self._time
        self._time = time
        transition = np.array([[1.0, step], [0.0, 1.0]])
        noise = np.array([0.5 * step**2, step]) * self.settings.acceleration
        self._state = self._state @ transition.T
        self._covariance = transition @ self._covariance @ transition.T + np.outer(noise, noise)

    def _take_in(self, places: Array) -> NDArray[np.bool_]:
        """Update contacts by candidates, start new ones, and return a mask of contacts detected."""
        variance = self._covariance[:, 0, 0] + self.settings.deviation**2
        away = places - self._state[:, :1]
        squares = away**2 / variance[:, None]
        # Costs beyond the gate are equal, so that no pair within the gate is given up for them.
        outside = self.settings.gate**2
        rows, columns = linear_sum_assignment(np.minimum(squares, outside))
        inside = squares[rows, columns] < outside
        rows, columns = rows[inside], columns[inside]
        gain = self._covariance[rows, :, 0] / variance[rows, None]
        self._state[rows] += gain * away[rows, columns, None]
        self._covariance[rows] -= gain[:, :, None] * self._covariance[rows, :1, :]
        detected = np.zeros(len(self._state), bool)
        detected[rows] = True
        # A further candidate near a contact that has one is a ripple of the same echo.
        beside = np.any(squares < outside, axis=0)
        new = places[~beside]
        self._begin(new)
        return np.concatenate([detected, np.ones(len(new), bool)])

    def _begin(self, places: Array) -> None:
        n = len(places)
        start = np.diag([self.settings.deviation**2, self.settings.speed**2])
        self._number = np.concatenate([self._number, np.full(n, -1)])
        self._state = np.concatenate([self._state, np.stack([places, 0 * places], axis=1)])
        self._covariance = np.concatenate([self._covariance, np.tile(start, (n, 1, 1))])
        self._hits = np.concatenate([self._hits, np.zeros(n, np.int64)])
        self._misses = np.concatenate([self._misses, np.zeros(n, np.int64)])

    def _keep(self, kept: NDArray[np.bool_]) -> None:
        for name in ("_number", "_state", "_covariance", "_hits", "_misses"):
            setattr(self, name, getattr(self, name)[kept])

    def _confirmed(self) -> Contacts:
        """Return the confirmed contacts, and number newly confirmed ones."""
        confirmed = self._hits >= self.settings.hits
        fresh = np.flatnonzero(confirmed & (self._number < 0))
        self._number[fresh] = self._begun + np.arange(len(fresh))
        self._begun += len(fresh)
        order = np.flatnonzero(confirmed)[np.argsort(self._number[confirmed])]
        return Contacts(
            number=self._number[order],
            place=self._state[order, 0],
            speed=self._state[order, 1],
            deviation=np.sqrt(self._covariance[order, 0, 0]),
        )


def _candidates(values: ArrayLike) -> Array:
    """Return candidates as a 1-D array, without values that are not finite."""
    row = np.asarray(values, float).ravel()
    return row[np.isfinite(row)]
