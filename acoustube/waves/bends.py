"""Scattering matrices of bends of a round bore, one or several in series.

The method and its references are in :mod:`acoustube.waves.bent_parts`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from math import ceil, pi

import numpy as np
from numpy.typing import ArrayLike

from acoustube.air import Air
from acoustube.base.checks import BORE, FLAG, FREQUENCIES, Optional, Several, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.waves.bent_parts import (
    LONGEST,
    Bent,
    equal_parts,
    plane_wave,
    scattering_of_parts,
)
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.modes import cut_on_frequency
from acoustube.waves.modes.bore_couplings import BoreModes, bore_modes
from acoustube.waves.modes.grid_modes import mode_numbers, wavenumbers
from acoustube.waves.port_waves import Complex
from acoustube.waves.scattering import ModalScattering
from acoustube.waves.star_product import star_product

LARGEST_ZERO = 10.0
"""Largest j'mn, zero of a Bessel function's derivative, of the modes in the sums. With 14 the
scattering by the bends of a tube wrapped as in the sleeve paper ("Wearable, Fabric-Embedded
Acoustic Waveguides for Meter-Scale Contact Localization and Force Sensing") changes by 1e-5."""
FREQUENCY_BATCH = 64
"""Number of frequencies that are computed together."""
LARGEST_CURVATURE = 0.95
"""Largest ratio of bore radius to bend radius; at 1 the inner wall is folded."""
HIGHEST = Number(1, 30.5)
"""Bounds of the largest Bessel zero j'mn: from 30.6, of (1,10), names as ``11c`` are ambiguous."""
NAMES = Optional(Several(str, 1))


@checked(
    air=Air, frequency=FREQUENCIES, radius=BORE, bend_radius=Number(-1e6, 1e6, "m"),
    angle=Number(-1e6, 1e6, "rad"), torsion=Number(-1e6, 1e6, "1/m"), modes=NAMES, highest=HIGHEST,
)  # fmt: skip
def bend(
    air: Air,
    frequency: ArrayLike,
    *,
    radius: float,
    bend_radius: float,
    angle: float,
    torsion: float = 0.0,
    lossy: bool = True,
    modes: Sequence[str] | None = None,
    highest: float = LARGEST_ZERO,
) -> ModalScattering:
    """Return the scattering matrix of a bend between two straight ends of a round bore.

    Parameters
    ----------
    air : Air
    frequency : array_like
        Rising frequencies in Hz, (n,).
    radius : float
        Bore radius in m.
    bend_radius : float
        Bend radius 1 / kappa, from the centre of curvature to the centre line, in m.
    angle : float
        Turning angle in rad; the length of the centre line is `bend_radius` times this angle.
    torsion : float
        Torsion of the centre line in 1/m, positive for a right-handed helix; 0 for a plane bend.
        The modes at the far end refer to the normal there, which points to the axis of a helix.
    lossy : bool
        With the losses of the straight bore.
    modes : sequence of str, optional
        Modes of the result, in this order: those of the presses with which it is combined. By
        default, all modes that propagate at the highest frequency.
    highest : float
        Largest j'mn of the modes that are computed, from 1 to 30.5.

    Returns
    -------
    ModalScattering
        Power-normalised, with a reference plane at either end; the position is the bend's middle.

    Raises
    ------
    ConfigError
        If a size is not positive, the bend is too sharp, the frequencies do not increase, `highest`
        is too low for them, or a mode is not among those computed.

    Notes
    -----
    The centre of curvature lies towards -y. The modes' signs are those of all scattering matrices:
    of J_m times cos(m phi) or sin(m phi), with phi from -y towards +x.
    """
    _check_bend(radius, bend_radius, angle)
    _check_length(angle, bend_radius)
    part = Bent(length=angle * bend_radius, curvature=1 / bend_radius, torsion=torsion)
    return joined_bends(
        air, frequency, [part], radius=radius, lossy=lossy, modes=modes, highest=highest
    )


@checked(
    air=Air, frequency=FREQUENCIES, parts=Several(Bent, 1), radius=BORE, modes=NAMES,
    highest=HIGHEST, gradual=FLAG,
)  # fmt: skip
def joined_bends(
    air: Air,
    frequency: ArrayLike,
    parts: Sequence[Bent],
    *,
    radius: float,
    lossy: bool = True,
    modes: Sequence[str] | None = None,
    highest: float = LARGEST_ZERO,
    gradual: bool = False,
) -> ModalScattering:
    """Return the scattering matrix of several bends in series.

    Parameters
    ----------
    air, frequency, radius, lossy, modes, highest
        See :func:`bend`.
    parts : sequence of Bent
        In their order along the tube. The normal, towards the centre of curvature, is continuous.
    gradual : bool
        Whether curvature and torsion are smooth functions of the part's number. Of many parts of
        equal length only a few (:data:`~acoustube.waves.bent_parts.GRADUAL_NODES`) are then
        computed, and the others interpolated by a polynomial. Default False.

    Returns
    -------
    ModalScattering
        See :func:`bend`, also for the errors that are raised.
    """
    frequency = np.atleast_1d(np.asarray(frequency, float))
    _check_curvature(radius, max(part.curvature for part in parts))
    _check_sound(frequency, radius, highest, air)
    bore = bore_modes(highest)
    names = _result_modes(modes, bore, frequency, radius, air)
    groups = equal_parts(parts) if gradual else [[part] for part in parts]
    s = np.concatenate([
        reduce(star_product, scattering_of_parts(air, some, bore, radius, groups, lossy))
        for some in np.array_split(frequency, ceil(len(frequency) / FREQUENCY_BATCH))
    ])  # fmt: skip
    length = sum(part.length for part in parts)
    found = _power_normalised(s, names, bore, air, frequency, radius, length, lossy)
    return replace(found, inside=plane_wave(air, frequency, bore, radius, groups, lossy))


def _power_normalised(
    s: Complex,
    names: tuple[str, ...],
    bore: BoreModes,
    air: Air,
    frequency: Array,
    radius: float,
    length: float,
    lossy: bool,
) -> ModalScattering:
    """Return the power-normalised scattering of some modes between the ends of a bend."""
    cut_ons = np.array(
        [cut_on_frequency(*mode_numbers(name), radius, air.sound_speed) for name in names]
    )
    propagates = frequency[:, None] > cut_ons
    place = mode_places(names, bore)
    m = len(bore.names)
    s = s.reshape(len(frequency), 2, m, 2, m)[:, :, place][..., place]
    straight = wavenumbers(names, frequency, radius, air, lossy=lossy)
    # The root is complex, as in :func:`acoustube.waves.spectral.ports.scattering_of`.
    size = np.sqrt(straight)
    inverse = 1 / np.where(size != 0, size, 1)
    s = size[:, None, :, None, None] * s * inverse[:, None, None, None, :]
    both = propagates[:, None, :, None, None] & propagates[:, None, None, None, :]
    return ModalScattering(
        frequency=frequency,
        modes=names,
        s=np.where(both, s, 0.0),
        evanescent=np.where(both, 0.0, s),
        propagates=propagates,
        cut_ons=cut_ons,
        sound_speed=air.sound_speed,
        extent=(-length / 2, length / 2),
        planes=(-length / 2, length / 2),
    )


def _check_bend(radius: float, bend_radius: float, angle: float) -> None:
    """Validate bore radius, bend radius and angle."""
    for name, value in (("radius", radius), ("bend_radius", bend_radius), ("angle", angle)):
        if not 0 < value < np.inf:
            advice = "give m, and rad for the angle"
            raise ConfigError("must be positive", setting=name, value=value, advice=advice)
    if radius > LARGEST_CURVATURE * bend_radius:
        raise ConfigError(
            f"is too sharp for a bore radius of {radius:.4g} m", setting="bend_radius",
            value=bend_radius, unit="m", allowed=(radius / LARGEST_CURVATURE, np.inf),
            advice=f"use {radius / LARGEST_CURVATURE:.4g} m or more",
        )  # fmt: skip


def _check_curvature(radius: float, curvature: float) -> None:
    """Validate the largest curvature of several bends, up to rounding."""
    if curvature * radius > LARGEST_CURVATURE * (1 + 1e-9):
        most = LARGEST_CURVATURE / radius
        raise ConfigError(
            f"is too sharp for a bore radius of {radius:.4g} m", setting="curvature",
            value=curvature, unit="1/m", allowed=(0, most),
            advice=f"use at most {0.999 * most:.4g}",
        )  # fmt: skip


def _check_length(angle: float, bend_radius: float) -> None:
    """Validate the length of a bend's centre line."""
    if not 1e-9 <= angle * bend_radius <= LONGEST:
        raise ConfigError(
            f"and bend_radius = {bend_radius:g} m make a bend of {angle * bend_radius:.3g} m",
            setting="angle", value=angle, unit="rad", advice=f"use 1e-09 to {LONGEST:g} m",
        )  # fmt: skip


def _check_sound(frequency: Array, radius: float, highest: float, air: Air) -> None:
    """Validate that the frequencies increase, and that the modes suffice for the highest."""
    if frequency.ndim != 1 or not np.all(np.diff(frequency, prepend=0.0) > 0) or not frequency.size:
        raise ConfigError("frequency must be positive and increasing; give a 1-D array in Hz")
    least = 2 * pi * frequency[-1] * radius / air.sound_speed / 0.8
    if least > highest:
        advice = f"use {ceil(100 * least) / 100:g} or more"
        if least > HIGHEST.high:
            most = frequency[-1] * HIGHEST.high / least
            advice = f"use frequencies up to {int(most)} Hz with highest = {HIGHEST.high:g}"
        raise ConfigError(
            f"is too low for frequency = {frequency[-1]:g} Hz and radius = {radius:g} m",
            setting="highest", value=highest, advice=advice,
        )  # fmt: skip


def _result_modes(
    wanted: Sequence[str] | None, bore: BoreModes, frequency: Array, radius: float, air: Air
) -> tuple[str, ...]:
    """Return the modes of the result, in the order of their cut-ons if none are named."""
    if wanted is None:
        reached = bore.zeros < 2 * pi * frequency[-1] * radius / air.sound_speed
        return tuple(name for name, is_in in zip(bore.names, reached, strict=True) if is_in)
    mode_places(wanted, bore)
    return tuple(wanted)


def mode_places(wanted: Sequence[str], bore: BoreModes) -> list[int]:
    """Return the indices of modes among those of a bore; raise ConfigError if one is missing."""
    unknown = [name for name in wanted if name not in bore.names]
    if unknown:
        raise ConfigError(
            f"are not among those computed, {', '.join(bore.names)}", setting="modes",
            value=", ".join(unknown), allowed=tuple(bore.names), advice="raise highest",
        )  # fmt: skip
    return [bore.names.index(name) for name in wanted]
