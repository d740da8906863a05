"""Types that several packages share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


Report = Callable[[str, float], None]
"""Called with the name of a stage and the fraction of it that is done."""


Index = NDArray[np.int64]


Mask = NDArray[np.bool_]


Progress = Callable[[float], None]
"""Called with the finished fraction of the work, 0 to 1."""
