"""Padding of arrays to few lengths, or to blocks, so that all meshes share compiled code."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

BLOCK = 64
"""Number of rows (elements or faces) in each block of :func:`in_blocks`."""


def padded_count(count: int) -> int:
    """Return the count to which elements or faces are padded: a multiple of 64, 128, 256...

    Above 512 it is at most an eighth larger than `count`.
    """
    step = max(64, 2 ** ((count - 1).bit_length() - 4))
    return step * math.ceil(count / step)


def padded(rows: NDArray[Any]) -> NDArray[Any]:
    """Return an array with its last row repeated up to :func:`padded_count`."""
    return _with_last_row_repeated(rows, padded_count(len(rows)))


def in_blocks(rows: NDArray[Any]) -> NDArray[Any]:
    """Return an array cut into blocks of `BLOCK` rows, the last filled by repeating the last row.

    Parameters
    ----------
    rows : ndarray
        (n, ...).

    Returns
    -------
    ndarray
        (n_blocks, `BLOCK`, ...).
    """
    full = _with_last_row_repeated(rows, BLOCK * math.ceil(len(rows) / BLOCK))
    return full.reshape(-1, BLOCK, *rows.shape[1:])


def counts_of_blocks(count: int) -> list[int]:
    """Return the number of rows in each block of :func:`in_blocks`, without repeated ones."""
    return [min(BLOCK, count - first) for first in range(0, count, BLOCK)]


def _with_last_row_repeated(rows: NDArray[Any], count: int) -> NDArray[Any]:
    return np.concatenate([rows, np.repeat(rows[-1:], count - len(rows), axis=0)])
