"""The discrete problem: grid with its ends, coefficients, and initial state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Choice
from acoustube.waves.grid.cells import CutCells, with_straight_ends
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.grid.small_cells import share_small_volumes
from acoustube.waves.scheme.losses import Losses, RelaxationState, losses
from acoustube.waves.scheme.operator import (
    Operator,
    assemble,
    dispersion_coefficient,
    on_device,
    silent,
    silent_with_halo,
)
from acoustube.waves.scheme.pml import Absorber, absorber, absorber_layers
from acoustube.waves.scheme.time_step import marching_step

SourceEnd = Literal["release", "absorbing", "rigid"]
FarEnd = Literal["absorbing", "rigid"]
LOSS_TAPER = 8e-3
"""Length in m over which the losses are tapered to zero towards an absorber."""


class State(NamedTuple):
    """Fields of the scheme, which change from step to step.

    Attributes
    ----------
    pressure : Array
        Pressure with halo, (nx+2, ny+2, nz+4), in Pa.
    change : Array
        Pressure change over the last step, sources excluded, (nx, ny, nz), in Pa.
    before, behind : Absorber or None
        Absorbing layers at the source end and at the far end.
    memory : RelaxationState or None
        Memory variables of the losses.
    """

    pressure: jax.Array
    change: jax.Array
    before: Absorber | None
    behind: Absorber | None
    memory: RelaxationState | None


class Scheme(NamedTuple):
    """Constant coefficients of the discrete problem.

    Attributes
    ----------
    operator : Operator
        Spatial operator.
    step_squared : Array
        Time step squared in s2.
    keep, source : Array
        The source layer is set to keep * pressure + source * signal; scalar and (nx, ny).
    probe_layers : Array
        Layer indices of the probes, (n_probes,).
    probe_weights : Array
        Weights of the probes over their layers, (nx, ny, n_probes).
    losses : Losses or None
        Coefficients of the losses at the wall and in the air.
    """

    operator: Operator
    step_squared: jax.Array
    keep: jax.Array
    source: jax.Array
    probe_layers: jax.Array
    probe_weights: jax.Array
    losses: Losses | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Setup:
    """Discrete problem of a lumen with its ends, ready for time stepping.

    Attributes
    ----------
    cells : CutCells
        The grid of the scheme: after `share_small_volumes`, with the absorbers appended.
    scheme : Scheme
        Coefficients.
    state : State
        State at rest, with the absorbers' coefficients.
    time_step : float
        In s.
    source_layer : int
        Index of the layer at z = 0.
    probes : tuple of float
        Positions of the probed layers in m.
    """

    cells: CutCells
    scheme: Scheme
    state: State
    time_step: float
    source_layer: int
    probes: tuple[float, ...]


def prepare(
    cells: CutCells,
    air: Air,
    *,
    probes: tuple[float, ...],
    source_end: SourceEnd = "release",
    far_end: FarEnd = "absorbing",
    absorber_thickness: float = 0.02,
    time_step: float | None = None,
    lossy_band: tuple[float, float] | None = None,
    dtype: DTypeLike = jnp.float32,
) -> Setup:
    """Return the discrete problem of a lumen.

    Parameters
    ----------
    cells : CutCells
        The lumen, with exact fractions of volume and faces.
    air : Air
        Gas in the lumen.
    probes : tuple of float
        Probe positions in m; each is moved to the nearest cell layer.
    source_end : {"release", "absorbing", "rigid"}
        Respectively, prescribed pressure at z = 0; a source at z = 0 that launches a wave into the
        tube, with an absorber behind it; or a rigid cap half a cell before z = 0, for problems that
        start from an initial pressure.
    far_end : {"absorbing", "rigid"}
        Straight continuation into an absorber, or a rigid cap at the end of the tube.
    absorber_thickness : float
        Thickness of the absorbing layer at an absorbing end, in m.
    time_step : float, optional
        In s; by default just below the limit of stability (:func:`marching_step`).
    lossy_band : tuple of float, optional
        Lowest and highest frequency in Hz of the fit of the losses; by default there are no losses.
    dtype : dtype
        Precision of the fields.

    Returns
    -------
    Setup
        Coefficients and the state at rest.

    Raises
    ------
    ValueError
        If an end is unknown, a probe lies outside the tube or where the lumen is closed, the grid
        has no open cell, or the lossy band is not positive and increasing.
    """
    Choice(get_args(SourceEnd)).check("source_end", source_end)
    Choice(get_args(FarEnd)).check("far_end", far_end)
    layers = absorber_layers(absorber_thickness, cells.spacing[2])
    ahead = layers if source_end == "absorbing" else 0
    behind = layers if far_end == "absorbing" else None
    nodes = [_layer(cells, probe) for probe in probes]
    exact = with_straight_ends(cells, ahead, behind)
    whole = share_small_volumes(exact)
    for probe, node in zip(probes, nodes, strict=True):
        if not whole.volume_fraction[:, :, ahead + node].any():
            raise ConfigError(f"the lumen is closed at probe = {probe:g} m; move the probe")
    step = marching_step(whole, air) if time_step is None else time_step
    across, dz = whole.shape[:2], cells.spacing[2]
    ends = [
        absorber(across, layers, dz, step, air.sound_speed, at_source=at_source, dtype=dtype)
        if present
        else None
        for at_source, present in ((True, bool(ahead)), (False, behind is not None))
    ]
    silence = silent(whole.shape, dtype)
    scheme = _scheme(whole, air, step, source_end, ahead, [ahead + k for k in nodes], dtype)
    lost, memory = None, None
    if lossy_band is not None:
        weight = _loss_weight(whole.shape[2], ahead, behind or 0, round(LOSS_TAPER / dz))
        lost, memory = losses(
            whole, exact, scheme.operator, air, step, lossy_band, weight=weight, dtype=dtype
        )
    return Setup(
        cells=whole,
        scheme=scheme._replace(losses=lost),
        state=State(silent_with_halo(whole.shape, dtype), silence, ends[0], ends[1], memory),
        time_step=step,
        source_layer=ahead,
        probes=tuple(k * dz for k in nodes),
    )


def _scheme(
    cells: CutCells,
    air: Air,
    step: float,
    source_end: SourceEnd,
    source_layer: int,
    probe_layers: list[int],
    dtype: DTypeLike,
) -> Scheme:
    """Return the coefficients of a grid that includes its ends."""
    operator = assemble(cells, air, dispersion_coefficient(cells, air, step), dtype=dtype)
    released = source_end == "release"
    if released:  # the prescribed pressure does not depend on its neighbours
        others = np.arange(cells.shape[2]) != source_layer
        inverse = np.asarray(operator.inverse_volume) * others.astype(dtype)
        operator = operator._replace(inverse_volume=on_device(inverse, dtype))
    volume = cells.volume_fraction
    driven = (volume[:, :, source_layer] > 0.0) & (source_end != "rigid")
    weights = volume[:, :, probe_layers]
    return Scheme(
        operator=operator,
        step_squared=on_device(step**2, dtype),
        keep=on_device(0.0 if released else 1.0, dtype),
        source=on_device(driven, dtype),
        probe_layers=on_device(np.array(probe_layers), np.int32),
        probe_weights=on_device(weights / weights.sum(axis=(0, 1)), dtype),
        losses=None,
    )


def _loss_weight(n_layers: int, ahead: int, behind: int, taper: int) -> Array:
    """Return the weight of the losses in each layer: 0 in absorbers, with a taper towards them.

    The absorbers are designed for lossless air, and an abrupt end of the losses would reflect. The
    two layers next to an absorber, which its stencil reaches, are lossless too.
    """
    distance = np.full(n_layers, np.inf)
    if ahead:
        distance = np.minimum(distance, np.arange(n_layers) - ahead)
    if behind:
        distance = np.minimum(distance, n_layers - 1 - behind - np.arange(n_layers))
    return 0.5 - 0.5 * np.cos(np.pi * np.clip((distance - 1.0) / max(taper - 1, 1), 0.0, 1.0))


def _layer(cells: CutCells, probe: float) -> int:
    """Return the index of the layer nearest to a probe."""
    if not 0.0 <= probe <= cells.length:
        raise ValueError(f"probe = {probe} m lies outside the tube; use 0 to {cells.length:.4g} m")
    return min(round(probe / cells.spacing[2]), cells.shape[2] - 1)
