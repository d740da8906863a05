"""Candidates for presses: the correlation behind a press, and the selection of maxima."""

import dataclasses

import numpy as np
import pytest
from test_inversion import MODES, RADIUS, tool

from acoustube.inversion import Baseband, ForwardModel, Library, search
from acoustube.inversion.likelihood import weights
from acoustube.inversion.parameters import CLOSEST
from acoustube.inversion.peeling import leading_edge
from acoustube.inversion.search import Templates, apart, exclude, front_of, separate
from acoustube.ranging import Rangefinder

FIRST, SECOND = (0.4, 2.5e-3), (0.53, 4.1e-3)
"""Places and depths of two presses in m."""
COUPLING = 6.0
"""Factor by which the coupling of plane and higher modes is stronger than in other tests."""


@pytest.fixture(scope="module")
def model():
    base = Baseband(Rangefinder(), RADIUS, 1.0, 20.0, MODES)
    one = tool(0.5e-3)
    s = one.s.copy()
    s[..., 0, :, 1:] *= COUPLING
    s[..., 1:, :, 0] *= COUPLING
    return ForwardModel(Library((dataclasses.replace(one, s=s),)), base)


def baseband(model, *presses):
    places, depths = np.array(presses).T[:, None]
    return model.baseband((0,) * len(presses), places, depths, np.zeros((1, 7)))[0][0]


def test_press_behind_another_is_the_best_candidate_with_a_right_gain(model):
    """The decrease of the squared residual by a candidate cannot exceed the residual.

    This holds if the energies of the templates, which beat behind a press, are right. With energies
    every 15 cm the ratio would be 1.05.
    """
    rest = baseband(model, FIRST, SECOND) - baseband(model, FIRST)
    whiten = weights(model, 1e-4 * np.abs(rest).max() ** 2, 0.0, None)
    fronts = front_of(model, (0,), np.array([FIRST[0]]), np.array([FIRST[1]]), np.zeros(7))
    found = Templates(model, 0).search(rest, whiten, fronts)
    total = 2 * np.sum(np.abs(whiten(rest)) ** 2)
    assert found.gain[0] < 1.02 * total
    assert found.gain[0] > 0.8 * total  # multiple reflections between the two are left out
    assert abs(found.place[0] - SECOND[0]) < 0.5e-3
    assert abs(found.depth[0] - SECOND[1]) < 0.2e-3
    assert np.all(np.abs(found.place - FIRST[0]) > CLOSEST)
    rounded = np.round([found.place / 1e-5, found.depth / 1e-5])
    assert np.unique(rounded, axis=1).shape == rounded.shape


@pytest.mark.parametrize("off", [-9, -5, 5, 9])
def test_press_beside_a_kept_coarse_place_is_a_candidate(model, monkeypatch, off):
    """A kept coarse place excludes others up to 30 mm away, and the press may be one of them."""
    rest = baseband(model, FIRST, SECOND) - baseband(model, FIRST)
    fronts = front_of(model, (0,), np.array([FIRST[0]]), np.array([FIRST[1]]), np.zeros(7))
    whiten = weights(model, 1e-4 * np.abs(rest).max() ** 2, 0.0, None)
    monkeypatch.setattr(search, "apart", lambda gain, *_: [int(np.argmax(gain)) + off])
    found = Templates(model, 0).search(rest, whiten, fronts)
    assert abs(found.place[0] - SECOND[0]) < 0.5e-3
    assert abs(found.depth[0] - SECOND[1]) < 0.2e-3


def test_leading_edge_is_that_of_the_first_echo_and_not_of_its_ringing_before():
    step = 1e-4
    level = np.full(80, 0.8)
    assert leading_edge(level, step) is None
    level[30:36] = 300.0
    level[26:30] = 8.0  # above the noise, and small beside the echo that follows
    level[55:60] = 3000.0
    assert leading_edge(level, step) in (28, 29, 30)


def test_places_of_highest_gains_are_apart_and_maxima_separate():
    places, depths = np.arange(0.3, 0.6, 1e-3), np.arange(1e-3, 5e-3, 0.25e-3)
    off = (depths[:, None] - 3e-3) / 0.3e-3, (places - 0.40) / 2e-3
    gain = 10 * np.exp(-(off[0] ** 2) - off[1] ** 2)
    gain += 5 * np.exp(-(((places - 0.50) / 2e-3) ** 2)) - 0.01
    gain[3, 250] = 100.0
    exclude(gain, places, [places[250]], np.full(len(places), True))
    first, second = apart(gain.max(axis=0), places, 2)
    assert places[[first, second]] == pytest.approx([0.40, 0.50], abs=1e-9)
    maxima = separate(gain.copy(), places, depths, 3)
    assert maxima[0][1:] == pytest.approx((0.40, 3e-3))
    assert all(
        abs(a[1] - b[1]) > 1.5e-3 or abs(a[2] - b[2]) > 0.5e-3
        for i, a in enumerate(maxima) for b in maxima[:i]
    )  # fmt: skip
