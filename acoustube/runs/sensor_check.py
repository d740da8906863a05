"""Parameters of a sensor that its recordings contradict: resonance and bore.

The inversion estimates them with the contacts of each group of cycles. They are the same in all
groups of a sensor, so that the estimates are combined.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from acoustube.base.report import Reporter
from acoustube.base.units import MM
from acoustube.inversion import Inversion, Library, Priors
from acoustube.inversion.goodness import MISFIT
from acoustube.ranging import Rangefinder
from acoustube.runs.inversion import Sensor

NOTED = {"resonance": 2e-3, "bore": 5e-3}
"""Least relative deviations from the stated values that are reported, by parameter. With a sensor
as stated, estimates from twenty cycles of a single press had standard deviations of 0.002 and
0.003 about it: errors of library and recordings act as such deviations too."""
DEVIATIONS = 4.0
"""Number of standard deviations of the combined estimate above which it is reported."""


class Differing(NamedTuple):
    """A parameter of a sensor that its recordings contradict.

    Attributes
    ----------
    name : str
        One of :data:`NOTED`.
    ratio, deviation : float
        Its value relative to the stated one, less 1, and the standard deviation of this.
    """

    name: str
    ratio: float
    deviation: float


def estimates_of(found: Inversion) -> dict[str, tuple[float, float]]:
    """Return estimates of the parameters of :data:`NOTED` and their standard deviations, by name.

    There are none for cycles without contacts or whose echo is not explained. That of the bore is
    left out for a wrapped tube, whose bends depend on it in other ways, and where no mode but the
    plane wave propagates, so that errors of the solver look like another bore.
    """
    if not found.misfit <= MISFIT:  # nan without contacts
        return {}
    model = found.model
    largest = 2 * np.pi * model.base.frequency[-1] / model.base.speed
    higher = (model.transverse > 0) & (model.transverse < largest)  # propagating in the band
    known = bool(higher.any()) and not model.path.converts
    names = [name for name in NOTED if name != "bore" or known]
    told = {name: getattr(found, name) for name in names}
    return {name: (one.value, one.deviation) for name, one in told.items()}


def differing(
    estimates: Sequence[dict[str, tuple[float, float]]], priors: Priors
) -> list[Differing]:
    """Return the parameters whose combined estimate differs from the stated value.

    Parameters
    ----------
    estimates : sequence of dict
        From :func:`estimates_of`, one for each group of cycles.
    priors : Priors
        Priors of the inversion. Each estimate contains that of the parameter; the combined one
        contains it once.
    """
    found = []
    for name, least in NOTED.items():
        known = np.array([one[name] for one in estimates if name in one])
        spread = getattr(priors, name)
        if not len(known) or spread == 0:  # the bore may be stated as known
            continue
        precision, prior = known[:, 1] ** -2.0, spread**-2.0
        known, precision = known[precision > prior], precision[precision > prior]
        whole = np.sum(precision - prior) + prior
        ratio, deviation = float(known[:, 0] @ precision / whole), float(whole**-0.5)
        if abs(ratio) > max(least, DEVIATIONS * deviation):
            found.append(Differing(name, ratio, deviation))
    return found


def note_differences(
    estimates: Sequence[dict[str, tuple[float, float]]],
    sensor: Sensor,
    library: Library,
    report: Reporter,
) -> None:
    """Report the parameters that differ from those of a sensor and a library."""
    for one in differing(estimates, sensor.priors):
        report.note(_sentence(one, sensor.rangefinder or Rangefinder(), library))


def _sentence(one: Differing, rangefinder: Rangefinder, library: Library) -> str:
    """Return a sentence about a parameter that recordings contradict."""
    told = f"{100 * abs(one.ratio):.2g} % (standard deviation {100 * one.deviation:.1g} %)"
    more = one.ratio > 0
    if one.name == "bore":
        bore = 2 * MM * library.radius
        return (
            f"the bore is {told} {'wider' if more else 'narrower'} than {bore:.4g} mm, that of the "
            "library. Depths are corrected for it; forces are those of the library's bore. For a "
            f"library of this bore: acoustube library --bore {bore * (1 + one.ratio):.4g}"
        )
    stated = getattr(rangefinder, one.name)
    return (
        f"the transducer's {one.name} is {told} {'higher' if more else 'lower'} than {stated:.6g} "
        f"Hz, the value of the sensor; the estimates of contacts allow for it. State {one.name} = "
        f"{stated * (1 + one.ratio):.5g} in the file of the sensor"
    )
