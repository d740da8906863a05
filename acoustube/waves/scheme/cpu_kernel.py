"""Leapfrog step over columns of cells along the tube, compiled by numba.

This module imports numba, and is therefore imported only when a run starts. The arrays are those of
`cpu_layout`, with z last. Each loop over z writes to few arrays, because it is vectorised only if
the compiler can check that no arrays overlap.
"""

from __future__ import annotations

import os

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from acoustube.waves.scheme.cpu_layout import CORE, CUT

BARRIER_POLLS = 2000
"""Number of polls of the barrier before a thread yields its core."""
# Indices are unsigned, because signed ones would be checked for negative values.
_NONE, _ONE, _TWO, _THREE, _FOUR = (np.uint64(i) for i in range(5))
# Sums may be reassociated, but NaN must be preserved. Reference counting is off, because the
# threads would share the counts, and every slice would change them.
_compiled = njit(
    cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"},
    forceinline=True, _nrt=False,
)  # fmt: skip
_yield_core = types.ExternalFunction(
    "SwitchToThread" if os.name == "nt" else "sched_yield", types.int32()
)


@intrinsic
def _barrier_arrive(typingctx, counter):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Increment the first entry of an array of int64 atomically."""

    def codegen(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        one = ir.Constant(ir.IntType(64), 1)
        builder.atomic_rmw("add", array.data, one, "seq_cst")
        return context.get_dummy_value()

    return types.void(counter), codegen


@intrinsic
def _barrier_count(typingctx, counter):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Return the first entry of an array of int64 by an atomic load."""

    def codegen(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        return builder.load_atomic(array.data, "acquire", 8)

    return types.int64(counter), codegen


@_compiled
def _barrier_wait(counter, total):  # type: ignore[no-untyped-def]
    """Wait until the number of arrivals of all threads has reached a total."""
    _barrier_arrive(counter)
    polls = 0
    while _barrier_count(counter) < total:
        polls += 1
        if polls > BARRIER_POLLS:
            _yield_core()


@_compiled
def _full_divergence(q, full, bent, x, y, k):  # type: ignore[no-untyped-def]
    """Return the discrete Laplacian of a field, times (c dt)^2, in a cell whose faces are full."""
    i, j, m = x + _ONE, y + _ONE, k + _TWO
    twice = q[i, j, m] + q[i, j, m]
    across = full[0] * ((q[i + _ONE, j, m] + q[x, j, m]) - twice)
    across += full[1] * ((q[i, j + _ONE, m] + q[i, y, m]) - twice)
    beside = (q[i, j, m + _ONE] + q[i, j, m - _ONE]) - twice
    beyond = (q[i, j, m + _TWO] + q[i, j, k]) - twice
    return across + (full[2] + np.float32(4) * bent) * beside - bent * beyond


@_compiled
def _flow_across(q, operator, x, y, k):  # type: ignore[no-untyped-def]
    """Return the divergence of area times field difference over a cell's transverse faces."""
    i, j, m = x + _ONE, y + _ONE, k + _TWO
    here, area_x, area_y = q[i, j, m], operator.area_x, operator.area_y
    flow_x = area_x[i, y, k] * (q[i + _ONE, j, m] - here) - area_x[x, y, k] * (here - q[x, j, m])
    flow_y = area_y[x, j, k] * (q[i, j + _ONE, m] - here) - area_y[x, y, k] * (here - q[i, y, m])
    return flow_x + flow_y


@_compiled
def _flow_along(velocities, areas, beta):  # type: ignore[no-untyped-def]
    """Return the divergence of area times `velocities` over axial faces, with correction `beta`."""
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
def _cut_divergence(q, operator, x, y, k):  # type: ignore[no-untyped-def]
    """Return the divergence of area times field difference over all faces of a cut cell."""
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
        moved = change[x, y, k] + _full_divergence(q, full, bent, x, y, k)
        change[x, y, k] = moved
        following[x + _ONE, y + _ONE, k + _TWO] = q[x + _ONE, y + _ONE, k + _TWO] + moved


@_compiled
def _lossless_cut(operator, q, following, change, x, y, begin, end):  # type: ignore[no-untyped-def]
    for k in range(begin, end):
        force = operator.weight[x, y, k] * _cut_divergence(q, operator, x, y, k)
        moved = change[x, y, k] + force
        change[x, y, k] = moved
        following[x + _ONE, y + _ONE, k + _TWO] = q[x + _ONE, y + _ONE, k + _TWO] + moved


@_compiled
def _update_air_memory(lossy, relaxed, middle, following, x, y, begin, end):  # type: ignore[no-untyped-def]
    """Advance the air's relaxations, and subtract them from the field of the next Laplacian."""
    for j in range(np.uint64(lossy.bulk.size)):
        decay, gain, lag = lossy.decay[j], lossy.gain[j], lossy.bulk[j]
        for k in range(begin, end):
            new = decay * relaxed[x, y, j, k] + gain * middle[k]
            relaxed[x, y, j, k] = new
            following[x + _ONE, y + _ONE, k + _TWO] -= lossy.weight[k] * lag * new


@_compiled
def _update_wall_memory(lossy, relaxed, relaxing, middle, x, y, begin, end):  # type: ignore[no-untyped-def]
    """Advance the wall's relaxations, and add up their parts of the half-integral's change."""
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
        moved[k] = _full_divergence(q, full, bent, x, y, k)


@_compiled
def _cut_force(operator, q, moved, x, y, begin, end):  # type: ignore[no-untyped-def]
    for k in range(begin, end):
        moved[k] = operator.weight[x, y, k] * _cut_divergence(q, operator, x, y, k)


@_compiled
def _subtract_drag(weight, drag, integral, moved, x, y, begin, end):  # type: ignore[no-untyped-def]
    for k in range(begin, end):
        moved[k] -= weight[x, y, k] * _cut_divergence(integral, drag, x, y, k)


@_compiled
def _wall_step(lossy, fields, moved, x, y, begin, end):  # type: ignore[no-untyped-def]
    """Include the wall's thermal losses in `moved`, the pressure's second difference in time."""
    response, half = lossy.scalars[0], np.float32(0.5) * lossy.scalars[0]
    change, pressure, increment = fields.change, fields.pressure, fields.increment
    for k in range(begin, end):
        expected = response * pressure[x + _ONE, y + _ONE, k + _TWO] + fields.relaxing[x, y, k]
        stiff = lossy.compliance[x, y, k] * (expected - increment[x, y, k])
        new = lossy.implicit_factor[x, y, k] * (change[x, y, k] - stiff + moved[k])
        increment[x, y, k] = expected + half * new
        moved[k] = new - change[x, y, k]


@_compiled
def _update_integral(integral, later, increment, relaxing, x, y, begin, end):  # type: ignore[no-untyped-def]
    i, j = x + _ONE, y + _ONE
    for k in range(begin, end):
        later[i, j, k + _TWO] = integral[i, j, k + _TWO] + increment[x, y, k]
        relaxing[x, y, k] = np.float32(0)


@_compiled
def _update_pressure(lossy, fields, following, moved, middle, x, y, begin, end):  # type: ignore[no-untyped-def]
    """Advance the pressure, its change per step, and the field whose Laplacian is taken next."""
    half, rate = np.float32(0.5), lossy.scalars[1]
    i, j, pressure, change = x + _ONE, y + _ONE, fields.pressure, fields.change
    for k in range(begin, end):
        new = change[x, y, k] + moved[k]
        now = pressure[i, j, k + _TWO]
        change[x, y, k] = new
        middle[k] = now + half * new
        pressure[i, j, k + _TWO] = now + new
        following[i, j, k + _TWO] = now + new + lossy.weight[k] * rate * new


@_compiled
def _pml_step(operator, layer, q, following, change, first, x, y):  # type: ignore[no-untyped-def]
    """Advance a column of cells of an absorber by one step, as `pml.pml_step` does."""
    i, j, n = x + _ONE, y + _ONE, np.uint64(layer.cells.shape[1])
    faces, velocity, memory = layer.faces, layer.velocity, layer.face_memory
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
def _source_increment(ends, field, x, y, sample):  # type: ignore[no-untyped-def]
    """Return the pressure increment of a cell of the source layer."""
    now = field[x + _ONE, y + _ONE, np.uint64(ends.layer) + _TWO]
    return (ends.keep[0] - np.float32(1)) * now + sample * ends.shape[x, y]


@_compiled
def _probe(ends, field, x, y, recorded):  # type: ignore[no-untyped-def]
    """Add a column's contribution to the probes' pressures."""
    for i in range(ends.planes.size):
        now = field[x + _ONE, y + _ONE, ends.planes[i] + _TWO]
        for j in range(ends.plane_of[i], ends.plane_of[i + 1]):
            recorded[j] += ends.weights[x, y, j] * now


@_compiled
def _lossless_column(problem, q, following, c, x, y, limit):  # type: ignore[no-untyped-def]
    columns, operator, _, fields = problem[:4]
    for s in range(columns.first[c], columns.first[c + 1]):
        begin, end = columns.spans[s, 0], min(columns.spans[s, 1], limit)
        if columns.spans[s, 2] == CORE:
            _lossless_core(operator, q, following, fields.change, x, y, begin, end)
        else:
            _lossless_cut(operator, q, following, fields.change, x, y, begin, end)


@_compiled
def _lossy_column(problem, q, following, integral, later, work, c, x, y, limit):  # type: ignore[no-untyped-def]
    columns, operator, lossy, fields = problem[:4]
    moved, middle = work[0], work[1]
    for s in range(columns.first[c], columns.first[c + 1]):
        begin, end, kind = columns.spans[s, 0], min(columns.spans[s, 1], limit), columns.spans[s, 2]
        if kind == CORE:
            _core_force(operator, q, moved, x, y, begin, end)
        else:
            _cut_force(operator, q, moved, x, y, begin, end)
            _subtract_drag(operator.weight, lossy.drag, integral, moved, x, y, begin, end)
            _wall_step(lossy, fields, moved, x, y, begin, end)
            _update_integral(integral, later, fields.increment, fields.relaxing, x, y, begin, end)
        _update_pressure(lossy, fields, following, moved, middle, x, y, begin, end)
        _update_air_memory(lossy, fields.relaxed, middle, following, x, y, begin, end)
        if kind == CUT:
            _update_wall_memory(lossy, fields.relaxed, fields.relaxing, middle, x, y, begin, end)


@_compiled
def _step(problem, thread, now, begin, end, sample, limit, work, recorded):  # type: ignore[no-untyped-def]
    """Advance a range of columns of cells by one step, in the layers up to `limit`.

    Without losses `work` is None, and the code for losses is not compiled.
    """
    columns, operator, _, fields, before, behind, ends = problem
    q, following = fields.ahead[now], fields.ahead[1 - now]
    integral, later = fields.integral[now], fields.integral[1 - now]
    last = np.uint64(fields.change.shape[2] - behind.cells.shape[1])
    layer = np.uint64(ends.layer) + _TWO
    for c in range(begin, end):
        x, y = columns.place[c, 0], columns.place[c, 1]
        if work is None:
            _lossless_column(problem, q, following, c, x, y, limit)
        else:
            _lossy_column(problem, q, following, integral, later, work[thread], c, x, y, limit)
        _pml_step(operator, before, q, following, fields.change, _NONE, x, y)
        if limit > last:
            _pml_step(operator, behind, q, following, fields.change, last, x, y)
        if work is None:
            following[x + _ONE, y + _ONE, layer] += _source_increment(ends, following, x, y, sample)
            _probe(ends, following, x, y, recorded)
        else:
            added = _source_increment(ends, fields.pressure, x, y, sample)
            fields.pressure[x + _ONE, y + _ONE, layer] += added
            following[x + _ONE, y + _ONE, layer] += added
            _probe(ends, fields.pressure, x, y, recorded)


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def advance(problem, thread, now, samples, limits, work, recorded, counter):  # type: ignore[no-untyped-def]
    """Advance a thread's columns by several steps, synchronised with the other threads.

    Parameters
    ----------
    problem : tuple
        `Columns`, `Stencil`, `LossCoefficients`, `Fields`, two `AbsorberColumns` and
        `SourceAndProbes`.
    thread : int
        Index of the thread.
    now : int
        Index of the present time in `Fields.ahead` and `Fields.integral`, 0 or 1.
    samples : ndarray
        Source signal, one sample per step, (n,).
    limits : ndarray
        Number of layers that each step advances, uint64, (n,).
    work : ndarray or None
        Work space with losses, (n_threads, 2, nz); None without losses.
    recorded : ndarray
        Receives the threads' contributions to the probes' pressures, (n_threads, n, n_probes);
        initially zero.
    counter : ndarray
        Number of arrivals at the barrier, int64, (1,), initially zero.
    """
    bounds = problem[0].bounds
    n_threads = bounds.size - 1
    for step in range(samples.size):
        begin, end = bounds[thread], bounds[thread + 1]
        sample, limit = samples[step], limits[step]
        part = recorded[thread, step]
        _step(problem, thread, now, begin, end, sample, limit, work, part)
        now = 1 - now
        if n_threads > 1:
            _barrier_wait(counter, n_threads * (step + 1))
