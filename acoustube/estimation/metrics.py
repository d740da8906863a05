"""Errors of estimates and coverage of their intervals.

Median, RMSE and IQR of absolute errors are the measures of "Wearable, Fabric-Embedded Acoustic
Waveguides for Meter-Scale Contact Localization and Force Sensing" (the sleeve paper).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acoustube.base.checks import Reals, check_alike, checked
from acoustube.base.rules import Number
from acoustube.base.types import Array

ROW = Reals(ndim=1, missing=True, empty=True)


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of n estimates, in the unit of the target.

    Attributes
    ----------
    n : int
    median : float
        Median of the absolute errors.
    rmse : float
        Root-mean-square error.
    iqr : float
        Interquartile range of the absolute errors.
    relative : float
        Median of the absolute errors divided by the absolute truth, where that is not zero.
    bias : float
        Median of estimate minus truth.
    covered, covered_wide : float
        Coverage: fraction of the truths within the stated intervals of 68 % and 90 %; nan without
        intervals.
    """

    n: int
    median: float
    rmse: float
    iqr: float
    relative: float
    bias: float
    covered: float
    covered_wide: float


@checked(truth=ROW, estimate=ROW, half_width=ROW, wide=ROW)
def errors(
    truth: ArrayLike,
    estimate: ArrayLike,
    half_width: ArrayLike | None = None,
    wide: ArrayLike | None = None,
) -> Errors:
    """Return the errors of estimates.

    Parameters
    ----------
    truth, estimate : array of shape (n,)
        In the same unit. Pairs with a value that is not finite are left out.
    half_width, wide : array of shape (n,), optional
        Half widths of the intervals around the estimates with a stated coverage of 68 % and 90 %.

    Returns
    -------
    Errors
        Without finite pairs, `n` is 0 and all others are nan.

    Raises
    ------
    ConfigError
        If the arrays do not have one shape.

    Notes
    -----
    Tables I and II of the sleeve paper give median, RMSE and IQR of the absolute errors and, for
    forces, the median absolute relative error, over all cycles of a dataset.
    """
    given = {"half_width": half_width, "wide": wide}
    given = {name: array for name, array in given.items() if array is not None}
    check_alike(truth=truth, estimate=estimate, **given)
    known, found = np.asarray(truth, float), np.asarray(estimate, float)
    used = np.isfinite(known) & np.isfinite(found)
    true, wrong = known[used], (found - known)[used]
    n, size = len(wrong), np.abs(wrong)
    if n == 0:
        return Errors(n=0, **dict.fromkeys(_MEASURES, np.nan))
    quarter, median, three_quarters = np.percentile(size, [25, 50, 75])
    some: NDArray[np.bool_] = true != 0
    return Errors(
        n=n,
        median=float(median),
        rmse=float(np.sqrt(np.mean(wrong**2))),
        iqr=float(three_quarters - quarter),
        relative=float(np.median(size[some] / np.abs(true[some]))) if some.any() else np.nan,
        bias=float(np.median(wrong)),
        covered=_covered(size, half_width, used),
        covered_wide=_covered(size, wide, used),
    )


_MEASURES = ("median", "rmse", "iqr", "relative", "bias", "covered", "covered_wide")


def _covered(size: Array, half_width: ArrayLike | None, used: NDArray[np.bool_]) -> float:
    if half_width is None:
        return float("nan")
    return float(np.mean(size <= np.asarray(half_width, float)[used]))


@checked(values=ROW, width=Number(1e-12, 1e12))
def bins(values: ArrayLike, width: float) -> tuple[Array, NDArray[np.intp]]:
    """Return the non-empty bins of equal width, and the bin of each value.

    Parameters
    ----------
    values : array of shape (n,)
        Values that are not finite are in no bin.
    width : float
        Width of a bin; bins begin at multiples of it. With 5 cm, the sleeve paper's 20 to 210 cm
        have 38 bins.

    Returns
    -------
    edges : array of shape (bin, 2)
        Lower and upper edges, rising. A value at an edge, up to rounding, is in the upper bin.
    index : array of int of shape (n,)
        Row of each value's bin in `edges`; -1 for values that are not finite.
    """
    values = np.asarray(values, float)
    known = np.isfinite(values)
    # Depths of 2.5 mm may be stored as 2.4999999 mm.
    number = np.floor(values[known] / width + 1e-6).astype(np.int64)
    found, inside = np.unique(number, return_inverse=True)
    index = np.full(values.shape, -1, np.intp)
    index[known] = inside
    return width * np.stack([found, found + 1], axis=-1), index
