"""Presses of a library's tool as scatterers of :mod:`acoustube.ranging`."""

from __future__ import annotations

import numpy as np

from acoustube.inversion import Tool
from acoustube.waves import PlacedScatterer, Scattering
from acoustube.waves.modes import cut_on_frequency
from acoustube.waves.modes.grid_modes import mode_numbers
from acoustube.waves.network import at_sound_speed


def placed_press(
    tool: Tool, place: float, depth: float, sound_speed: float | None = None
) -> PlacedScatterer:
    """Return a press of a tool as a placed scatterer.

    Parameters
    ----------
    tool : Tool
        Tool of a library.
    place, depth : float
        In m.
    sound_speed : float, optional
        In m/s, that of the tool's matrices if not given.
    """
    s, m = tool.matrix(depth), len(tool.modes)
    numbers = [mode_numbers(name) for name in tool.modes]
    cut_ons = [cut_on_frequency(*one, tool.radius, tool.sound_speed) for one in numbers]
    found = Scattering(
        frequency=tool.frequency, modes=tool.modes, s=s,
        propagates=np.ones((len(s), m), bool), cut_ons=np.array(cut_ons),
        settled=np.ones(s.shape, bool), sound_speed=tool.sound_speed,
        extent=(-0.01, 0.01), spacing=(np.nan,) * 3, shape=(0, 0, 0), steps=0, time_step=np.nan,
    )  # fmt: skip
    if sound_speed is not None:
        found = at_sound_speed(found, sound_speed)
    return PlacedScatterer(found, place)
