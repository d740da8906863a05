"""A wrapped tube with presses, as a cascade: against one bend and against a straight tube."""

import numpy as np
import pytest

from acoustube.air import air_at
from acoustube.base.errors import ConfigError
from acoustube.sleeve import Helix, between_bends, winding, with_antisymmetric, wrapped
from acoustube.tube import Tube
from acoustube.waves import (
    Bent,
    PlacedScatterer,
    axial_wavenumber,
    cut_on_frequency,
    joined_bends,
    transfer,
)
from acoustube.waves.interpolation import interpolate_scattering
from acoustube.waves.scattering import ModalScattering

AIR, BORE, REACH = air_at(20.0), 3.95e-3, 0.03
BAND = np.arange(39e3, 45.05e3, 100.0)
INSIDE = BAND[20:-20]
MODES = ("00", "11c")
FOREARM = Helix(radius=0.04, taper=0.03, length=0.14, loops=4, lead=0.15)


def press(position, reflection=0.0):
    """Return a press that reflects a share of both modes and transmits the rest of the power."""
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
    assert [p.scattering.extent for p in kept] == [pytest.approx((-REACH, REACH), abs=1e-8)] * 2
    assert len(pieces) == 5


@pytest.mark.parametrize("places", [(0.64, 0.7), (0.5, 0.56)])
def test_presses_may_be_twice_the_reach_apart(places):
    """6 cm, which differ from 2 x 3 cm by rounding: 0.70 - 0.64 is less than 0.06."""
    pieces = wrapped(FOREARM, [press(p) for p in places], AIR, radius=BORE, reach=REACH)
    assert len(pieces) == 4
    assert np.all(np.isfinite(passed(pieces, 0.05)))


def test_arm_that_is_hardly_curved_is_a_straight_tube():
    """The radius is 40 m: under 1e-6 of the power is converted."""
    wide = Helix(radius=40.0, length=1e-3, loops=0.004, lead=0.15)
    echo = [press(0.5, 0.3)]
    bent = wrapped(wide, echo, AIR, radius=BORE, reach=REACH)
    assert len(bent) == 3
    assert passed(bent, 0.05) == pytest.approx(passed(echo, 0.05), abs=1e-3)


@pytest.mark.parametrize("step", [100.0, 300.0])
def test_wrap_of_a_metre_is_known_between_its_frequencies(step):
    """Interpolated over steps as of presses, against bends computed at the frequencies.

    The reference has parts a third as long, and modes of larger wavenumbers. With the half turns of
    constant curvature that were used before, mode conversion is off by 5e-3.
    """
    stop, at = FOREARM.tube_length, FOREARM.tube_length + 1e-6
    f = np.sort(np.random.default_rng(2).uniform(36e3, 48e3, 25))
    edges = np.linspace(FOREARM.lead, stop, 221)
    parts = [
        Bent(length=edges[1] - edges[0], curvature=float(curvature), torsion=float(torsion))
        for curvature, torsion in zip(
            *FOREARM.bend(FOREARM.height((edges[1:] + edges[:-1]) / 2)), strict=True
        )
    ]
    names = with_antisymmetric(MODES)
    there = joined_bends(AIR, f, parts, radius=BORE, modes=names, highest=8.0).s
    band = np.arange(28e3, 56.05e3, step)
    bent = winding(FOREARM, AIR, band, FOREARM.lead, stop, radius=BORE, modes=names)
    here = interpolate_scattering(bent.scattering, f)
    assert stop - FOREARM.lead > 1.0
    off = np.abs(here - there)
    assert np.sqrt(np.mean(off[:, 1, 0, 0, 0] ** 2)) < 1e-4
    assert off[:, 1, 1, 0, 0].max() < 1e-3
    assert off.max() < (1e-3 if step == 100.0 else 6e-3)
    # As the sound of a tube, between both ends of the wrap.
    ends = axial_wavenumber(0, 0, f, BORE, AIR, lossy=True) * (FOREARM.lead + 1e-6)
    sound = transfer(
        [bent], AIR, f, radius=BORE, length=at + 0.3, probes=(at,), source_reflection=0
    )
    assert sound[0] == pytest.approx(here[:, 1, 0, 0, 0] * np.exp(-1j * ends), abs=1e-6)


def test_wrap_is_interpolated_relative_to_its_plane_wave():
    """Between frequencies 100 Hz apart, against the same bends computed there.

    Were the delay of 3.1 ms, in a period of 10 ms, interpolated too, the plane wave would be off by
    2e-3.
    """
    names = with_antisymmetric(MODES)
    here, there = (
        winding(FOREARM, AIR, f, FOREARM.lead, FOREARM.tube_length, radius=BORE, modes=names)
        for f in (np.arange(28e3, 56.05e3, 100.0), np.arange(36.05e3, 48e3, 100.0))
    )
    found = interpolate_scattering(here.scattering, there.scattering.frequency)
    off = np.abs(found - there.scattering.s)
    assert off[:, 1, 0, 0, 0].max() < 1e-4
    assert off.max() < 1e-3


def test_antisymmetric_modes_pass_a_symmetric_press():
    found = between_bends(press(0.4, 0.3), REACH).scattering
    assert found.modes == ("00", "11c", "11s")
    assert found.s[:, :, :2, :, :2] == pytest.approx(press(0.4, 0.3).scattering.s)
    eye = np.broadcast_to(np.eye(2)[::-1], (len(BAND), 2, 2))
    assert found.s[:, :, 2, :, 2] == pytest.approx(eye)
    assert np.abs(found.s[:, :, 2, :, :2]).max() == np.abs(found.s[:, :, :2, :, 2]).max() == 0


def test_flattened_tube_converts_less():
    """The cut-on of (1,1) rises, and its wavenumber moves away from the plane wave's."""
    sizes = {"radius": BORE, "modes": MODES}
    power = [
        max(
            np.abs(winding(FOREARM, AIR, [42e3], 0.15, stop, tube=tube, **sizes).scattering.s)[
                0, 1, 1, 0, 0
            ]
            ** 2
            for stop in np.linspace(0.16, 0.25, 10)
        )
        for tube in (None, Tube())
    ]
    assert power[1] < 0.8 * power[0]


@pytest.mark.parametrize(
    ("presses", "words"),
    [
        ([], "there is no press"),
        ([0.4, 0.45], "40, 45 cm are nearer to each other"),
        ([0.17], "15 to 14 cm is not part"),
        ([1.4], "is not part of a tube wound from 15 to"),
    ],
)
def test_presses_that_cannot_be_on_the_wrap_are_refused(presses, words):
    with pytest.raises(ConfigError, match=words):
        wrapped(FOREARM, [press(p) for p in presses], AIR, radius=BORE, reach=REACH)
