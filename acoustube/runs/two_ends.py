"""Inversion of recordings from one end of a tube, or from both."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from acoustube.base.errors import ConfigError, about
from acoustube.base.types import Array
from acoustube.base.units import CM, MM
from acoustube.inversion import Inversion, Library, joined_contacts
from acoustube.inversion.detection import limits_along
from acoustube.inversion.goodness import MISFIT, RESIDUAL, good_fit
from acoustube.inversion.parameters import CLOSEST
from acoustube.runs.contact_table import ContactFit
from acoustube.runs.inversion import RecordingInverter

LIMIT_COLUMNS = (
    "recording", "group", "distance_cm", "shape", "indenter_mm", "depth_mm", "force_n", "misfit",
    "residual",
)  # fmt: skip
"""Columns of the table of limits of detection, by position and tool."""


class EndsContacts(NamedTuple):
    """Contacts of a group of cycles, from one end or both.

    Attributes
    ----------
    contacts : list of ContactFit
        Contacts, at distances from the near end, each with misfit and residual of that end that
        explains its echo better, of those that detect it. The residual is nan if it is due to a
        contact that the end misses. The misfit is 1 or more where both ends detect the contact but
        contradict each other in position or depth.
    misfit, residual : float
        With one end those of `near`. With two ends `misfit` is the largest of a contact, nan
        without contacts, and `residual` the larger of both ends, of those that are not due to a
        contact which the end misses; nan if both are.
    near : Inversion
        Inversion from the near end alone.
    far : (Inversion, float) or None
        Inversion from the far end alone, and the tube's length in m; None if there is only one end.
    """

    contacts: list[ContactFit]
    misfit: float
    residual: float
    near: Inversion
    far: tuple[Inversion, float] | None = None

    @classmethod
    def of_one_end(cls, near: Inversion) -> EndsContacts:
        """Return the contacts of an inversion from one end."""
        fit = near.misfit, near.residual
        return cls([ContactFit(one, *fit) for one in near.contacts], *fit, near)

    @property
    def fits(self) -> bool:
        """Goodness of fit: whether the contacts explain the echoes (:func:`.good_fit`)."""
        return good_fit(self.misfit, self.residual)

    @property
    def span(self) -> tuple[float, float]:
        """Nearest and farthest position from the near end in m at which contacts are sought."""
        low, high = self.near.model.span
        if self.far is None:
            return low, high
        far, length = self.far
        return min(low, length - far.model.span[1]), max(high, length - far.model.span[0])

    def detection_limit(self, places: ArrayLike, tool: int = 0) -> Array:
        """Return the least detectable depths in m, the smaller one of both ends at each position.

        An end whose inversion does not fit is ignored, unless neither fits. Parameters and result
        are those of :meth:`acoustube.inversion.Inversion.detection_limit`, with positions from the
        near end.
        """
        at = np.asarray(places, float)
        if self.far is None:
            return self.near.detection_limit(at, tool)
        far, length = self.far
        ends = [(self.near, at), (far, length - at)]
        explained = [end for end in ends if end[0].fits] or ends
        found = np.fmin.reduce([one.detection_limit(z, tool) for one, z in explained])
        for one in self.contacts:
            found[np.abs(at - one.contact.distance.value) <= CLOSEST] = np.nan
        return np.asarray(found)


class EndsInverter:
    """Inversion of recordings from one end of a tube, or of pairs of recordings from both ends.

    Parameters
    ----------
    near : RecordingInverter
        Inversion of recordings from the near end. The rangefinders of both ends are of one kind.
    untouched : sequence of (Path, xarray.Dataset), optional
        Recordings of the untouched tube from the far end.
    """

    def __init__(
        self, near: RecordingInverter, untouched: Sequence[tuple[Path, xr.Dataset]] = ()
    ) -> None:
        self.near, self.untouched = near, untouched
        self._far: dict[float, RecordingInverter] = {}

    def groups(
        self, path: Path, data: xr.Dataset, far: tuple[Path, xr.Dataset | ConfigError] | None,
        size: int, check: Callable[[], None],
    ) -> Iterator[tuple[int, EndsContacts]]:  # fmt: skip
        """Yield the index of each group of cycles of a recording, and the contacts found in it.

        Parameters
        ----------
        path, data, size, check
            As of :meth:`acoustube.runs.inversion.RecordingInverter.groups`.
        far : (Path, xarray.Dataset or ConfigError) or None
            File and recording of the same cycles from the far end, or the error of reading it; None
            if there is only one end.

        Raises
        ------
        ConfigError
            If a recording does not match the sensor. With `far` also if this recording could not be
            read, the numbers of cycles differ, or nothing states the length of the tube.
        """
        here = self.near.groups(path, data, size, check)
        if far is None:
            for number, one in here:
                yield number, EndsContacts.of_one_end(one)
            return
        source, other = far
        if isinstance(other, ConfigError):
            raise ConfigError(about(source, other)) from other
        if other.sizes["cycle"] != data.sizes["cycle"]:
            raise ConfigError(
                f"{source} has {other.sizes['cycle']} cycles and {path} {data.sizes['cycle']}; "
                "give recordings of the same cycles from both ends"
            )
        length = self.near.length(data)
        if length is None:
            raise ConfigError(
                f"{path} does not state the tube's length, which is needed to combine recordings "
                "from both ends; state length_cm in the file of the sensor"
            )
        if length not in self._far:
            self._far[length] = self.near.from_other_end(length, self.untouched)
        there = self._far[length].groups(source, other, size, check)
        for (number, one), (_, two) in zip(here, there, strict=True):
            yield number, self._joined(one, two, length)

    def _joined(self, near: Inversion, far: Inversion, length: float) -> EndsContacts:
        """Return the contacts that one end or both detect, in a tube of a length in m."""
        known = self.near.tool_library, self.near.sensor.priors
        joined, found = joined_contacts(near.contacts, far.contacts, length, *known), []
        lost = [one.contact.distance.value for one in joined if one.near is None]
        hidden = [length - one.contact.distance.value for one in joined if one.far is None]
        fits = [(end.misfit, _own_residual(end, z)) for end, z in ((near, lost), (far, hidden))]
        for one in joined:
            seen = one.near is not None, one.far is not None
            ends = list(itertools.compress(fits, seen))
            misfit, residual = min(ends, key=_excess)
            # Where the ends contradict each other, the contact counts as unexplained.
            if not one.agree:
                misfit = max(1.0, *(fit[0] for fit in ends))
            found.append(ContactFit(one.contact, misfit, residual))
        misfit = max((one.misfit for one in found), default=float("nan"))
        residual = float(np.fmax(fits[0][1], fits[1][1]))
        return EndsContacts(found, misfit, residual, near, (far, length))


def _excess(fit: tuple[float, float]) -> float:
    """Return the larger of misfit and residual relative to their thresholds; inf for nan."""
    misfit, residual = fit
    return float("inf") if np.isnan(residual) else max(misfit / MISFIT, residual / RESIDUAL)


def _own_residual(end: Inversion, missed: Sequence[float]) -> float:
    """Return the residual of an end, or nan if a contact that the end misses may cause it.

    `missed` are the distances from that end in m of such contacts. The echo of a contact arrives
    later than that of nearer places, so that it causes no residual in front of the contact.
    """
    last = end.residual_span[1]
    return float("nan") if any(place < last for place in missed) else end.residual


def limit_rows(path: Path, group: int, found: EndsContacts, library: Library) -> list[list[object]]:
    """Return the least detectable depths and forces along the tube as :data:`LIMIT_COLUMNS`.

    Parameters
    ----------
    path : Path
        File of the recording.
    group : int
        Number of the group of cycles.
    found : EndsContacts
        Contacts of the group.
    library : Library

    Returns
    -------
    list of list
        A row for each tool and each position of :func:`acoustube.inversion.detection.limits_along`
        that has a limit.
    """
    rows: list[list[object]] = []
    for number, tool in enumerate(library.tools):
        places, depths = limits_along(partial(found.detection_limit, tool=number), found.span)
        known = np.isfinite(depths)
        forces = np.full(len(depths), np.inf)
        forces[known] = tool.force_at(depths[known])
        start, kind = [str(path), group], [tool.shape, f"{MM * tool.diameter:g}"]
        rows += [
            [*start, f"{CM * place:.6g}", *kind, f"{MM * d:.4g}", f"{f:.4g}", f"{found.misfit:.4g}",
             f"{found.residual:.4g}"]
            for place, d, f in zip(places, depths, forces, strict=True)
            if not np.isnan(d)
        ]  # fmt: skip
    return rows
