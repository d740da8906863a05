"""A wrapped tube with presses in a cascade: against one bend, and against a straight tube."""

import numpy as np
import pytest

from acoustube.air import air_at
from acoustube.base.errors import ConfigError
from acoustube.sleeve import Helix, winding, wrapped
from acoustube.tube import Tube
from acoustube.waves import Bent, PlacedScatterer, cut_on_frequency, joined_bends, transfer
from acoustube.waves.scattering import ModalScattering

AIR, BORE, REACH = air_at(20.0), 3.95e-3, 0.03
BAND = np.arange(39e3, 45.05e3, 100.0)
INSIDE = BAND[20:-20]
MODES = ("00", "11c")
FOREARM = Helix(radius=0.04, taper=0.03, length=0.14, loops=4, lead=0.15)


def press(position, reflection=0.0):
    """Return a press that reflects a share of both modes and lets the rest of the power pass."""
    n = len(MODES)
    through = 1j * np.sqrt(1 - reflection**2) if reflection else 1.0
    s = np.zeros((len(BAND), 2, n, 2, n), complex)
    for i in range(n):
        s[:, :, i, :, i] = [[reflection, through], [through, reflection]]
    return PlacedScatterer(
        ModalScattering(
            frequency=BAND,
            modes=MODES,
            s=s,
            propagates=np.ones((len(BAND), n), bool),
            cut_ons=np.array([0.0, cut_on_frequency(1, 1, BORE, AIR.sound_speed)]),
            sound_speed=AIR.sound_speed,
            extent=(-0.08, 0.08),
        ),
        position,
    )


def passed(presses, probe, length=1.4):
    return transfer(
        presses, AIR, INSIDE, radius=BORE, length=length, probes=(probe,), source_reflection=0.0
    )[0]


def test_pieces_fill_the_wrap_but_for_what_the_presses_keep_straight():
    presses = [press(0.4), press(0.9)]
    pieces = wrapped(FOREARM, presses, AIR, radius=BORE, reach=REACH)
    pieces.sort(key=lambda piece: piece.position)
    spans = np.array([p.position + np.array(p.scattering.extent) for p in pieces])
    assert spans[0, 0] == pytest.approx(FOREARM.lead, abs=1e-8)
    assert spans[-1, 1] == pytest.approx(FOREARM.tube_length, abs=1e-8)
    assert spans[1:, 0] - spans[:-1, 1] == pytest.approx(0, abs=1e-8)
    kept = [p for p in pieces if p.position in (0.4, 0.9)]
    assert [p.scattering.extent for p in kept] == [(-REACH, REACH)] * 2
    assert all(np.ptp(span) < 0.27 for span in spans)


def test_arm_that_is_hardly_curved_is_a_straight_tube():
    """A radius of 40 m: what it converts is under 1e-6 of the power."""
    wide = Helix(radius=40.0, length=1e-3, loops=0.004, lead=0.15)
    echo = [press(0.5, 0.3)]
    bent = wrapped(wide, echo, AIR, radius=BORE, reach=REACH)
    assert len(bent) == 3
    assert passed(bent, 0.05) == pytest.approx(passed(echo, 0.05), abs=1e-3)


def test_loops_in_a_row_pass_the_plane_wave_as_one_bend_does():
    """Within 2 %: what torsion puts into (1,1) of the other symmetry is dropped after each loop."""
    even = Helix(radius=0.04, length=0.105, loops=3)
    n, step = 3, even.tube_length / 3
    curvature, torsion = (float(value) for value in even.bend(0.0))
    pieces = winding(even, AIR, BAND, 0.0, even.tube_length, radius=BORE, modes=MODES)
    part = Bent(length=n * step, curvature=curvature, torsion=torsion)
    whole = joined_bends(AIR, BAND, [part], radius=BORE, modes=MODES, highest=8.0)
    assert len(pieces) == n
    at = even.tube_length + 0.01
    there = passed([PlacedScatterer(whole, even.tube_length / 2 + 1e-6)], at)
    here = passed([PlacedScatterer(p.scattering, p.position + 1e-6) for p in pieces], at)
    assert np.abs(here - there).max() < 0.02 * np.abs(there).max()


def test_flattened_tube_converts_less():
    """The cut-on of (1,1) rises, and its wavenumber moves away from the plane wave's."""
    sizes = {"radius": BORE, "modes": MODES}
    power = [
        max(
            np.abs(found[0].scattering.s[0, 1, 1, 0, 0]) ** 2
            for stop in np.linspace(0.16, 0.25, 10)
            for found in [winding(FOREARM, AIR, [42e3], 0.15, stop, tube=tube, **sizes)]
        )
        for tube in (None, Tube())
    ]
    assert power[1] < 0.8 * power[0]


@pytest.mark.parametrize(
    ("presses", "words"),
    [
        ([], "no press gives the frequency band"),
        ([0.4, 0.45], "40, 45 cm are nearer to each other"),
        ([0.17], "15 to 14 cm is not part"),
        ([1.4], "is not part of a tube wound from 15 to"),
    ],
)
def test_presses_that_cannot_be_on_the_wrap_are_refused(presses, words):
    with pytest.raises(ConfigError, match=words):
        wrapped(FOREARM, [press(p) for p in presses], AIR, radius=BORE, reach=REACH)
