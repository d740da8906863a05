"""Scattering matrix of a press between two bends, in the modes of the bent tube, with derivatives.

To first order in B, the scattering matrix between the bent tube's modes (bent modes) is

    W = E^T (S + S B S) E + G + P.

S is the scattering matrix of the press between the straight tube's modes. E, B and G describe the
joints at its two ends, and are block-diagonal and referred to the press. E is their transmission, B
their reflection back into the straight bore, and G their reflection back into the bent one. P is
the transmission of modes that pass the press unscattered: those antisymmetric about the plane of
the bend, which are not in S. The derivatives are needed in products u^T dW v, where v holds the
amplitudes of the waves that arrive, and u the factors with which leaving waves are received. These
need only products of matrices and vectors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from acoustube.inversion.tables import Matrices
from acoustube.waves.scattering import Complex


@dataclass(frozen=True, eq=False)
class Joined:
    """Scattering of n presses between bends at n_f frequencies, in the modes of the bends.

    Attributes
    ----------
    straight : Matrices
        Scattering between three straight modes, zero for modes that the tool's matrices lack.
    joints, moved : ndarray
        Scattering matrices of the joints at both ports, flattened, and their derivatives by the
        position of the press in 1/m, (2, n, n_f, n_parts); see
        :mod:`acoustube.inversion.joint_sums`.
    way : ndarray
        Propagation factors of the straight modes from a press to a joint, (n, n_f, 3).
    warm : ndarray
        Relative derivatives of `way` by temperature in 1/K, (n_f, 3).
    through, through_warm : ndarray
        Propagation factors of the n_own modes that pass the press unscattered, from joint to joint,
        and their relative derivatives by temperature in 1/K, (n, n_f, n_own) and (n_f, n_own).
    untouched : ndarray
        Transmission of the plane wave from port to port of a bend without a press, (n, n_f).
    """

    straight: Matrices
    joints: Complex
    moved: Complex
    way: Complex
    warm: Complex
    through: Complex
    through_warm: Complex
    untouched: Complex

    @cached_property
    def value(self) -> Complex:
        """Scattering matrices between bent modes, (n, n_f, 2, 3, 2, 3)."""
        from acoustube.inversion.joint_sums import joined_values  # imports Numba

        return np.asarray(joined_values(self.straight.value, self.joints, self.way, self.through))

    def changes(
        self,
        left: Complex | None = None,
        right: Complex | None = None,
        out: Complex | None = None,
        into: Complex | None = None,
    ) -> Complex:
        """Return the derivatives of u^T W v, the sound received from presses with the matrices W.

        Parameters
        ----------
        left, right : ndarray, optional
            Factors u with which waves that leave the first port are received, and amplitudes v of
            the waves that arrive there, (n, n_f, 3); zero by default.
        out, into : ndarray, optional
            Factors u and amplitudes v at the second port, (n, n_f, 3); zero by default.

        Returns
        -------
        ndarray
            Derivatives by depth (1/m), stretch (a relative change of frequency), position (1/m),
            temperature (1/K), (4, n, n_f).
        """
        from acoustube.inversion.joint_sums import joined_changes

        s, silent = self.straight, np.zeros(self.way.shape, complex)
        waves = [silent if one is None else one for one in (left, out, right, into)]
        return np.asarray(joined_changes(
            s.value, s.by_depth, s.by_stretch, self.joints, self.moved, self.way, self.warm,
            self.through, self.through_warm, np.stack(waves, axis=2),
        ))  # fmt: skip

    def transmission(self) -> tuple[Complex, Complex, Complex]:
        """Return the plane wave's two-way transmission, and its derivatives by depth and stretch.

        Each is (n, n_f), divided by the two-way transmission of the bend without a press, which the
        clutter behind the press already contains. Stretch is a relative change of frequency.
        """
        plane = np.zeros(self.way.shape, complex)
        plane[..., 0] = 1.0
        onwards, back = self.changes(right=plane, out=plane), self.changes(left=plane, into=plane)
        there, here = self.value[..., 1, 0, 0, 0], self.value[..., 0, 0, 1, 0]
        by_depth, by_stretch = (onwards[i] * here + there * back[i] for i in (0, 1))
        both_ways = self.untouched**2
        return there * here / both_ways, by_depth / both_ways, by_stretch / both_ways
