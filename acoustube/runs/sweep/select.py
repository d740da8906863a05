"""Selection of a sweep's cases for figures and pages."""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
import xarray as xr

from acoustube import signals
from acoustube.base.units import MM
from acoustube.runs import sound
from acoustube.runs.config import configured
from acoustube.runs.config.si import SISettings, settings_in_si
from acoustube.waves import Recording


def chosen(cases: xr.Dataset) -> xr.Dataset:
    """Return each case for the source end that its settings select.

    ``amplitude`` and ``error`` are added: the highest echo relative to the send pulse, and the
    estimated less the true distance in m, nan for an untouched tube.
    """
    ends = xr.DataArray(cases["chosen_source_end"].values, dims="press")
    there = cases.sel(source_end=ends)
    error = (there["estimated_distance"] - there["true_distance"]).where(there["depth"] > 0)
    return there.assign(amplitude=there["echo_amplitude"], error=error)


def by_tool(cases: xr.Dataset) -> Iterator[tuple[str, xr.Dataset]]:
    """Yield the name of each indenter, and the cases with this indenter."""
    tools = list(zip(cases["shape"].values, cases["diameter"].values, strict=True))
    for shape, diameter in sorted(set(tools)):
        mine = [i for i, tool in enumerate(tools) if tool == (shape, diameter)]
        yield f"{MM * diameter:g} mm {shape}", cases.isel(press=mine)


def usual(cases: xr.Dataset) -> xr.Dataset:
    """Return the largest set of cases that differ in depth alone."""
    keys = []
    for text in cases["configuration"].values:
        settings = json.loads(str(text))
        del settings["indentation"]["depth_mm"]
        keys.append(json.dumps(settings))
    most = max(dict.fromkeys(keys), key=keys.count)
    return cases.isel(press=[i for i, key in enumerate(keys) if key == most])


def ranged(case: xr.Dataset) -> tuple[SISettings, Recording, signals.Ranging]:
    """Estimate the distance of a case again from its stored recording.

    Parameters
    ----------
    case : xarray.Dataset
        A case of a sweep at one source end.

    Returns
    -------
    settings : SISettings
    recording : Recording
        Time and pressure of the case; the grid is not known.
    ranging : Ranging
    """
    settings = settings_in_si(configured(json.loads(str(case["configuration"].values))))
    there = np.isfinite(case["pressure"].values)
    time, pressure = case["time"].values[there], case["pressure"].values[there].astype(float)
    recording = Recording(
        time=time, pressure=pressure[None], time_step=sound.TIME_STEP,
        probes=(settings.probe,), spacing=(np.nan,) * 3, shape=(0, 0, 0),
    )  # fmt: skip
    return settings, recording, sound.locate(settings, recording)


def envelope_of(case: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return distances in m, (n,), and the envelope of a case relative to the send pulse, (n,)."""
    settings, recording, ranging = ranged(case)
    delay = recording.time - float(ranging.send_time)
    away = signals.distance(delay, settings.temperature) + settings.probe
    return np.asarray(away), np.asarray(ranging.envelope)
