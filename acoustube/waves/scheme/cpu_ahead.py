"""Compilation of the time-stepping kernel for CPUs, ahead of the first run."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import numpy as np

from acoustube.waves.scheme.cpu_kernel import advance
from acoustube.waves.scheme.cpu_layout import (
    AbsorberColumns,
    Array,
    Columns,
    Fields,
    LossCoefficients,
    SourceAndProbes,
    Stencil,
)


def compile_march(*, lossy: bool) -> None:
    """Compile the single-precision kernel by a call with no time steps, if JAX runs on the CPU.

    Parameters
    ----------
    lossy : bool
        Whether the run will have losses.
    """
    if jax.default_backend() != "cpu":
        return
    numbers, one, (samples,) = np.zeros(0, np.uint64), np.zeros(1, np.int64), _empty(1)
    stencil = Stencil(*_empty(3, 3, 3, 3, 1, 1))
    absorber = AbsorberColumns(*_empty(2, 2, 3, 3, 3, 3))
    shape, keep, weights = _empty(2, 1, 3)
    problem = (
        Columns(numbers.reshape(0, 2), one, numbers.reshape(0, 3), np.zeros(2, np.int64)),
        stencil,
        LossCoefficients(stencil, *_empty(3, 3, 1, 1, 1, 1, 1, 1)),
        Fields(*_empty(4, 3, 3, 4, 3, 4, 3)),
        absorber,
        absorber,
        SourceAndProbes(shape, keep, 0, numbers, one, weights),
    )
    work = next(_empty(3)) if lossy else None
    advance(problem, 0, 0, samples, numbers, work, *_empty(3), one)


def _empty(*axes: int) -> Iterator[Array]:
    """Yield an empty array for each number of axes."""
    return (np.zeros((0,) * n_axes, np.float32) for n_axes in axes)
