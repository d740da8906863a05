"""A rangefinder at each end: mirrored presses, products of posteriors, contacts of both."""

import csv
import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from commands import run_here
from test_inversion import MODES, RADIUS, press, tool

from acoustube.base.errors import ConfigError
from acoustube.inversion import (
    Baseband,
    Contact,
    ForwardModel,
    Inverter,
    Library,
    Priors,
    joined_contacts,
    measured_clutter,
)
from acoustube.inversion.posterior import mixture
from acoustube.inversion.wrap import Wrap
from acoustube.ranging import Rangefinder, record
from acoustube.recordings import write
from acoustube.reports.figures.posterior import posterior_figure
from acoustube.runs.contact_table import ContactFit
from acoustube.runs.libraries import files
from acoustube.runs.libraries.plan import tool_plans
from acoustube.runs.two_ends import EndsContacts, EndsInverter

LENGTH = 1.6


def recorded(presses, end, n_cycles=20):
    """Cycles of the rangefinder at an end, 0 or 1, with its own clutter and noise."""
    turned = [one.from_other_end(LENGTH) for one in presses] if end else presses
    return record(turned, n_cycles=n_cycles, length=LENGTH, tube_seed=7 + end, seed=3 + end)


@pytest.fixture(scope="module")
def ends():
    """Inversions from both ends, of a tube whose bore is known, and nearly the resonances."""
    base = Baseband(Rangefinder(), RADIUS, LENGTH, 20.0, MODES)
    known = Library((tool(),)), base
    free = [recorded([], end, 200)["signal"].values for end in (0, 1)]
    clutter = [measured_clutter(base, one) for one in free]
    priors = Priors(bore=0.0, resonance=1e-3)
    return [Inverter(ForwardModel(*known, one, priors)) for one in clutter]


def both(ends, presses, priors):
    near, far = (one(recorded(presses, i)["signal"].values) for i, one in enumerate(ends))
    known = ends[0].model.tool_library, priors
    return near, far, joined_contacts(near.contacts, far.contacts, LENGTH, *known)


def test_mirrored_press_has_its_ports_exchanged():
    one = press(4e-3, 0.7)
    s = one.scattering.s * np.array([1.0, 2.0])[:, None, None, None]
    changed = dataclasses.replace(one.scattering, s=s, extent=(-0.02, 0.01))
    one = dataclasses.replace(one, scattering=changed)
    turned = one.from_other_end(LENGTH)
    assert turned.position == pytest.approx(0.9)
    assert turned.scattering.extent == (-0.01, 0.02)
    assert np.array_equal(turned.scattering.s[:, 0, 1, 1, 2], s[:, 1, 1, 0, 2])
    assert turned.scattering.planes == (0.0, 0.0)
    assert np.array_equal(turned.from_other_end(LENGTH).scattering.s, s)


def contact(places, depths, spread, weights=(0.7, 0.3), tool_number=0):
    share = np.array(weights)
    place, depth = (mixture(share, np.array(x), np.full(len(x), s))
                    for x, s in zip((places, depths), spread, strict=True))  # fmt: skip
    return Contact(probability=0.9, distance=place, depth=depth, force=depth, tool=tool_number)


@pytest.mark.slow
def test_limit_of_detection_behind_a_press_is_that_of_the_other_end(ends):
    """The limit of both ends is the lower of the two, each at its own distance."""
    near, far = (
        one(recorded([press(6.5e-3, 0.6)], end)["signal"].values) for end, one in enumerate(ends)
    )
    both_ends = EndsContacts([], 0.0, 1.0, near, (far, LENGTH))
    known = EndsContacts([ContactFit(near.contacts[0], 0.0, 1.0)], 0.0, 1.0, near, (far, LENGTH))
    assert np.isnan(known.detection_limit([0.62])[0])
    (here, behind), (there, beyond) = (
        near.detection_limit([0.4, 1.1]),
        far.detection_limit([LENGTH - 0.4, LENGTH - 1.1]),
    )
    assert here < there
    assert beyond < behind
    assert list(both_ends.detection_limit([0.4, 1.1])) == [here, beyond]
    # An end with a misfit does not count, unless both have one.
    wrong = [dataclasses.replace(one, misfit=0.3) for one in (near, far)]
    one_end = EndsContacts([], 0.3, 1.0, near, (wrong[1], LENGTH))
    assert list(one_end.detection_limit([0.4, 1.1])) == [here, behind]
    neither = EndsContacts([], 0.3, 1.0, wrong[0], (wrong[1], LENGTH))
    assert list(neither.detection_limit([0.4, 1.1])) == [here, beyond]
    alone = EndsContacts([], 0.0, 1.0, near)
    assert list(alone.detection_limit([0.4, 1.1])) == [here, behind]


def test_contact_found_from_both_ends_has_the_product_of_distributions():
    """For position and depth, on a grid; the error of the model in depth is not halved."""
    priors = Priors(depth=0.0, length=0.3e-3)
    near = contact([0.7, 0.704], [3e-3, 3.05e-3], (1e-3, 0.04e-3))
    far = contact([LENGTH - 0.7035, LENGTH - 0.6995], [3.02e-3, 2.9e-3], (2e-3, 0.05e-3))
    (joined,) = joined_contacts([near], [far], LENGTH, Library((tool(),)), priors)
    found = joined.contact
    assert (joined.near, joined.far, joined.agree) == (0, 0, True)
    assert found.probability == pytest.approx(0.99)
    place, depth = np.linspace(0.69, 0.715, 401), np.linspace(2.7e-3, 3.3e-3, 401)

    def density(one, at, spread):
        each = [
            w * np.outer(*(np.exp(-0.5 * ((x - m) / s) ** 2) / s
                           for x, m, s in zip(at, (a, b), spread, strict=True)))
            for w, a, b in zip(one.distance.weights, one.distance.means, one.depth.means,
                               strict=True)
        ]  # fmt: skip
        return sum(each)

    spread = np.hypot(2e-3, 0.3e-3), 0.05e-3
    product = density(near, (place, depth), (1e-3, 0.04e-3))
    product *= density(far, (LENGTH - place, depth), spread)
    for told, axis, values in ((found.distance, 1, place), (found.depth, 0, depth)):
        exact = product.sum(axis=axis)
        exact /= exact.sum() * (values[1] - values[0])
        assert np.abs(told.density(values) - exact).max() < 1e-3 * exact.max()
    assert found.distance.deviation < near.distance.deviation
    shared = Priors(depth=0.039e-3)
    (joined,) = joined_contacts([near], [far], LENGTH, Library((tool(),)), shared)
    found = joined.contact
    assert found.depth.deviation > 0.039e-3


def test_contacts_of_one_end_or_of_two_tools_are_kept():
    near = [contact([0.7, 0.704], [3e-3, 3.1e-3], (1e-3, 1e-4))]
    far = [contact([0.1, 0.104], [2e-3, 2.1e-3], (1e-3, 1e-4)),
           contact([0.9, 0.904], [5e-3, 5.1e-3], (0.5e-3, 1e-4), tool_number=1)]  # fmt: skip
    found = joined_contacts(
        near, far, LENGTH, Library((tool(), tool(diameter=0.01))), Priors(length=0.0)
    )
    assert [(one.near, one.far) for one in found] == [(0, 1), (None, 0)]
    assert found[0].contact.tool == 1
    assert found[1].contact.distance.value == pytest.approx(1.5)


def test_ends_that_contradict_each_other_are_not_averaged():
    near = [contact([0.7, 0.704], [6.8e-3, 6.8e-3], (0.5e-3, 4e-5))]
    far = [contact([0.885, 0.889], [2.5e-3, 2.5e-3], (1e-3, 4e-5))]
    (found,) = joined_contacts(near, far, LENGTH, Library((tool(),)), Priors())
    assert not found.agree
    assert found.contact.depth.value == 6.8e-3


def test_contacts_are_joined_with_their_nearest():
    """The contact of larger uncertainty is not joined with its neighbour's."""
    near = [contact([at, at], [3e-3, 3e-3], (8e-3, 1e-4)) for at in (0.90, 0.96)]
    far = [contact([LENGTH - 0.955] * 2, [3e-3, 3e-3], (1e-3, 1e-4))]
    found = joined_contacts(near, far, LENGTH, Library((tool(),)), Priors())
    assert [(one.near, one.far) for one in found] == [(0, None), (1, 0)]


SPANS = (1.0, 1.3), (0.2, 0.5)


@pytest.mark.parametrize(
    ("near", "far", "spans", "told", "whole"),
    [
        # The far end explains its echo better; nothing explains the residual of the near one.
        ([0.5], [0.5], SPANS, [(0.1, 1.5)], 3.0),
        # It is due to the contact that the far end alone detects,
        ([0.5], [0.5, 1.1], SPANS, [(0.1, 1.5), (0.1, 1.5)], 1.5),
        # unless it arrives before the echo of that contact.
        ([0.5], [0.5, 1.45], SPANS, [(0.1, 1.5), (0.1, 1.5)], 3.0),
        # Each end misses the other's contact, and its residual is due to that.
        ([0.5], [1.1], ((1.0, 1.3), (1.0, 1.3)), [(0.05, np.nan), (0.1, np.nan)], np.nan),
        # The near end reports all contacts, and the residual of the far one is due to the first.
        ([0.5, 1.1], [1.1], ((1.0, 1.3), (1.2, 1.5)), [(0.05, 3.0), (0.05, 3.0)], 3.0),
        ([], [], SPANS, [], 3.0),
    ],
)
def test_contact_has_the_fit_of_the_better_end(near, far, spans, told, whole):
    """Spans of the largest residuals are distances from each end."""
    known = SimpleNamespace(
        tool_library=Library((tool(),)), sensor=SimpleNamespace(priors=Priors())
    )
    one, other = (
        SimpleNamespace(misfit=misfit, residual=residual, residual_span=span, contacts=[
            contact([z, z], [3e-3, 3e-3], (1e-3, 1e-4)) for z in places
        ])
        for places, misfit, residual, span in
        ((near, 0.05, 3.0, spans[0]), ([LENGTH - z for z in far[::-1]], 0.1, 1.5, spans[1]))
    )  # fmt: skip
    found = EndsInverter(known)._joined(one, other, LENGTH)
    fits = [(each.misfit, each.residual) for each in found.contacts]
    np.testing.assert_array_equal(np.reshape(fits, (-1, 2)), np.reshape(told, (-1, 2)))
    np.testing.assert_array_equal(found.residual, whole)


def test_press_behind_a_deep_one_is_found_from_the_other_end(ends):
    """A press of 2.5 mm behind one of 6.8 mm, whose trapped sound dominates at the near end."""
    near, far, found = both(ends, [press(6.8e-3, 0.45), press(2.5e-3, 0.95)], Priors())
    assert len(near.contacts) == 1
    assert len(far.contacts) == 2
    assert [one.contact.distance.value for one in found] == pytest.approx([0.45, 0.95], abs=1e-3)
    assert [one.contact.depth.value for one in found] == pytest.approx([6.8e-3, 2.5e-3], abs=1.5e-4)
    # The picture: the second press is above the noise at the far end only, left of the first.
    fit = far.misfit, far.residual
    known = EndsContacts(
        [ContactFit(one.contact, *fit) for one in found], *fit, near, (far, LENGTH)
    )
    axes = posterior_figure(known, Library((tool(),))).axes
    assert len(axes) == 3 + 2 * 3
    echoes = dict(zip(("near", "far"), axes, strict=False))
    for name, one in echoes.items():
        assert one.get_title().endswith(f"{name} end")
        assert one.get_xlim() == (0.0, 100 * LENGTH)
        marks = [line.get_xdata()[0] for line in one.lines if len(line.get_xdata()) == 2]
        assert marks == pytest.approx([45, 95], abs=0.1)
    first = {name: one.lines[0].get_xdata()[0] for name, one in echoes.items()}
    assert first["near"] < 30
    assert first["far"] == pytest.approx(100 * LENGTH - first["near"], abs=1)


def test_positions_from_both_ends_have_no_half_wave_ambiguity(ends):
    """The tube's length is known to 0.3 mm."""
    near, _, found = both(ends, [press(2e-3, 1.05)], Priors(length=0.3e-3))
    (joined,), (alone,) = found, near.contacts
    one = joined.contact
    assert (joined.near, joined.far) == (0, 0)
    assert alone.distance.deviation > 2e-3
    assert one.distance.deviation < 0.5e-3
    assert abs(one.distance.value - 1.05) < 3 * one.distance.deviation


def test_wrap_from_the_other_end():
    wrap = Wrap(place=np.array([0.2, 0.5, 1.0]), curvature=np.array([10.0, 20.0, 25.0]),
                torsion=np.array([1.0, 2.0, 3.0]))  # fmt: skip
    turned = wrap.from_other_end(1.2)
    assert turned.place == pytest.approx([0.2, 0.7, 1.0])
    assert list(turned.curvature) == [25.0, 20.0, 10.0]
    assert list(turned.torsion) == [3.0, 2.0, 1.0]
    assert list(turned.from_other_end(1.2).torsion) == [1.0, 2.0, 3.0]
    with pytest.raises(ConfigError, match=r"make length_cm 100 or more \(length 1 m\)"):
        wrap.from_other_end(0.99)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A library, and recordings of two presses from both ends."""
    where = tmp_path_factory.mktemp("ends")
    (plan,) = tool_plans({"depth_mm": ["1:3:0.5"]}, 0.01)
    (where / "lib").mkdir()
    files.write_tool(where / "lib" / plan.name, tool(), plan)
    (where / "sensor.toml").write_text("length_cm = 160")
    presses = [press(6.8e-3, 0.45), press(2.5e-3, 0.95)]
    for end, name in enumerate(("near", "far")):
        write(recorded(presses, end), where / f"{name}.nc")
        write(recorded([], end, 100), where / f"{name}_free.nc")
        silent = recorded([], end, 2)
        del silent.attrs["tube_length"]
        write(silent, where / f"{name}_silent.nc")
    return where


def test_command_joins_recordings_of_both_ends(folder, tmp_path):
    done = run_here(
        "invert", folder / "near.nc", "--far", folder / "far.nc", "--library", folder / "lib",
        "--untouched", folder / "near_free.nc", "--far-untouched", folder / "far_free.nc",
        "--sensor", folder / "sensor.toml", "--group", 20, "--out", tmp_path / "c.csv",
        "--detection-limits", tmp_path / "l.csv",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    with (tmp_path / "l.csv").open(newline="") as file:
        limits = {float(row["distance_cm"]): row["depth_mm"] for row in csv.DictReader(file)}
    # Near the near end the limit is that of the far one. The near end misses the second press and
    # does not explain its echo, so that next to the far end there is no limit.
    assert min(limits) < 10
    assert 100 * LENGTH - 30 < max(limits) < 100 * LENGTH - 20
    assert not [z for z in limits if abs(z - 45) < 2.5 or abs(z - 95) < 2.5]
    # Behind the first press of either end the limit is that of the other end.
    assert float(limits[70.2]) < 3
    assert float(limits[119.6]) < 3
    with (tmp_path / "c.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row, (place, depth) in zip(rows, [(45, 6.8), (95, 2.5)], strict=True):
        assert float(row["distance_cm"]) == pytest.approx(place, abs=0.05)
        assert abs(float(row["depth_mm"]) - depth) < 3 * float(row["depth_sd_mm"]) < 0.2
        assert float(row["misfit"]) < 0.15
        assert float(row["residual"]) < 2.5


def test_far_recording_that_cannot_be_read_loses_its_pair_alone(folder, tmp_path):
    (tmp_path / "broken.nc").write_text("nothing")
    done = run_here(
        "invert", folder / "near_free.nc", folder / "near.nc", "--far", tmp_path / "broken.nc",
        folder / "far.nc", "--library", folder / "lib", "--sensor", folder / "sensor.toml",
        "--group", 20, "--out", tmp_path / "c.csv",
    )  # fmt: skip
    assert done.returncode == 1
    assert "broken.nc" in done.stderr
    with (tmp_path / "c.csv").open(newline="") as file:
        assert {row["recording"] for row in csv.DictReader(file)} == {str(folder / "near.nc")}


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["near_silent.nc", "--far", "far_silent.nc"], "does not state the tube's length"),
        (["near.nc", "--far-untouched", "far_free.nc"], "--far-untouched needs --far"),
        (["near.nc", "--far", "far_free.nc"], "recordings of the same cycles from both ends"),
        (
            ["near.nc", "near_free.nc", "--far", "far.nc", "--group", "20"],
            "2 recordings from the near end and 1 of --far",
        ),
    ],
)
def test_recordings_that_do_not_go_together_are_one_sentence(folder, words, reason):
    given = [folder / one if one.endswith(".nc") else one for one in words]
    done = run_here("invert", *given, "--library", folder / "lib")
    assert done.returncode != 0
    assert reason in " ".join(done.stderr.split())
