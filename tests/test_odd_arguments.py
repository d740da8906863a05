"""Public functions refuse unusable arguments, by a ValueError that names the argument.

The functions and their valid arguments are those of the fuzzer, which draws stranger ones at
random.
"""

import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.fuzz.functions import specs, trial

NUMBERS = st.one_of(
    st.floats(),
    st.complex_numbers(),
    st.sampled_from([0, -1, 1e308, -1e308, 1e-320, 10**400, np.nan, np.inf, -np.inf]),
)
KINDS = st.sampled_from(
    [None, "", "x", "nan", b"x", [], {}, (), [None], [[1.0], [1.0, 2.0]], object(), True, 10**400]
)
ODD = st.one_of(NUMBERS, KINDS, st.lists(NUMBERS, max_size=4))


def arrays_like(good):
    """Arrays with another type, shape or content than a valid one."""
    plain = np.asarray(good, float)
    odd = [
        plain[..., :0], plain[..., :1], plain[np.newaxis], plain.T, plain * 1e308, plain * np.nan,
        plain * np.inf, plain + 1j, plain.astype(str), plain.astype(object), plain.ravel()[0],
        plain.astype("M8[s]"), -plain,
    ]  # fmt: skip
    return st.sampled_from(odd)


def odd_for(good):
    return st.one_of(ODD, arrays_like(good)) if isinstance(good, np.ndarray) else ODD


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", specs())
@settings(max_examples=40, deadline=None, derandomize=True, database=None,
          suppress_health_check=list(HealthCheck))  # fmt: skip
@given(data=st.data())
def test_odd_argument_is_named_or_the_answer_is_finite(name, data):
    spec = specs()[name]
    argument = data.draw(st.sampled_from(sorted(spec.good)))
    value = data.draw(odd_for(spec.good[argument]))
    assert trial(spec, {argument: value}) == ""


@pytest.mark.parametrize(
    ("name", "argument", "value"),
    [
        ("sleeve.layout", "deviation", -1), ("sleeve.layout", "reach", np.nan),
        ("waves.Pulse", "frequency", np.inf), ("signals.locate", "temperature", np.inf),
        ("signals.locate", "samples", np.full((3, 1200), 1j)),
        ("signals.locate", "samples", np.full((3, 1200), 1e308)),
        ("signals.process", "offset_cutoff", 0), ("signals.process", "prominence", None),
        ("sleeve.design", "length", 0), ("estimation.Decoder", "frame_bytes", 0),
        ("press.indent", "depth", -1e-3), ("press.indent", "depth", np.nan),
        ("fields.propagate", "duration", np.inf), ("fields.cut_cells", "spacing", 0.0),
        ("fields.stable_step", "air", 343.0), ("estimators.network.fit", "X", "words"),
        ("estimators.load_config", "depth_mm", -1), ("estimators.load_plan", "count", None),
        ("estimators.echo.fit", "X", np.full((60, 2), np.nan)),
        ("estimators.boosting.fit", "y", np.full(60, np.nan)),
        ("estimators.network.fit", "y", np.ones(60)), ("estimators.network.fit", "n_folds", 60),
        ("signals.process", "offset_cutoff", 1e6), ("signals.remove_offset", "cutoff", 1e6),
        ("signals.template", "frequency", 1e-3),
        ("signals.calibrate", "blocked", np.ones((8, 1))),
        ("signals.calibrate", "untouched", np.ones((0, 1200))),
        ("sleeve.design", "lead", 2), ("sleeve.design", "length", 60),
        ("sleeve.design", "n_tubes", 60), ("walls.decimate_rings", "inner", np.ones((1, 2, 3))),
        ("walls.profile", "vertices", np.ones((1, 3))),
        ("walls.straighten", "line", np.ones((1, 3))), ("signals.process", "pulse_duration", 1e6),
        ("waves.bend", "angle", 1e-320), ("waves.bend", "bend_radius", 1000.0),
        ("waves.probe_pressure", "duration", 1000.0), ("waves.probe_pressure", "length", 1e-3),
        ("waves.modes_below", "sound_speed", 1.0), ("waves.cut_ons_in_band", "sound_speed", 1.0),
        ("waves.Pulse", "frequency", np.timedelta64(42, "s")), ("inversion.Baseband", "length", -1),
        ("inversion.Baseband", "n_samples", 10**7), ("inversion.Inverter", "model", None),
        ("inversion.measured_clutter", "counts", np.ones((0, 1600))),
        ("inversion.measured_clutter", "counts", np.ones((2, 3))),
        ("inversion.Tool", "frequency", np.arange(84.0) ** 2), ("inversion.Tool", "s", None),
        ("inversion.update", "elapsed", 1e308), ("inversion.force_at", "depth", "deep"),
        ("signals.rectify", "pressure", np.ma.masked_equal(np.arange(9.0), 4)),
        ("signals.rectify", "pressure", {1.0}), ("twin.fit_material", "presses", []),
        ("twin.fit_twin", "humidity", np.nan), ("twin.Group", "cycles", np.ones(9)),
    ],
)  # fmt: skip
def test_nonsense_is_refused_with_the_name_of_the_argument(name, argument, value):
    spec = specs()[name]
    with pytest.raises(ValueError, match=rf"\b{argument}\b"):
        spec.function(**(dict(spec.good) | {argument: value}))


@pytest.mark.parametrize("name", specs())
def test_good_arguments_are_taken(name):
    spec = specs()[name]
    assert spec.function(**spec.good) is not None or name in {
        "sleeve.check_reach",
        "sleeve.check_room",
    }


class NoPath:
    def __fspath__(self):
        return 3


@pytest.mark.parametrize(
    "value", [3.0, None, b"a.npz", "a\0b.npz", "x" * 5000, np.ones(2), NoPath()]
)
@pytest.mark.parametrize(
    ("place", "argument"),
    [("recordings:read", "path"), ("recordings:find", "paths"), ("estimation:load", "path"),
     ("runs.opening:open_dataset", "where"), ("runs.scattering_file:read", "path"),
     ("runs.libraries.files:open_library", "path"), ("reports.page:read", "where")],
)  # fmt: skip
def test_what_is_no_name_of_a_file_is_refused_by_its_argument(place, argument, value):
    module, _, name = place.partition(":")
    call = getattr(import_module(f"acoustube.{module}"), name)
    with pytest.raises(ValueError, match=rf"\b{argument} = "):
        call(value)


def test_what_is_no_dataset_or_model_is_not_written(tmp_path):
    from acoustube import estimation, recordings

    with pytest.raises(ValueError, match="dataset = "):
        recordings.write(None, tmp_path / "a.nc")
    with pytest.raises(ValueError, match="model = "):
        estimation.save(None, tmp_path / "a.model")
    with pytest.raises(ValueError, match="cycles = "):
        estimation.groups(None, "tube")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("argument", "value"),
    [("settings", None), ("temperature", ["warm"]), ("temperature", [-300.0]), ("radius", "wide"),
     ("radius", -4e-3)],
)  # fmt: skip
def test_features_of_nonsense_are_refused(argument, value):
    from acoustube.estimation.features import echo_features
    from acoustube.signals import Processing

    good = {"time": np.arange(1200) / 200e3, "signal": np.ones((1, 1200)),
            "temperature": np.array([20.0]), "settings": Processing(), "radius": 4e-3}  # fmt: skip
    with pytest.raises(ValueError, match=argument):
        echo_features(**(good | {argument: value}))
