"""Scattering matrices of parts in series: Redheffer's star product.

References
----------
* Redheffer, R. (1962). On the relation of transmission-line theory to scattering and transfer.
  Journal of Mathematics and Physics 41, 1-41.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from acoustube.waves.port_waves import Complex


def star_product(first: Complex, second: Complex) -> Complex:
    """Return the scattering matrix of two parts in series, Redheffer's star product.

    Parameters
    ----------
    first, second : ndarray
        Scattering matrices of the parts at n frequencies, (n, 2 m, 2 m): outgoing waves by incoming
        waves, the m modes at the start of the part before those at its end. The end of the first
        part is the start of the second.

    Returns
    -------
    ndarray
        Scattering matrix in the same order, (n, 2 m, 2 m).
    """
    m = first.shape[1] // 2
    (a11, a12), (a21, a22) = _blocks(first, m)
    (b11, b12), (b21, b22) = _blocks(second, m)
    echo = np.linalg.solve(np.eye(m) - a22 @ b11, np.concatenate([a21, a22 @ b12], axis=2))
    onward, returned = echo[:, :, :m], echo[:, :, m:]
    return np.block(
        [
            [a11 + a12 @ b11 @ onward, a12 @ (b12 + b11 @ returned)],
            [b21 @ onward, b22 + b21 @ returned],
        ]
    )


def _blocks(s: Complex, m: int) -> Any:
    """Return the four (n, m, m) blocks of a scattering matrix: [port out][port in]."""
    return (s[:, :m, :m], s[:, :m, m:]), (s[:, m:, :m], s[:, m:, m:])
