"""Expected errors of a sensor for given contacts and one pulse; differentiable by JAX.

The Cramer-Rao bound with nuisance parameters holds only near the true contact. Besides it, the
probability of an error of whole half wavelengths is estimated, as for the ambiguity of a
narrow-band pulse: the probability that a contact so far off, with the best nuisance parameters, has
the larger likelihood.

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
from jax.scipy.special import fresnel, ndtr

from acoustube.base.checks import Reals, checked
from acoustube.base.small_systems import solve
from acoustube.base.types import Array
from acoustube.inversion.baseband import (
    AFTER_CLIPPING,
    CHIRP_BAND,
    DITHER,
    FADE,
    HALF_WIDTH,
    OWN_LENGTH,
    half_width,
)
from acoustube.inversion.design.fisher import Information
from acoustube.ranging import Burst, Chirp, Rangefinder

HALF_WAVES = (-3, -2, -1, 1, 2, 3)
"""Errors of an estimated position that are considered, in half wavelengths."""
DETECTED = 6.0
"""Amplitude of an echo after its matched filter, in standard deviations of the noise, at which half
of the echoes are detected; noise alone exceeds it in exp(-18) of its samples."""
BAND_EDGE, BAND_ROLL = 0.875, 0.084
"""Sigmoid in place of the tapers of the inversion's band: distance of its middle from the carrier,
and its width, both relative to half the width of the band."""
BLIND_ROLL = 0.02
"""Width in m of the transition from masked to unmasked echoes behind the ring-down."""


class Electronics(NamedTuple):
    """Pulse, transducer and converter, as scalars or as arrays of one shape.

    Attributes
    ----------
    carrier : float
        Frequency of drive and transducer in Hz.
    cycles : float
        Duration of the drive, a square burst or a chirp, in periods of the carrier.
    quality : float
        Quality factor of the transducer.
    level : float
        Counts received from a complete reflection of a steady drive, over the standard deviation of
        the noise of a sample of the mean of cycles.
    rate : float
        Samples per second.
    ring : float
        Received amplitude of the rangefinder's own drive over half of full scale, at least 1.
    ends : float
        Number of rangefinders, 1 or 2.
    bandwidth : float
        Bandwidth of a chirp in Hz; 0 for a burst.
    low_corner, high_corner : float
        Corner frequencies of loudspeaker and microphone in Hz; 0 for none.
    """

    carrier: float | Array
    cycles: float | Array
    quality: float | Array
    level: float | Array
    rate: float | Array
    ring: float | Array
    ends: float | Array
    bandwidth: float | Array = 0.0
    low_corner: float | Array = 0.0
    high_corner: float | Array = 0.0


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
        Farthest position in m at which the lightest contact is detected; twice that distance with
        two rangefinders, (...).
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
        """Reach in m, rms relative deviation of force, and resolution in m, (..., 3)."""
        force = np.sqrt(np.mean(self.force**2, axis=-1))
        return np.stack([self.reach, force, self.resolution], axis=-1)


def electronics_of(rangefinder: Rangefinder, ends: int = 1, average: int = 1) -> Electronics:
    """Return the electronics of a rangefinder with a square burst or plain chirp at its resonance.

    Parameters
    ----------
    rangefinder : Rangefinder
    ends : int
        Number of rangefinders, of which the second is at the far end.
    average : int
        Number of cycles whose mean is inverted.
    """
    r, drive = rangefinder, rangefinder.drive
    assert isinstance(drive, Burst | Chirp)
    noise = r.noise * 2**r.bits / r.full_scale
    variance = noise**2
    if r.quantised:
        # Rounding that noise does not dither is an error within the band of the signal.
        share = min(2 * half_width(r) / (r.sampling_rate / 2), 1.0)
        variance += 1 / 12 / (1.0 if noise >= DITHER else share)
    level = r.gain * 2**r.bits / r.full_scale / np.sqrt(max(variance / average, 1e-12))
    return Electronics(
        drive.frequency, drive.duration * drive.frequency, r.quality_factor, level,
        r.sampling_rate, max(2 * r.send / r.full_scale, 1.0), ends, drive.bandwidth,
        r.low_corner, r.high_corner,
    )  # fmt: skip


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
    """
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
    """Return the score and its gradient: forward derivatives along each of the few logarithms."""

    def scored(logs):  # type: ignore[no-untyped-def]
        found = Prediction(*_prediction(jnp.concatenate([jnp.exp(logs), given[2:]]), tensors))
        return _score(jnp, found, goal)

    def along(direction):  # type: ignore[no-untyped-def]
        return jax.jvp(scored, (logs,), (direction,))

    return jax.vmap(along, out_axes=(None, 0))(jnp.eye(len(logs)))


def spectrum(frequency, electronics):  # type: ignore[no-untyped-def]
    """Return the energy spectrum of a drive after both passages of its transducer, in s2, (n_f,).

    A square burst has that of :meth:`acoustube.ranging.Burst.spectrum` for whole half periods, and
    is continuous in their number. A chirp is without the part at negative frequencies.
    """
    one = Electronics(*electronics)
    carrier, cycles = one.carrier, one.cycles
    u = jnp.pi / 2 * (frequency / carrier - 1)
    near = jnp.abs(jnp.sin(u)) < 1e-7
    safe = jnp.where(near, 1.0, u)
    kernel = jnp.where(near, 2 * cycles, jnp.sin(2 * cycles * safe) / jnp.sin(safe))
    burst = (jnp.cos(u) * kernel / (jnp.pi * frequency)) ** 2
    drive = jnp.where(one.bandwidth > 0, _chirp(frequency - carrier, one), burst)
    off = frequency / carrier - carrier / frequency
    # Squared magnitudes of Butterworth filters of second order.
    high = jnp.where(one.high_corner > 0, one.high_corner, jnp.inf)
    passed = 1 / ((1 + (one.low_corner / frequency) ** 4) * (1 + (frequency / high) ** 4))
    return drive * passed / (1 + (one.quality * off) ** 2) ** 2


def _chirp(off, one):  # type: ignore[no-untyped-def]
    """Return the squared magnitude of a chirp's spectrum in s2, at offsets in Hz from its carrier.

    It is computed by Fresnel integrals, without the part at negative frequencies.
    """
    width = jnp.where(one.bandwidth > 0, one.bandwidth, 1.0)
    lasting = one.cycles / one.carrier
    scale = jnp.sqrt(2 * lasting / width)
    (s0, c0), (s1, c1) = (fresnel(scale * (side * width / 2 - off)) for side in (-1, 1))
    return ((c1 - c0) ** 2 + (s1 - s0) ** 2) * lasting / width / 8


def _received(frequency, electronics):  # type: ignore[no-untyped-def]
    """Return :func:`spectrum`, tapered to the band of the inversion, in s2, (n_f,)."""
    one = Electronics(*electronics)
    half = jnp.maximum(HALF_WIDTH * one.carrier, CHIRP_BAND * one.bandwidth)
    sides = (BAND_EDGE - jnp.abs(frequency - one.carrier) / half) / BAND_ROLL
    return spectrum(frequency, electronics) * jax.nn.sigmoid(4 * sides)


def weight_of(frequency: Array, electronics: Electronics) -> Array:
    """Return the weight of each frequency in the Fisher information, (n_f,).

    It is the energy of the echo of a complete reflection over the variance of a sample's noise.

    Parameters
    ----------
    frequency : ndarray
        In Hz, evenly spaced, (n_f,).
    electronics : Electronics
        Scalars.
    """
    step = frequency[1] - frequency[0]
    with jax.enable_x64(True):
        given = [jnp.asarray(float(one)) for one in electronics]
        received = np.asarray(_received(jnp.asarray(frequency), given))
    return np.asarray(2 * electronics.rate * step * electronics.level**2 * received)


def _prediction(electronics, tensors):  # type: ignore[no-untyped-def]
    carrier, cycles, quality, level, rate, ring, ends, *_ = electronics
    known = Information(*tensors)
    f = known.frequency
    step = f[1] - f[0]
    received = _received(f, electronics)
    weight = 2 * rate * step * level**2 * received
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
    far = jnp.log(known.range_power @ weight + 1e-300) - 2 * jnp.log(DETECTED)
    reach = jnp.interp(0.0, -far, known.range_grid) * jnp.where(ends > 1.5, 2.0, 1.0)
    width = step * received.sum() ** 2 / (received**2).sum()
    resolution = jnp.hypot(known.sound_speed / (2 * width), OWN_LENGTH)
    return (
        jnp.sqrt(place) * scale[0], jnp.sqrt(depth) * scale[1], jnp.sqrt(force), found,
        each.sum(axis=0), noise, known.slope * known.model, reach, resolution,
        jnp.where(ends > 1.5, 0.0, nearest),
    )  # fmt: skip


def _information(known, weight, carrier, unmasked):  # type: ignore[no-untyped-def]
    """Return the information (n, 4, 4) and, for :data:`HALF_WAVES`, three properties of the errors.

    They are shift of position in m, (6,), squared distance of the echoes, and scaled shift of
    depth, both (6, n). Gain and phase of each rangefinder are eliminated.
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
