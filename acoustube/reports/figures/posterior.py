"""Figure of an inversion: the recorded and modelled echo, and the posterior of each contact."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from acoustube.base.report import counted
from acoustube.base.types import Array
from acoustube.base.units import CM, MM
from acoustube.inversion import Inversion, Library
from acoustube.inversion.detection import limits_along
from acoustube.inversion.estimate import Contact
from acoustube.inversion.goodness import RESIDUAL
from acoustube.reports.figures.run import ENVELOPE, PRESS, RETURN
from acoustube.runs.two_ends import EndsContacts

SPAN = 4.0
"""Half the width of a panel with a contact's posterior, in its standard deviations."""
POINTS = 400


def posterior_figure(found: EndsContacts, library: Library) -> Figure:
    """Draw the recorded and modelled echo at each end, and the posterior of each contact.

    Parameters
    ----------
    found : EndsContacts
        Contacts of a group of cycles. For an inversion from one end alone, use
        :meth:`~acoustube.runs.two_ends.EndsContacts.of_one_end`.
    library : Library
        The library of the inversion.
    """
    ends = 1 if found.far is None else 2
    contacts = [one.contact for one in found.contacts]
    above, rows = ends + 1, len(contacts)
    sheet = Figure(figsize=(9.0, 2.2 + 3.2 * ends + 2.2 * rows), layout="constrained")
    grid = sheet.add_gridspec(
        above + rows, 3, height_ratios=[*[1.4] * ends, *[1.0] * (1 + rows)]
    )  # fmt: skip
    echo = sheet.add_subplot(grid[0, :])
    of_end = "" if found.far is None else ", near end"
    _draw_echo(echo, found.near, found.near.place, contacts, of_end)
    if found.far is not None:
        far, length = found.far
        axes = sheet.add_subplot(grid[1, :], sharex=echo)
        _draw_echo(axes, far, length - far.place, contacts, ", far end")
    _draw_limit(sheet.add_subplot(grid[ends, :], sharex=echo), found, library)
    for row, contact in enumerate(contacts):
        tool = library.tools[contact.tool].name
        panels = [sheet.add_subplot(grid[above + row, i]) for i in range(3)]
        _draw_contact(panels, contact, tool)
    return sheet


def _draw_echo(
    axes: Axes, end: Inversion, place: Array, contacts: Sequence[Contact], of_end: str
) -> None:
    """Draw the echo that an end receives over `place`, distances in m from the near transducer."""
    at = CM * place
    axes.semilogy(at, np.abs(end.measured), color=ENVELOPE, lw=1.2, label="recorded")
    axes.semilogy(at, np.abs(end.explained), color=PRESS, lw=1.0, ls="--", label="modelled")
    rest = np.abs(end.measured - end.explained)
    axes.semilogy(at, rest, color="0.6", lw=0.8, label="difference")
    if end.residual > RESIDUAL:
        low, high = np.sort(at[np.isin(end.place, end.residual_span)])
        label = f"not explained{' from this end' * bool(of_end)}, {low:.0f} to {high:.0f} cm"
        axes.axvspan(low, high, color="0.9", lw=0, label=label)
    floor = float(np.median(rest))
    axes.set_ylim(0.3 * floor, 2 * float(np.abs(end.measured).max()))
    for contact in contacts:
        axes.axvline(CM * contact.distance.value, color=RETURN, lw=0.8)
    axes.set_xlim(0.0, CM * end.model.base.length)
    face = "near face" if of_end else "face"
    axes.set_xlabel(f"distance from the {face}, by the delay (cm)")
    axes.set_ylabel("echo without clutter (counts)")
    number = counted(len(end.contacts), "contact") if end.contacts else "no contact"
    words = [number, *([f"misfit {end.misfit:.3g}"] if end.contacts else [])]
    axes.set_title(", ".join([*words, f"residual {end.residual:.3g}"]) + of_end, fontsize=10)
    axes.legend(fontsize=8)


def _draw_limit(axes: Axes, found: EndsContacts, library: Library) -> None:
    """Draw the contacts' depths, and the limit of detection of a further contact."""
    contacts = [one.contact for one in found.contacts]
    tool = contacts[0].tool if contacts else 0
    deepest = MM * max(one.depth[-1] for one in library.tools)
    places, depths = limits_along(partial(found.detection_limit, tool=tool), found.span)
    hidden = np.where(np.isinf(depths), 1.1 * deepest, MM * depths)
    axes.fill_between(CM * places, 0.0, hidden, color="0.85", lw=0)
    first, last, end = CM * places[0], CM * places[-1], CM * found.near.model.base.length
    axes.fill_between(
        [0.0, first, *(CM * places), last, end], 0.0, 1.1 * deepest,
        where=[True, True, *np.isnan(depths), True, True], facecolor="none", edgecolor="0.8",
        hatch="///", lw=0,
    )  # fmt: skip
    for contact in contacts:
        place = CM * contact.distance.value
        axes.plot([place, place], MM * np.array(contact.depth.intervals[0.9]), color=RETURN)
        axes.plot(place, MM * contact.depth.value, "o", ms=4, color=RETURN)
    axes.set_ylim(0, 1.1 * deepest)
    axes.set_xlabel("distance from the face (cm)")
    axes.set_ylabel("depth (mm)")
    words = f"grey: depths at which a further {library.tools[tool].name} may have been missed; "
    words += "hatched: not searched"
    axes.set_title(words, fontsize=9, loc="left")


def _draw_contact(panels: list[Axes], contact: Contact, tool: str) -> None:
    words = f"{tool}, probability {contact.probability:.3f}"
    quantities = (
        (contact.distance, CM, "distance (cm)"), (contact.depth, MM, "depth (mm)"),
        (contact.force, 1.0, "force (N)"),
    )  # fmt: skip
    for axes, (estimate, scale, label) in zip(panels, quantities, strict=True):
        low, high = np.array(estimate.intervals[0.9]) * scale
        middle, reach = scale * estimate.value, SPAN * scale * estimate.deviation
        x = np.linspace(middle - reach, middle + reach, POINTS)
        axes.fill_between(x, estimate.density(x / scale) / scale, color=PRESS, alpha=0.3, lw=0)
        axes.axvspan(low, high, color=ENVELOPE, alpha=0.12, lw=0)
        axes.axvline(middle, color=RETURN, lw=0.8)
        axes.set_xlim(float(x[0]), float(x[-1]))
        axes.ticklabel_format(useOffset=False)
        axes.tick_params(labelsize=7)
        axes.locator_params(axis="x", nbins=4)
        axes.set_yticks([])
        axes.set_ylim(bottom=0)
        axes.set_xlabel(label)
    panels[0].set_title(words, fontsize=9, loc="left")
