"""Tables of contacts, and notes about recordings whose echoes the contacts do not explain."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from acoustube.base.report import Reporter
from acoustube.base.units import CM, MM
from acoustube.inversion import Contact, Library
from acoustube.inversion.goodness import MISFIT, RESIDUAL
from acoustube.runs.inversion import USUAL_LENGTH

CONTACT_COLUMNS = (
    "probability", "distance_cm", "distance_sd_cm", "depth_mm", "depth_sd_mm", "force_n",
    "force_sd_n", "indenter_mm", "misfit", "shape",
)  # fmt: skip
"""Columns of a contact in tables: ``sd`` is a standard deviation, ``misfit`` the relative error of
the forward model."""
COLUMNS = ("recording", "group", "contact", *CONTACT_COLUMNS, "residual")
"""Columns of the table of contacts of recordings: ``residual`` is
:attr:`acoustube.inversion.Inversion.residual`."""


class ContactFit(NamedTuple):
    """A contact, and how well the contacts explain the echo that shows it.

    Attributes
    ----------
    contact : Contact
    misfit, residual : float
        See :class:`acoustube.inversion.Inversion`.
    """

    contact: Contact
    misfit: float
    residual: float


def rows_of(
    path: Path, group: int, contacts: Sequence[ContactFit], library: Library
) -> list[list[object]]:
    """Return a row of :data:`COLUMNS` for each contact of a group, numbered from 0."""
    return [
        [str(path), group, i, *contact_cells(one.contact, one.misfit, library),
         f"{one.residual:.4g}"]
        for i, one in enumerate(contacts)
    ]  # fmt: skip


def contact_cells(contact: Contact, misfit: float, library: Library) -> list[str]:
    """Return the cells of :data:`CONTACT_COLUMNS` for a contact and a misfit."""
    estimates = (contact.distance, CM), (contact.depth, MM), (contact.force, 1.0)
    values = [
        f"{scale * value:.6g}" for one, scale in estimates for value in (one.value, one.deviation)
    ]
    tool = library.tools[contact.tool]
    diameter = f"{MM * tool.diameter:g}"
    return [f"{contact.probability:.4f}", *values, diameter, f"{misfit:.4g}", tool.shape]


def note_warnings(
    path: Path,
    poor: Sequence[tuple[int, float, float]],
    n_groups: int,
    length: float | None,
    report: Reporter,
) -> None:
    """Report the groups whose contacts do not explain the echo, and an assumed tube length.

    Parameters
    ----------
    path : Path
        File of the recording.
    poor : sequence of (int, float, float)
        Number, misfit and residual of each such group.
    n_groups : int
        Number of all groups.
    length : float or None
        Stated length of the tube in m; None if it was assumed.
    report : Reporter
    """
    if poor:
        groups, *values = zip(*poor, strict=True)
        most = zip(("misfit", "residual"), values, (MISFIT, RESIDUAL), strict=True)
        told = [
            f"{name} up to {np.nanmax(each):.4g}, allowed {allowed:g}"
            for name, each, allowed in most
            if np.any(np.array(each) > allowed)
        ]
        report.note(
            f"{path}: in {len(poor)} of {n_groups} groups (the first: group {groups[0]}, counted "
            f"from 0) the echo is not explained ({'; '.join(told)}); tube, noise, sensor, "
            "indenters or number of contacts are not those stated, or a force is beyond the "
            "library's"
        )
    if length is None:
        report.note(
            f"{path}: nothing states the length of the tube, and {CM * USUAL_LENGTH:g} cm is "
            "assumed; state length_cm in the file of the sensor"
        )
