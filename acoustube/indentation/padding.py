"""Padding of arrays to few lengths, so that meshes of different size share compiled code."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray


def padded_count(count: int) -> int:
    """Return the count to which elements or faces are padded: a multiple of 64, 128, 256...

    Above 512 it is at most an eighth larger than `count`.
    """
    step = max(64, 2 ** ((count - 1).bit_length() - 4))
    return step * math.ceil(count / step)


def padded(rows: NDArray[Any]) -> NDArray[Any]:
    """Return an array with its last row repeated up to :func:`padded_count`."""
    surplus = padded_count(len(rows)) - len(rows)
    return np.concatenate([rows, np.repeat(rows[-1:], surplus, axis=0)])
