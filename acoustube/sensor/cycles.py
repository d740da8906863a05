"""Change of the voltage of a cycle by contacts, in JAX, for one cycle and for many."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from acoustube.base.types import Array
from acoustube.ranging import Rangefinder
from acoustube.ranging.analogue import REFLECTOR_SPACING
from acoustube.sensor.network import Constants, Pair, Press, echo

AT_ONCE = 8
"""Number of cycles that are computed at once; more do not fit into the nearest caches."""
OPTIONS = {"xla_backend_optimization_level": 1, "xla_cpu_use_fusion_emitters": False}
"""Options of XLA's compiler. Further optimisation makes cycles slower by a factor of two; with its
fusion emitters, compilation takes twice the time and 90 MB more."""


@dataclass(frozen=True)
class Shape:
    """Sizes and reflection coefficients that are fixed when a sensor is compiled.

    Attributes
    ----------
    number : tuple of int
        Indices of coefficients, :attr:`acoustube.sensor.tables.PressTables.number`, flattened.
    modes : int
        Number of modes that propagate between contacts.
    period, n_samples : int
        Number of samples of the inverse Fourier transform, and of samples of the cycle.
    first_bin : int
        Index of the band's first frequency in the spectrum.
    ends : tuple of float
        Places in m between which the `modes` propagate: both ends of the tube, or of its wrap.
    face : complex
        Reflection coefficient of the transducer's face.
    places : int
        Number of places along a wrapped tube at which the scattering of contacts is tabulated; 1
        for a straight tube.
    every : int
        Number of computed samples for each one of the cycle; 1 if no band is aliased.
    """

    number: tuple[int, ...]
    modes: int
    period: int
    n_samples: int
    first_bin: int
    ends: tuple[float, float]
    face: complex
    places: int = 1
    every: int = 1


class Parts(NamedTuple):
    """Arrays of a sensor; a row is a press of its tables, at one depth of one tool.

    Attributes
    ----------
    constants : Constants
        Arrays from which the echo is computed.
    depths : jax.Array
        Depth of each row of each tool in m, rising, padded with infinity, (n_tools, n_most).
    diameters : jax.Array
        Diameter of each tool in m, rising, (n_tools,).
    first : jax.Array
        Index of the first row of each tool, (n_tools,).
    untouched : Pair
        Echo of the untouched tube, clutter included, relative to the launched wave, (n_f,).
    scale : Pair
        Spectrum of the voltage of a complete reflection, multiplied by the sampling rate, in V,
        (n_f,).
    growth : jax.Array
        Exponential that undoes the decay due to the imaginary part of the frequencies,
        (n_samples,).
    """

    constants: Constants
    depths: jax.Array
    diameters: jax.Array
    first: jax.Array
    untouched: Pair
    scale: Pair
    growth: jax.Array


def changes_of(
    shape: Shape, parts: Parts, place: jax.Array, depth: jax.Array, diameter: jax.Array
) -> jax.Array:
    """Return the changes of cycles' voltage by contacts, relative to the untouched tube.

    Parameters
    ----------
    shape : Shape
    parts : Parts
    place, depth, diameter : jax.Array
        Of the contacts in m, in any order, (n, n_contacts); depth 0 for no contact. Depths and
        diameters outside the tables are replaced by those at their ends, and places outside the
        ends of :class:`Shape` by these ends.

    Returns
    -------
    jax.Array
        In V, (n, n_samples).
    """

    def spectrum_of(contacts: tuple[jax.Array, ...]) -> jax.Array:
        order = jnp.argsort(contacts[0])
        found = echo_of(shape, parts, *(one[order].astype(jnp.float32) for one in contacts))
        changed = (found - parts.untouched) * parts.scale
        return jax.lax.complex(changed.re, changed.im)

    band = jax.lax.map(spectrum_of, (place, depth, diameter), batch_size=AT_ONCE)
    return _voltage(shape, parts, band)


def echo_voltage(shape: Shape, parts: Parts, echo_at_face: Pair) -> Array:
    """Return the voltage of an echo in V, (n_samples,).

    The echo is given relative to the launched wave, at the frequencies of the band, (n_f,).
    """
    received = echo_at_face * parts.scale
    band = jax.lax.complex(received.re, received.im)
    return np.asarray(_voltage(shape, parts, band[None])[0], float)


def _voltage(shape: Shape, parts: Parts, band: jax.Array) -> jax.Array:
    """Return the voltages in V of spectra at the frequencies of the band, (n, n_samples)."""
    spectrum = jnp.zeros((len(band), shape.period // 2 + 1), jnp.complex64)
    columns = slice(shape.first_bin, shape.first_bin + band.shape[1])
    spectrum = spectrum.at[:, columns].set(band)
    end = shape.every * shape.n_samples
    return jnp.fft.irfft(spectrum, shape.period)[:, : end : shape.every] * parts.growth[None]


def counts_of(
    rangefinder: Rangefinder, untouched: ArrayLike, changes: jax.Array, key: jax.Array | None
) -> jax.Array:
    """Return the counts of cycles, (n, n_samples), float32.

    With a key they have noise, drift and, if the rangefinder quantises, rounding and clipping.

    Parameters
    ----------
    rangefinder : Rangefinder
    untouched : array_like
        Voltage of the untouched tube in V, (n_samples,).
    changes : jax.Array
        Changes of the voltage by contacts in V, (n, n_samples).
    key : jax.Array or None
        Random key.
    """
    r, per_volt = rangefinder, 2**rangefinder.bits / rangefinder.full_scale
    counts = (jnp.asarray(untouched, jnp.float32)[None] + r.offset + changes) * per_volt
    if key is None:
        return counts
    noise, drift = jax.random.split(key)
    white = jax.random.normal(noise, counts.shape, jnp.float32)
    slow = jax.random.normal(drift, (len(counts), 1), jnp.float32)
    counts = counts + per_volt * (r.noise * white + r.drift * slow)
    return jnp.clip(jnp.rint(counts), 0, 2**r.bits - 1) if r.quantised else counts


@cache
def compiled() -> tuple[Callable[..., jax.Array], Callable[..., jax.Array]]:
    """Return :func:`changes_of` and :func:`counts_of` compiled, with the options XLA supports."""
    known = {}
    for name, value in OPTIONS.items():
        with suppress(jax.errors.JaxRuntimeError):
            jax.jit(jnp.negative, compiler_options={name: value})(np.float32(0))
            known[name] = value
    jit = partial(jax.jit, static_argnums=0, compiler_options=known)
    return jit(changes_of), jit(counts_of)


@partial(
    jax.tree_util.register_dataclass, data_fields=("parts", "untouched"),
    meta_fields=("shape", "rangefinder"),
)  # fmt: skip
@dataclass(frozen=True)
class CycleModel:
    """Model of a sensor's cycles, for use in larger JAX computations.

    Pass it to compiled functions as an argument. A function that closes over it takes minutes to
    compile, since the tables become constants of the function.

    Attributes
    ----------
    parts : Parts
    untouched : jax.Array
        Voltage of the untouched tube in V, (n_samples,).
    shape : Shape
    rangefinder : Rangefinder
    """

    parts: Parts
    untouched: jax.Array
    shape: Shape
    rangefinder: Rangefinder

    def __call__(
        self,
        places: jax.Array,
        depths: jax.Array,
        diameters: jax.Array | None = None,
        key: jax.Array | None = None,
    ) -> jax.Array:
        """Return the counts of cycles; nothing is checked.

        Parameters
        ----------
        places, depths, diameters : jax.Array
            Of the contacts in m, (n, n_contacts); depth 0 for no contact. Depths and diameters
            outside the library's range are replaced by those at its ends. The default diameter is
            the smallest of the library.
        key : jax.Array, optional
            Random key of noise, drift and, if the rangefinder has it, quantisation, which has no
            derivative.

        Returns
        -------
        jax.Array
            Counts, (n, n_samples), float32.
        """
        sizes = jnp.zeros_like(depths) if diameters is None else diameters
        changes = changes_of(self.shape, self.parts, places, depths, sizes)
        return counts_of(self.rangefinder, self.untouched, changes, key)


def echo_of(
    shape: Shape, parts: Parts, place: jax.Array, depth: jax.Array, diameter: jax.Array
) -> Pair:
    """Return the echo of the contacts of one cycle, relative to the launched wave, (n_f,).

    The parameters are those of :func:`changes_of`, but for one cycle, with rising places,
    (n_contacts,).
    """
    n = parts.constants.clutter.shape[0] - 1
    reflector = jnp.clip((place / REFLECTOR_SPACING + 0.5).astype(jnp.int32), 0, n)
    size = 2 * shape.modes
    # Contacts of depth 0 may be anywhere.
    place = jnp.clip(place, *shape.ends)
    press = _press(parts, depth, diameter)
    if shape.places > 1:
        press = _placed(shape, parts, press, place)
    return echo(
        parts.constants, np.reshape(shape.number, (size, size)), press, place, reflector,
        shape.ends, shape.face,
    )  # fmt: skip


def _press(parts: Parts, depth: jax.Array, diameter: jax.Array) -> Press:
    """Return table rows and weights of contacts, for interpolation in depth and diameter."""
    n_tools = parts.depths.shape[0]
    if n_tools == 1:
        row, weight = _rows(parts, jnp.zeros(depth.shape, jnp.int32), depth)
        return Press(row[:, None], weight[:, None])
    low = jnp.searchsorted(parts.diameters, diameter, side="right") - 1
    low = jnp.clip(low, 0, n_tools - 2)
    start, end = parts.diameters[low], parts.diameters[low + 1]
    share = jnp.clip((diameter - start) / (end - start), 0, 1)
    (row, weight), (other, others) = (_rows(parts, low + i, depth) for i in (0, 1))
    return Press(jnp.stack([row, other], 1), jnp.stack([weight, others, share], 1))


def _placed(shape: Shape, parts: Parts, press: Press, place: jax.Array) -> Press:
    """Return rows and weights of contacts interpolated between two tabulated places of a wrap."""
    n_rows = parts.constants.presses.shape[0] // shape.places
    x = (place - shape.ends[0]) * ((shape.places - 1) / (shape.ends[1] - shape.ends[0]))
    low = jnp.clip(jnp.floor(x).astype(jnp.int32), 0, shape.places - 2)
    k = press.row.shape[1]
    rows = [press.row + (n_rows * (low + i))[:, None] for i in (0, 1)]
    weights = [press.weight[:, :k], press.weight[:, :k], press.weight[:, k:], (x - low)[:, None]]
    return Press(jnp.concatenate(rows, axis=1), jnp.concatenate(weights, axis=1))


def _rows(parts: Parts, tool: jax.Array, depth: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the row of each contact's tool below its depth, and the weight of the next row."""
    known = parts.depths[tool]
    last = jnp.sum(jnp.isfinite(known), axis=1) - 2
    found = jax.vmap(partial(jnp.searchsorted, side="right"))(known, depth) - 1
    found = jnp.clip(found, 0, last)
    start, end = (jnp.take_along_axis(known, found[:, None] + i, axis=1)[:, 0] for i in (0, 1))
    weight = jnp.clip((depth - start) / (end - start), 0, 1)
    return parts.first[tool] + found, weight
