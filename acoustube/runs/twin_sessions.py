"""Variation of a sensor's parameters between sessions, from a twin fitted to each session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from acoustube.base.errors import ConfigError
from acoustube.base.foreign.documents import read_document
from acoustube.base.types import Array
from acoustube.base.units import MPA
from acoustube.ranging.analogue import MEASURED_SPACING
from acoustube.runs.sensor_file import (
    KIND,
    determined,
    finite_numbers,
    twin_settings,
    young_modulus,
)
from acoustube.runs.sweep.cycles import PLAIN
from acoustube.runs.sweep.dataset import rangefinder_in

COMPARED = {
    "inner_diameter_mm": None, "resonance_khz": "resonance", "quality_factor": "quality_factor",
    "temperature_offset_c": "temperature_bias", "gain_v": "gain", "send_v": "send",
    "noise_v": "noise", "offset_v": "offset", "young_modulus_mpa": None,
}  # fmt: skip
"""Parameters of twins that are compared, each with the parameter of the rangefinder or None."""
LOGARITHMS = ("resonance_khz", "quality_factor", "gain_v", "send_v", "noise_v")
"""Positive parameters, whose logarithms are compared."""
CHANCE = 0.05
"""Significance level of the test whether a parameter varies between sessions."""


@dataclass(frozen=True, kw_only=True)
class Across:
    """Mean and variation of a parameter over sessions.

    Attributes
    ----------
    name : str
    mean, deviation : float
        Mean over sessions and the standard deviation of this mean, in the parameter's unit; for
        :data:`LOGARITHMS` the geometric mean.
    spread : float
        Standard deviation between sessions, less that due to the fits, in the parameter's unit; for
        :data:`LOGARITHMS` the standard deviation of the logarithm times the mean.
    wanders : bool
        Whether the sessions differ significantly, at the level :data:`CHANCE`.
    """

    name: str
    mean: float
    deviation: float
    spread: float
    wanders: bool


def across_sessions(name: str, values: Array, deviations: Array) -> Across:
    """Return mean and variation of a parameter over sessions, by a random-effects model.

    Parameters
    ----------
    name : str
    values, deviations : ndarray
        Values and standard deviations of the parameter in the sessions, (n,), n > 1.

    Notes
    -----
    Random-effects model: the value of a session is that of the sensor, plus a normal deviation of
    the session, plus the error of the fit. The variance between sessions is estimated by moments
    [1]_. The sessions differ if Cochran's Q is significant by the chi-squared distribution with
    n - 1 degrees of freedom.

    References
    ----------
    .. [1] DerSimonian, R. and Laird, N. (1986). Meta-analysis in clinical trials. Controlled
       Clinical Trials 7, 177-188.
    """
    logarithmic = name in LOGARITHMS
    y, s = (np.log(values), deviations / values) if logarithmic else (values, deviations)
    weight = np.maximum(s, 1e-9 * max(float(np.abs(y).max()), 1e-9)) ** -2.0
    fixed = float(weight @ y / weight.sum())
    scatter, freedom = float(weight @ (y - fixed) ** 2), len(y) - 1
    excess = scatter - freedom
    variance = max(excess, 0.0) / float(weight.sum() - (weight**2).sum() / weight.sum())
    both = 1 / (variance + 1 / weight)
    mean, deviation = float(both @ y / both.sum()), float(both.sum() ** -0.5)
    wanders = bool(chi2.sf(scatter, freedom) < CHANCE)
    scale = float(np.exp(mean)) if logarithmic else 1.0
    return Across(
        name=name, mean=scale if logarithmic else mean, deviation=scale * deviation,
        spread=scale * float(np.sqrt(variance)), wanders=wanders,
    )  # fmt: skip


def recipe_settings(paths: Sequence[Path]) -> tuple[dict[str, Any], list[Across]]:
    """Return settings of a :class:`acoustube.runs.sweep.cycles.Recipe` from a sensor's files.

    Parameters
    ----------
    paths : sequence of Path
        Files of twins of one sensor, one for each session; or a single file of any sensor.

    Returns
    -------
    settings : dict
        Arguments of the recipe by name. With several files, the rangefinder is that of the first
        file with the means over sessions.
    table : list of Across
        Mean and variation of each parameter that two or more sessions determine; empty for one
        file.

    Raises
    ------
    ConfigError
        If a file cannot be read or describes a wrapped tube, one of several is not that of a twin,
        or several differ in sampling, converter or in whether the humidity is stated.
    """
    documents = [read_document(path) for path in paths]
    for path, document in zip(paths, documents, strict=True):
        if "wrap" in document:
            raise ConfigError(
                f"{path}: [wrap] describes a wrapped tube, but cycles are simulated for straight "
                "tubes only; remove [wrap]"
            )
    first = rangefinder_in(documents[0], paths[0])
    settings: dict[str, Any] = {"rangefinder": first} | twin_settings(paths[0])
    moduli = [young_modulus(one, path) for one, path in zip(documents, paths, strict=True)]
    stated = [modulus for modulus in moduli if modulus is not None]
    if len(stated) == 1:
        settings["young_modulus"] = stated[0][0]
    if len(paths) == 1:
        return settings, []
    for path, document in zip(paths, documents, strict=True):
        if KIND not in document:
            raise ConfigError(
                f"{path} is not the file of a twin; of several files each must be one"
            )
        if ("humidity_percent" in document) != ("humidity_percent" in documents[0]):
            raise ConfigError(
                f"only one of {path} and {paths[0]} was fitted with --humidity; fit all alike"
            )
        other = rangefinder_in(document, path)
        for name in ("sampling_rate", "n_samples", "bits", "full_scale"):
            if getattr(other, name) != getattr(first, name):
                raise ConfigError(
                    f"{path} has {name} = {getattr(other, name):g} and {paths[0]} "
                    f"{getattr(first, name):g}; sessions are of one sensor"
                )
    table = [
        across_sessions(name, *known)
        for name in COMPARED
        if (known := _known(name, documents, paths)) is not None
    ]
    return settings | _drawn(settings, table, documents[0], paths), table


def _known(
    name: str, documents: Sequence[dict[str, Any]], paths: Sequence[Path]
) -> tuple[Array, Array] | None:
    """Return values and deviations of a parameter, (n,), from the n sessions that determine it.

    None is returned unless n is 2 or more. Zeros, such as a noise that rounding hides, have no
    logarithm and are left out.
    """
    found = []
    for document, path in zip(documents, paths, strict=True):
        if name in determined(document):
            least = 0.0 if name in LOGARITHMS else -np.inf
            value = finite_numbers([document.get(name)], path, least=least)
            deviation = finite_numbers([document.get(f"{name}_sd")], path)
            if name not in LOGARITHMS or value[0] > 0:
                found.append(value + deviation)
    values = np.array(found)
    return (values[:, 0], values[:, 1]) if len(found) > 1 else None


def _drawn(
    settings: dict[str, Any],
    table: Sequence[Across],
    first: dict[str, Any],
    paths: Sequence[Path],
) -> dict[str, Any]:
    """Return arguments of a recipe: means over sessions, and deviations to draw sessions with."""
    means: dict[str, float] = {}
    spread: list[tuple[str, float]] = []
    found: dict[str, Any] = {}
    kilo = {"resonance_khz": 1e3}
    for one in table:
        own = COMPARED[one.name]
        if own == "temperature_bias":
            # The bias is defined for dry air; the offset in moist air differs.
            (own_offset,) = finite_numbers([first.get(one.name)], paths[0])
            moist = settings["rangefinder"].temperature_bias + own_offset
            means[own] = moist - one.mean
            between = one.spread if one.wanders else 0.0
            found["offset_deviation"] = float(np.hypot(between, one.deviation))
        elif own is not None:
            means[own] = one.mean * kilo.get(one.name, 1.0)
            width = one.spread if own in PLAIN else one.spread / one.mean
            if one.wanders and width > 0:
                spread.append((own, float(width)))
        elif one.name == "young_modulus_mpa":
            found["young_modulus"] = one.mean / MPA
    clutter, power = _clutter(paths)
    return found | {
        "rangefinder": replace(settings["rangefinder"], **means), "spread": tuple(spread),
        "reflectors": clutter, "clutter_spread": power,
    }  # fmt: skip


def _clutter(paths: Sequence[Path]) -> tuple[tuple[float, ...], float]:
    """Return mean reflection coefficients of the clutter, and variance of their changes in 1/m."""
    each = [np.array(twin_settings(path)["reflectors"]) for path in paths]
    n = min(len(one) for one in each)
    if n == 0:
        return (), 0.0
    all_of = np.stack([one[:n] for one in each])
    power = float(np.mean(all_of.var(axis=0, ddof=1))) / MEASURED_SPACING
    return tuple(map(float, all_of.mean(axis=0))), power
