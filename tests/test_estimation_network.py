"""The force network's parts against hand calculations and scikit-learn."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.neural_network import MLPRegressor

from acoustube.base.errors import ConfigError
from acoustube.estimation import Boosting, EchoEnsemble, ForceNetwork, errors, folds, network

RNG = np.random.default_rng(0)
ROWS = 103
"""Rows of most tests, in four unequal folds; other numbers of rows need another compilation."""


def forces(count, seed=0, noise=0.2):
    """Return amplitude and distance, and a smooth force with noise."""
    rng = np.random.default_rng(seed)
    x = np.stack([rng.uniform(0, 1, count), rng.uniform(0.2, 2, count)], axis=-1)
    return x, 3 * x[:, 0] * x[:, 1] + noise * rng.normal(size=count)


def test_initial_weights_have_hes_variance_and_shapes():
    """The variance is 2 / fan_in: to 2 % of 50 x 4096 numbers (known to 0.3 %), to 5 % of fewer."""
    keys = jax.random.split(jax.random.key(1), 50)
    layers = jax.vmap(lambda key: network.initial(key, (2, 64, 64, 1)))(keys)
    assert [w.shape[1:] for w, _ in layers] == [(2, 64), (64, 64), (64, 1)]
    assert [b.shape[1:] for _, b in layers] == [(64,), (64,), (1,)]
    for weights, bias in layers:
        assert float(jnp.var(weights)) == pytest.approx(2 / weights.shape[1], rel=0.05)
        assert not np.any(bias)
    assert float(jnp.var(layers[1][0])) == pytest.approx(2 / 64, rel=0.02)
    assert all(a.dtype == np.float32 for layer in layers for a in layer)


def test_outputs_are_leaky_layers_by_hand():
    """Outputs in single precision are compared with double: errors of 1e-6 in 64 terms, twice."""
    layers = [(RNG.normal(size=s), RNG.normal(size=s[1])) for s in ((2, 64), (64, 64), (64, 1))]
    x = RNG.normal(size=(9, 2))
    hidden = x
    for weights, bias in layers[:-1]:
        z = hidden @ weights + bias
        hidden = np.maximum(z, 0.01 * z)
    wanted = hidden @ layers[-1][0] + layers[-1][1]
    single = jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), layers)
    found = network.outputs(single, jnp.asarray(x, jnp.float32))
    assert np.asarray(found) == pytest.approx(wanted, rel=1e-4, abs=1e-4)


def adam_by_hand(x, y, weights, bias, steps, rate=1e-2, decay=1e-2):
    """Return a linear model after steps of Adam on all rows, with the decay in the gradient."""
    p = np.append(weights, bias)
    m = v = np.zeros_like(p)
    for t in range(1, steps + 1):
        off = x @ p[:-1] + p[-1] - y
        g = 2 * np.append(x.T @ off, off.sum()) / len(y) + decay * p
        m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g**2
        p = p - rate * (m / (1 - 0.9**t)) / (np.sqrt(v / (1 - 0.999**t)) + 1e-8)
    return p


def test_training_takes_adams_steps_by_hand_on_each_folds_own_standards():
    """A linear network, one batch of 50 training rows: Adam's method in double precision.

    Seven steps; single precision leaves 1e-5 of a weight. The bias is left out: for standardised
    rows its gradient is zero, and Adam divides its rounding error by its own size.
    """
    x, y = forces(100)
    x[:50] += 3.0  # so that the folds' standards differ
    fold = np.repeat([0, 1], 50)
    fitted = network.train(
        x, y[:, None], fold, hidden=(), epochs=7, batch_size=50, learning_rate=1e-2,
        weight_decay=1e-2, seed=5,
    )  # fmt: skip
    keys = jax.random.split(jax.random.key(5), 2)
    for k in range(2):
        a, b = x[fold != k], y[fold != k]
        assert fitted.scaler.x_mean[k] == pytest.approx(a.mean(axis=0))
        assert fitted.scaler.y_deviation[k] == pytest.approx(b.std())
        first, zero = network.initial(keys[k], (2, 1))[0]
        a, b = (a - a.mean(axis=0)) / a.std(axis=0), (b - b.mean()) / b.std()
        wanted = adam_by_hand(a, b, np.asarray(first, float)[:, 0], np.asarray(zero, float), 7)
        assert fitted.layers[0][0][k, :, 0] == pytest.approx(wanted[:-1], abs=1e-5)


def test_decay_is_in_the_gradient_and_not_beside_adams_step():
    """A large parameter with zero gradient moves by the rate, not by rate * decay * p."""
    step = network.optimiser(1e-3, 1e-5)
    parameter = jnp.array([100.0])
    change, _ = step.update(jnp.zeros(1), step.init(parameter), parameter)
    # The gradient is 1e-3; Adam's epsilon of 1e-8 takes 1e-5 of the step.
    assert float(change[0]) == pytest.approx(-1e-3, rel=1e-4)
    beside = optax.adamw(1e-3, weight_decay=1e-5)
    other, _ = beside.update(jnp.zeros(1), beside.init(parameter), parameter)
    assert float(other[0]) == pytest.approx(-1e-6, rel=1e-4)


def test_an_epoch_holds_every_training_row_once_and_no_held_out_one():
    fold = folds(np.arange(101), 10, seed=3)
    order = network.batches(np.random.default_rng(0), fold, 10, 16)
    assert order.shape == (6, 10, 16)  # 91 rows at most
    for k in range(10):
        rows = order[:, k].ravel()
        own = np.flatnonzero(fold != k)
        assert set(rows) == set(own)
        assert sorted(rows[: own.size]) == list(own)


def test_held_out_rows_do_not_affect_their_network():
    x, y = forces(ROWS)
    fold = folds(np.arange(ROWS), 4)
    changed_x, changed_y = x.copy(), y.copy()
    changed_x[fold == 1] *= 5
    changed_y[fold == 1] -= 40
    # The mean of all rows is a shift before rounding: it changes single-precision results by 1e-5.
    plain, changed = (
        network.train(a, b[:, None], fold, epochs=3) for a, b in ((x, y), (changed_x, changed_y))
    )
    for one, other in zip(plain.layers, changed.layers, strict=True):
        for a, b in zip(one, other, strict=True):
            assert a[1] == pytest.approx(b[1], abs=1e-3)
            assert np.abs(a[2] - b[2]).max() > 1e-2 or a[2].size == 1
    assert plain.training[1] == pytest.approx(changed.training[1], rel=1e-3)


def test_validation_loss_is_the_mean_square_of_the_held_out_rows():
    x, y = forces(ROWS)
    fold = folds(np.arange(ROWS), 4)
    fitted = network.train(x, y[:, None], fold, epochs=2)
    own = network.predict(fitted, x)[fold, np.arange(ROWS), 0]
    scales = fitted.scaler
    truth = (y - scales.y_mean[fold, 0]) / scales.y_deviation[fold, 0]
    wanted = [np.mean((own - truth)[fold == k] ** 2) for k in range(4)]
    assert fitted.validation[:, -1] == pytest.approx(wanted, rel=1e-4)


def test_folds_are_weighted_by_inverse_validation_loss():
    found = network.weights(np.array([[9.0, 1.0], [9.0, 2.0], [1.0, 4.0]]))
    assert found == pytest.approx(np.array([4, 2, 1]) / 7)


def test_any_number_of_folds_compiles_one_step(compilations):
    """Eleven folds compile as often as seven, and another seed compiles nothing.

    No other test has these numbers of rows and folds: JAX keeps what one compiled in the process.
    """
    x, y = forces(211)

    def compiled(n_folds, seed):
        before = len(compilations)
        fold = folds(np.arange(211), n_folds)
        network.train(x, y[:, None], fold, epochs=2, hidden=(4,), seed=seed)
        return len(compilations) - before

    compiled(2, 0)  # what is compiled once for all
    assert compiled(11, 0) == compiled(7, 0) > 0
    assert compiled(11, 1) == 0


def test_same_seed_trains_the_same_network_and_another_another():
    x, y = forces(ROWS)
    one, same, other = (
        ForceNetwork(epochs=2, n_folds=4, seed=seed).fit(x, y).predict(x[:5])
        for seed in (1, 1, 2**32 - 1)
    )
    assert np.array_equal(one, same)
    assert not np.allclose(one, other)


def test_prediction_is_the_weighted_mean_of_the_folds():
    x, y = forces(ROWS)
    model = ForceNetwork(epochs=3, n_folds=4).fit(x, y)
    out = network.predict(model.networks_, x[:6])[..., 0]
    each = model.networks_.scaler.y_mean + model.networks_.scaler.y_deviation * out
    assert model.predict(x[:6]) == pytest.approx(model.weights_ @ each)
    assert model.weights_ == pytest.approx(network.weights(model.networks_.validation))
    assert model.networks_.training.shape == model.networks_.validation.shape == (4, 3)


def test_large_offsets_lose_nothing():
    """1e5 +- 1 is learned as well as 0 +- 1, at a single-precision resolution of 0.008."""
    x, y = forces(400)
    near = ForceNetwork(epochs=5, n_folds=3).fit(x, y).predict(x)
    far = ForceNetwork(epochs=5, n_folds=3).fit(x + 1e4, y + 1e5).predict(x + 1e4)
    assert far - 1e5 == pytest.approx(near, abs=1e-2)


@pytest.mark.parametrize(
    "model",
    [ForceNetwork(n_folds=4, epochs=2), EchoEnsemble(n_folds=2, epochs=1, hidden=(4,)),
     Boosting(n_folds=2, max_iter=3)],
)  # fmt: skip
def test_estimator_follows_scikit_learns_conventions(model):
    assert clone(model).get_params() == model.get_params()
    model, (x, y) = clone(model), forces(ROWS)
    with pytest.raises(NotFittedError):
        model.predict(x)
    assert model.fit(x, y) is model
    assert np.isfinite(model.score(x, y))
    for n in (ROWS, 0):
        estimate, deviation = model.predict(x[:n], return_std=True)
        assert estimate.shape == deviation.shape == model.half_width(x[:n]).shape == (n,)


@pytest.mark.parametrize(
    ("columns", "words"),
    [((2,), "each of offset_columns = 2 is out of range; use a whole number from 0 to 1"),
     (0, "offset_columns = 0 is not a sequence"), ((0, 1), "takes all columns of X")],
)  # fmt: skip
def test_offset_columns_that_cannot_be_are_refused(columns, words):
    x, y = forces(ROWS)
    y = np.stack([y, y], axis=-1) if columns == (0, 1) else y
    with pytest.raises(ConfigError, match=words):
        EchoEnsemble(n_folds=2, epochs=1, offset_columns=columns).fit(x, y)


def test_integers_of_numpy_are_stored_as_pythons():
    model = EchoEnsemble(n_folds=2, epochs=1, hidden=np.array([4]), offset_columns=(np.int8(0),))
    found = model.fit(*forces(ROWS)).get_params()
    assert json.dumps([found["hidden"], found["offset_columns"]]) == "[[4], [0]]"


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        (np.zeros((30, 2)), np.arange(30.0), "X has 30 rows, too few"),
        (np.zeros((80, 2)), np.ones(80), "target 0 of y is 1 in all rows"),
        (
            np.full((80, 2), np.nan),
            np.arange(80.0),
            "X has an input that is not finite in 80 of 80 rows",
        ),
        (
            np.zeros((80, 2)),
            np.full(80, np.inf),
            "y has a target that is not finite in 80 of 80 rows",
        ),
        (np.zeros((80, 2)), np.arange(79.0), "one row of targets for each row"),
        (np.zeros(80), np.arange(80.0), r"X has shape \(80,\)"),
        (np.zeros((80, 2)), np.eye(80)[:, :2], "has one target, not 2"),
    ],
)
def test_what_cannot_be_learned_is_refused(x, y, words):
    with pytest.raises(ConfigError, match=words):
        ForceNetwork().fit(x, y)


def test_inputs_of_another_width_are_refused():
    x, y = forces(ROWS)
    with pytest.raises(ConfigError, match=r"give \(rows, 2\)"):
        ForceNetwork(epochs=1, n_folds=4).fit(x, y).predict(np.zeros((5, 3)))


def test_intervals_have_the_stated_coverage():
    """Coverage of 4000 new rows, whose noise grows with the estimate, is the stated one.

    The binomial deviations are 0.7 and 0.5 %; the intervals come from 3000 held-out rows, which
    adds 0.9 and 0.6 %. The mean of the networks is a little more accurate than the single ones for
    which the intervals are computed.
    """
    rng = np.random.default_rng(1)

    def rows(count):
        x, y = forces(count, seed=count, noise=0.0)
        return x, y + rng.normal(size=count) * (0.1 + 0.4 * x[:, 0] * x[:, 1])

    x, y = rows(3000)
    fresh, truth = rows(4000)
    model = ForceNetwork(epochs=15, n_folds=5).fit(x, y)
    estimate, deviation = model.predict(fresh, return_std=True)
    found = errors(truth, estimate, deviation, model.half_width(fresh, 0.9))
    assert found.covered == pytest.approx(0.683, abs=0.035)
    assert found.covered_wide == pytest.approx(0.9, abs=0.025)
    # Wider where the noise is larger, ideally by 0.74 / 0.12; about half of that is required.
    product = fresh[:, 0] * fresh[:, 1]
    ratio = np.median(deviation[product > 1.2]) / np.median(deviation[product < 0.1])
    assert ratio > 2.5


@pytest.mark.slow
@pytest.mark.long
def test_held_out_loss_is_that_of_scikit_learns_network():
    """Losses of a 64-64-1 network of ReLUs without a leak are within 5 % of scikit-learn's.

    Each varies by 2 % between seeds; both end 3 % above the variance of the noise, which is 0.04.
    """
    x, y = forces(6000)
    fold = folds(np.arange(6000), 10, seed=1)
    own = network.train(x, y[:, None], fold, epochs=40)
    kept = fold != 0
    scale = [(a[kept].mean(axis=0), a[kept].std(axis=0)) for a in (x, y)]
    a, b = ((v - m) / s for v, (m, s) in zip((x, y), scale, strict=True))
    losses = []
    for seed in range(2):
        peer = MLPRegressor(
            hidden_layer_sizes=(64, 64), batch_size=32, alpha=32e-5, max_iter=40,
            n_iter_no_change=1000, random_state=seed,
        )  # fmt: skip
        with pytest.warns(match="Maximum iterations"):
            peer.fit(a[kept], b[kept])
        losses.append(np.mean((peer.predict(a[~kept]) - b[~kept]) ** 2))
    noise = 0.04 / scale[1][1] ** 2
    assert own.validation[0, -1] == pytest.approx(np.mean(losses), rel=0.05)
    assert own.validation[0, -1] == pytest.approx(noise, rel=0.2)
