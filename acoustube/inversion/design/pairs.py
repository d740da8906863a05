"""Expected errors of two presses at once, the second one behind the first.

The sound of the second press passes the first one twice: its echo is T1^2 R2 exp(-2j k z2), and
that of the first press is R1 exp(-2j k z1). R and T are the presses' reflection and transmission
coefficients, z their distances, and k is the wavenumber. Overlap of the echoes and shared nuisance
parameters (air, gain) increase the errors of both presses. Multiple reflections between the presses
and modes other than the plane one are left out, as for one press.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from acoustube.air import air_at
from acoustube.base.checks import TEMPERATURE, Instance, Optional, Several, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.inversion.design.echoes import Contacts, PressedTube, check_tools
from acoustube.inversion.design.electronics import Electronics, weight_of
from acoustube.inversion.design.fisher import by_temperature
from acoustube.inversion.design.prediction import DETECTED
from acoustube.inversion.model import Priors
from acoustube.waves.modes import axial_wavenumber
from acoustube.waves.scattering import Complex


class Pairs(NamedTuple):
    """Expected errors of n pairs of presses, the nearer press first.

    Attributes
    ----------
    place : ndarray
        Cramer-Rao standard deviations of the positions in m, (n, 2).
    depth : ndarray
        Cramer-Rao standard deviations of the depths in m, (n, 2).
    force : ndarray
        Relative standard deviations of the forces, including errors of the wall's modulus and of
        the model, (n, 2).
    detection : ndarray
        Probabilities that the second press is distinguished from changes of other
        parameters, (n,).
    """

    place: Array
    depth: Array
    force: Array
    detection: Array


@checked(
    tubes=Several(PressedTube, 1), contacts=Contacts, electronics=Instance((Electronics,)),
    separation=Number(1e-3, 100, "m"), modulus=Number(1e-6, 1e6), temperature=TEMPERATURE,
    priors=Optional(Priors), hardness=Number(0, 100), model=Number(0, 1.0, "m"),
)  # fmt: skip
def predict_pairs(
    tubes: Sequence[PressedTube],
    contacts: Contacts,
    electronics: Electronics,
    separation: float,
    *,
    modulus: float = 1.0,
    temperature: float = 20.0,
    priors: Priors | None = None,
    hardness: float = 0.05,
    model: float = 0.0,
) -> Pairs:
    """Return the expected errors of pairs of presses with one rangefinder at the face.

    Parameters
    ----------
    tubes : sequence of PressedTube
        One for each tool, with their transmission.
    contacts : Contacts
        The first press of each pair. The second one has the force and the tool of the next contact,
        or of the first contact in the last pair.
    electronics : Electronics
        Scalars.
    separation : float
        Distance between the two presses in m.
    modulus, temperature, priors, hardness, model
        See :func:`acoustube.inversion.design.information`.

    Raises
    ------
    ConfigError
        If a tube has no transmission, or there is no tube for the tool of a contact.

    Notes
    -----
    The Fisher information has eight parameters: two positions and depths, temperature, stretch of
    frequency, gain and phase, in units of their prior standard deviations. The second press is
    distinguished where the part of its echo that no change of the six parameters other than its own
    explains, to first order, exceeds the threshold of detection,
    :data:`acoustube.inversion.design.prediction.DETECTED`.
    """
    check_tools(tubes, contacts)
    if any(tube.transmission is None for tube in tubes):
        raise ConfigError("a tube has no transmission; give transmission with its reflection")
    priors, air = priors or Priors(), air_at(temperature)
    f = tubes[0].frequency
    k = axial_wavenumber(0, 0, f, tubes[0].radius, air)
    heat, faster = by_temperature(f, tubes[0].radius, temperature)
    weight = weight_of(f, electronics)
    ends = np.array([contacts.lightest, contacts.strongest]) / modulus
    span = max(np.ptp([tube.depth_at(ends) for tube in tubes]), 1e-4)
    scale = np.array([contacts.length, span]) / np.sqrt(12)
    n = len(contacts.force)
    place, depth, force = np.empty((3, n, 2))
    detection = np.empty(n)
    for i in range(n):
        chosen = [tubes[contacts.tool[j]] for j in (i, (i + 1) % n)]
        given = [contacts.force[j] / modulus for j in (i, (i + 1) % n)]
        echoes, by_depth = _echoes(chosen, given)
        z = contacts.place[i] + np.array([0.0, separation])
        turned = np.exp(-2j * k * z[:, None])
        echoes, by_depth = echoes * turned, by_depth * turned
        total = echoes.sum(axis=0)
        # A stretch of frequency changes the presses, not the propagation to them.
        stretch = f * (np.gradient(echoes / turned, f, axis=1) * turned).sum(axis=0)
        warm = (-2j * heat * z[:, None] * echoes).sum(axis=0) - faster * stretch
        columns = np.stack([
            -2j * k * echoes[0] * scale[0], by_depth[0] * scale[1],
            -2j * k * echoes[1] * scale[0], by_depth[1] * scale[1],
            priors.temperature * warm, priors.stretch * stretch, priors.gain * total,
            priors.phase * 1j * total,
        ])  # fmt: skip
        # The depth of the first press changes the transmission to the second.
        columns[1] += scale[1] * _passed_by_depth(chosen[0], given[0]) * echoes[1]
        matrix = np.eye(8) + ((columns.conj() * weight) @ columns.T).real
        deviation = np.sqrt(np.diag(np.linalg.inv(matrix)))
        place[i], depth[i] = deviation[[0, 2]] * scale[0], deviation[[1, 3]] * scale[1]
        slope = [1 / (g * tube.compliance_at(np.array([g]))[0])
                 for g, tube in zip(given, chosen, strict=True)]  # fmt: skip
        off = np.hypot(depth[i], model) * np.array(slope)
        force[i] = np.minimum(np.hypot(off, hardness), contacts.force_prior)
        detection[i] = _detection(echoes[1], columns[[0, 1, 4, 5, 6, 7]], weight)
    return Pairs(place, depth, force, detection)


def _echoes(tubes: Sequence[PressedTube], force: Sequence[float]) -> tuple[Complex, Complex]:
    """Return both echoes without propagation, and the derivative of each by its depth, (2, n_f)."""
    depths = [tube.depth_at(np.array([g])) for tube, g in zip(tubes, force, strict=True)]
    passed = tubes[0].transmission_at(depths[0])[0] ** 2
    echo = np.stack([tube.reflection_at(d)[0] for tube, d in zip(tubes, depths, strict=True)])
    slope = np.stack([tube.reflection_at(d, 1)[0] for tube, d in zip(tubes, depths, strict=True)])
    through = np.stack([np.ones_like(passed), passed])
    return echo * through, slope * through


def _passed_by_depth(tube: PressedTube, force: float) -> Complex:
    """Return the logarithmic derivative by depth of a press's two-way transmission, (n_f,)."""
    depth = tube.depth_at(np.array([force]))
    return np.asarray(2 * tube.transmission_at(depth, 1)[0] / tube.transmission_at(depth)[0])


def _detection(echo: Complex, columns: Complex, weight: Array) -> float:
    """Return the probability that an echo is distinguished from changes of other parameters."""
    matrix = np.eye(len(columns)) + ((columns.conj() * weight) @ columns.T).real
    along = ((columns.conj() * weight) @ echo).real
    energy = float((np.abs(echo) ** 2 * weight).sum() - along @ np.linalg.solve(matrix, along))
    return float(ndtr(sqrt(max(energy, 0.0)) - DETECTED))
