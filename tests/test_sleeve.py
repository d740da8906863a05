"""The sleeve: helices against closed forms, and layouts against their geometry."""

import numpy as np
import pytest
from refusals import refused
from scipy.integrate import quad
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation
from scipy.special import jv, jvp

from acoustube.base.errors import ConfigError
from acoustube.sleeve import Frame, Helix, design, layout, nearest, spacing
from acoustube.sleeve.ovalisation import ovality
from acoustube.tube import Tube
from acoustube.waves.modes.bore_couplings import bore_modes

FOREARM = {"radius": 0.0326, "taper": 0.057, "length": 0.25, "loops": 9, "lead": 0.15}
ASKEW = Frame(
    origin=np.array([0.4, -0.2, 0.9]),
    rotation=Rotation.from_rotvec([0.4, -0.7, 0.3]).as_matrix(),
)


def arc_by_quadrature(helix):
    """The helix's length by adaptive quadrature of the arc density in the sleeve paper."""
    rho = 2 * np.pi * helix.loops / helix.length
    return quad(
        lambda z: np.sqrt(1 + helix.taper**2 + (rho * (helix.radius + helix.taper * z)) ** 2),
        0,
        helix.length,
        epsabs=1e-13,
        epsrel=1e-13,
    )[0]


def test_arc_length_of_a_cylinder_is_the_hypotenuse_of_the_unrolled_one():
    helix = Helix(radius=0.04, length=0.25, loops=9, lead=0.15)
    exact = np.hypot(0.25, 9 * 2 * np.pi * 0.04)
    assert helix.tube_length == pytest.approx(0.15 + exact, rel=1e-6)


@pytest.mark.parametrize("taper", [0.057, -0.1, 0.5])
def test_arc_length_of_a_cone_is_that_of_adaptive_quadrature(taper):
    helix = Helix(**FOREARM | {"taper": taper})
    assert helix.table[1, -1] == pytest.approx(arc_by_quadrature(helix), rel=1e-6)


def test_arc_length_converges_with_second_order():
    # A slender cone, whose arc density is curved: on a forearm the error soon is rounding.
    shape = {"radius": 0.01, "taper": 0.5, "length": 0.25, "loops": 1}
    exact = arc_by_quadrature(Helix(**shape))
    errors = [abs(Helix(**shape, intervals=n).table[1, -1] - exact) for n in (20, 40, 80)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert orders == pytest.approx([2, 2], abs=0.05)


@pytest.mark.parametrize("hand", ["right", "left"])
def test_distance_to_place_and_back_is_the_same_to_a_hundredth_of_a_millimetre(hand):
    tubes = [Helix(**FOREARM, phase=phase, hand=hand, frame=ASKEW) for phase in (0.3, 0.3 + np.pi)]
    distance = np.linspace(0.15, tubes[0].tube_length, 4001)
    for number, tube in enumerate(tubes):
        found = nearest(tubes, tube.place(distance))
        assert np.all(found.tube == number)
        assert np.max(np.abs(found.distance - distance)) < 1e-5
        assert np.max(found.gap) < 1e-9
        # The next loop is the other tube's, half a pitch further: at the spacing of the tubes.
        assert np.all(found.next_tube == 1 - number)
        middle = np.abs(distance - distance.mean()) < 0.3
        assert found.next_gap[middle] == pytest.approx(spacing(tubes), rel=0.02)


def test_places_off_the_tubes_find_the_nearest_of_many_points_along_them():
    tubes = [Helix(**FOREARM, frame=ASKEW), Helix(**FOREARM, phase=2.0, hand="left", frame=ASKEW)]
    random = np.random.default_rng(1)
    z, psi = random.uniform(-0.02, 0.27, 400), random.uniform(-np.pi, np.pi, 400)
    r = tubes[0].radius_at(z) + random.uniform(-0.006, 0.012, 400)
    places = ASKEW.outwards(np.stack([r * np.cos(psi), r * np.sin(psi), z], axis=-1))
    along = np.linspace(0.15, tubes[0].tube_length, 8001)
    brute = [
        np.linalg.norm(places[:, None] - tube.place(along), axis=-1).min(axis=1) for tube in tubes
    ]
    found = nearest(tubes, places)
    # The points are 0.28 mm apart: at 6 mm from the tube, up to 2 um farther than the nearest one.
    assert found.gap == pytest.approx(np.min(brute, axis=0), abs=2e-5)
    assert np.all(found.gap <= np.min(brute, axis=0) + 1e-12)
    assert np.all(found.next_gap >= found.gap)


@pytest.mark.parametrize("lead", [0.0, 2.0])
def test_next_loop_does_not_depend_on_the_lead(lead):
    """Loops of one tube are a pitch apart, 33.3 mm across the loops."""
    helix = Helix(radius=0.04, length=0.1, loops=3, lead=lead)
    found = nearest([helix], helix.place(helix.distance(0.05)))
    assert abs(found.next_distance - found.distance) == pytest.approx(0.249, abs=1e-3)
    assert found.next_gap == pytest.approx(0.0330, abs=1e-4)


def test_distances_in_the_lead_and_beyond_the_end_have_no_place():
    helix = Helix(**FOREARM)
    assert np.all(np.isnan(helix.place([0.1, helix.tube_length + 0.01])))
    assert np.all(np.isfinite(helix.place([0.15, helix.tube_length])))


def test_spread_around_a_cylinder_has_the_moments_of_a_wrapped_normal():
    """For a normal angle with standard deviation s the mean of cos is exp(-s^2/2)."""
    helix = Helix(radius=0.04, length=0.5, loops=18)
    distance, deviation = helix.tube_length / 2, 0.05
    step = deviation / helix.density(0.0)
    turned = abs(helix.twist) * step
    mean, covariance = helix.spread(distance, deviation)
    radial = helix.place(distance) * [1, 1, 0] / 0.04
    assert mean @ radial == pytest.approx(0.04 * np.exp(-(turned**2) / 2), rel=1e-6)
    assert covariance[2, 2] == pytest.approx(step**2, rel=1e-6)
    around = np.cross([0, 0, 1], radial)
    variance = 0.5 * (1 - np.exp(-2 * turned**2)) * 0.04**2
    assert around @ covariance @ around == pytest.approx(variance, rel=1e-6)


def test_curvature_and_torsion_are_those_of_the_curve():
    helix = Helix(radius=0.04, length=0.25, loops=8, hand="left")
    curvature, torsion = helix.bend(0.1)
    z, h = 0.1, 1e-4
    points = helix.point(z + h * np.arange(-2, 3))
    d1 = (points[3] - points[1]) / (2 * h)
    d2 = (points[3] - 2 * points[2] + points[1]) / h**2
    d3 = (points[4] - 2 * points[3] + 2 * points[1] - points[0]) / (2 * h**3)
    normal = np.cross(d1, d2)
    assert curvature == pytest.approx(np.linalg.norm(normal) / np.linalg.norm(d1) ** 3, rel=1e-3)
    assert torsion == pytest.approx(normal @ d3 / (normal @ normal), rel=1e-3)
    assert torsion < 0


def test_coverage_of_a_cylinder_is_the_width_of_the_strip_over_the_pitch():
    # Strips of 2 x 5 mm beside a tube of 60 mm pitch; up to the curvature of the skin.
    (tube,) = tubes = [Helix(radius=0.05, length=0.6, loops=10, lead=0.15)]
    found = layout(tubes, within=5e-3, reach=10)
    assert found.skin_area == pytest.approx(2 * np.pi * 0.05 * 0.6, rel=1e-6)
    assert found.coverage == pytest.approx(2 * 5e-3 / spacing(tubes), rel=0.02)
    assert found.blind == 0
    with pytest.warns(DeprecationWarning, match="detection_range"):
        assert found.heard is found.detection_range
    assert found.detection_range == pytest.approx(np.array([[0.15, tube.tube_length]]))


def test_a_dead_zone_on_the_arm_is_the_skin_nearest_to_it():
    """Unrolled: half a pitch above the tube, the skin below it, and a parabola around its start."""
    (tube,) = tubes = [Helix(radius=0.05, length=0.6, loops=10)]
    pitch, below = 0.06, 0.15 / 2 / tube.density(0.0)
    area = 0.15 * (pitch / 2 + below) + pitch**2 / 3
    found = layout(tubes, dead_zone=0.15, reach=10)
    assert found.blind == pytest.approx(area / (2 * np.pi * 0.05 * 0.6), rel=0.05)


def test_designed_forearm_is_as_wide_as_its_girths_and_the_tube():
    tubes = design(0.25, (0.17, 0.26), pitch=0.05, n_tubes=2)
    assert tubes[0].loops == pytest.approx(5)
    assert 2 * np.pi * (tubes[1].radius_at([0, 0.25]) - 5.55e-3) == pytest.approx([0.17, 0.26])
    assert tubes[1].phase - tubes[0].phase == pytest.approx(np.pi)


@pytest.mark.parametrize(
    ("changes", "setting", "value"),
    [
        ({"loops": 0}, "loops", 0),
        ({"loops": 9, "hand": "both"}, "hand", "'both'"),
        ({"loops": 9, "lead": -1}, "lead", -1),
    ],
)
def test_impossible_helices_are_refused(changes, setting, value):
    refused(lambda: design(0.25, (0.17, 0.26), **changes), setting=setting, value=value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"loops": 12}, ["a tube of", "up to 250 cm", "9.3 loops or fewer"]),
        ({"loops": 9, "n_tubes": 4}, ["6.9 mm apart", "11.1 mm outer diameter", "fewer"]),
        ({"loops": 9, "pitch": 0.03}, ["loops or a pitch"]),
        ({"pitch": -0.03}, ["pitch = -3 cm"]),
    ],
)
def test_layouts_that_cannot_be_are_refused(changes, words):
    with pytest.raises(ConfigError) as refusal:
        design(0.25, (0.17, 0.26), **changes)
    for word in words:
        assert word in str(refusal.value)


@pytest.mark.parametrize("sleeve", [(0.25, (0.17, 0.26), 12.0), (1.2, (0.2, 0.2), 10.0)])
def test_advised_number_of_loops_is_the_largest_that_fits(sleeve):
    """In tenths; on the longer sleeve the tube's length is far from proportional to its loops."""
    length, girths, loops = sleeve
    with pytest.raises(ConfigError) as refusal:
        design(length, girths, loops=loops, reach=2.0)
    advised = float(str(refusal.value).split(" loops or fewer")[0].split()[-1])
    assert 0 < advised < loops
    design(length, girths, loops=advised, reach=2.0)
    with pytest.raises(ConfigError, match=f"use {advised:g} loops or fewer"):
        design(length, girths, loops=advised + 0.1, reach=2.0)


def test_a_tip_on_the_arm_is_refused():
    with pytest.raises(ConfigError, match=r"arm's end comes out as -0\.02"):
        Helix(radius=0.03, taper=-0.2, length=0.25, loops=9)


def test_places_of_another_shape_and_no_tube_are_refused():
    with pytest.raises(ConfigError, match=r"places = .* has shape \(5, 2\)"):
        nearest([Helix(**FOREARM)], np.zeros((5, 2)))
    with pytest.raises(ConfigError, match=r"tubes = \[\] has only 0 entries"):
        nearest([], np.zeros(3))


def test_flattened_bore_moves_the_cut_ons_as_its_own_eigenvalues_do():
    """By Ritz's method in the ellipse, with the modes of the circle stretched to it."""
    zeta = 0.02
    a, b = 1 - zeta, 1 + zeta
    bore = bore_modes(30.0)
    first = bore.names.index("11c")
    shift = 0.5 * zeta * bore.flattening[first] / bore.zeros[first] ** 2
    r, w = np.polynomial.legendre.leggauss(60)
    r, w = 0.5 * (r + 1)[:, None], 0.5 * w[:, None] * 0.5 * (r + 1)[:, None]
    phi = 2 * np.pi * np.arange(64) / 64
    names = [n for n in bore.names if n.endswith("c") and int(n[:-2]) % 2]
    rows = []
    for name in names:
        m, zero = int(name[:-2]), bore.zeros[bore.names.index(name)]
        d_r = zero * jvp(m, zero * r) * np.cos(m * phi)
        d_phi = -m * jv(m, zero * r) * np.sin(m * phi) / r
        psi = jv(m, zero * r) * np.cos(m * phi)
        d_x = d_r * np.cos(phi) - d_phi * np.sin(phi)
        d_y = d_r * np.sin(phi) + d_phi * np.cos(phi)
        rows.append((psi, d_x / a, d_y / b))
    psi, d_x, d_y = (np.array([row[i] for row in rows]) for i in range(3))
    mass = np.einsum("irp,rp,jrp->ij", psi, w + 0 * phi, psi)
    stiff = sum(np.einsum("irp,rp,jrp->ij", d, w + 0 * phi, d) for d in (d_x, d_y))
    lowest = np.sqrt(eigh(stiff, mass, eigvals_only=True)[0])
    assert lowest / bore.zeros[1] - 1 == pytest.approx(shift, rel=0.05)


def test_brazier_ovality_of_a_thin_tube_is_that_of_its_formula_and_kinks_are_refused():
    thin = Tube(inner_diameter=0.0199, wall_thickness=1e-4, poisson_ratio=0.3)
    mean = 0.01
    expected = 0.91 * (0.3 * mean**2 / 1e-4) ** 2 * mean / 0.00995
    assert ovality(thin, 0.3) == pytest.approx(expected)
    refused(lambda: ovality(thin, 0.6), setting="curvature", value=0.6)
