"""Fisher information of a contact at each frequency, before weighting by the spectrum of a pulse.

The echo of a press is R(f, d) exp(-2j k z) times the spectrum that the electronics receive from a
complete reflection. R is the reflection coefficient of the plane mode at frequency f by a press of
depth d, k the mode's wavenumber, and z the distance of the press. The Fisher information is a sum
over frequency of products of derivatives of the echo, and linear in the power of that spectrum. The
factors that do not depend on pulse and transducer are computed once for a tube.

References
----------
* Fisher information and the Cramer-Rao bound: Kay, S. M. (1993). Fundamentals of Statistical
  Signal Processing: Estimation Theory, chapter 3. Prentice Hall.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from acoustube.air import air_at, neighbouring_air
from acoustube.base.checks import TEMPERATURE, Optional, Several, checked
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.inversion.design.echoes import Contacts, PressedTube, check_tools
from acoustube.inversion.model import Priors
from acoustube.waves.modes import axial_wavenumber
from acoustube.waves.scattering import Complex

FARTHEST, REACHES = 12.0, 48
"""Largest reach in m that is computed, and number of positions up to it."""


class Information(NamedTuple):
    """Fisher information of n contacts on a tube at each frequency, per received spectral power.

    Columns are the derivatives of the echo by position, depth, temperature, stretch of frequency,
    gain and phase, each times the prior standard deviation of its parameter. A first axis of length
    2 is for the rangefinder at the near end and for one at the far end.

    Attributes
    ----------
    frequency : ndarray
        In Hz, (n_f,).
    sound_speed : float
        In m/s.
    wavenumber : ndarray
        Real part of the plane mode's wavenumber, in rad/m, (n_f,).
    products : ndarray
        Real parts of the products of conjugate columns with columns, (2, n, 6, 6, n_f).
    echoes : ndarray
        Products of the conjugate columns with the echo, (2, n, 6, n_f).
    power : ndarray
        Squared magnitude of the echo, attenuated by the path, (2, n, n_f).
    place : ndarray
        Distances of the contacts from either rangefinder in m, (2, n).
    scale : ndarray
        Prior standard deviations of position and depth in m, (2,).
    slope : ndarray
        Relative change of force with depth in 1/m, (n,).
    within_range : ndarray
        1 if the force is at most that of the deepest press of the tube, otherwise 0, (n,).
    force_prior : float
        Standard deviation of the logarithm of an unknown force.
    hardness : float
        Relative standard deviation of the wall's modulus.
    model : float
        Standard deviation in m of depths due to errors of the forward model.
    range_grid : ndarray
        Positions in m at which the echo of the lightest contact is computed, (m,).
    range_power : ndarray
        Squared magnitude of this echo for each tool, (n_tools, m, n_f).
    """

    frequency: Array
    sound_speed: float
    wavenumber: Array
    products: Array
    echoes: Complex
    power: Array
    place: Array
    scale: Array
    slope: Array
    within_range: Array
    force_prior: float
    hardness: float
    model: float
    range_grid: Array
    range_power: Array


@checked(
    tubes=Several(PressedTube, 1), contacts=Contacts, modulus=Number(1e-6, 1e6),
    temperature=TEMPERATURE, priors=Optional(Priors), hardness=Number(0, 100),
    model=Number(0, 1.0, "m"),
)  # fmt: skip
def information(
    tubes: Sequence[PressedTube],
    contacts: Contacts,
    *,
    modulus: float = 1.0,
    temperature: float = 20.0,
    priors: Priors | None = None,
    hardness: float = 0.05,
    model: float = 0.0,
) -> Information:
    """Return the Fisher information of contacts on a tube at each frequency.

    Parameters
    ----------
    tubes : sequence of PressedTube
        One for each tool, all with the same bore and frequencies.
    contacts : Contacts
    modulus : float
        Shear modulus of the wall, relative to that with which the presses were computed. Forces of
        a neo-Hookean tube on a rigid floor are proportional to it.
    temperature : float
        Of the air in degC.
    priors : Priors, optional
        The standard deviations of temperature, stretch of frequency, gain and phase are used.
    hardness : float
        Relative standard deviation of the wall's modulus.
    model : float
        Standard deviation in m of depths due to errors of the forward model.

    Returns
    -------
    Information

    Raises
    ------
    ConfigError
        If there is no tube for the tool of a contact.
    """
    check_tools(tubes, contacts)
    priors, air = priors or Priors(), air_at(temperature)
    f, first = tubes[0].frequency, tubes[0]
    k = axial_wavenumber(0, 0, f, first.radius, air)
    by_heat, faster = by_temperature(f, first.radius, temperature)
    slope, within_range, echo, by_depth = _presses(tubes, contacts, modulus)
    by_stretch = f * np.gradient(echo, f, axis=1)
    ends = np.array([contacts.lightest, contacts.strongest]) / modulus
    span = max(np.ptp([tube.depth_at(ends) for tube in tubes]), 1e-4)
    scale = np.array([contacts.length, span]) / np.sqrt(12)
    place = np.stack([contacts.place, contacts.length - contacts.place])
    heated = -2j * by_heat * place[..., None] * echo - faster * by_stretch
    same = np.ones((2, 1, 1))
    columns = np.stack([
        np.array([1, -1])[:, None, None] * scale[0] * (-2j * k * echo),
        same * scale[1] * by_depth,
        priors.temperature * heated,
        same * priors.stretch * by_stretch,
        same * priors.gain * echo,
        same * priors.phase * 1j * echo,
    ], axis=2)  # fmt: skip
    left = np.exp(4 * k.imag * place[..., None])
    turned = columns.conj() * left[:, :, None]
    grid = np.linspace(0.1, FARTHEST, REACHES)
    forces = np.full(1, contacts.lightest / modulus)
    light = [np.abs(tube.reflection_at(tube.depth_at(forces))[0]) ** 2 for tube in tubes]
    return Information(
        frequency=f, sound_speed=air.sound_speed, wavenumber=k.real,
        products=(turned[:, :, :, None] * columns[:, :, None]).real,
        echoes=turned * echo[:, None], power=np.abs(echo) ** 2 * left, place=place, scale=scale,
        slope=slope, within_range=within_range, force_prior=contacts.force_prior,
        hardness=hardness, model=model, range_grid=grid,
        range_power=np.array(light)[:, None] * np.exp(4 * k.imag * grid[:, None]),
    )  # fmt: skip


def by_temperature(frequency: Array, radius: float, temperature: float) -> tuple[Complex, float]:
    """Return the derivatives by temperature of wavenumber and logarithm of sound speed.

    They are in 1/(m K), (n_f,), and in 1/K: differences over an interval of 1 K or, at an end of
    the range of :func:`acoustube.air.air_at`, of 0.5 K.

    Parameters
    ----------
    frequency : ndarray
        In Hz, (n_f,).
    radius : float
        Of the bore in m.
    temperature : float
        In degC.
    """
    cold, warm, apart = neighbouring_air(temperature)
    before, after = (axial_wavenumber(0, 0, frequency, radius, air) for air in (cold, warm))
    faster = np.log(warm.sound_speed / cold.sound_speed) / apart
    return np.asarray((after - before) / apart, complex), float(faster)


def _presses(
    tubes: Sequence[PressedTube], contacts: Contacts, modulus: float
) -> tuple[Array, Array, Complex, Complex]:
    """Return four properties of the presses of the contacts.

    They are the slope of the logarithm of force by depth in 1/m, (n,), 1 where the force is within
    range, (n,), the reflection coefficient, (n, n_f), and its derivative by depth in 1/m, (n, n_f).
    """
    n = len(contacts.force)
    slope, within_range = np.zeros((2, n))
    echo, by_depth = np.zeros((2, n, len(tubes[0].frequency)), complex)
    for i, tube in enumerate(tubes):
        here = contacts.tool == i
        force = contacts.force[here] / modulus
        depth = tube.depth_at(force)
        slope[here] = 1 / (force * tube.compliance_at(force))
        within_range[here] = force <= tube.force[-1]
        echo[here] = tube.reflection_at(depth)
        by_depth[here] = tube.reflection_at(depth, 1)
    return slope, within_range, echo, by_depth
