"""Sensor for simulations: contacts in, cycles of counts out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from os import PathLike
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from acoustube.base.checks import (
    LENGTH,
    SEED,
    TEMPERATURE,
    Optional,
    Reals,
    Several,
    check_argument,
    checked,
)
from acoustube.base.errors import ConfigError
from acoustube.base.names import PATH
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.inversion import Library, Wrap
from acoustube.ranging import Rangefinder, digitise, response
from acoustube.runs.libraries.files import open_library
from acoustube.sensor.assembly import assembled
from acoustube.sensor.contacts import (
    HALF_PRESS,
    Contact,
    check_contacts,
    contact_arrays,
    depth_at,
    diameter_of,
    force_at,
)
from acoustube.sensor.cycles import (
    CycleModel,
    compiled,
    echo_voltage,
)
from acoustube.sensor.wrapped import check_wrap

BATCH = 128
"""Number of cycles in a compiled batch, for which one core needs 15 MB."""


class TubeSensor:
    """Rangefinder on a straight or a wrapped tube, whose cycles take a fraction of a millisecond.

    Parameters
    ----------
    library : Library
        Scattering of the tools; see :meth:`from_library` for a folder.
    rangefinder : Rangefinder, optional
        Default: the sleeve paper's board.
    length : float
        Length of the tube in m.
    temperature : float
        Temperature of the air in degC.
    tube_seed : int
        Random seed of the tube's clutter, as in :func:`acoustube.ranging.record`.
    most_contacts : int
        Largest number of contacts in a cycle.
    tolerance : float
        Relative rms error of the reflection that linear interpolation between the depths of the
        tables may add to the error of the library's interpolation.
    wrap : Wrap, optional
        Wrap of the tube about an arm, from a sleeve (:func:`acoustube.runs.wrap.wrap_of`) or the
        file of a sensor (``read_sensor(path).wrap``,
        :func:`acoustube.runs.inversion.read_sensor`); a straight tube by default.

    Attributes
    ----------
    tool_library, rangefinder, length, temperature, most_contacts, tolerance, wrap
        The parameters.
    span : (float, float)
        Nearest and farthest place of a contact in m; on a wrapped tube both are on the wrap.
    apart : float
        Least distance between two contacts in m.
    tables : acoustube.sensor.tables.PressTables
        Scattering and forces over depth.
    model : acoustube.sensor.cycles.CycleModel
        The same cycles in JAX, for compiled functions and derivatives.

    Raises
    ------
    ConfigError
        If the library's band does not contain the received spectrum, its tools cannot be combined,
        or the wrap is longer than the tube or too short for a press.

    Notes
    -----
    A cycle is the sum of that of the untouched tube, from :func:`acoustube.ranging.response`, and
    the change by the contacts. The change is computed in the band of the received spectrum, at
    frequencies with a constant negative imaginary part, so that echoes later than the cycle hardly
    wrap around; see :mod:`acoustube.sensor.network`. Where a contact's depth and diameter are those
    of one of the library's matrices, the cycle equals that of :func:`acoustube.ranging.record` with
    this matrix, but for rounding and the part outside the band. Between depth 0, where the tube is
    untouched, and the library's first depth, the scattering is interpolated.
    """

    @checked(
        library=Library, rangefinder=Optional(Rangefinder), length=LENGTH, temperature=TEMPERATURE,
        tube_seed=SEED, most_contacts=Number(1, 64, whole=True), tolerance=Number(1e-6, 0.1),
        wrap=Optional(Wrap),
    )  # fmt: skip
    def __init__(
        self,
        library: Library,
        rangefinder: Rangefinder | None = None,
        *,
        length: float = 2.5,
        temperature: float = 20.0,
        tube_seed: int = 0,
        most_contacts: int = 3,
        tolerance: float = 1e-3,
        wrap: Wrap | None = None,
    ) -> None:
        self.tool_library, self.rangefinder = library, rangefinder or Rangefinder()
        self.length, self.temperature, self.tolerance = length, temperature, tolerance
        self.most_contacts, self.wrap = most_contacts, wrap
        self.span, self.apart = (HALF_PRESS, length - HALF_PRESS), 2 * HALF_PRESS
        if wrap is not None:
            check_wrap(wrap, length)
            self.span = wrap.start + wrap.reach, wrap.stop - wrap.reach
            self.apart = 2 * wrap.reach
        r = self.rangefinder
        _, self._untouched = response(
            [], r, radius=library.radius, length=length, temperature=temperature,
            tube_seed=tube_seed,
        )  # fmt: skip
        self.tables, self._shape, self._parts, bent = assembled(
            library, r, length, temperature, tube_seed, tolerance, wrap
        )
        if bent is not None:
            self._untouched = self._untouched + echo_voltage(self._shape, self._parts, bent)
        untouched = jnp.asarray(self._untouched, jnp.float32)
        self.model = CycleModel(self._parts, untouched, self._shape, r)

    @classmethod
    def from_library(cls, path: str | PathLike[str], *given: Any, **options: Any) -> TubeSensor:
        """Return the sensor with the library of a folder; other parameters are those of the class.

        Raises
        ------
        ConfigError
            As :func:`acoustube.runs.libraries.files.open_library`, and as the class.
        """
        check_argument("path", path, PATH)
        return cls(open_library(Path(path)), *given, **options)

    def force_of(self, depth: float, diameter: float | None = None) -> float:
        """Return the force in N of a tool at a depth in m.

        Without a `diameter` in m, the tool is the only one of the library.

        Raises
        ------
        ConfigError
            If the depth or the diameter is outside the library's range, or the diameter is missing
            and there are several tools.
        """
        return force_at(self.tables, depth, diameter)

    def depth_of(self, force: float, diameter: float | None = None) -> float:
        """Return the depth in m at which a tool exerts a force in N.

        Without a `diameter` in m, the tool is the only one of the library.

        Raises
        ------
        ConfigError
            If the force or the diameter is outside the library's range, or the diameter is missing
            and there are several tools.
        """
        return depth_at(self.tables, force, diameter)

    @property
    def errors(self) -> list[Array]:
        """Estimated rms errors of the scattering interpolated over depth, by tool.

        For each tool, in the order of diameter, its `interpolation_error` between each depth of the
        library and the next (:class:`acoustube.inversion.Tool`) plus the tolerance.
        """
        tools = sorted(self.tool_library.tools, key=lambda tool: tool.diameter)
        return [tool.interpolation_error + self.tolerance for tool in tools]

    @property
    def diameter_errors(self) -> Array:
        """Relative rms error of each tool's reflection, if interpolated between its neighbours.

        The neighbours are the next smaller and the next larger tool; tools are in the order of
        diameter, (n_tools,). The error is the largest over the depths; nan for the first and the
        last tool.
        """
        return self.tables.between

    @checked(contacts=Several(Contact), cycle=Number(0, 2**53, whole=True), seed=Optional(SEED))
    def read(
        self, contacts: Sequence[Contact], *, cycle: int = 0, seed: int | None = None
    ) -> NDArray[Any]:
        """Return the counts of one cycle.

        Parameters
        ----------
        contacts : sequence of Contact
            In any order; contacts of depth or force 0 are ignored.
        cycle : int
            Number of the cycle, on which its noise and drift depend.
        seed : int, optional
            Random seed of noise and drift, as in :func:`acoustube.ranging.record`, after which the
            counts are rounded; by default there is no noise, drift or rounding.

        Returns
        -------
        ndarray
            (n_samples,), uint16; float64 without a seed, or if the rangefinder does not quantise.

        Raises
        ------
        ConfigError
            If there are too many contacts, or one is outside the range of the tube or the library,
            or too close to another.
        """
        given = contact_arrays(self.tables, contacts, self.most_contacts)
        check_contacts(self.tables, *given, self.span, self.apart)
        changes = compiled()[0](self._shape, self._parts, *(a.astype(np.float32) for a in given))
        voltage = self._untouched + np.asarray(changes[0], float)
        r = self.rangefinder
        if seed is None:
            return (voltage + r.offset) * 2**r.bits / r.full_scale
        return digitise(voltage, r, np.array([cycle]), seed)[0]

    @checked(places=Reals(0, 1e3, "m", ndim=2), depths=Reals(0, 1.0, "m", ndim=2),
             diameters=Optional(Reals(0, 1.0, "m", ndim=2)), seed=Optional(SEED))  # fmt: skip
    def read_many(
        self,
        places: ArrayLike,
        depths: ArrayLike,
        diameters: ArrayLike | None = None,
        *,
        seed: int | None = None,
    ) -> NDArray[np.float32]:
        """Return the counts of many cycles, computed on all cores.

        Parameters
        ----------
        places, depths : array_like
            Of the contacts in m, in any order, (n, n_contacts); depth 0 for no contact.
        diameters : array_like, optional
            Of their tools in m, (n, n_contacts); by default that of the library's only tool.
        seed : int, optional
            Random seed of noise, drift and, if the rangefinder has it, quantisation. Each cycle's
            drift is independent of the others'; jitter and wander of the gain are left out.

        Returns
        -------
        ndarray
            Counts, (n, n_samples), float32.

        Raises
        ------
        ConfigError
            As :meth:`read`, or if the arrays differ in shape.
        """
        given = self._checked_arrays(places, depths, diameters)
        n = len(given[0])
        parts = [slice(i, min(i + BATCH, n)) for i in range(0, n, BATCH)]
        keys: Sequence[jax.Array | None] = [None] * len(parts)
        if seed is not None:
            keys = list(jax.random.split(_key(seed), len(parts)))
        found = np.empty((n, self.rangefinder.n_samples), np.float32)

        def compute(part: slice, key: jax.Array | None) -> None:
            missing = ((0, BATCH - (part.stop - part.start)), (0, 0))
            block = [np.pad(a[part], missing) for a in given]
            changes_of, counts_of = compiled()
            changes = changes_of(self._shape, self._parts, *block)
            counts = counts_of(self.rangefinder, self.model.untouched, changes, key)
            found[part] = counts[: part.stop - part.start]

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(compute, parts, keys))
        return found

    def _checked_arrays(
        self, places: ArrayLike, depths: ArrayLike, diameters: ArrayLike | None
    ) -> list[NDArray[np.float32]]:
        """Return the arrays of contacts, checked, with most_contacts columns.

        Raises
        ------
        ConfigError
            As :meth:`read_many`.
        """
        place, depth = np.asarray(places, float), np.asarray(depths, float)
        if diameters is None:
            diameters = np.full_like(depth, diameter_of(self.tables, None))
        size = np.asarray(diameters, float)
        if not place.shape == depth.shape == size.shape or place.shape[1] > self.most_contacts:
            raise ConfigError(
                f"places, depths and diameters have shapes {place.shape}, {depth.shape} and "
                f"{size.shape}; give equal ones of at most {self.most_contacts} contacts a cycle"
            )
        check_contacts(self.tables, place, depth, size, self.span, self.apart)
        missing = ((0, 0), (0, self.most_contacts - place.shape[1]))
        return [np.pad(a, missing).astype(np.float32) for a in (place, depth, size)]


def _key(seed: int) -> jax.Array:
    """Return the random key of all bits of a seed, up to 63; jax.random.key uses 32 of them."""
    key = jax.random.key(seed & 0xFFFFFFFF)
    return jax.random.fold_in(key, seed >> 32) if seed >> 32 else key
