"""A press between two bends: its scattering matrix between bent modes, and changes of it.

With S its matrix between straight modes, and of the joints at its two ends E what they pass, B what
they return to the straight bore and G what they reflect in the bent one, all block-diagonal and
referred to the press, the matrix between bent modes is

    E^T (S + S B S) E + G + P,

to first order in B, with P what passes the press unscattered: modes antisymmetric about the plane
of the bend, which the press does not have. Its derivatives are wanted in products u^T dW v with the
sound v that arrives and what is heard of the sound that leaves, u; these need products of matrices
and vectors alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from acoustube.inversion.tables import Matrices
from acoustube.waves.scattering import Complex


@dataclass(frozen=True, eq=False)
class Joined:
    """Presses between bends.

    Attributes
    ----------
    straight : Matrices
        Between straight modes, of which there are three or fewer.
    joints, moved : ndarray
        At both ports, and their derivatives by place in 1/m, (2, n, n_f, n_parts); see
        :mod:`acoustube.inversion.joint_sums`.
    way : ndarray
        Factors of the straight modes from a press to a joint, (n, n_f, 3).
    warm : ndarray
        Their relative derivatives by temperature in 1/K, (n_f, 3).
    through, through_warm : ndarray
        The same of the modes that pass from joint to joint, (n, n_f, n_own) and (n_f, n_own).
    untouched : ndarray
        Factor of the plane wave from port to port of a bend without a press, (n, n_f).
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
        """Matrices between bent modes, (n, n_f, 2, 3, 2, 3)."""
        from acoustube.inversion.joint_sums import joined_values  # Numba, as in `tables`

        return np.asarray(joined_values(self.straight.value, self.joints, self.way, self.through))

    def changes(
        self,
        left: Complex | None = None,
        right: Complex | None = None,
        out: Complex | None = None,
        into: Complex | None = None,
    ) -> Complex:
        """Return derivatives of what is heard of the sound that the presses scatter.

        Parameters
        ----------
        left, right : ndarray, optional
            What is heard of sound that leaves at the first port, and the sound that arrives there,
            (n, n_f, 3); nothing by default.
        out, into : ndarray, optional
            The same at the second port.

        Returns
        -------
        ndarray
            By depth, stretch, place and temperature, (4, n, n_f).
        """
        from acoustube.inversion.joint_sums import joined_changes

        s, silent = self.straight, np.zeros(self.way.shape, complex)
        waves = [silent if one is None else one for one in (left, out, right, into)]
        return np.asarray(joined_changes(
            s.value, s.by_depth, s.by_stretch, self.joints, self.moved, self.way, self.warm,
            self.through, self.through_warm, np.stack(waves, axis=2),
        ))  # fmt: skip

    def transmission(self) -> tuple[Complex, Complex, Complex]:
        """Return the plane wave's transmission both ways, and changes by depth and stretch.

        Relative to the bend without a press, as clutter behind it is.
        """
        plane = np.zeros(self.way.shape, complex)
        plane[..., 0] = 1.0
        onwards, back = self.changes(right=plane, out=plane), self.changes(left=plane, into=plane)
        there, here = self.value[..., 1, 0, 0, 0], self.value[..., 0, 0, 1, 0]
        by_depth, by_stretch = (onwards[i] * here + there * back[i] for i in (0, 1))
        both_ways = self.untouched**2
        return there * here / both_ways, by_depth / both_ways, by_stretch / both_ways
