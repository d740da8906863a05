"""Small fully connected networks, one per fold, trained simultaneously.

The functions are pure, and the first axis of the parameters is the fold. The folds share the rows:
a batch is gathered by index, so that the folds differ in their indices only and one compiled step
trains all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray

# Weights (fan_in, fan_out) and biases (fan_out,) of each layer.
Layers = list[tuple[Any, Any]]
Loss = Literal["squared", "laplace"]
Progress = Callable[[int, float, float], None]
"""Called after each epoch with its number from 1, and the losses of training and validation."""

LEAKY_SLOPE = 0.01
"""Slope of the leaky ReLU for negative inputs, PyTorch's default."""
ROWS_AT_ONCE = 8192
"""Rows evaluated at once, which bounds the memory."""
MAX_LOG_SCALE = 6.0
"""Largest absolute logarithm of a scale: a factor of 400 of the target's standard deviation."""


class Scaler(NamedTuple):
    """Means and standard deviations of inputs (fold, input) and targets (fold, target)."""

    x_mean: Any
    x_deviation: Any
    y_mean: Any
    y_deviation: Any


class FittedNetworks(NamedTuple):
    """Trained networks.

    Attributes
    ----------
    layers : list
        Weights (fold, fan_in, fan_out) and biases (fold, fan_out) of each layer, float32.
    scaler : Scaler
        Means and standard deviations of each fold's training rows.
    training, validation : array of shape (fold, epoch)
        Losses: mean over the batches of an epoch, and of the held-out rows after it.
    """

    layers: Layers
    scaler: Scaler
    training: NDArray[np.float32]
    validation: NDArray[np.float32]


def initial(key: Any, widths: tuple[int, ...]) -> Layers:
    """Return He's initial layers: normal weights of variance 2 / fan_in [1]_, biases zero.

    Parameters
    ----------
    key : jax.Array
        Key of the random numbers.
    widths : tuple of int
        Widths of inputs, hidden layers and outputs.

    References
    ----------
    .. [1] K. He et al., Delving deep into rectifiers, ICCV 2015. doi:10.1109/ICCV.2015.123
    """
    pairs = list(pairwise(widths))
    keys = jax.random.split(key, len(pairs))
    return [
        (np.sqrt(2 / a).astype(np.float32) * jax.random.normal(k, (a, b), jnp.float32),
         jnp.zeros(b, jnp.float32))
        for k, (a, b) in zip(keys, pairs, strict=True)
    ]  # fmt: skip


def outputs(layers: Layers, x: Any) -> Any:
    """Return the outputs (row, output) of one network for standardised inputs (row, input)."""
    for weights, bias in layers[:-1]:
        x = x @ weights + bias[None, :]
        x = jnp.where(x > 0, x, LEAKY_SLOPE * x)
    weights, bias = layers[-1]
    return x @ weights + bias[None, :]


def squared_loss(out: Any, y: Any) -> Any:
    """Return the mean squared error of outputs (row, target)."""
    return jnp.mean((out - y) ** 2)


def laplace_loss(out: Any, y: Any) -> Any:
    """Return the mean negative log likelihood, up to a constant, of Laplace distributed targets.

    The outputs (row, 2 n_targets) are the medians, then the logarithms of the scales, to which
    :func:`bounded` is applied here.
    """
    median, log_scale = jnp.split(out, 2, axis=1)
    log_scale = bounded(log_scale)
    return jnp.mean(jnp.abs(y - median) * jnp.exp(-log_scale) + log_scale)


def bounded(raw: Any) -> Any:
    """Return the logarithm of a scale, bounded to +-:data:`MAX_LOG_SCALE` by a tanh."""
    return MAX_LOG_SCALE * jnp.tanh(raw / MAX_LOG_SCALE)


LOSSES = {"squared": squared_loss, "laplace": laplace_loss}


def optimiser(learning_rate: float, weight_decay: float) -> optax.GradientTransformation:
    """Return Adam [1]_ with the weight decay as an L2 term in the gradient.

    As ``weight_decay`` of PyTorch's Adam: decay times the parameter, biases included, is added to
    the gradient before its moments. AdamW [2]_, which decays parameters separately, is different.

    References
    ----------
    .. [1] D. P. Kingma and J. Ba, Adam: a method for stochastic optimization, ICLR 2015.
       arXiv:1412.6980
    .. [2] I. Loshchilov and F. Hutter, Decoupled weight decay regularization, ICLR 2019.
       arXiv:1711.05101
    """
    return optax.chain(optax.add_decayed_weights(weight_decay), optax.adam(learning_rate))


def fit_scaler(x: NDArray[Any], y: NDArray[Any], fold: NDArray[np.intp], count: int) -> Scaler:
    """Return the means and standard deviations of x and y over each fold's training rows.

    `fold` holds the fold in which each row is held out, from 0 to `count` - 1. A constant column
    has the deviation 1, so that its standardised values are zero.
    """
    found: list[Any] = []
    for data in (x, y):
        parts = [data[fold != k] for k in range(count)]
        mean = np.array([part.mean(axis=0) for part in parts])
        spread = np.array([part.std(axis=0) for part in parts])
        wide = spread > 1e-6 * np.maximum(np.abs(mean), 1e-30)
        found += [mean, np.where(wide, spread, 1.0)]
    return Scaler(*found)


def batches(
    rng: np.random.Generator, fold: NDArray[np.intp], count: int, size: int
) -> NDArray[np.int32]:
    """Return the shuffled row numbers of each batch of an epoch: (step, fold, size).

    Every row of a fold's training set occurs once; the last batch is filled up with the first rows.
    Folds with fewer training rows than the largest repeat their first rows, so that all folds take
    the same number of steps.
    """
    most = len(fold) - int(np.bincount(fold, minlength=count).min())
    steps = -(-most // size)
    rows = np.empty((count, steps * size), np.int32)
    for k in range(count):
        rows[k] = np.resize(rng.permutation(np.flatnonzero(fold != k)), steps * size)
    return rows.reshape(count, steps, size).swapaxes(0, 1)


def train(
    x: NDArray[Any],
    y: NDArray[Any],
    fold: NDArray[np.intp],
    *,
    hidden: tuple[int, ...] = (64, 64),
    loss: Loss = "squared",
    epochs: int = 100,
    batch_size: int = 32,
    learning_rate: float = 1e-3,
    weight_decay: float = 1e-5,
    seed: int = 0,
    progress: Progress | None = None,
) -> FittedNetworks:
    """Train one network per fold on the rows of the other folds, all simultaneously.

    Parameters
    ----------
    x, y : array of shape (row, input), (row, target)
        Not standardised; each fold standardises them by its own training rows.
    fold : array of int of shape (row,)
        Fold in which each row is held out, from 0; no fold is empty.
    hidden : tuple of int
        Widths of the hidden layers.
    loss : str
        ``squared``: an output per target. ``laplace``: a median and the logarithm of a
        scale per target.
    epochs : int
        Number of passes over the training rows.
    batch_size : int
        Number of rows of an optimiser's step.
    learning_rate, weight_decay : float
        See :func:`optimiser`.
    seed : int
        Random seed of the initial weights and the order of the rows.
    progress : callable, optional
        Called as :data:`Progress`.
    """
    count = int(fold.max()) + 1
    scales = fit_scaler(x, y, fold, count)
    n_out = y.shape[1] * (2 if loss == "laplace" else 1)
    widths = (x.shape[1], *hidden, n_out)
    key = jax.random.key(seed)  # not in compiled code, where integers have 32 bits
    layers, state = _start(key, count, widths, learning_rate, weight_decay)
    # Single precision would lose differences of large values: subtract the mean before rounding.
    shift = Scaler(x.mean(axis=0), 0.0, y.mean(axis=0), 0.0)
    near = Scaler(*((s - t).astype(np.float32) for s, t in zip(scales, shift, strict=True)))
    rows = tuple(
        jnp.asarray((data - mean).astype(np.float32))
        for data, mean in ((x, shift.x_mean), (y, shift.y_mean))
    )
    held_out = _held_out(fold, count)
    rng = np.random.default_rng(seed)
    curves = np.empty((2, count, epochs), np.float32)
    for epoch in range(epochs):
        order = jnp.asarray(batches(rng, fold, count, batch_size))
        layers, state, curves[0, :, epoch] = _epoch(
            layers, state, order, *rows, near, loss, learning_rate, weight_decay
        )
        curves[1, :, epoch] = _validation(layers, *held_out, *rows, near, loss)
        if progress is not None:
            progress(epoch + 1, *(float(np.mean(c[:, epoch])) for c in curves))
    plain = [(np.asarray(w), np.asarray(b)) for w, b in layers]
    return FittedNetworks(plain, scales, *curves)


@partial(jax.jit, static_argnums=(1, 2, 3, 4))
def _start(
    key: Any, count: int, widths: tuple[int, ...], learning_rate: float, weight_decay: float
) -> Any:
    """Return the initial layers of all folds, and the state of the optimiser."""
    keys = jax.random.split(key, count)
    layers = jax.vmap(partial(initial, widths=widths))(keys)
    return layers, jax.vmap(optimiser(learning_rate, weight_decay).init)(layers)


@partial(jax.jit, static_argnames=("loss", "learning_rate", "weight_decay"), donate_argnums=(0, 1))
def _epoch(
    layers: Any, state: Any, order: Any, x: Any, y: Any, scales: Scaler,
    loss: Loss, learning_rate: float, weight_decay: float,
) -> Any:  # fmt: skip
    """Take one optimiser's step per batch in all folds; return layers, state, mean loss (fold,)."""
    optimise = optimiser(learning_rate, weight_decay)

    def one(layers: Any, state: Any, rows: Any, scales: Scaler) -> Any:
        a, b = _standardised(x[rows], y[rows], scales)
        value, gradient = jax.value_and_grad(lambda p: LOSSES[loss](outputs(p, a), b))(layers)
        change, state = optimise.update(gradient, state, layers)
        return optax.apply_updates(layers, change), state, value

    def step(carried: Any, rows: Any) -> Any:
        layers, state = carried
        layers, state, value = jax.vmap(one)(layers, state, rows, scales)
        return (layers, state), value

    (layers, state), values = jax.lax.scan(step, (layers, state), order)
    return layers, state, values.mean(axis=0)


def _standardised(x: Any, y: Any, scales: Scaler) -> tuple[Any, Any]:
    x = (x - scales.x_mean[None, :]) / scales.x_deviation[None, :]
    return x, (y - scales.y_mean[None, :]) / scales.y_deviation[None, :]


def _held_out(fold: NDArray[np.intp], count: int) -> tuple[Any, Any]:
    """Return the held-out rows of each fold (fold, row), padded, and the mask of valid ones."""
    members = [np.flatnonzero(fold == k) for k in range(count)]
    most = max(len(rows) for rows in members)
    index = np.array([np.resize(rows, most) for rows in members], np.int32)
    counts = np.arange(most)[None, :] < np.array([len(rows) for rows in members])[:, None]
    return jnp.asarray(index), jnp.asarray(counts)


@partial(jax.jit, static_argnames=("loss",))
def _validation(
    layers: Any, rows: Any, counts: Any, x: Any, y: Any, scales: Scaler, loss: Loss
) -> Any:
    """Return the loss of each fold's held-out rows, (fold,)."""

    def one(layers: Any, rows: Any, counts: Any, scales: Scaler) -> Any:
        a, b = _standardised(x[rows], y[rows], scales)
        each = jax.vmap(lambda o, t: LOSSES[loss](o[None], t[None]))(outputs(layers, a), b)
        return jnp.sum(jnp.where(counts, each, 0.0)) / jnp.sum(counts).astype(each.dtype)

    return jax.vmap(one)(layers, rows, counts, scales)


def predict(fitted: FittedNetworks, x: NDArray[Any]) -> NDArray[np.float64]:
    """Return every network's standardised outputs (fold, row, output) for inputs (row, input)."""
    scales, parts = fitted.scaler, []
    for start in range(0, len(x), ROWS_AT_ONCE):
        part = x[start : start + ROWS_AT_ONCE]
        # Padded to a power of two, so that few shapes are compiled.
        full = np.resize(part, (1 << (len(part) - 1).bit_length(), x.shape[1]))
        inputs = (full[None] - scales.x_mean[:, None]) / scales.x_deviation[:, None]
        parts.append(_all_outputs(fitted.layers, inputs.astype(np.float32))[:, : len(part)])
    if not parts:
        return np.empty((len(scales.x_mean), 0, fitted.layers[-1][1].shape[-1]))
    return np.concatenate(parts, axis=1, dtype=float)


_all_outputs = jax.jit(jax.vmap(outputs))


def weights(validation: NDArray[Any]) -> NDArray[np.float64]:
    """Return the folds' normalised inverse validation losses (fold,) after the last epoch."""
    inverse = 1 / np.maximum(np.asarray(validation[:, -1], float), 1e-12)
    return np.asarray(inverse / inverse.sum())
