"""Round ends: their modes, and scattering matrices from the impedance matrix of a lumen.

The impedance matrix Z gives the modal pressures from the modal fluxes (outward normal derivatives
of the pressure) of a lumen whose ends are otherwise rigid. Ingoing and outgoing waves, a and b,
have pressures (a + b) / sqrt(kz) and fluxes j sqrt(kz) (a - b), so that with D = sqrt(j kz) and
Q = D Z D

    b = S a,    S = (I + Q)^-1 (Q - I),

which is regular at cut-ons, where D vanishes. Modes far below their cut-on are terminated by the
condition dp/dn = -sqrt(kt^2 - k^2) p of outward decay, with the cut-on wavenumber kt, linearised in
k^2 about half the square of the highest wavenumber.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import jnp_zeros, jv

from acoustube.waves.spectral.polynomials import Array, Polynomials, gauss

Complex = NDArray[np.complexfloating[Any, Any]]

MARGIN = 1.3
"""Port modes have j' up to the largest k R plus this margin: they propagate or almost propagate. j'
is the cut-on wavenumber times the radius R."""
EVANESCENT_RANGE = 12.0
"""Range of j' above that of the port modes in which evanescent modes terminate the ends by their
outward decay. j' is the cut-on wavenumber times the radius."""


@dataclass(frozen=True, eq=False)
class PortModes:
    """Modes of an end of one symmetry about x = 0, or of both, in the order of their cut-ons.

    Attributes
    ----------
    names : tuple of str
        As ``00``, ``11c``, ``21s``: for an end that is not round, those of a round bore's modes of
        the same symmetry and rank.
    m : ndarray of int
        Nodal diameters of the mode in a round bore, (n,).
    zeros : ndarray
        Cut-on wavenumbers times the radius, for a round bore j'mn, (n,).
    sine : ndarray of bool
        True for modes antisymmetric about x = 0, False for symmetric ones, (n,): in a round bore
        sin(m phi) and cos(m phi), phi from -y towards +x.
    """

    names: tuple[str, ...]
    m: NDArray[np.intp]
    zeros: Array
    sine: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.names)

    def part(self, which: slice) -> PortModes:
        """Return the modes in a slice."""
        return PortModes(self.names[which], self.m[which], self.zeros[which], self.sine[which])


def port_modes(highest: float, odd: bool | None, lowest: float = -1.0) -> PortModes:
    """Return the modes of a round bore with `lowest` < j'mn <= `highest`.

    `odd` is True for those antisymmetric about x = 0, False for the symmetric ones; None for both.
    j'mn is the cut-on wavenumber times the radius, a zero of the derivative of J_m.
    """
    found = [] if odd else [(0.0, "00", 0, False)]
    for m in range(int(highest) + 1):
        zeros = jnp_zeros(m, int(highest / 2) + 2)
        sides = (False,) if m == 0 else (False, True)
        found += [
            (float(zero), f"{m}{n}" + ("" if m == 0 else "cs"[side]), m, side)
            for n, zero in enumerate(zeros, start=1)
            for side in sides
        ]
    if odd is not None:
        found = [mode for mode in found if mode[3] == odd]
    found = sorted(mode for mode in found if lowest < mode[0] <= highest)
    return PortModes(
        names=tuple(mode[1] for mode in found),
        m=np.array([mode[2] for mode in found], int),
        zeros=np.array([mode[0] for mode in found], float),
        sine=np.array([mode[3] for mode in found], bool),
    )


def port_functions(modes: PortModes, basis: Polynomials, box: Array, radius: float) -> Array:
    """Integrate polynomials times the modes, of unit integral of the square, over a round end.

    Parameters
    ----------
    modes : PortModes
    basis : Polynomials
    box : ndarray
        Centre and half width in x, then in y, of the end's box in m: x0, a, y0, b, (4,).
    radius : float
        In m.

    Returns
    -------
    ndarray
        In m, (n, n_modes).
    """
    reach = basis.degree + int(np.max(modes.zeros, initial=0.0))
    r, wr = gauss(reach // 2 + 8, 0.0, radius)
    n_phi = 2 * (reach // 2 + 4)
    phi = 2 * np.pi * (np.arange(n_phi) + 0.5) / n_phi
    x, y = np.outer(r, np.sin(phi)), -np.outer(r, np.cos(phi))
    weight = (wr * r)[:, None] * (2 * np.pi / n_phi)
    p = basis.values((x - box[0]) / box[1], (y - box[2]) / box[3]) * weight
    radial = jv(modes.m[:, None], modes.zeros[:, None] * r / radius)
    angle = modes.m[:, None] * phi
    around = np.where(modes.sine[:, None], np.sin(angle), np.cos(angle))
    shape = radial[:, :, None] * around[:, None, :]
    norm = np.sqrt((shape**2 * weight).sum((1, 2)))
    return np.asarray(
        p.reshape(basis.size, -1) @ (shape / norm[:, None, None]).reshape(len(modes), -1).T
    )


def wall_signs(modes: PortModes) -> Array:
    """Return the signs, (n,), of the radial functions J_m of a round bore's modes at the wall."""
    return np.asarray(np.sign(jv(modes.m, modes.zeros)))


def axial_wavenumbers(k: Array, zeros: Array, radius: float) -> Complex:
    """Return axial wavenumbers k_z without losses in 1/m, (n_frequencies, n_modes), towards +z.

    `k` are wavenumbers in 1/m, (n_frequencies,), and `zeros` cut-on wavenumbers times the radius.
    Below its cut-on k_z of a mode is negative imaginary.
    """
    root = np.sqrt(k[:, None] ** 2 - (zeros / radius) ** 2 + 0j)
    return np.where(root.imag > 0, -root, root)


def scattering_of(response: Complex | Array, kz: Complex) -> Complex:
    """Return the scattering matrix S of an impedance matrix Z in m, (n_frequencies, n, n) each.

    `kz` are the axial wavenumbers of the n modes at the ports in 1/m, (n_frequencies, n).
    """
    root = np.sqrt(1j * kz)
    q = root[:, :, None] * response * root[:, None, :]
    one = np.eye(q.shape[-1])
    return np.asarray(np.linalg.solve(one + q, q - one))


def changed_scattering(
    response: Complex | Array, change: Complex | Array, kz: Complex, drift: Complex | None = None
) -> Complex:
    """Return the first-order change of the scattering matrix, (n_frequencies, n, n).

    Parameters
    ----------
    response, change : ndarray
        Impedance matrix and its change in m, (n_frequencies, n, n).
    kz : ndarray
        Axial wavenumbers in 1/m, (n_frequencies, n).
    drift : ndarray, optional
        Changes of `kz` in 1/m, zero by default. They have to be zero where `kz` is zero, at a
        cut-on.
    """
    root = np.sqrt(1j * kz)
    if drift is not None:
        share = np.divide(drift, 2 * kz, out=np.zeros_like(kz), where=np.abs(kz) > 0)
        change = change + share[:, :, None] * response + response * share[:, None, :]
    one = np.eye(response.shape[-1])
    inverse = np.linalg.inv(one + root[:, :, None] * response * root[:, None, :])
    return 2 * inverse @ (root[:, :, None] * change * root[:, None, :]) @ inverse


def of_both_ports(found: list[Complex]) -> Complex:
    """Return S at the ports, (n, 2, m, 2, m), from one matrix per parity along z.

    A lumen symmetric about its middle has two parities: the fields symmetric about the middle, then
    the antisymmetric ones, with matrices (n, m, m) at one port. Any other lumen has one matrix,
    (n, 2 m, 2 m), of both ports.
    """
    n, size = found[0].shape[:2]
    if len(found) == 1:
        return found[0].reshape(n, 2, size // 2, 2, size // 2)
    reflected, passed = (found[0] + found[1]) / 2, (found[0] - found[1]) / 2
    rows = [np.stack(row, axis=2) for row in ((reflected, passed), (passed, reflected))]
    return np.stack(rows, axis=1)
