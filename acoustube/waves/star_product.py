"""Scattering matrix of a part of a duct from its transfer matrix, and of parts in series.

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
        Scattering matrices of the parts at n frequencies, (n, 2 m, 2 m): a row for each outgoing
        and a column for each incoming wave, the m modes at the start of the part before those at
        its end. The end of the first part is the start of the second.

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


def from_transfer(transfer: Complex, admittance: Complex) -> Complex:
    """Return the scattering matrix of a part from its transfer matrix of pressure and velocity.

    Parameters
    ----------
    transfer : ndarray
        Matrix from the modal pressures and velocities (towards the end) of m modes at the start of
        the part to those at its end, at n frequencies, (n, 2 m, 2 m).
    admittance : ndarray
        Ratio of velocity to pressure of each mode's forward wave on both sides, (n, m).

    Returns
    -------
    ndarray
        Scattering matrix in the order of :func:`star_product`, (n, 2 m, 2 m).
    """
    m = admittance.shape[1]
    one = np.broadcast_to(np.eye(m), (len(admittance), m, m))
    y = admittance[:, :, None] * one
    basis = np.block([[one, one], [y, -y]])
    w = np.linalg.solve(basis, transfer @ basis)
    back = np.linalg.inv(w[:, m:, m:])
    turned = w[:, :m, m:] @ back
    return np.block([[-back @ w[:, m:, :m], back], [w[:, :m, :m] - turned @ w[:, m:, :m], turned]])


def _blocks(s: Complex, m: int) -> Any:
    """Return the four (n, m, m) blocks of a scattering matrix: [port out][port in]."""
    return (s[:, :m, :m], s[:, :m, m:]), (s[:, m:, :m], s[:, m:, m:])
