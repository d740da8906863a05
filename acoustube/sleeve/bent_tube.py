"""Sound in a wrapped tube: scattering matrices of the bends between its presses.

The pressed part of a tube is computed as straight. On an arm the tube is bent up to that part, and
the plane wave is incident on a press together with the modes into which the bend has scattered it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil

import numpy as np
from numpy.typing import ArrayLike

from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.base.units import CM
from acoustube.sleeve.helix import Helix
from acoustube.sleeve.ovalisation import ovality
from acoustube.tube import Tube
from acoustube.waves import Bent, PlacedScatterer, joined_bends
from acoustube.waves.scattering import ModalScattering

HIGHEST_WAVENUMBER = 6.0
"""Largest j'mn (transverse wavenumber times the bore's radius) of the modes in a bend.

With 10 instead, the scattering of a loop changes by 1.4e-3.
"""
LONGEST_PART = 0.015
"""Largest length in m of a part of constant curvature and torsion. Where curvature changes
abruptly, modes are converted; a gradual change converts none. Parts as long as the beat length of
the plane wave and (1,1), 3 to 5 cm, would add up the conversions at their ends in phase."""
CLEARANCE = 1e-9
"""Length in m by which bends and presses end early, so that rounding does not make them overlap."""
SHORTEST_BEND = 1e-3
"""Length of tube in m below which no bend is computed."""
LONGEST_DELAY = 1.0
"""Largest delay of the plane wave in a bend, times the step of frequency.

Interpolation between frequencies removes this delay; higher modes are slower by a factor of up to
two. The inverse of the step is the period of the impulse response that the frequencies resolve.
"""


def winding(
    helix: Helix,
    air: Air,
    frequency: ArrayLike,
    start: float,
    stop: float,
    *,
    radius: float,
    modes: Sequence[str],
    tube: Tube | None = None,
) -> PlacedScatterer:
    """Return the scattering of a part of a wrapped tube, computed as one bend.

    Parameters
    ----------
    helix : Helix
    air : Air
    frequency : array_like
        Frequencies of the presses in Hz, increasing and evenly spaced. A long part is also computed
        at frequencies between these, see :data:`LONGEST_DELAY`.
    start, stop : float
        Distances from the sensor in m, on the helix.
    radius : float
        Of the bore in m.
    modes : sequence of str
        Modes of the neighbouring presses, and their antisymmetric partners
        (:func:`with_antisymmetric`), which torsion excites.
    tube : Tube, optional
        Tube flattened by the bending, see :func:`acoustube.sleeve.ovalisation.ovality`; without it
        the bore stays round. The ovality at the helix's middle is used throughout, since steps of
        it would cause echoes.

    Returns
    -------
    PlacedScatterer
        The bend, placed at the middle of the part.

    Raises
    ------
    ConfigError
        If the part is not on the helix, or the tube would kink.

    Notes
    -----
    Curvature and torsion are taken as constant over each of many short parts, see
    :data:`LONGEST_PART`. The parts are joined with all their modes, evanescent ones too. Over
    1.1 m, parts a third as long change the coefficients by 2e-4 at most. Interpolation between
    frequencies changes the coefficient of the plane wave by less than 1e-4, those of (1,1) by 4e-4
    and those of (2,1) by 5e-3, or by 0.05 in the first 100 Hz above its cut-on.
    """
    ends = helix.height([start, stop])
    if not (np.all(np.isfinite(ends)) and stop > start):
        raise ConfigError(
            f"{CM * start:.4g} to {CM * stop:.4g} cm is not part of a tube wound from "
            f"{CM * helix.lead:.4g} to {CM * helix.tube_length:.4g} cm; use distances in this range"
        )
    n_parts = ceil((stop - start) / LONGEST_PART)
    edges = np.linspace(start + CLEARANCE, stop - CLEARANCE, n_parts + 1)
    bends = helix.bend(helix.height((edges[1:] + edges[:-1]) / 2))
    length = (edges[-1] - edges[0]) / n_parts
    flat = 0.0 if tube is None else ovality(tube, float(helix.bend(helix.length / 2)[0]))
    parts = [
        Bent(length=float(length), curvature=float(curvature), torsion=float(torsion), ovality=flat)
        for curvature, torsion in zip(*bends, strict=True)
    ]
    grid = _fine_enough(np.asarray(frequency, float), (stop - start) / air.sound_speed)
    bent = joined_bends(
        air, grid, parts, radius=radius, modes=modes, highest=HIGHEST_WAVENUMBER, gradual=True
    )
    return PlacedScatterer(bent, (start + stop) / 2)


def _fine_enough(frequency: Array, delay: float) -> Array:
    """Return evenly spaced frequencies in Hz, refined if a delay in s requires smaller steps."""
    if len(frequency) < 2:
        return frequency
    times = ceil(delay * (frequency[1] - frequency[0]) / LONGEST_DELAY)
    return np.linspace(frequency[0], frequency[-1], times * (len(frequency) - 1) + 1)


def windings(
    helix: Helix,
    air: Air,
    frequency: ArrayLike,
    places: Sequence[float],
    *,
    reach: float,
    radius: float,
    modes: Sequence[str],
    tube: Tube | None = None,
) -> list[PlacedScatterer]:
    """Return the bends of a wrapped tube, which is straight at the presses.

    Parameters
    ----------
    helix, air, frequency, radius, tube
        See :func:`winding`.
    places : sequence of float
        Positions of the presses on the helix in m, increasing; empty for the whole tube.
    reach : float
        See :func:`wrapped`.
    modes : sequence of str
        Modes of the presses; the bends have their antisymmetric partners too.

    Returns
    -------
    list of PlacedScatterer
        The bends alone, in order of distance. They can be combined with any presses returned by
        :func:`between_bends` at these positions and for this `reach`.

    Raises
    ------
    ConfigError
        If presses are nearer to each other than twice the reach or not in order, a part between
        them is not on the helix, or the tube would kink.
    """
    at = np.asarray(places, float)
    if np.any(np.diff(at) < 2 * reach - CLEARANCE):
        raise ConfigError(
            f"presses at {', '.join(f'{CM * place:.4g}' for place in at)} cm are nearer to "
            f"each other than twice the reach, {2 * CM * reach:.3g} cm, or not in order; move them"
        )
    starts = [helix.lead, *(at + reach)]
    stops = [*(at - reach), helix.tube_length]
    names = with_antisymmetric(modes)
    return [
        winding(helix, air, frequency, start, stop, radius=radius, modes=names, tube=tube)
        for start, stop in zip(starts, stops, strict=True)
        if abs(stop - start) > SHORTEST_BEND
    ]


def wrapped(
    helix: Helix,
    presses: Sequence[PlacedScatterer],
    air: Air,
    *,
    radius: float,
    reach: float,
    tube: Tube | None = None,
) -> list[PlacedScatterer]:
    """Return the bends of a wrapped tube before, between and behind presses, and the presses.

    Parameters
    ----------
    helix : Helix
    presses : sequence of PlacedScatterer
        One or more, on the helix, computed over the same band and with the same modes.
    air : Air
    radius : float
        Of the bore in m.
    reach : float
        Length in m, to each side of a press, over which the tube is straight. Beyond it the lumen
        should be round: the straight tube that the scattering matrix contains there is replaced
        by the bend.
    tube : Tube, optional
        See :func:`winding`.

    Returns
    -------
    list of PlacedScatterer
        For :func:`acoustube.waves.probe_pressure` or :func:`acoustube.ranging.record`.

    Raises
    ------
    ConfigError
        If there is no press, one is not on the helix, two are nearer to each other than twice the
        reach, or the tube would kink.
    """
    if not presses:
        raise ConfigError(
            "there is no press, from which the frequency band is taken; use windings() without one"
        )
    matrix = presses[0].scattering
    found = windings(
        helix, air, matrix.frequency, sorted(press.position for press in presses),
        reach=reach, radius=radius, modes=matrix.modes, tube=tube,
    )  # fmt: skip
    return found + [between_bends(press, reach) for press in presses]


def between_bends(press: PlacedScatterer, reach: float) -> PlacedScatterer:
    """Return a press cut to its reach and extended by antisymmetric modes, for use between bends.

    Parameters
    ----------
    press : PlacedScatterer
        Press of a straight tube.
    reach : float
        See :func:`wrapped`.

    Returns
    -------
    PlacedScatterer
        The press, whose extent is the reach on each side. A press that is symmetric about x = 0 has
        symmetric modes alone; their antisymmetric partners are added, and pass it unscattered.
    """
    matrix = press.scattering
    names = with_antisymmetric(matrix.modes)
    m = len(matrix.modes)
    partners = [matrix.modes.index(f"{name[:-1]}c") for name in names[m:]]
    propagates = np.hstack([matrix.propagates, matrix.propagates[:, partners]])
    s = np.zeros((len(matrix.frequency), 2, len(names), 2, len(names)), complex)
    s[:, :, :m, :, :m] = matrix.s
    added = np.arange(m, len(names))
    s[:, 0, added, 1, added] = s[:, 1, added, 0, added] = propagates[:, m:]
    whole = ModalScattering(
        frequency=matrix.frequency, modes=names, s=s, propagates=propagates,
        cut_ons=np.append(matrix.cut_ons, matrix.cut_ons[partners]),
        sound_speed=matrix.sound_speed, extent=(CLEARANCE - reach, reach - CLEARANCE),
        planes=matrix.planes,
    )  # fmt: skip
    return replace(press, scattering=whole)


def with_antisymmetric(modes: Sequence[str]) -> tuple[str, ...]:
    """Return modes followed by the antisymmetric partners of the symmetric modes among them.

    Parameters
    ----------
    modes : sequence of str
        Names of modes, such as ``00``, ``11c``, ``21s``.
    """
    partners = [f"{name[:-1]}s" for name in modes if name.endswith("c")]
    return (*modes, *(name for name in partners if name not in modes))
