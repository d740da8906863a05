"""Modes of a bore of constant curvature and torsion, and its joints with a straight bore.

The coupled equations of :mod:`acoustube.waves.bent_parts`, whose coefficients do not vary along the
arc length s, have solutions (p, v) exp(-j beta s). p is the pressure, v is rho c times the axial
velocity, both as coefficients of the straight bore's modes, and beta is the wavenumber. These are
the bent bore's own modes, which propagate in it without mode conversion. For each forward mode,
(Q p, -Q v) with -beta is a backward mode. The diagonal matrix Q is 1 for straight modes that are
symmetric about the plane of the bend, and -1 for antisymmetric ones: the centre line rotated by
half a turn about its normal is the same line, in the opposite direction. By reciprocity
p_i Q v_j + v_i Q p_j is zero for two different modes i and j; they are normalised to p_i Q v_i = 1,
the value for a straight mode of unit power.

Where a bent bore continues straight, pressure and axial velocity are continuous. As sums of the
straight bore's modes, each has therefore equal coefficients on both sides. All modes in the sums
are included, evanescent ones too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acoustube.air import Air
from acoustube.base.checks import BORE, WAVES, Several, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.waves.bends import mode_places
from acoustube.waves.bent_parts import Bent, bend_generator
from acoustube.waves.modes.bore_couplings import bore_modes
from acoustube.waves.port_waves import Complex

LARGEST_ZERO = 4.5
"""Largest j'mn, zero of a Bessel function's derivative, of the modes in the sums. With 8 the
wavenumbers of (0,0) and (1,1) in the sleeve paper's tube at 42 kHz change by 0.02 per metre at
most."""
LEAN = 0.1
"""Weight of the real part of the wavenumber, relative to the decay, in the order of evanescent
modes: it decides within pairs of nearly equal decay."""
PREFERRED = 1e-6
"""Weight of the real part of the wavenumber, relative to the imaginary part, in the choice of
forward waves: it decides among waves that do not decay."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BentModes:
    """Forward modes of a bent bore, and their scattering at a joint with a straight bore.

    Propagating modes are first, in the order of decreasing real part of the wavenumber. Evanescent
    ones, whose wavenumber has the larger imaginary part, follow in the order of increasing decay.

    Attributes
    ----------
    wavenumber : ndarray
        beta in 1/m at n_f frequencies, (n_f, m).
    passed : ndarray
        Transmission from m bent to m_s straight modes at the joint, (n_f, m_s, m). In the other
        direction it is the transpose.
    reflected : ndarray
        Reflection of bent modes by the joint, (n_f, m, m).
    returned : ndarray
        Reflection of straight modes by the joint, (n_f, m_s, m_s).
    fields : ndarray
        p and v of the bent modes (see the module), as coefficients of the straight bore's N modes,
        (n_f, 2, N, m).
    symmetry : ndarray
        Signs of the symmetry of the straight bore's N modes about the plane of the bend, (N,).
    signs : ndarray
        Signs `symmetry` of the m_s straight modes at the joint, (m_s,). At the other end of a
        straight bore, where it becomes bent again, the transmission is ``passed.T * signs``, and
        the reflection is ``returned`` times the signs of both modes.
    """

    wavenumber: Complex
    passed: Complex
    reflected: Complex
    returned: Complex
    fields: Complex
    symmetry: Array
    signs: Array

    def aligned(self, other: BentModes) -> BentModes:
        """Return these modes with the order and the signs of the modes of a neighbouring curvature.

        Parameters
        ----------
        other : BentModes
            Modes of a bore of slightly different curvature.
        """
        p, v = self.fields[:, 0], self.fields[:, 1]
        q, w = (self.symmetry[:, None] * other.fields[:, i] for i in (0, 1))
        overlap = 0.5 * (q.swapaxes(1, 2) @ v + w.swapaxes(1, 2) @ p)
        order = np.argmax(np.abs(overlap), axis=2)
        sign = np.sign(np.take_along_axis(overlap, order[..., None], 2)[..., 0].real)
        sign = np.where(sign == 0, 1.0, sign)

        def taken(part: Complex, axis: int) -> Complex:
            index = np.expand_dims(order, tuple(i for i in range(1, part.ndim) if i != axis))
            factor = np.expand_dims(sign, tuple(i for i in range(1, part.ndim) if i != axis))
            return np.asarray(np.take_along_axis(part, index, axis) * factor)

        wavenumber = np.take_along_axis(self.wavenumber, order, 1)
        return BentModes(
            wavenumber=wavenumber, passed=taken(self.passed, 2),
            reflected=taken(taken(self.reflected, 1), 2), returned=self.returned,
            fields=taken(self.fields, 3), symmetry=self.symmetry, signs=self.signs,
        )  # fmt: skip


@checked(
    air=Air,
    frequency=WAVES,
    part=Bent,
    radius=BORE,
    modes=Several(str, 1),
    count=Number(1, 50, whole=True),
)
def bent_modes(
    air: Air,
    frequency: Array | Complex,
    part: Bent,
    *,
    radius: float,
    modes: Sequence[str],
    count: int,
) -> BentModes:
    """Return the first modes of a bent bore, and the scattering of its joint with a straight one.

    Losses at the wall are those of the straight bore.

    Parameters
    ----------
    air : Air
    frequency : ndarray
        In Hz, (n_f,). With a negative imaginary part, spectra are those of signals times a decaying
        exponential.
    part : Bent
        The bend; its length is not used.
    radius : float
        Bore radius in m.
    modes : sequence of str
        Names of the m_s straight modes at the joint, as ``11c``. Their coefficients are
        power-normalised, also below cut-on, where an evanescent mode's root of k_z is complex.
    count : int
        Number m of bent modes.

    Raises
    ------
    ConfigError
        If a mode is not among those in the sums, or `count` is larger than their number.
    """
    frequency = np.atleast_1d(np.asarray(frequency))
    bore = bore_modes(LARGEST_ZERO)
    place = mode_places(modes, bore)
    generator, admittance = bend_generator(air, frequency, bore, radius, part, lossy=True)
    n, (_, size) = len(frequency), admittance.shape
    if count > size:
        raise ConfigError(
            "is larger than the number of modes computed", setting="count", value=count,
            allowed=(1, size), advice=f"use at most {size}",
        )  # fmt: skip
    growth, vectors = np.linalg.eig(generator)
    beta = 1j * growth
    forward = np.argsort(beta.imag - PREFERRED * beta.real, axis=1)[:, :size]
    beta = np.take_along_axis(beta, forward, 1)
    order = _order(beta)
    forward, beta = np.take_along_axis(forward, order, 1), np.take_along_axis(beta, order, 1)
    vectors = np.take_along_axis(vectors, forward[:, None], 2)
    p, v = vectors[:, :size], vectors[:, size:]
    own = np.array([-1.0 if name.endswith("s") else 1.0 for name in bore.names])
    scale = np.sqrt(np.einsum("nim,i,nim->nm", p, own, v))[:, None]
    p, v = p / scale, v / scale
    eye = np.broadcast_to(np.eye(size), (n, size, size))
    y = admittance[:, :, None] * eye
    q = own[:, None]
    outgoing = np.concatenate(
        [np.concatenate([q * p, -eye], 2), np.concatenate([-q * v, -y], 2)], 1
    )
    incident = np.concatenate([np.concatenate([-p, eye], 2), np.concatenate([-v, -y], 2)], 1)
    s = np.linalg.solve(outgoing, incident)
    # As in the scattering of presses, also for evanescent modes: k_z and its root are complex.
    root: Complex = np.sqrt(admittance[:, place])
    at = np.array(place) + size
    return BentModes(
        wavenumber=beta[:, :count],
        passed=root[:, :, None] * s[:, at][..., :count],
        reflected=s[:, :count, :count],
        returned=root[:, :, None] * s[:, at][..., at] / root[:, None],
        fields=np.stack([p[..., :count], v[..., :count]], 1),
        symmetry=own,
        signs=own[place],
    )


def _order(beta: Complex) -> NDArray[np.intp]:
    """Return the order of forward modes of wavenumbers in 1/m, (n_f, m), as in :class:`BentModes`.

    With losses or torsion the wavenumbers of evanescent modes have real parts too.
    """
    evanescent = np.abs(beta.imag) > beta.real
    decay = -beta.imag - LEAN * beta.real
    return np.lexsort((np.where(evanescent, decay, -beta.real), evanescent), axis=1)
