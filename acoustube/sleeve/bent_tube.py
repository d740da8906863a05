"""Sound in a wrapped tube: the bends between its presses, for a cascade.

The pressed part of a tube is computed straight. On an arm the tube is bent up to there, and the
plane wave meets a press together with the modes that the bend has made of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil

import numpy as np
from numpy.typing import ArrayLike

from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.sleeve.helix import Helix
from acoustube.sleeve.ovalisation import ovality
from acoustube.tube import Tube
from acoustube.waves import Bent, PlacedScatterer, joined_bends

HIGHEST = 6.0
"""Largest j'mn of the modes in a bend: with 10 a loop of the paper's tube changes by 1.4e-3."""
CLEARANCE = 1e-9
"""Straight tube in m at either end of a bend, so that bends and presses do not meet by rounding."""
SHORTEST = 1e-3
"""Tube in m that is not worth a bend."""


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
    """Return the bends that a part of a wrapped tube is, a loop each at the most.

    Parameters
    ----------
    helix : Helix
    air : Air
    frequency : array_like
        In Hz, rising and evenly spaced: those of the presses. In steps of 100 Hz over 28 kHz a loop
        is told between them to 0.5 %, of 300 Hz to 3 %.
    start, stop : float
        Distances from the sensor in m, on the helix.
    radius : float
        Of the bore in m.
    modes : sequence of str
        Those of the presses beside it.
    tube : Tube, optional
        The tube that the wrap flattens, see :func:`acoustube.sleeve.ovalisation.ovality`; it stays
        round without. All along as at the helix's middle: steps from loop to loop would echo.

    Returns
    -------
    list of PlacedScatterer

    Raises
    ------
    ConfigError
        If the part is not on the helix, or the tube would kink.

    Notes
    -----
    Each has the curvature and the torsion of its middle. A longer one could not be told between its
    frequencies: beside a cut-on a mode travels so slowly that its delay in a loop is as long as the
    press's. What torsion converts into modes that are not asked for, 1 to 2 % of the power in a
    loop, is lost at the loop's end.
    """
    ends = helix.height([start, stop])
    if not (np.all(np.isfinite(ends)) and stop > start):
        raise ConfigError(
            f"{100 * start:.4g} to {100 * stop:.4g} cm is no part of a tube that is wound from "
            f"{100 * helix.lead:.4g} to {100 * helix.tube_length:.4g} cm; take two distances there"
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
        bent = joined_bends(air, frequency, [part], radius=radius, modes=modes, highest=HIGHEST)
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
    """Return the bends of a wrapped tube that presses keep straight where they are.

    Parameters
    ----------
    helix, air, frequency, radius, modes, tube
        See :func:`winding`.
    places : sequence of float
        Of the presses on the helix, rising, in m; none for the whole tube.
    reach : float
        See :func:`wrapped`.

    Returns
    -------
    list of PlacedScatterer
        The same for all presses at these places.

    Raises
    ------
    ConfigError
        See :func:`wrapped`.
    """
    at = np.asarray(places, float)
    if np.any(np.diff(at) < 2 * reach):
        raise ConfigError(
            f"presses at {', '.join(f'{100 * place:.4g}' for place in at)} cm are nearer to "
            f"each other than twice the reach, {200 * reach:.3g} cm, or do not rise; move them"
        )
    starts = [helix.lead, *(at + reach)]
    stops = [*(at - reach), helix.tube_length]
    return [
        bend
        for start, stop in zip(starts, stops, strict=True)
        if abs(stop - start) > SHORTEST
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
        One or more, on the helix, of one band.
    air : Air
    radius : float
        Of the bore in m.
    reach : float
        How far a press keeps the tube straight, to each side, in m. Its lumen should be round
        beyond: there its scattering matrix holds nothing but straight tube, which the bend
        replaces.
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
        raise ConfigError("a wrap without a press has no band; use windings for the tube alone")
    matrix = presses[0].scattering
    found = windings(
        helix, air, matrix.frequency, sorted(press.position for press in presses),
        reach=reach, radius=radius, modes=matrix.modes, tube=tube,
    )  # fmt: skip
    return found + [shortened(press, reach) for press in presses]


def shortened(press: PlacedScatterer, reach: float) -> PlacedScatterer:
    """Return a press that leaves the tube beyond its reach, in m, to others."""
    return replace(press, scattering=replace(press.scattering, extent=(-reach, reach)))
