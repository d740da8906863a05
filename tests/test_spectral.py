"""Scattering by the spectral solver, against an independent solution and closed forms."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from refusals import refused

from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.waves import Scattering, axial_wavenumber, spectral
from acoustube.waves.scattering import ModalScattering
from acoustube.waves.spectral import boundary, first_basis, layers, solver
from acoustube.waves.spectral.band import swept
from acoustube.waves.spectral.discretisation import discretise, respond
from acoustube.waves.spectral.ports import axial_wavenumbers, changed_scattering, scattering_of
from acoustube.waves.spectral.quadrature import axial_rule
from acoustube.waves.spectral.reduction import ritz

RADIUS = 3.95e-3
AIR = Air(sound_speed=343.2, density=1.204)
CASES = {"A": (0.30, 12e-3), "E": (0.40, 8e-3)}
KIRCHHOFF = 0.533286, 1.07123, 1.57711, 1.91734
"""Attenuation in Np/m of the plane mode at 5, 20, 42 and 60 kHz in a bore of 3.95 mm radius."""
REFERENCE = Path(__file__).parent / "data" / "spectral_reference.csv"
"""File of an independent spectral solution with exact modal ends, which agrees with quintic finite
elements (NGSolve) to 3e-7; frequencies above 8 kHz, including all cut-ons."""


def shape(case, turned=0.0, deeper=0.0):
    """Lumens A (flattened from above) and E (narrowed all round), turned about the axis."""
    h, w = CASES[case]
    h = h + deeper
    c, s = np.cos(turned), np.sin(turned)

    def lines(z, t):
        inside = np.abs(z) < w
        f = h * np.where(inside, 0.5 * (1 + np.cos(np.pi * z / w)), 0.0)
        f_z = h * np.where(inside, -0.5 * np.pi / w * np.sin(np.pi * z / w), 0.0)
        x, y = RADIUS * np.sin(t), -RADIUS * np.cos(t)
        if case == "A":
            moved = x * (1 + 0.45 * f), (y + RADIUS) * (1 - f) - RADIUS
            along = 0.45 * x * f_z, -(y + RADIUS) * f_z
        else:
            moved, along = (x * (1 - f), y * (1 - f)), (-x * f_z, -y * f_z)
        return tuple(part for a, b in (moved, along) for part in (c * a - s * b, s * a + c * b))

    return lines


def wall(case, turned=0.0, *, deeper=0.0, reversible=True):
    w = CASES[case][1]
    return spectral.analytic_wall(
        shape(case, turned, deeper), ends=(-w, w), radius=RADIUS, symmetric=turned == 0.0,
        reversible=reversible,
    )  # fmt: skip


@cache
def reference(case):
    rows = [row.split(",") for row in REFERENCE.read_text().splitlines()]
    values = np.array([row[1:] for row in rows if row[0] == case], float).T
    return values[0], values[1] + 1j * values[2], values[3] + 1j * values[4]


@cache
def solved(case):
    return scattered(wall(case), reference(case)[0], symmetric_only=True)


def scattered(of, frequency, **options):
    return spectral.scatter_spectral(of, AIR, frequency, lossy=False, **options)


def plane(found):
    return found.s[:, 0, 0, 0, 0], found.s[:, 1, 0, 0, 0]


@pytest.mark.parametrize("case", ["A", "E"])
def test_plane_mode_scatters_as_in_independent_solution(case):
    """The frequencies include the cut-ons and the trapped mode of A at 42.2 kHz."""
    _, reflected, passed = reference(case)
    found = plane(solved(case))
    error = np.maximum(np.abs(found[0] - reflected), np.abs(found[1] - passed))
    assert error.max() < 1e-5


@pytest.mark.parametrize("case", ["A", "E"])
def test_estimated_error_bounds_that_against_independent_solution(case):
    _, reflected, passed = reference(case)
    found = plane(solved(case))
    error = np.maximum(np.abs(found[0] - reflected), np.abs(found[1] - passed))
    # The reference has seven digits.
    assert np.all(error < solved(case).error + 2e-6)
    assert solved(case).error.max() < 1e-4


def test_richer_basis_changes_no_coefficient_by_more_than_estimated():
    """For all modes of lumen E, including those antisymmetric about x = 0."""
    frequency = np.arange(8e3, 60.1e3, 5.2e3)
    found, richer = (
        scattered(wall("A"), frequency, tolerance=tolerance) for tolerance in (1e-2, 1e-4)
    )
    assert found.modes == ("00", "11c", "11s", "21c", "21s", "01", "31c", "31s")
    change = np.abs(found.s - richer.s).max(axis=(1, 2, 3, 4))
    assert np.all(change < found.error + richer.error)


def test_error_of_too_few_initial_shifts_is_corrected_at_all_frequencies(monkeypatch):
    """The effect of one more shift elsewhere says nothing about the error at a frequency."""
    frequency = np.arange(8e3, 60.05e3, 200.0)
    monkeypatch.setattr(first_basis, "FIELDS_PER_WAVE", {False: 1e-3})
    monkeypatch.setattr(first_basis, "SPARE_SHIFTS", {False: 1})
    ends = (-30e-3, 30e-3)
    long = spectral.analytic_wall(shape("A"), ends=ends, radius=RADIUS, reversible=True)
    found = scattered(long, frequency, reference=ends, symmetric_only=True)
    short = scattered(wall("A"), frequency, reference=ends, symmetric_only=True)
    assert np.abs(found.s - short.s).max() < found.tolerance


def test_modes_of_linearly_dependent_functions_are_those_of_their_span():
    """The third function is the sum of the first two, up to rounding, which makes M indefinite."""
    span = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    stiffness, mass = np.diag([2.0, 12.0]), np.diag([1.0, 3.0])
    lack = np.diag([0.0, 0.0, -1e-14])
    square, vector = ritz(span @ stiffness @ span.T, span @ mass @ span.T + lack)
    np.testing.assert_allclose(square, [2.0, 4.0], rtol=1e-12)
    fields = span.T @ vector
    np.testing.assert_allclose(fields.T @ mass @ fields, np.eye(2), atol=1e-12)
    with pytest.raises(np.linalg.LinAlgError):
        ritz(np.eye(2), np.diag([1.0, -1e-3]))


def response(degree, order, n_elements, frequency=41e3):
    """S of lumen A at one frequency from one basis, and its estimated error."""
    edges = np.concatenate([np.linspace(0, 12e-3, n_elements + 1), [14e-3]])
    k = 2 * np.pi * np.array([frequency]) / AIR.sound_speed
    system = discretise(wall("A"), edges, degree, order, False, float(2 * np.pi * 6e4 / 343.2))
    kz = axial_wavenumbers(k, system.modes.zeros, RADIUS)
    sides = respond(system, float(k[0] ** 2), 1)
    s = [scattering_of(side.impedance[None], kz)[0, :2, :2] for side in sides]
    by_degree = [
        changed_scattering(q.impedance[None], q.by_degree[None], kz)[0, :2, :2] for q in sides
    ]
    by_element = [
        changed_scattering(q.impedance[None], q.by_element.sum(0)[None], kz)[0, :2, :2]
        for q in sides
    ]
    return np.array(s), np.array(by_degree), np.array(by_element)


def test_error_falls_exponentially_with_degree_and_is_estimated_within_a_factor():
    best = response(16, 7, 6)[0]
    errors = []
    for degree in (6, 8, 10):
        s, lacks, _ = response(degree, 7, 6)
        errors.append(np.abs(s - best).max())
        assert 0.4 < np.abs(lacks).max() / errors[-1] < 1.1
    assert errors[1] < 0.01 * errors[0]
    assert errors[2] < 0.3 * errors[1]


def test_error_falls_with_the_elements_and_is_estimated_within_a_factor():
    best = response(10, 7, 12)[0]
    errors = []
    for n_elements in (2, 4):
        s, _, lacks = response(10, 3, n_elements)
        errors.append(np.abs(s - best).max())
        assert 0.4 < np.abs(lacks).max() / errors[-1] < 1.1
    assert errors[0] / errors[1] > 2**5


def test_lumen_without_mirror_plane_scatters_the_plane_mode_as_before_it_was_turned():
    """Lumen A is turned by 25 degrees about its axis, so that all modes are solved for together."""
    frequency = np.array([20e3, 35e3, 47e3])
    turned = scattered(wall("A", 0.4363), frequency)
    straight = scattered(wall("A"), frequency)
    assert turned.modes == straight.modes
    np.testing.assert_allclose(plane(turned), plane(straight), atol=2e-5)
    pair = slice(1, 3)
    power = [(np.abs(s.s[:, 1, pair, 0, 0]) ** 2).sum(axis=-1) for s in (turned, straight)]
    np.testing.assert_allclose(*power, atol=2e-5)
    # The pair of modes is coupled by the turn.
    assert abs(turned.s[2, 1, 2, 0, 0]) > 0.2


def test_lumen_that_counts_as_not_reversible_scatters_as_by_halves():
    frequency = np.array([20e3, 44e3])
    whole = scattered(wall("E", reversible=False), frequency, symmetric_only=True)
    halved = scattered(wall("E"), frequency, symmetric_only=True)
    np.testing.assert_allclose(whole.s, halved.s, atol=1e-6)


def rings(case, n_rings=97, n_around=120, deeper=0.0):
    """A lumen of rings as a press leaves it: the deformed part between round rings."""
    w = CASES[case][1]
    z = np.concatenate([[-40e-3, -w], np.linspace(-w, w, n_rings)[1:-1], [w, 40e-3]])
    t = 2 * np.pi * np.arange(n_around) / n_around
    x, y, _, _ = (
        np.broadcast_to(part, (len(z), n_around))
        for part in shape(case, deeper=deeper)(z[:, None], t)
    )
    points = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], axis=-1)
    return SimpleNamespace(
        rings=points + np.array([0, 0, 0.04]), position=0.04, symmetric=True, same=1e-9,
        sealing_gap=0.0,
    )  # fmt: skip


def test_lumen_of_rings_scatters_as_its_formula():
    frequency, reflected, passed = (part[::4] for part in reference("E"))
    found = plane(scattered(spectral.wall_of(rings("E")), frequency, symmetric_only=True))
    # The rings end in a corner: half a millimetre is a cone where the formula is smooth.
    np.testing.assert_allclose(found, (reflected, passed), atol=2e-4)


def test_tolerance_and_sealed_gap_of_a_lumen_are_those_that_it_states():
    """A lumen moved by a micrometre on one side alone is reversible within two, not within half."""
    lumen = rings("E")
    lumen.rings[len(lumen.rings) // 3, :, 0] += 1e-6
    for lumen.same, reversible in ((2e-6, True), (0.5e-6, False)):
        assert spectral.wall_of(lumen).reversible is reversible
    lumen.sealing_gap = 3e-5
    assert spectral.wall_of(lumen).sealing_gap == 3e-5
    del lumen.sealing_gap  # a lumen must state it
    with pytest.raises(AttributeError, match="sealing_gap"):
        spectral.wall_of(lumen)


def test_reference_planes_move_the_phases_of_each_mode():
    frequency = np.array([30e3])
    here = scattered(wall("A"), frequency, symmetric_only=True)
    there = scattered(wall("A"), frequency, symmetric_only=True, reference=(-1e-3, 2e-3))
    kz = axial_wavenumbers(2 * np.pi * frequency / 343.2, np.array([0, 1.8411838]), RADIUS)[0]
    turn = np.exp(-1j * np.stack([kz, 2 * kz]) * 1e-3)
    np.testing.assert_allclose(there.s[0], turn[..., None, None] * here.s[0] * turn, atol=1e-6)
    assert there.extent == pytest.approx((here.extent[0] + 1e-3, here.extent[1] - 2e-3))


def test_result_is_a_scattering_matrix_that_a_tube_can_be_joined_from():
    found = solved("A")
    assert isinstance(found, ModalScattering)
    assert not isinstance(found, Scattering)
    assert found.s.shape == (len(found.frequency), 2, 5, 2, 5)
    silent = ~found.propagates
    assert np.all(found.s.transpose(0, 2, 1, 3, 4)[silent] == 0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"frequency": np.array([2e4, 1e4])}, "frequency must be positive"),
        ({"frequency": np.array([1e4, np.inf])}, "frequency = .* is out of range or not finite"),
        ({"tolerance": 0.5}, "tolerance = 0.5 is out of range; use 1e-06 to 0.1"),
        ({"tolerance": "x"}, "tolerance = 'x' is not a number"),
        ({"reference": (0.0,)}, r"reference = .* has shape \(1,\)"),
        ({"wall": None}, "wall = None is of type NoneType"),
        ({"air": None}, "air = None is of type NoneType"),
    ],
)
def test_what_cannot_be_solved_is_refused_in_one_sentence(change, words):
    arguments = {"wall": wall("A"), "air": AIR, "frequency": np.array([1e4, 2e4])} | change
    with pytest.raises(ConfigError, match=words):
        spectral.scatter_spectral(**arguments)


def test_ends_that_are_not_as_stated_are_refused():
    shorter = replace(wall("A"), ends=(-6e-3, 6e-3))
    wider = replace(wall("A"), radius=1.01 * RADIUS)
    for one in (shorter, wider):
        error = refused(lambda one=one: scattered(one, np.array([2e4])), setting="radius")
        assert error.value == one.radius
    unequal = replace(wall("A"), ends=(-6e-3, 12e-3), circular=False)
    with pytest.raises(ConfigError, match="ends differ in section"):
        scattered(unequal, np.array([2e4]))


def test_odd_number_of_points_of_a_symmetric_wall_is_refused():
    """Half of the points would leave out half of the piece at the top: |R| would be 5 % off."""
    words = {"ends": (-12e-3, 12e-3), "radius": RADIUS, "n_points": 97}
    error = refused(
        lambda: spectral.analytic_wall(shape("A"), **words), setting="n_points", value=97
    )
    assert error.advice == "use 98"
    spectral.analytic_wall(shape("A"), **words, symmetric=False)


def test_number_of_fields_is_that_of_the_larger_space(monkeypatch):
    """A reversible lumen has spaces of two symmetries along it; here the second is larger."""
    sizes = []

    def recorded(*given):
        found = swept(*given)
        sizes.append([space.fields.shape[-1] for space in found[0]])
        return found

    monkeypatch.setattr(solver, "swept", recorded)
    found = spectral.scatter_spectral(wall("E"), AIR, np.array([20e3]), symmetric_only=True)
    assert len(sizes[-1]) == 2
    assert found.n_fields == max(sizes[-1])


def test_lumens_without_straight_ends_alike_are_refused():
    straight, unlike, open_ended = (rings("E") for _ in range(3))
    straight.rings[:] = straight.rings[0] + (straight.rings[:, :1, 2:] * [0, 0, 1] - [0, 0, 0])
    unlike.rings[-2:, :, 0] *= 1.01
    open_ended.rings = open_ended.rings[20:]
    for lumen, words in (
        (straight, "straight all along"),
        (unlike, "differ in section"),
        (open_ended, "straight at its ends"),
    ):
        with pytest.raises(ConfigError, match=words):
            spectral.wall_of(lumen)


def straight(radius, half_length):
    def lines(z, t):
        return radius * np.sin(t), -radius * np.cos(t), 0 * z, 0 * z

    ends = (-half_length, half_length)
    return spectral.analytic_wall(lines, ends=ends, radius=radius, reversible=True)


def plane_wavenumber(radius, half_length, frequency, air=AIR):
    """Wavenumber of the plane mode, from the transmission of straight tubes of two lengths."""
    short, long = (
        spectral.scatter_spectral(
            straight(radius, part), air, frequency, reference=(-part, part), symmetric_only=True
        ).s[:, 1, 0, 0, 0]
        for part in (half_length, 2 * half_length)
    )
    return 1j * np.log(long / short) / (2 * half_length)


def test_paper_bore_attenuates_as_kirchhoffs_equation_says():
    """The reference is Kirchhoff's equation to 40 digits, less its absorption in the bulk.

    Zwikker and Kosten, who assume a uniform pressure over the section, are 0.3 % lower at 20 kHz
    and 1.6 % at 60 kHz. Prandtl's number is 0.70520337.
    """
    air = Air(sound_speed=343.2, density=1.204, viscosity=1.8133e-5, prandtl=0.70520337)
    frequency = np.array([5e3, 20e3, 42e3, 60e3])
    kirchhoff = np.array(KIRCHHOFF)
    diffusivity = air.viscous_diffusivity * (4 / 3 + 0.4 / air.prandtl)
    bulk = (2 * np.pi * frequency) ** 2 * diffusivity / (2 * air.sound_speed**3)
    found = plane_wavenumber(RADIUS, 2.4e-3, frequency, air)
    np.testing.assert_allclose(-found.imag, kirchhoff - bulk, rtol=5e-4)


@pytest.mark.parametrize(
    ("radius", "half_length", "frequency", "accuracy"),
    [
        (0.5e-3, 0.6e-3, [5e3, 20e3, 60e3], 3e-3),
        # The bore is nine viscous layers wide.
        (0.1e-3, 0.3e-3, [5e3, 20e3, 60e3], 3e-3),
    ],
)
def test_straight_tube_attenuates_as_zwikker_and_kosten_say(
    radius, half_length, frequency, accuracy
):
    frequency = np.array(frequency)
    expected = axial_wavenumber(0, 0, frequency, radius, AIR)
    found = plane_wavenumber(radius, half_length, frequency)
    np.testing.assert_allclose(found.imag, expected.imag, rtol=accuracy)
    np.testing.assert_allclose(found.real, expected.real, rtol=5e-4)


def test_losses_vanish_with_the_viscosity():
    frequency = np.array([20e3, 42.2e3, 55e3])
    thin = Air(sound_speed=343.2, density=1.204, viscosity=1.8e-13)
    nearly = spectral.scatter_spectral(wall("E"), thin, frequency, symmetric_only=True)
    without = scattered(wall("E"), frequency, symmetric_only=True)
    # The layers are 1e4 times thinner than in air.
    np.testing.assert_allclose(nearly.s, without.s, atol=1e-5)


def test_slit_and_tube_fill_with_their_layers_as_their_closed_forms():
    """The share of the boundary layer: limits D << h and h << D, and Zwikker and Kosten's form."""
    thickness = np.array(1e-5 * np.exp(-0.25j * np.pi))
    wide, narrow = np.array(1e-2), np.array(1e-7)
    for roundness in (0.0, 1.0):
        f = layers.filling(wide, np.array(roundness), thickness)
        np.testing.assert_allclose(f, 1 - roundness * thickness / wide, rtol=1e-5)
        # The free section, h - 2 f D of a slit and 1 - 4 f D / h of a tube, vanishes.
        f = layers.filling(narrow, np.array(roundness), thickness)
        left = 1 - (2 + 2 * roundness) * f * thickness / narrow
        slowed = (narrow / (2 * thickness)) ** 2 / (3 if roundness == 0 else 8)
        np.testing.assert_allclose(left, slowed, rtol=1e-2)


def test_losses_of_narrow_gaps_are_functions_of_their_own():
    """The functions of wide gaps come first; wide gaps have no part in the others."""
    width = np.geomspace(2e-5, 8e-3, 200)
    thickness = layers.layer_thickness(np.geomspace(8e3, 6e4, 5), AIR)[0][:, None]
    both = layers.filling(width, np.zeros(1), thickness)
    rows = np.concatenate([both.real, both.imag])
    wide = width > 1e-3
    functions, weights = layers._parts(rows, wide)
    least = layers.LEAST_PART * np.linalg.norm(rows)
    assert np.abs(functions @ weights - rows).max() < 2 * least
    n_wide = int(weights[:, wide].any(axis=1).sum())
    assert 0 < n_wide < len(weights)
    assert not weights[n_wide:, wide].any()


def test_greatest_circle_in_an_ellipse_is_that_of_curvature_at_its_tips():
    """An ellipse with half axes 3 and 0.2 mm: b^2 / a at the tips, b at the flat sides."""
    a, b = 3e-3, 0.2e-3

    def lines(z, t):
        return a * np.sin(t), -b * np.cos(t), 0 * z, 0 * z

    flat = spectral.analytic_wall(lines, ends=(0.0, 1e-3), radius=a, n_points=240)
    points = boundary.wall_points(flat, axial_rule(np.array([0.0, 1e-3]), 1, np.zeros(0)))
    width = layers.gap_widths(points.contours, points.boxes, True, np.array([True]))[0]
    np.testing.assert_allclose(width[0], 2 * b, rtol=1e-3)
    assert width.min() == pytest.approx(2 * b**2 / a, rel=0.1)
