"""Modulus of the wall and compliance of the ground from presses of known force or depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from acoustube.base.checks import Several, checked
from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.inversion.tools import Tool
from acoustube.inversion.twin.background import Measured

PRIOR_MODULUS = 0.5
"""Prior standard deviation of the logarithm of the ratio of the wall's modulus to the library's:
ten Shore A, and as much again because of the scatter of conversions from hardness to modulus."""
PRIOR_ZERO, PRIOR_COMPLIANCE = 3e-4, 5e-4
"""Prior standard deviations of the zero of the stated depths in m, and of the compliance in m/N of
what the tube lies on; that of soft tissue is 1e-4 to 5e-4."""
FORCE_SCATTERS = np.geomspace(0.002, 0.5, 24)
DEPTH_SCATTERS = np.geomspace(2e-6, 1e-3, 24)
"""Standard deviations of the stated forces (relative) and of the stated depths (in m) over which
the results are averaged."""
USUAL_FORCE, USUAL_DEPTH, WIDTH = 0.03, 5e-5, 1.0
"""Prior medians of the standard deviations of stated forces (relative) and of stated depths (in m),
and prior standard deviation of the logarithms of these two standard deviations."""
ECHO_DEPTH = 3e-5
"""Standard deviation in m of depths from an echo due to errors of the model, which the posterior of
the depth leaves out."""
LIBRARY_FORCE = 0.01
"""Relative standard deviation, due to the mesh, that all forces of a library have in common."""
OUTLYING, LEAST_OUTLYING, FEWEST_OUTLYING = 6.0, 0.1, 5
"""Residual of the log force, in standard deviations (estimated from the median deviation) and
absolute, above both of which a press is left out, and least number of presses for this test."""
SIGNIFICANT = 3.0
"""Ratio of the compliance to its standard deviation above which the ground is reported to yield."""


class Press(NamedTuple):
    """A press with its known quantities; unknown ones are nan.

    Attributes
    ----------
    tool : Tool
    depth, depth_deviation : float
        Compression of the tube in m estimated from the echo, and its standard deviation in m.
    stated_depth : float
        Stated travel of the tool from first contact in m: the tube's compression plus the ground's.
    force : float
        Stated force in N.
    """

    tool: Tool
    depth: float
    depth_deviation: float
    stated_depth: float
    force: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Material:
    """Stiffness of a tube's wall and compliance of the ground, estimated from n presses.

    Attributes
    ----------
    young_modulus : Measured
        Young's modulus of the wall in Pa.
    poisson_ratio : float
        Assumed Poisson's ratio of the wall.
    compliance : Measured
        Compliance of the ground in m/N.
    zero : Measured
        Stated depth in m at first contact.
    expected : ndarray
        Forces in N expected from the modulus and the depths, (n,); nan where the depth is not known
        or outside the library's range.
    left_out : dict
        Reasons why presses are left out, by index of the press.
    yields : bool
        Whether the compliance exceeds :data:`SIGNIFICANT` times the standard deviation that it
        would have if the modulus were known.
    """

    young_modulus: Measured
    poisson_ratio: float
    compliance: Measured
    zero: Measured
    expected: Array
    left_out: dict[int, str]
    yields: bool


@checked(presses=Several(Press, 1))
def fit_material(presses: Sequence[Press]) -> Material:
    """Return the wall's Young's modulus and the ground's compliance.

    Parameters
    ----------
    presses : sequence of Press
        Presses by tools whose forces are proportional to a known modulus, the same for all.

    Raises
    ------
    ConfigError
        If there is no press, or the modulus of the tools is not known or differs.

    Notes
    -----
    The shape of a Neo-Hookean wall between rigid bodies depends on the depth d alone. The force is
    ``F = (E / E_0) F_0(d)``, with modulus E_0 and force F_0 of the library. The ground yields by
    ``c F``, so that the stated depth is ``d_0 + d + c F``, with that of first contact d_0. The
    depth d is that of the echo, which does not depend on the modulus; without an echo it follows
    from the stated depth. E, and then c and d_0, are fitted by linear least squares, averaged over
    the unknown scatter of the labels. For presses whose force is missing or left out, the fit of c
    takes F from E and d, and the error of E adds to that of c.
    """
    moduli = np.unique([one.tool.young_modulus for one in presses])
    if len(moduli) > 1:
        raise ConfigError(
            "the presses are of indenters whose libraries differ in Young's modulus; use one "
            "library"
        )
    modulus = float(moduli[0]) if presses else np.nan
    if not np.isfinite(modulus):
        raise ConfigError(
            "the library does not state a modulus that its forces are proportional to; make a "
            "library on rigid ground with acoustube library"
        )
    told = np.array([one.depth for one in presses], float)
    sure = np.hypot([one.depth_deviation for one in presses], ECHO_DEPTH)
    stated = np.array([one.stated_depth for one in presses], float)
    force = np.array([one.force for one in presses], float)
    usual = [
        one.tool.force_at(d) if np.isfinite(d) else 0.0
        for one, d in zip(presses, told, strict=True)
    ]
    # A force not stated, or left out, is the library's at the echo's depth, for the wall's modulus.
    scale, within, wrong = _stiffness(presses, told, sure, force)
    doubted = np.isin(np.arange(len(force)), list(wrong))
    stands_in = ~np.isfinite(force) | (doubted & np.isfinite(within))
    load = np.where(stands_in, np.exp(scale.value) * np.array(usual, float), force)
    zero, compliance = _ground(told, sure, stated, load)
    yields = compliance.value > SIGNIFICANT * compliance.deviation
    known = np.isfinite(told) & np.isfinite(stated)
    share = np.sum(load[known & stands_in] ** 2) / max(np.sum(load[known] ** 2), 1e-300)
    common = float(share) * compliance.value * scale.deviation
    compliance = replace(compliance, deviation=float(np.hypot(compliance.deviation, common)))
    # Without an echo the depth is the stated one, less its origin and the ground's compression.
    depth = np.where(np.isfinite(told), told, stated - zero.value)
    sunk = np.where(np.isfinite(force), compliance.value * force, 0.0)
    depth = np.where(np.isfinite(told), depth, depth - sunk)
    loose = np.hypot(zero.deviation, np.nan_to_num(force) * compliance.deviation)
    sure = np.where(np.isfinite(told), sure, np.hypot(loose, USUAL_DEPTH))
    scale, expected, left_out = _stiffness(presses, depth, sure, force)
    factor = float(np.exp(scale.value))
    return Material(
        young_modulus=Measured(
            value=modulus * factor, deviation=modulus * factor * scale.deviation
        ),
        poisson_ratio=presses[0].tool.poisson_ratio, compliance=compliance, zero=zero,
        expected=factor * expected, left_out=left_out, yields=yields,
    )  # fmt: skip


def _ground(told: Array, sure: Array, stated: Array, load: Array) -> tuple[Measured, Measured]:
    """Return the stated depth in m at first contact, and the ground's compliance in m/N.

    Depths from the echo, their standard deviations and stated depths are in m, loads in N, (n,).
    """
    known = np.isfinite(told) & np.isfinite(stated)
    design = np.stack([np.ones(known.sum()), load[known]], axis=1)
    mean, covariance = _averaged(
        design, (stated - told)[known], sure[known] ** 2,
        np.array([PRIOR_ZERO, PRIOR_COMPLIANCE]), DEPTH_SCATTERS, USUAL_DEPTH,
    )  # fmt: skip
    both = [
        Measured(value=float(m), deviation=float(np.sqrt(v)))
        for m, v in zip(mean, np.diag(covariance), strict=True)
    ]
    return both[0], both[1]


def _stiffness(
    presses: Sequence[Press], depth: Array, sure: Array, force: Array
) -> tuple[Measured, Array, dict[int, str]]:
    """Return the log ratio of the wall's modulus to the library's, forces, and presses left out.

    The returned forces are the library's at the depths, in N, (n,). Depths and their standard
    deviations `sure` are in m, the stated forces `force` in N, (n,).
    """
    known, left_out = np.zeros(len(presses), bool), {}
    log_force, slope, expected = np.zeros((3, len(presses)))
    expected[:] = np.nan
    for i, one in enumerate(presses):
        tool = one.tool
        if not np.isfinite(depth[i]):
            left_out[i] = "neither its echo nor its label gives a depth"
        elif not tool.depth[0] <= depth[i] <= tool.depth[-1]:
            left_out[i] = "its depth is outside the library's"
        else:
            expected[i] = tool.force_at(depth[i])
            if not np.isfinite(force[i]):
                left_out[i] = "its force is not stated"
            elif force[i] <= 0 or expected[i] <= 0:
                left_out[i] = "its force is not positive"
            else:
                known[i] = True
                log_force[i] = np.log(force[i] / expected[i])
                slope[i] = tool.force_at(depth[i], 1) / expected[i]
    found = log_force[known]
    if len(found) >= FEWEST_OUTLYING:
        off = np.abs(log_force - np.median(found))
        limit = max(OUTLYING * 1.48 * float(np.median(off[known])), LEAST_OUTLYING)
        for k in np.flatnonzero(known & (off > limit)):
            left_out[int(k)] = "unlike others, its force does not fit its depth; check its label"
            known[k] = False
    mean, covariance = _averaged(
        np.ones((int(known.sum()), 1)), log_force[known], (slope * sure)[known] ** 2,
        np.array([PRIOR_MODULUS]), FORCE_SCATTERS, USUAL_FORCE,
    )  # fmt: skip
    # An error common to all depths, such as that of their origin, does not average out.
    common = 0.0
    if known.any():
        common = float(np.hypot(LIBRARY_FORCE, np.min((slope * sure)[known])))
    deviation = float(np.hypot(np.sqrt(covariance[0, 0]), common))
    scale = Measured(value=float(mean[0]), deviation=min(deviation, PRIOR_MODULUS))
    return scale, expected, left_out


def _averaged(
    design: Array, target: Array, variance: Array, prior: Array, scatters: Array, usual: float
) -> tuple[Array, Array]:
    """Return mean and covariance of linear parameters, averaged over the scatter of the data.

    Parameters
    ----------
    design, target, variance : ndarray
        Design matrix (n, p), data (n,), and the part of their variance that is known, (n,).
    prior : ndarray
        Standard deviations of the parameters about zero, (p,).
    scatters : ndarray
        Standard deviations of the data's scatter that are averaged over, (n_s,).
    usual : float
        Median of their log-normal prior.

    Returns
    -------
    mean, covariance : ndarray
        (p,) and (p, p).
    """
    weight, means, covariances = [], [], []
    for scatter in scatters:
        total = variance + scatter**2
        precision = (design.T / total) @ design + np.diag(prior**-2.0)
        covariance = np.linalg.inv(precision)
        mean = covariance @ (design.T @ (target / total))
        left = target - design @ mean
        value = np.sum(left**2 / total) + np.sum((mean / prior) ** 2) + np.sum(np.log(total))
        value += np.linalg.slogdet(precision)[1] + (np.log(scatter / usual) / WIDTH) ** 2
        weight.append(-0.5 * value)
        means.append(mean)
        covariances.append(covariance)
    share = np.exp(np.array(weight) - max(weight))
    share /= share.sum()
    mean = share @ np.array(means)
    spread = np.array(means) - mean
    covariance = np.einsum("i,ipq->pq", share, covariances) + (share * spread.T) @ spread
    return mean, covariance
