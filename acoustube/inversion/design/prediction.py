"""Expected errors of a sensor for given contacts and one pulse; differentiable by JAX.

The Cramer-Rao bound with nuisance parameters holds only near the true contact. Besides it, the
probability of an error of whole half wavelengths is estimated, as for the ambiguity of a
narrow-band pulse: the probability that a contact displaced by that much, with the nuisance
parameters fitted to it, is likelier than the true one.

References
----------
* Errors beyond the Cramer-Rao bound by the next maxima of the ambiguity function: Van Trees, H. L.
  and Bell, K. L. (2013). Detection, Estimation, and Modulation Theory, Part I, section 4.3. Wiley.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtr

from acoustube.base.checks import Reals, checked
from acoustube.base.errors import ConfigError
from acoustube.base.small_systems import solve
from acoustube.base.types import Array
from acoustube.inversion.baseband import AFTER_CLIPPING, FADE, OWN_LENGTH
from acoustube.inversion.design.electronics import Electronics, received
from acoustube.inversion.design.fisher import Information

HALF_WAVES = (-3, -2, -1, 1, 2, 3)
"""Errors of an estimated position that are considered, in half wavelengths."""
DETECTED = 6.0
"""Amplitude of an echo after its matched filter, in standard deviations of the noise, at which half
of the echoes are detected; noise alone exceeds it in exp(-18) of its samples."""
BLIND_ROLL = 0.02
"""Width in m of the transition from masked to unmasked echoes behind the ring-down."""


class Prediction(NamedTuple):
    """Expected errors of a sensor's inversion over its tube.

    Attributes
    ----------
    place : ndarray
        Standard deviations of positions in m, (..., n).
    depth : ndarray
        Standard deviations of depths in m, (..., n).
    force : ndarray
        Relative standard deviations of forces, (..., n).
    found : ndarray
        Probabilities that the contact is detected, (..., n).
    wrong : ndarray
        Probabilities of an error of whole half wavelengths, (..., n).
    noise : ndarray
        Relative standard deviation of the force by the Cramer-Rao bound alone, (..., n).
    model : ndarray
        Relative standard deviation of the force by errors of the forward model alone, (..., n).
    reach : ndarray
        Farthest position in m at which the lightest contact is detected with each tool; twice that
        distance with two rangefinders, (...).
    resolution : ndarray
        Least distance in m at which the echoes of two presses are separate, (...).
    nearest : ndarray
        Distance in m up to which the ring-down hides presses; 0 with two rangefinders, (...).
    """

    place: Array
    depth: Array
    force: Array
    found: Array
    wrong: Array
    noise: Array
    model: Array
    reach: Array
    resolution: Array
    nearest: Array

    @property
    def objectives(self) -> Array:
        """Reach in m, rms relative standard deviation of force, and resolution in m, (..., 3)."""
        force = np.sqrt(np.mean(self.force**2, axis=-1))
        return np.stack([self.reach, force, self.resolution], axis=-1)


@checked(known=Information, electronics=Electronics)
def predict(known: Information, electronics: Electronics) -> Prediction:
    """Return the expected errors for one set of electronics, or for many.

    Parameters
    ----------
    known : Information
    electronics : Electronics
        Scalars, or arrays (m,).

    Returns
    -------
    Prediction
        Arrays (n,) and scalars, or (m, n) and (m,).

    Notes
    -----
    The errors are computed in the band of the inversion. Errors of the forward model are included
    as a stretch of frequency and an error of depth. Clutter that remains after calibration and
    reflections by the face are not included.
    """
    given = np.broadcast_arrays(*(np.asarray(one, float) for one in electronics))
    with jax.enable_x64(True):
        run = _many if given[0].ndim else _one
        found = run(jnp.stack([jnp.asarray(one) for one in given], axis=-1), _tensors(known))
        return Prediction(*(np.asarray(one) for one in found))


def score(found: Prediction, asked: Sequence[float]) -> Array:
    """Return the logarithm of the rms relative error of force, plus penalties for missed goals.

    The result has the shape (...) of `found.reach`; lower values are better. A small term favours
    precise positions.

    Parameters
    ----------
    found : Prediction
    asked : sequence of float
        Goals, all in m: reach, distance of two presses that are resolved, median standard deviation
        of position, and distance of the nearest press.
    """
    return np.asarray(_score(np, found, np.array(asked)))


@checked(known=Information, electronics=Electronics, asked=Reals(0, 1e6, "m", ndim=1))
def gradient(
    known: Information, electronics: Electronics, asked: Sequence[float]
) -> tuple[float, Array]:
    """Return the score, and its gradient by the logarithms of carrier and cycles, (2,).

    Parameters
    ----------
    known : Information
    electronics : Electronics
        Scalars.
    asked : sequence of float
        See :func:`score`.

    Raises
    ------
    ConfigError
        If `asked` does not hold the four goals.
    """
    if len(asked) != 4:
        raise ConfigError(
            f"asked holds {len(asked)} goals; give four: reach, distance of two presses, deviation "
            "of position, and nearest press"
        )
    with jax.enable_x64(True):
        given = jnp.array([float(one) for one in electronics])
        goal = jnp.array(asked)
        value, slope = _scored(jnp.log(given[:2]), given, _tensors(known), goal)
        return float(value), np.asarray(slope)


def on_device(known: Information) -> Information:
    """Return the information as JAX arrays, so that repeated predictions need not copy it."""
    with jax.enable_x64(True):
        return Information(*(jnp.asarray(one) for one in known))  # type: ignore[arg-type]


def _tensors(known: Information) -> tuple[jax.Array, ...]:
    return tuple(jnp.asarray(one) for one in known)


def _score(numbers, found, goal):  # type: ignore[no-untyped-def]
    reach, separation, place, nearest = goal
    missing = [
        numbers.log(reach / found.reach), numbers.log(found.resolution / separation),
        numbers.log(numbers.median(found.place, -1) / place),
        numbers.log(numbers.maximum(found.nearest, 1e-3) / nearest),
    ]  # fmt: skip
    penalty = sum(2 * numbers.maximum(one, 0.0) for one in missing)
    force = numbers.log(numbers.mean(found.force**2, -1)) / 2
    return force + penalty + 0.02 * missing[2]


@jax.jit
def _scored(logs, given, tensors, goal):  # type: ignore[no-untyped-def]
    """Return the score, and its gradient by `logs`, the logarithms of carrier and cycles."""

    def scored(logs):  # type: ignore[no-untyped-def]
        found = Prediction(*_prediction(jnp.concatenate([jnp.exp(logs), given[2:]]), tensors))
        return _score(jnp, found, goal)

    def along(direction):  # type: ignore[no-untyped-def]
        return jax.jvp(scored, (logs,), (direction,))

    return jax.vmap(along, out_axes=(None, 0))(jnp.eye(len(logs)))


def _prediction(electronics, tensors):  # type: ignore[no-untyped-def]
    carrier, cycles, quality, level, rate, ring, ends, *_ = electronics
    known = Information(*tensors)
    f = known.frequency
    step = f[1] - f[0]
    heard = received(f, electronics)
    weight = 2 * rate * step * level**2 * heard
    decay = quality / (jnp.pi * carrier)
    free = cycles / carrier + decay * jnp.log(ring) + AFTER_CLIPPING + FADE
    nearest = 0.5 * known.sound_speed * free + OWN_LENGTH  # as in the inversion's baseband
    unmasked = jax.nn.sigmoid(4 * (known.place - nearest) / BLIND_ROLL)
    unmasked = unmasked * jnp.stack([1.0, jnp.where(ends > 1.5, 1.0, 0.0)])[:, None]
    power = (known.power @ weight) * unmasked
    found = ndtr(jnp.sqrt(power.sum(axis=0) + 1e-12) - DETECTED)
    matrix, missed, distance, shifts = _information(known, weight, carrier, unmasked)
    covariance = solve(matrix, jnp.eye(4)[None])
    each = ndtr(-jnp.sqrt(jnp.maximum(distance, 1e-9)) / 2)
    each = each / (1 + each.sum(axis=0))[None]
    scale = known.scale
    off = (each * missed[:, None] ** 2).sum(axis=0) / scale[0] ** 2
    turned = (each * shifts**2).sum(axis=0)
    place = jnp.minimum(covariance[:, 0, 0] + off, 1.0)
    mistaken = (known.model / scale[1]) ** 2
    depth = jnp.minimum(covariance[:, 1, 1] + turned + mistaken, 1.0)
    noise = known.slope * scale[1] * jnp.sqrt(covariance[:, 1, 1])
    force = (known.slope * scale[1]) ** 2 * depth + known.hardness**2  # of detected contacts
    # Of contacts that are missed, only the prior is known.
    place, depth = (found * one + 1 - found for one in (place, depth))
    prior = known.force_prior**2
    force = jnp.where(
        known.within_range > 0, found / (1 / force + 1 / prior) + (1 - found) * prior, prior
    )
    faintest = (known.range_power @ weight).min(axis=0)  # of all tools
    far = jnp.log(faintest + 1e-300) - 2 * jnp.log(DETECTED)
    reach = jnp.interp(0.0, -far, known.range_grid) * jnp.where(ends > 1.5, 2.0, 1.0)
    width = step * heard.sum() ** 2 / (heard**2).sum()
    resolution = jnp.hypot(known.sound_speed / (2 * width), OWN_LENGTH)
    return (
        jnp.sqrt(place) * scale[0], jnp.sqrt(depth) * scale[1], jnp.sqrt(force), found,
        each.sum(axis=0), noise, known.slope * known.model, reach, resolution,
        jnp.where(ends > 1.5, 0.0, nearest),
    )  # fmt: skip


def _information(known, weight, carrier, unmasked):  # type: ignore[no-untyped-def]
    """Return the information (n, 4, 4), and three properties of the errors :data:`HALF_WAVES`.

    They are the shift of position in m, (6,), the squared distance between the true and the
    displaced echo, in variances of the noise, and the shift of depth, in prior standard deviations,
    both (6, n). Gain and phase of each rangefinder are eliminated.
    """
    half = jnp.interp(carrier, known.frequency, known.wavenumber)
    off = jnp.array(HALF_WAVES) * jnp.pi / half
    angle = 2 * known.wavenumber[None] * off[:, None]
    side = jnp.array([1.0, -1.0])
    n = known.place.shape[1]
    matrix = jnp.eye(4)[None]
    vector, energy = jnp.zeros((len(HALF_WAVES), n, 4)), jnp.zeros((len(HALF_WAVES), n))
    for end in (0, 1):
        given = unmasked[end]
        full = (known.products[end] @ weight) * given[:, None, None]
        turn_real, turn_imag = jnp.cos(angle) - 1, -side[end] * jnp.sin(angle)
        real, imag = known.echoes[end].real, known.echoes[end].imag
        moved = (turn_real * weight[None]) @ real.reshape(-1, len(weight)).T
        moved = moved - (turn_imag * weight[None]) @ imag.reshape(-1, len(weight)).T
        moved = moved.reshape(len(HALF_WAVES), n, 6) * given[None, :, None]
        size = ((turn_real**2 + turn_imag**2) * weight[None]) @ known.power[end].T * given[None]
        own = full[:, 4:, 4:] + jnp.eye(2)[None]
        solved = solve(own, full[:, 4:, :4])
        matrix = matrix + full[:, :4, :4] - full[:, :4, 4:] @ solved
        vector = vector + moved[..., :4] - jnp.einsum("mnj,nji->mni", moved[..., 4:], solved)
        own_moved = solve(own[None], moved[..., 4:, None])[..., 0]
        energy = energy + size - (moved[..., 4:] * own_moved).sum(axis=-1)
    best = solve(matrix[None], vector[..., None])[..., 0]
    return matrix, off, energy - (vector * best).sum(axis=-1), best[..., 1]


_one = jax.jit(_prediction)
_many = jax.jit(jax.vmap(_prediction, in_axes=(0, None)))
