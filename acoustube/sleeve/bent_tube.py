"""Sound in a wrapped tube: scattering matrices of the bends between its presses.

The pressed part of a tube is computed straight. On an arm the tube is bent up to there, and the
plane wave is incident on a press together with the modes into which the bend has scattered it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil

import numpy as np
from numpy.typing import ArrayLike

from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.base.units import CM
from acoustube.sleeve.helix import Helix
from acoustube.sleeve.ovalisation import ovality
from acoustube.tube import Tube
from acoustube.waves import Bent, PlacedScatterer, joined_bends

HIGHEST_WAVENUMBER = 6.0
"""Largest j'mn of the modes in a bend; with 10 the scattering of a loop changes by 1.4e-3."""
CLEARANCE = 1e-9
"""Straight tube in m at either end of a bend, so that rounding does not make elements overlap."""
SHORTEST_BEND = 1e-3
"""Length of tube in m below which no bend is computed."""


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
) -> list[PlacedScatterer]:
    """Return the bends of a part of a wrapped tube, each of one loop at most.

    Parameters
    ----------
    helix : Helix
    air : Air
    frequency : array_like
        In Hz, increasing and evenly spaced: those of the presses. Over 28 kHz, the interpolation
        error of a loop is 0.5 % for steps of 100 Hz and 3 % for steps of 300 Hz.
    start, stop : float
        Distances from the sensor in m, on the helix.
    radius : float
        Of the bore in m.
    modes : sequence of str
        Modes of the neighbouring presses.
    tube : Tube, optional
        Tube flattened by the bending, see :func:`acoustube.sleeve.ovalisation.ovality`; without it
        the bore stays round. The ovality is that at the helix's middle: steps would echo.

    Raises
    ------
    ConfigError
        If the part is not on the helix, or the tube would kink.

    Notes
    -----
    Each has the curvature and torsion at its middle. A longer bend could not be interpolated in
    frequency: close to cut-on the group velocity of a mode is so low that its delay in a loop is as
    long as that of a press. The power that torsion converts into modes not requested, 1 to 2 % per
    loop, is lost at the loop's end.
    """
    ends = helix.height([start, stop])
    if not (np.all(np.isfinite(ends)) and stop > start):
        raise ConfigError(
            f"{CM * start:.4g} to {CM * stop:.4g} cm is not part of a tube wound from "
            f"{CM * helix.lead:.4g} to {CM * helix.tube_length:.4g} cm; use distances in this range"
        )
    n_parts = ceil(abs(float(np.diff(helix.angle(ends))[0])) / (2 * np.pi))
    edges = np.linspace(start, stop, n_parts + 1)
    middles, length = (edges[1:] + edges[:-1]) / 2, (stop - start) / n_parts
    flat = 0.0 if tube is None else ovality(tube, float(helix.bend(helix.length / 2)[0]))
    found = []
    for middle, curvature, torsion in zip(middles, *helix.bend(helix.height(middles)), strict=True):
        part = Bent(
            length=length - 2 * CLEARANCE,
            curvature=float(curvature),
            torsion=float(torsion),
            ovality=flat,
        )
        bent = joined_bends(
            air, frequency, [part], radius=radius, modes=modes, highest=HIGHEST_WAVENUMBER
        )
        found.append(PlacedScatterer(bent, float(middle)))
    return found


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
    helix, air, frequency, radius, modes, tube
        See :func:`winding`.
    places : sequence of float
        Positions of the presses on the helix in m, increasing; empty for the whole tube.
    reach : float
        See :func:`wrapped`.

    Returns
    -------
    list of PlacedScatterer
        The bends alone; valid for any presses at these positions.
    """
    at = np.asarray(places, float)
    if np.any(np.diff(at) < 2 * reach):
        raise ConfigError(
            f"presses at {', '.join(f'{100 * place:.4g}' for place in at)} cm are nearer to "
            f"each other than twice the reach, {200 * reach:.3g} cm, or not in order; move them"
        )
    starts = [helix.lead, *(at + reach)]
    stops = [*(at - reach), helix.tube_length]
    return [
        bend
        for start, stop in zip(starts, stops, strict=True)
        if abs(stop - start) > SHORTEST_BEND
        for bend in winding(
            helix, air, frequency, start, stop, radius=radius, modes=modes, tube=tube
        )
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
    """Return presses with the bends before, between and behind them.

    Parameters
    ----------
    helix : Helix
    presses : sequence of PlacedScatterer
        One or more, on the helix, computed over the same band.
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
        If there is no press, one is not on the helix, or two are nearer to each other than twice
        the reach.
    """
    if not presses:
        raise ConfigError("no press gives the frequency band; use windings() for the tube alone")
    matrix = presses[0].scattering
    found = windings(
        helix, air, matrix.frequency, sorted(press.position for press in presses),
        reach=reach, radius=radius, modes=matrix.modes, tube=tube,
    )  # fmt: skip
    return found + [shortened(press, reach) for press in presses]


def shortened(press: PlacedScatterer, reach: float) -> PlacedScatterer:
    """Return a press whose length along the tube is limited to its reach in m."""
    return replace(press, scattering=replace(press.scattering, extent=(-reach, reach)))
