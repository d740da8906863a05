"""The leapfrog scheme over columns of cells along the tube, compiled by numba.

Importing this module imports numba, so it is imported only where a march starts. All arrays have
the tube's axis z last. A loop over z writes to few arrays, for it becomes vector code only if the
compiler can check that none overlaps another.
"""

from __future__ import annotations

import os
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]
Integers = NDArray[np.integer[Any]]

CORE, CUT = 0, 1  # spans of full cells without losses at the wall, and all others
POLLS = 2000  # of a barrier, before the thread yields its core
# Indices are unsigned, as only those need no check whether they count from the end.
_NONE, _ONE, _TWO, _THREE, _FOUR = (np.uint64(i) for i in range(5))
# Sums may be regrouped, but what is not a number must stay so. References are not counted: the
# threads would share the counts, and every slice would change them.
_compiled = njit(
    cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"},
    forceinline=True, _nrt=False,
)  # fmt: skip
_yield_core = types.ExternalFunction(
    "SwitchToThread" if os.name == "nt" else "sched_yield", types.int32()
)


class Columns(NamedTuple):
    """The open cells, column by column.

    Attributes
    ----------
    place : ndarray
        x and y of each column, (n, 2).
    first : ndarray
        Its first span, (n+1,).
    spans : ndarray
        First layer, last layer plus one, and `CORE` or `CUT`, (n_spans, 3).
    shares : ndarray
        First column of each thread, (n_threads+1,).
    """

    place: Integers
    first: Integers
    spans: Integers
    shares: Integers


class Stencil(NamedTuple):
    """Coefficients as in `wave_operator.Operator`.

    Attributes
    ----------
    weight : ndarray
        Inverse volume times the time step squared, (nx, ny, nz).
    area_x, area_y, area_z : ndarray
    full : ndarray
        Areas of the three full faces, times the time step squared, (3,).
    beta : ndarray
        (1,).
    """

    weight: Array
    area_x: Array
    area_y: Array
    area_z: Array
    full: Array
    beta: Array


class Lossy(NamedTuple):
    """Those of `losses.Losses`; without losses all are empty.

    Attributes
    ----------
    drag : Stencil
        Acts in cut spans only.
    compliance, yielding : ndarray
    share : ndarray
        How much the air absorbs in each layer, (nz,).
    decay, gain, wall, bulk : ndarray
        Of the relaxations, those of the air first, (n_poles,); `wall` is what a relaxation gives
        to the half-integral within a step, `bulk` of those of the air only.
    scalars : ndarray
        Response and rate, (2,).
    """

    drag: Stencil
    compliance: Array
    yielding: Array
    share: Array
    decay: Array
    gain: Array
    wall: Array
    bulk: Array
    scalars: Array


class Fields(NamedTuple):
    """What changes from step to step.

    Attributes
    ----------
    ahead : ndarray
        What the Laplacian is taken of: the pressure and what the air's absorption adds to it. At
        two times, (2, nx+2, ny+2, nz+4).
    change : ndarray
        (nx, ny, nz).
    pressure : ndarray
        (nx+2, ny+2, nz+4); empty without losses, as are all that follow.
    relaxed : ndarray
        (nx, ny, n_poles, nz).
    relaxing : ndarray
        What the relaxations give to the half-integral within a step, (nx, ny, nz).
    integral : ndarray
        At two times.
    increment : ndarray
    """

    ahead: Array
    change: Array
    pressure: Array
    relaxed: Array
    relaxing: Array
    integral: Array
    increment: Array


class Layer(NamedTuple):
    """An absorber: coefficients and state as in `absorber.Absorber`, in n layers; n may be 0.

    Attributes
    ----------
    cells, faces : ndarray
        Decay, gain and inverse, (3, n) and (3, n+3).
    transverse, velocity, face_memory, cell_memory : ndarray
    """

    cells: Array
    faces: Array
    transverse: Array
    velocity: Array
    face_memory: Array
    cell_memory: Array


class Ends(NamedTuple):
    """What is driven and heard.

    Attributes
    ----------
    shape : ndarray
        Of the source, (nx, ny).
    keep : ndarray
        (1,).
    layer : int
        Of the source.
    planes : ndarray
        Probed layers, (n_planes,).
    plane_of : ndarray
        First probe of each plane, (n_planes+1,).
    weights : ndarray
        (nx, ny, n_probes), the probes in the order of their planes.
    """

    shape: Array
    keep: Array
    layer: int
    planes: Integers
    plane_of: Integers
    weights: Array


@intrinsic
def _arrive(typingctx, counter):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Add one to the first entry of an array of int64, as seen by all threads."""

    def codegen(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        one = ir.Constant(ir.IntType(64), 1)
        builder.atomic_rmw("add", array.data, one, "seq_cst")
        return context.get_dummy_value()

    return types.void(counter), codegen


@intrinsic
def _arrived(typingctx, counter):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Return the first entry of an array of int64, read anew."""

    def codegen(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        return builder.load_atomic(array.data, "acquire", 8)

    return types.int64(counter), codegen


@_compiled
def _meet(counter, total):  # type: ignore[no-untyped-def]
    """Wait until the threads have arrived as often as given."""
    _arrive(counter)
    polls = 0
    while _arrived(counter) < total:
        polls += 1
        if polls > POLLS:
            _yield_core()


@_compiled
def _full_balance(q, full, bent, x, y, k):  # type: ignore[no-untyped-def]
    """Return the balance of a cell all of whose faces are full."""
    i, j, m = x + _ONE, y + _ONE, k + _TWO
    twice = q[i, j, m] + q[i, j, m]
    across = full[0] * ((q[i + _ONE, j, m] + q[x, j, m]) - twice)
    across += full[1] * ((q[i, j + _ONE, m] + q[i, y, m]) - twice)
    beside = (q[i, j, m + _ONE] + q[i, j, m - _ONE]) - twice
    beyond = (q[i, j, m + _TWO] + q[i, j, k]) - twice
    return across + (full[2] + np.float32(4) * bent) * beside - bent * beyond


@_compiled
def _flow_across(q, operator, x, y, k):  # type: ignore[no-untyped-def]
    """Return the balance of a cell over its faces across."""
    i, j, m = x + _ONE, y + _ONE, k + _TWO
    here, area_x, area_y = q[i, j, m], operator.area_x, operator.area_y
    flow_x = area_x[i, y, k] * (q[i + _ONE, j, m] - here) - area_x[x, y, k] * (here - q[x, j, m])
    flow_y = area_y[x, j, k] * (q[i, j + _ONE, m] - here) - area_y[x, y, k] * (here - q[i, y, m])
    return flow_x + flow_y


@_compiled
def _flow_along(velocities, areas, beta):  # type: ignore[no-untyped-def]
    """Return the balance over the axial faces, as `wave_operator.axial_divergence`."""
    before, below, above, behind = velocities
    a, b, c, d = areas
    low, here, high = (
        min(a, b) * (below - before),
        min(b, c) * (above - below),
        min(c, d) * (behind - above),
    )
    return (c * above - b * below) - beta * ((high - here) - (here - low))


@_compiled
def _axial_areas(operator, x, y, k):  # type: ignore[no-untyped-def]
    area = operator.area_z
    return area[x, y, k], area[x, y, k + _ONE], area[x, y, k + _TWO], area[x, y, k + _THREE]


@_compiled
def _cut_balance(q, operator, x, y, k):  # type: ignore[no-untyped-def]
    """Return the balance of a cell, each face with its own area."""
    i, j = x + _ONE, y + _ONE
    a, b, c, d, e = (
        q[i, j, k],
        q[i, j, k + _ONE],
        q[i, j, k + _TWO],
        q[i, j, k + _THREE],
        q[i, j, k + _FOUR],
    )
    areas = _axial_areas(operator, x, y, k)
    along = _flow_along((b - a, c - b, d - c, e - d), areas, operator.beta[0])
    return _flow_across(q, operator, x, y, k) + along


@_compiled
def _lossless_core(operator, q, following, change, x, y, begin, end):  # type: ignore[no-untyped-def]
    full = operator.full[0], operator.full[1], operator.full[2]
    bent = operator.beta[0] * full[2]
    for k in range(begin, end):
        moved = change[x, y, k] + _full_balance(q, full, bent, x, y, k)
        change[x, y, k] = moved
        following[x + _ONE, y + _ONE, k + _TWO] = q[x + _ONE, y + _ONE, k + _TWO] + moved


@_compiled
def _lossless_cut(operator, q, following, change, x, y, begin, end):  # type: ignore[no-untyped-def]
    for k in range(begin, end):
        force = operator.weight[x, y, k] * _cut_balance(q, operator, x, y, k)
        moved = change[x, y, k] + force
        change[x, y, k] = moved
        following[x + _ONE, y + _ONE, k + _TWO] = q[x + _ONE, y + _ONE, k + _TWO] + moved


@_compiled
def _relax(lossy, relaxed, middle, following, x, y, begin, end):  # type: ignore[no-untyped-def]
    """Advance the air's relaxations, by which the pressure is ahead of itself."""
    for j in range(np.uint64(lossy.bulk.size)):
        decay, gain, lag = lossy.decay[j], lossy.gain[j], lossy.bulk[j]
        for k in range(begin, end):
            new = decay * relaxed[x, y, j, k] + gain * middle[k]
            relaxed[x, y, j, k] = new
            following[x + _ONE, y + _ONE, k + _TWO] -= lossy.share[k] * lag * new


@_compiled
def _relax_wall(lossy, relaxed, relaxing, middle, x, y, begin, end):  # type: ignore[no-untyped-def]
    """Advance the wall's relaxations."""
    for j in range(np.uint64(lossy.bulk.size), np.uint64(lossy.decay.size)):
        decay, gain, part = lossy.decay[j], lossy.gain[j], lossy.wall[j]
        for k in range(begin, end):
            new = decay * relaxed[x, y, j, k] + gain * middle[k]
            relaxed[x, y, j, k] = new
            relaxing[x, y, k] += part * new


@_compiled
def _core_force(operator, q, moved, x, y, begin, end):  # type: ignore[no-untyped-def]
    full = operator.full[0], operator.full[1], operator.full[2]
    bent = operator.beta[0] * full[2]
    for k in range(begin, end):
        moved[k] = _full_balance(q, full, bent, x, y, k)


@_compiled
def _cut_force(operator, q, moved, x, y, begin, end):  # type: ignore[no-untyped-def]
    for k in range(begin, end):
        moved[k] = operator.weight[x, y, k] * _cut_balance(q, operator, x, y, k)


@_compiled
def _subtract_drag(weight, drag, integral, moved, x, y, begin, end):  # type: ignore[no-untyped-def]
    for k in range(begin, end):
        moved[k] -= weight[x, y, k] * _cut_balance(integral, drag, x, y, k)


@_compiled
def _yield_to_wall(lossy, fields, moved, x, y, begin, end):  # type: ignore[no-untyped-def]
    """Turn the force, less the last change, into the change; advance the half-integral's."""
    response, half = lossy.scalars[0], np.float32(0.5) * lossy.scalars[0]
    change, pressure, increment = fields.change, fields.pressure, fields.increment
    for k in range(begin, end):
        expected = response * pressure[x + _ONE, y + _ONE, k + _TWO] + fields.relaxing[x, y, k]
        stiff = lossy.compliance[x, y, k] * (expected - increment[x, y, k])
        new = lossy.yielding[x, y, k] * (change[x, y, k] - stiff + moved[k])
        increment[x, y, k] = expected + half * new
        moved[k] = new - change[x, y, k]


@_compiled
def _integrate(integral, later, increment, relaxing, x, y, begin, end):  # type: ignore[no-untyped-def]
    i, j = x + _ONE, y + _ONE
    for k in range(begin, end):
        later[i, j, k + _TWO] = integral[i, j, k + _TWO] + increment[x, y, k]
        relaxing[x, y, k] = np.float32(0)


@_compiled
def _settle(lossy, fields, following, moved, middle, x, y, begin, end):  # type: ignore[no-untyped-def]
    """Advance change and pressure."""
    half, rate = np.float32(0.5), lossy.scalars[1]
    i, j, pressure, change = x + _ONE, y + _ONE, fields.pressure, fields.change
    for k in range(begin, end):
        new = change[x, y, k] + moved[k]
        now = pressure[i, j, k + _TWO]
        change[x, y, k] = new
        middle[k] = now + half * new
        pressure[i, j, k + _TWO] = now + new
        following[i, j, k + _TWO] = now + new + lossy.share[k] * rate * new


@_compiled
def _absorb(operator, layer, q, following, change, first, x, y):  # type: ignore[no-untyped-def]
    """Advance an absorber's column, as `absorber.absorb`."""
    i, j, n = x + _ONE, y + _ONE, np.uint64(layer.cells.shape[1])
    faces, velocity, memory, weight = (
        layer.faces,
        layer.velocity,
        layer.face_memory,
        operator.weight,
    )
    if n == _NONE:
        return
    for f in range(n + _THREE):
        difference = q[i, j, first + f + _ONE] - q[i, j, first + f]
        new = faces[_NONE, f] * memory[x, y, f] + faces[_ONE, f] * difference
        memory[x, y, f] = new
        velocity[x, y, f] += faces[_TWO, f] * difference + new
    for c in range(n):
        k = first + c
        weight = operator.weight[x, y, k]
        transverse = layer.transverse[x, y, c] + weight * _flow_across(q, operator, x, y, k)
        velocities = (
            velocity[x, y, c],
            velocity[x, y, c + _ONE],
            velocity[x, y, c + _TWO],
            velocity[x, y, c + _THREE],
        )
        balance = _flow_along(velocities, _axial_areas(operator, x, y, k), operator.beta[0])
        new = layer.cells[_NONE, c] * layer.cell_memory[x, y, c] + layer.cells[_ONE, c] * balance
        moved = transverse + weight * (layer.cells[_TWO, c] * balance + new)
        layer.transverse[x, y, c] = transverse
        layer.cell_memory[x, y, c] = new
        change[x, y, k] = moved
        following[i, j, k + _TWO] = q[i, j, k + _TWO] + moved


@_compiled
def _drive(ends, field, x, y, sample):  # type: ignore[no-untyped-def]
    """Return by how much the source moves a cell of its layer."""
    now = field[x + _ONE, y + _ONE, np.uint64(ends.layer) + _TWO]
    return (ends.keep[0] - np.float32(1)) * now + sample * ends.shape[x, y]


@_compiled
def _probe(ends, field, x, y, heard):  # type: ignore[no-untyped-def]
    """Add a column's share to what the probes hear."""
    for i in range(ends.planes.size):
        now = field[x + _ONE, y + _ONE, ends.planes[i] + _TWO]
        for j in range(ends.plane_of[i], ends.plane_of[i + 1]):
            heard[j] += ends.weights[x, y, j] * now


@_compiled
def _lossless_column(problem, q, following, c, x, y):  # type: ignore[no-untyped-def]
    columns, operator, _, fields = problem[:4]
    for s in range(columns.first[c], columns.first[c + 1]):
        begin, end = columns.spans[s, 0], columns.spans[s, 1]
        if columns.spans[s, 2] == CORE:
            _lossless_core(operator, q, following, fields.change, x, y, begin, end)
        else:
            _lossless_cut(operator, q, following, fields.change, x, y, begin, end)


@_compiled
def _lossy_column(problem, q, following, integral, later, work, c, x, y):  # type: ignore[no-untyped-def]
    columns, operator, lossy, fields = problem[:4]
    moved, middle = work[0], work[1]
    for s in range(columns.first[c], columns.first[c + 1]):
        begin, end, kind = columns.spans[s, 0], columns.spans[s, 1], columns.spans[s, 2]
        if kind == CORE:
            _core_force(operator, q, moved, x, y, begin, end)
        else:
            _cut_force(operator, q, moved, x, y, begin, end)
            _subtract_drag(operator.weight, lossy.drag, integral, moved, x, y, begin, end)
            _yield_to_wall(lossy, fields, moved, x, y, begin, end)
            _integrate(integral, later, fields.increment, fields.relaxing, x, y, begin, end)
        _settle(lossy, fields, following, moved, middle, x, y, begin, end)
        _relax(lossy, fields.relaxed, middle, following, x, y, begin, end)
        if kind == CUT:
            _relax_wall(lossy, fields.relaxed, fields.relaxing, middle, x, y, begin, end)


@_compiled
def _step(problem, now, begin, end, sample, work, heard):  # type: ignore[no-untyped-def]
    """Advance some columns by one step."""
    columns, operator, lossy, fields, before, behind, ends = problem
    q, following = fields.ahead[now], fields.ahead[1 - now]
    integral, later = fields.integral[now], fields.integral[1 - now]
    last = np.uint64(fields.change.shape[2] - behind.cells.shape[1])
    layer = np.uint64(ends.layer) + _TWO
    for c in range(begin, end):
        x, y = columns.place[c, 0], columns.place[c, 1]
        if lossy.decay.size > 0:
            _lossy_column(problem, q, following, integral, later, work, c, x, y)
        else:
            _lossless_column(problem, q, following, c, x, y)
        _absorb(operator, before, q, following, fields.change, _NONE, x, y)
        _absorb(operator, behind, q, following, fields.change, last, x, y)
        if lossy.decay.size > 0:
            added = _drive(ends, fields.pressure, x, y, sample)
            fields.pressure[x + _ONE, y + _ONE, layer] += added
            following[x + _ONE, y + _ONE, layer] += added
            _probe(ends, fields.pressure, x, y, heard)
        else:
            following[x + _ONE, y + _ONE, layer] += _drive(ends, following, x, y, sample)
            _probe(ends, following, x, y, heard)


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def advance(problem, thread, now, samples, work, heard, counter):  # type: ignore[no-untyped-def]
    """Advance a thread's columns by some steps, in step with the other threads.

    Parameters
    ----------
    problem : tuple
        `Columns`, `Stencil`, `Lossy`, `Fields`, two `Layer` and `Ends`.
    thread : int
    now : int
        Where `Fields.ahead` and `Fields.integral` hold the present, 0 or 1.
    samples : ndarray
        Of the source, one a step, (n,).
    work : ndarray
        For intermediate values, (n_threads, 2, nz).
    heard : ndarray
        Receives the thread's share of what the probes hear, (n_threads, n, n_probes); zero before.
    counter : ndarray
        Of int64, (1,), zero before.
    """
    shares = problem[0].shares
    n_threads = shares.size - 1
    for step in range(samples.size):
        begin, end = shares[thread], shares[thread + 1]
        _step(problem, now, begin, end, samples[step], work[thread], heard[thread, step])
        now = 1 - now
        if n_threads > 1:
            _meet(counter, n_threads * (step + 1))
