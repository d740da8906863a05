"""How far estimates are from the truth, by the paper's measures, and whether intervals hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acoustube.base.types import Array


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of n estimates, in the unit of the target.

    Attributes
    ----------
    n : int
    median : float
        Of the absolute errors.
    rmse : float
        Root of the mean of the squared errors.
    iqr : float
        Of the absolute errors: their third quartile less their first.
    relative : float
        Median of the absolute errors over the size of the truth, as a share; where the truth is
        zero there is none.
    bias : float
        Median of the errors, estimate less truth.
    covered, covered_wide : float
        Share of the truths within the stated intervals of 68 % and 90 %; nan without intervals.
    """

    n: int
    median: float
    rmse: float
    iqr: float
    relative: float
    bias: float
    covered: float
    covered_wide: float


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
        In the same unit. Where one of them is not finite there is no error.
    half_width, wide : array of shape (n,), optional
        Half the lengths of the intervals around the estimates that are stated to hold 68 % and
        90 % of the truths.

    Returns
    -------
    Errors
        All nan for no estimates.

    Notes
    -----
    Tables I and II of the paper evaluate absolute errors and give their median, RMSE, IQR and, of
    forces, the median absolute relative error, over all cycles of a dataset.
    """
    told, found = np.asarray(truth, float), np.asarray(estimate, float)
    used = np.isfinite(told) & np.isfinite(found)
    true, wrong = told[used], (found - told)[used]
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


def bins(values: ArrayLike, width: float) -> tuple[Array, NDArray[np.intp]]:
    """Return bins of one width that hold some values, and which one each value is in.

    Parameters
    ----------
    values : array of shape (n,)
        Those that are not finite are in no bin.
    width : float
        The bins begin at its multiples: 5 cm make 38 of the paper's 20 to 210 cm.

    Returns
    -------
    edges : array of shape (bin, 2)
        Lower and upper edges, rising. A value at an edge, to rounding, is in the upper bin.
    index : array of int of shape (n,)
        Of the bin; -1 for none.
    """
    values = np.asarray(values, float)
    known = np.isfinite(values)
    # Depths of 2.5 mm may be stored as 2.4999999 mm.
    number = np.floor(values[known] / width + 1e-6).astype(np.int64)
    found, inside = np.unique(number, return_inverse=True)
    index = np.full(values.shape, -1, np.intp)
    index[known] = inside
    return width * np.stack([found, found + 1], axis=-1), index
