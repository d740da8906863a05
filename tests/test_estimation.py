"""Splits, errors, intervals, features and model files, against hand calculations."""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from labelled_cycles import BAND, HOW, SENSOR, cycles
from refusals import refused
from sklearn.base import clone
from sklearn.ensemble import HistGradientBoostingRegressor

from acoustube import estimation, signals
from acoustube.base.errors import ConfigError
from acoustube.cli.cite import OF_ESTIMATORS, topics_of
from acoustube.estimation import Boosting, EchoEnsemble, FeatureSettings, errors, uncertainty
from acoustube.estimation.trees import export_trees, predict_trees
from acoustube.ranging import blockage, record

ECHO = FeatureSettings(kind="echo", processing=HOW)
QUICK = {
    "network": {"n_folds": 3, "epochs": 3},
    "echo": {"n_folds": 3, "epochs": 3},
    "boosting": {"n_folds": 3, "max_iter": 10},
}


@pytest.fixture(scope="module")
def recorded():
    return cycles(90)


@pytest.fixture(scope="module")
def tables(recorded):
    return {
        kind: estimation.feature_table(recorded, FeatureSettings(kind=kind, processing=HOW))
        for kind in ("paper", "echo")
    }


@pytest.fixture(scope="module")
def models(tables):
    kinds = {"network": "paper", "echo": "echo", "boosting": "echo"}
    return {
        name: estimation.train(
            tables[kind], name, FeatureSettings(kind=kind, processing=HOW), **QUICK[name]
        )
        for name, kind in kinds.items()
    }


# ---------------------------------------------------------------------------------------------
# Splits


def grouped():
    """Return cycles of two tubes with sessions of the same numbers."""
    tube = np.repeat(["a", "b"], [40, 20])
    session = np.repeat([0, 1, 2, 0, 1], [10, 10, 20, 5, 15])
    return xr.Dataset({"tube": ("cycle", tube), "session": ("cycle", session)})


def test_a_session_of_one_tube_is_not_that_of_another():
    data = grouped()
    assert len(set(estimation.groups(data, "session"))) == 5
    assert len(set(estimation.groups(data, "tube"))) == 2
    assert len(set(estimation.groups(data, "cycle"))) == 60


@pytest.mark.parametrize("by", ["session", "tube"])
def test_no_group_is_in_two_folds_or_on_both_sides_of_a_split(by):
    group = estimation.groups(grouped(), by)
    fold = estimation.folds(group, 2, seed=1)
    assert all(len(set(fold[group == g])) == 1 for g in set(group))
    train, test = estimation.split(group, 0.3, seed=1)
    assert not set(group[train]) & set(group[test])
    assert sorted([*train, *test]) == list(range(60))
    assert test.size


def test_folds_of_single_rows_differ_by_one_row_and_by_the_seed():
    fold = estimation.folds(np.arange(103), 10, seed=4)
    assert sorted(np.bincount(fold)) == [10] * 7 + [11] * 3
    assert np.array_equal(fold, estimation.folds(np.arange(103), 10, seed=4))
    assert not np.array_equal(fold, estimation.folds(np.arange(103), 10, seed=5))


def test_folds_of_uneven_groups_hold_about_as_many_rows():
    fold = estimation.folds(np.repeat(np.arange(6), [50, 30, 20, 10, 5, 5]), 2)
    assert sorted(np.bincount(fold)) == [60, 60]


def test_what_cannot_be_split_is_refused():
    with pytest.raises(ConfigError, match="no label tube"):
        estimation.groups(grouped().drop_vars("tube"), "tube")
    refused(lambda: estimation.groups(grouped(), "day"), setting="by", value="day")
    with pytest.raises(ConfigError, match="3 folds cannot be made of 2 groups"):
        estimation.folds([0, 0, 1], 3)
    with pytest.raises(ConfigError, match="one group of cycles cannot be split"):
        estimation.split([7, 7])
    refused(lambda: estimation.split([0, 1], 1.5), setting="share", value=1.5)


# ---------------------------------------------------------------------------------------------
# Errors


def test_errors_are_the_papers_measures_by_hand():
    truth = np.array([1.0, 2.0, 4.0, 0.0, np.nan])
    found = errors(truth, [2.0, 2.5, 2.0, 0.25, 9.0], [1.0, 0.1, 3.0, 0.1, 1.0], np.full(5, 1.5))
    assert found.n == 4
    assert found.median == pytest.approx(0.75)  # of 0.25, 0.5, 1, 2
    assert found.rmse == pytest.approx(np.sqrt((1 + 0.25 + 4 + 0.0625) / 4))
    assert found.iqr == pytest.approx(1.25 - 0.4375)
    assert found.relative == pytest.approx(0.5)  # of 1, 0.25, 0.5: none for a truth of zero
    assert found.bias == pytest.approx(0.375)
    assert (found.covered, found.covered_wide) == (0.5, 0.75)


def test_no_estimates_have_no_errors():
    found = errors([1.0, 2.0], [np.nan, np.nan])
    assert found.n == 0
    assert np.isnan([found.median, found.rmse, found.relative, found.covered]).all()


def test_bins_hold_values_at_their_lower_edge_to_rounding():
    edges, index = estimation.bins([0.2, 0.2499, 0.25 - 1e-12, 0.3, np.nan], 0.05)
    assert edges == pytest.approx(np.array([[0.2, 0.25], [0.25, 0.3], [0.3, 0.35]]))
    assert list(index) == [0, 0, 1, 2, -1]
    places = np.arange(20, 211) / 100
    assert len(estimation.bins(places[places < 2.1], 0.05)[0]) == 38  # the paper's


# ---------------------------------------------------------------------------------------------
# Uncertainty


def test_conformal_quantile_is_the_rank_of_the_textbook():
    """For scores 1 to 99 of scale 2, the factor at level p is the (100 p)-th score, over 2."""
    quantiles = uncertainty.conformal_quantiles(np.arange(1.0, 100)[::-1], np.full(99, 2.0))
    assert uncertainty.factor(quantiles, 0.9) == pytest.approx(45.0)
    assert uncertainty.factor(quantiles, 0.5) == pytest.approx(25.0)
    assert uncertainty.factor(quantiles, 0.905) == pytest.approx(45.25)
    refused(
        lambda: uncertainty.factor(quantiles, 1.0),
        setting="coverage", value=1.0, allowed=(0.01, 0.995),
    )  # fmt: skip


def test_residual_scale_follows_noise_that_grows():
    """The noise is 0.1 + estimate; the deviation in bins of 1000 rows is known to 5 %."""
    rng = np.random.default_rng(0)
    estimate = rng.uniform(0, 2, 20_000)
    at, scale = uncertainty.residual_scale(estimate, rng.normal(size=20_000) * (0.1 + estimate))
    assert len(at) == uncertainty.MAX_BINS
    assert scale == pytest.approx(0.1 + at, rel=0.15)


def uneven(count, seed):
    """Return rows whose noise in the first target depends on the second input."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, 1, (count, 4))
    noise = rng.normal(size=(count, 2)) * np.stack([0.1 + 0.4 * x[:, 1], np.full(count, 0.2)], -1)
    y = np.stack([x[:, 3] + np.sin(3 * x[:, 0]), x[:, 0] * x[:, 2]], axis=-1) + noise
    return x, y


@pytest.mark.slow
@pytest.mark.parametrize(
    "estimator",
    [
        EchoEnsemble(n_folds=5, epochs=15, offset_columns=(3, None)),
        Boosting(max_iter=40, offset_columns=(3, None)),
    ],
)
def test_intervals_of_estimators_with_several_targets_have_the_stated_coverage(estimator):
    """Coverage of 2000 new rows is within 5 and 3.5 points of the stated one.

    The binomial deviations are 1 and 0.7 %, and as much by the 3000 held-out rows. The mean of the
    folds is a little more accurate than the single ones for which the intervals are computed.
    """
    estimator = clone(estimator).fit(*uneven(3000, 1))
    x, truth = uneven(2000, 2)
    estimate, deviation = estimator.predict(x, return_std=True)
    wide = estimator.half_width(x, 0.9)
    assert estimate.shape == deviation.shape == wide.shape == (2000, 2)
    for column in range(2):
        found = errors(*(a[:, column] for a in (truth, estimate, deviation, wide)))
        assert found.covered == pytest.approx(0.683, abs=0.05)
        assert found.covered_wide == pytest.approx(0.9, abs=0.035)
    ratio = np.median(deviation[x[:, 1] > 0.8, 0]) / np.median(deviation[x[:, 1] < 0.2, 0])
    assert ratio > 2  # of noises of 0.46 and 0.14
    # Noise of a median size of 0.18 and 0.13, plus the error of the estimators.
    assert np.all(np.median(np.abs(estimate - truth), axis=0) < [0.22, 0.16])


def test_a_target_learned_as_an_addition_is_exact_where_nothing_is_to_be_added():
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 1, (200, 3))
    y = np.stack([x[:, 1] + 1e-3 * x[:, 0], x[:, 0]], axis=-1)
    model = EchoEnsemble(n_folds=2, epochs=5, offset_columns=(1, None)).fit(x, y)
    far = x + np.array([0, 1e3, 0])
    assert model.predict(far)[:, 0] == pytest.approx(far[:, 1], abs=2e-3)
    assert model.predict(far)[:, 1] == pytest.approx(model.predict(x)[:, 1])


def test_exported_trees_predict_as_scikit_learn_does():
    x, y = uneven(600, 3)
    models = [
        HistGradientBoostingRegressor(max_iter=n, max_leaf_nodes=leaves).fit(x, y[:, n % 2])
        for n, leaves in ((1, 2), (20, 31))
    ]
    found = predict_trees(export_trees(models), x)
    assert found == pytest.approx(np.stack([model.predict(x) for model in models]), abs=1e-12)


# ---------------------------------------------------------------------------------------------
# Features


def test_level_of_a_closure_is_the_same_wherever_and_however_warm_it_is():
    """The level, corrected for the path, is constant to 0.5 dB over 0.9 m and 12 K.

    The echo itself falls by 13 dB. The correction at the carrier is used for the pulse's whole
    band, and for the temperature that the board reports, 0.5 K too high.
    """
    found = []
    for place, warmth in ((0.3, 18.0), (0.3, 30.0), (0.75, 18.0), (1.2, 18.0), (1.2, 30.0)):
        data = record([blockage(BAND[[0, -1]], place)], SENSOR, temperature=warmth)
        features = estimation.feature_table(data, ECHO)["features"].to_series().unstack().iloc[0]
        found.append([features["level"], features["spectrum_42.0_khz"], features["distance"]])
        middle = [features[f"spectrum_{f:.1f}_khz"] for f in (41.0, 42.0, 43.0)]
        found[-1] += [middle[2] - middle[0]]
    level, spectrum, distance, tilt = np.array(found).T
    assert np.ptp(level) < 0.5
    assert np.ptp(spectrum) < 0.5
    assert np.ptp(tilt) < 0.5
    assert distance - [0.3, 0.3, 0.75, 1.2, 1.2] == pytest.approx(np.full(5, 0.04), abs=0.02)


def test_bore_of_a_sweeps_cycles_is_that_of_their_features(recorded):
    """Attenuation, which is removed from levels, depends on the bore."""
    one = recorded.isel(cycle=slice(5, 6)).drop_attrs(deep=False)
    one.attrs["sampling_rate"] = recorded.attrs["sampling_rate"]
    levels = [
        estimation.feature_table(one.assign(given), ECHO)["features"].sel(feature="level").item()
        for given in (
            {"bore_radius": ("cycle", [2.5e-3])},
            {"inner_diameter": ("cycle", [5e-3], {"units": "m"})},
            {"inner_diameter": ("cycle", [5.0])},
        )
    ]  # fmt: skip
    assert levels[0] == levels[1]
    assert abs(levels[2] - levels[0]) > 0.1


def test_features_reach_the_ends_of_the_temperatures_and_not_beyond(recorded):
    one = recorded.isel(cycle=slice(0, 1))
    near, end = (
        estimation.feature_table(one.assign(temperature=("cycle", [warmth])), ECHO)["features"]
        for warmth in (59.999, 60.0)
    )
    assert end.values == pytest.approx(near.values, abs=1e-3)
    with pytest.raises(ConfigError, match="is outside -20 to 60 degC"):
        estimation.feature_table(one.assign(temperature=("cycle", [60.001])), ECHO)


def test_features_of_pieces_are_those_of_single_cycles(recorded, tables):
    some = recorded.isel(cycle=slice(3, 5))
    alone = estimation.feature_table(some, ECHO)["features"]
    assert alone.values == pytest.approx(tables["echo"]["features"].values[3:5], abs=1e-9)
    assert list(alone["feature"].values) == list(estimation.features.names(ECHO))


def test_paper_features_are_those_of_the_processing(recorded, tables):
    ranging = signals.locate(
        recorded["time"], recorded["signal"], HOW, temperature=recorded["temperature"]
    )
    assert list(tables["paper"]["feature"].values) == ["amplitude", "distance"]
    found = tables["paper"]["features"].values
    assert np.array_equal(found[:, 0], ranging.amplitude, equal_nan=True)
    assert np.array_equal(found[:, 1], ranging.distance, equal_nan=True)


def test_a_cycle_without_an_echo_has_no_features_and_no_estimate(models):
    time = np.arange(4000) / 200e3
    quiet = np.where(time < 3e-4, np.sin(2 * np.pi * 42e3 * time), 0.0)[None]
    data = xr.Dataset(
        {"signal": (("cycle", "time"), quiet), "temperature": ("cycle", [20.0])}, {"time": time}
    )
    for name, model in models.items():
        found = estimation.estimate(model, estimation.feature_table(data, model.feature_settings))
        assert np.isnan(found["force"]).all(), name


# ---------------------------------------------------------------------------------------------
# Models


def test_echo_estimators_find_distance_and_depth_of_new_presses(tables):
    """Presses of another seed: errors below a third of the spread of depths, and below 2 cm."""
    model = estimation.train(tables["echo"], "echo", ECHO, n_folds=5, epochs=60)
    fresh = cycles(25, seed=9)
    found = estimation.estimate(model, estimation.feature_table(fresh, ECHO))
    depth = errors(fresh["depth"], found["depth"])
    assert depth.median < np.std(fresh["depth"].values) / 3
    assert errors(fresh["true_distance"], found["distance"]).median < 0.02
    assert found["depth"].attrs["units"] == "m"


@pytest.mark.parametrize("name", ["network", "echo", "boosting"])
def test_a_saved_model_gives_the_same_estimates(name, models, tables):
    model = models[name]
    estimation.save(model, "a.model")
    loaded = estimation.load("a.model")
    assert loaded.targets == model.targets
    assert loaded.feature_settings == model.feature_settings
    assert loaded.estimator.get_params() == model.estimator.get_params()
    table = tables["paper" if name == "network" else "echo"]
    before, after = (estimation.estimate(m, table) for m in (model, loaded))
    xr.testing.assert_identical(before, after)
    assert topics_of(Path("a.model")) == OF_ESTIMATORS[name]


def rewritten(change, source="a.model", target="b.model"):
    """Write a model once more after a change of its arrays."""
    with np.load(source) as archive:
        arrays = {name: archive[name] for name in archive.files}
    change(arrays)
    with Path(target).open("wb") as file:
        np.savez(file, **arrays)
    return target


def header_with(**words):
    def change(arrays):
        arrays["header"] = np.array(json.dumps(json.loads(str(arrays["header"])) | words))

    return change


def test_a_model_of_another_format_is_refused_with_its_versions(models):
    estimation.save(models["network"], "a.model")
    name = rewritten(header_with(format=99, acoustube_version="7.1"))
    with pytest.raises(ConfigError, match=r"by acoustube 7\.1 in format 99.*reads format 1; train"):
        estimation.load(name)


def broken_trees(arrays):
    arrays["mean_left"][0] = 0  # a walk that never ends


def past_the_end(arrays):
    arrays["mean_feature"][0] = 10_000


def nan_weights(arrays):
    arrays["weights_1"][0, 0, 0] = np.nan


def narrow_weights(arrays):
    arrays["weights_1"] = arrays["weights_1"][:, :, :-1]


def processing_with(**words):
    def change(arrays):
        header = json.loads(str(arrays["header"]))
        header["processing"] |= words
        arrays["header"] = np.array(json.dumps(header))

    return change


def dates_in_trees(arrays):
    arrays["mean_value"] = arrays["mean_value"].astype("M8[s]")


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("boosting", dates_in_trees, "trees of the mean are invalid"),
        ("echo", header_with(radius=1e-8), "radius = 1e-08 is out of range"),
        ("echo", processing_with(template_cycles=1e308), "template_cycles"),
        ("echo", processing_with(offset_cutoff=1e-320), "offset_cutoff"),
        ("echo", processing_with(frequency=1e-9), "frequency"),
        ("boosting", broken_trees, "trees of the mean are invalid"),
        ("boosting", past_the_end, "trees of the mean are invalid"),
        ("network", nan_weights, "its weights_1"),
        ("echo", narrow_weights, "its weights_1"),
        ("network", header_with(kind="song"), "it is a song"),
        ("network", header_with(targets=["taste"]), "network does not estimate taste"),
        ("network", header_with(settings={"cheese": 1}), "cheese"),
        ("network", lambda arrays: arrays.pop("quantiles"), "quantiles"),
        ("network", header_with(origin={}), "it has no cycles"),
        ("network", header_with(sampling_rate=1e308), "sampling_rate = 1e\\+308 is out of range"),
        ("network", header_with(radius="wide"), "could not convert"),
        ("network", lambda arrays: arrays.update(scale=np.float64(1)), "tuple index out of range"),
    ],
)
def test_a_damaged_model_is_refused(name, change, words, models):
    estimation.save(models[name], "a.model")
    with pytest.raises(ConfigError, match=f"is not a model .*{words}"):
        estimation.load(rewritten(change))


def test_model_whose_estimates_overflow_is_refused(models, tables):
    def huge(arrays):
        arrays["weights_2"] = np.full_like(arrays["weights_2"], 1e38)

    estimation.save(models["network"], "a.model")
    with pytest.raises(ConfigError, match="not finite"):
        estimation.estimate(estimation.load(rewritten(huge)), tables["paper"])


def test_what_is_no_model_is_refused_and_nothing_in_it_is_run():
    with Path("a.model").open("wb") as file:
        pickle.dump({"header": 1}, file)
    np.savez("b.npz", header=np.array([{"kind": "acoustube model"}], dtype=object))
    Path("c.model").write_text("nothing")
    for name, words in (
        ("a.model", " is not a model"),
        ("b.npz", ": header is an array of Python objects, which could run code"),
        ("c.model", " is not a model"),
        ("missing.model", " cannot be read .No such file"),
    ):
        with pytest.raises(ConfigError, match=f"{name}{words}"):
            estimation.load(name)


def test_cycles_of_another_rate_are_refused(models, tables):
    other = tables["paper"].assign_attrs(sampling_rate=80e3)
    with pytest.raises(ConfigError, match="80000 samples per second, and the model was trained wi"):
        estimation.estimate(models["network"], other)


def test_labels_that_teach_nothing_are_refused(tables):
    table = tables["echo"]
    for change, words in (
        (table.drop_vars(["depth", "force", "true_distance"]), "no label true_distance or depth"),
        (table.assign(depth=0 * table["depth"] + 2e-3), "depth is 0.002 m in all cycles"),
        (table.isel(cycle=slice(20)), "20 of 20 cycles have an echo and the labels"),
        (table.assign(force=table["force"].where(table["force"] > 3)), "too few to train with"),
    ):
        with pytest.raises(ConfigError, match=words):
            estimation.train(change, "echo", ECHO, **QUICK["echo"])


def test_features_of_another_estimator_or_other_settings_are_refused(tables):
    paper = FeatureSettings(kind="paper", processing=HOW)
    other = FeatureSettings(kind="echo", processing=replace(HOW, frequency=40e3))
    for table, name, how, words in (
        ("paper", "echo", paper, 'feature_settings.kind = paper does not fit echo; use "echo"'),
        ("echo", "network", ECHO, 'does not fit network; use "paper"'),
        ("paper", "boosting", ECHO, "table has 2 features that are not those of feature_settings"),
        ("echo", "echo", other, "table has 44 features that are not those of feature_settings"),
    ):
        with pytest.raises(ConfigError, match=words):
            estimation.train(tables[table], name, how, **QUICK[name])


def test_uncertainty_can_be_stated_for_new_sessions(tables):
    model = estimation.train(tables["echo"], "echo", ECHO, by="session", **QUICK["echo"])
    assert model.origin["by"] == "session"
    with pytest.raises(ConfigError, match="3 folds cannot be made of 1 group of cycles; split"):
        estimation.train(tables["echo"], "echo", ECHO, by="tube", **QUICK["echo"])
