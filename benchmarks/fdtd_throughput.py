"""How many grid cells per second does the time-domain solver march, and how accurate is it?

First the error of a pulse after 30 cm of straight tube, against the exact delayed pulse. Then, for
a pinched tube with absorbers at both ends and two probes on three grids, without and with losses:
cells of the grid's box, and open cells, per second in the JAX form and in compiled columns on one
and two threads; the bytes that a step of the columns moves per cell of the box, counted from the
reads and writes of each kind of cell; and these bytes per second as a fraction of those of a triad
of the same footprint. The largest difference of the probe pressures of both forms is printed too.

Each rate is the median of five warm runs. Run on an otherwise idle machine, ``python
benchmarks/fdtd_throughput.py``. Where JAX computes on a GPU, a march runs the JAX form there, and
the same command prints its rates only, on one larger grid too: with the bytes of the arrays that a
step must read and write once, and their rate as a fraction of that of a scaled copy of 1 GiB.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from statistics import median
from time import perf_counter

import jax
import jax.numpy as jnp
import numpy as np
import trimesh

from acoustube.air import air_at
from acoustube.waves import CutCells, Pulse, cut_cells, grid_spacing, propagate
from acoustube.waves.scheme.leapfrog import CHUNK, Marcher, _TracedMarcher
from acoustube.waves.scheme.problem import Setup, prepare

RADIUS, PROBES = 3.95e-3, (0.01, 0.02)
AIR = air_at(20.0)
PULSE = Pulse(frequency=42e3)
BAND = (5e3, 60e3)
GRIDS = {"scattering": (32, True, 0.033), "fine": (32, False, 0.182), "long": (20, True, 0.355)}
"""Grids by name: cells per bore, whether half of the tube, and length in m."""
GPU_GRIDS = {"large": (64, False, 0.182)}
"""Grids that run on a GPU only."""
NUMBERS = {"core": 5, "cut": 14, "absorber": 24}
"""Numbers read and written per cell and step without losses; neighbours count once."""
PER_POLE, AT_WALL = 2, 19
"""Additional numbers with losses: per relaxation, and in cut cells."""
DENSE, DENSE_ABSORBER, DENSE_LOSSES = 8, 8, 9
"""The same for the JAX form, whose arrays cover the box: pressure and change, read and written, one
volume and three areas; four more fields in an absorber; with losses the half-integral, its
increment, three areas, compliance and implicit factor, and `PER_POLE`."""


def tube(length: float, press: float = 0.0) -> trimesh.Trimesh:
    """Return a tube whose height decreases by a share in the middle."""
    z = np.linspace(0.0, length, 400)
    profile = [[0, 0], *[[1.0, zi] for zi in z], [0, length]]
    mesh = trimesh.creation.revolve(profile, sections=256)
    vertices = mesh.vertices * [RADIUS, RADIUS, 1.0]
    share = press * np.exp(-(((vertices[:, 2] - length / 2) / 4e-3) ** 2))
    vertices[:, 1] -= share * (vertices[:, 1] + RADIUS)
    mesh.vertices = vertices
    return mesh


def far_probe_error(resolution: int) -> tuple[CutCells, float]:
    """Return the largest error of the pulse after 30 cm, relative to its peak."""
    cells = cut_cells(tube(0.40), grid_spacing(2 * RADIUS, resolution), half=True)
    recording = propagate(
        cells, AIR, PULSE, duration=0.30 / AIR.sound_speed + 1.2 * PULSE.duration,
        probes=(0.02, 0.30), source_end="absorbing",
    )  # fmt: skip
    late = recording.time - recording.probes[1] / AIR.sound_speed
    return cells, float(np.abs(recording.pressure[1] - PULSE(late)).max())


def seconds(run: Callable[[], object]) -> float:
    """Return the median time of five runs after a first one."""
    run()
    times = []
    for _ in range(5):
        start = perf_counter()
        run()
        times.append(perf_counter() - start)
    return median(times)


def rate(marcher: Marcher, n_cells: float, n_steps: int) -> float:
    """Return the cells marched per second."""
    return (
        n_cells * n_steps / seconds(lambda: (marcher.advance(source(n_steps)), marcher.is_finite()))
    )


def source(n_steps: int) -> np.ndarray:
    """Return a tone."""
    return np.sin(0.3 * np.arange(n_steps))


def triad(n_bytes: float, n_threads: int) -> float:
    """Return the bytes per second of a = b + s c over arrays of a given total size."""
    from numba import njit

    @njit(nogil=True, fastmath=True)
    def add(a: np.ndarray, b: np.ndarray, c: np.ndarray, n: int) -> None:
        for _ in range(n):
            for i in range(a.size):
                a[i] = b[i] + a.dtype.type(1.5) * c[i]

    size = int(n_bytes / 12 / n_threads)
    arrays = [[np.ones(size, np.float32) for _ in range(3)] for _ in range(n_threads)]
    n = max(1, int(1e9 / n_bytes))
    with ThreadPoolExecutor(n_threads) as pool:
        return (
            12
            * size
            * n_threads
            * n
            / seconds(lambda: list(pool.map(lambda three: add(*three, n), arrays)))
        )


def device_copy() -> float:
    """Return the bytes per second, read and written, of a scaled copy of 1 GiB."""
    array, n = jnp.linspace(0.0, 1.0, 2**28, dtype=jnp.float32), 20
    scaled = jax.jit(lambda a: jnp.float32(0.99) * a)

    def run() -> None:
        copy = array
        for _ in range(n):  # in a row, so that the start does not count
            copy = scaled(copy)
        copy.block_until_ready()

    return 8 * array.size * n / seconds(run)


def dense_traffic(setup: Setup) -> float:
    """Return the bytes that a step of the JAX form must read and write, each array once."""
    numbers = float(DENSE * np.prod(setup.cells.shape))
    for layer in (setup.state.before, setup.state.behind):
        numbers += DENSE_ABSORBER * layer.transverse.size if layer is not None else 0
    if setup.scheme.losses is not None:
        n_poles = len(setup.scheme.losses.decay)
        numbers += (DENSE_LOSSES + PER_POLE * n_poles) * setup.state.change.size
    return 4.0 * numbers


def traffic(setup: Setup) -> float:
    """Return the bytes that a step of the compiled columns moves."""
    from acoustube.waves.scheme.cpu_layout import CORE, CUT
    from acoustube.waves.scheme.cpu_leapfrog import ABSORBING, _kinds

    kinds = _kinds(setup, setup.state)
    core, cut, absorbing = (np.sum(kinds == kind) for kind in (CORE, CUT, ABSORBING))
    numbers = core * NUMBERS["core"] + cut * NUMBERS["cut"] + absorbing * NUMBERS["absorber"]
    if setup.scheme.losses is not None:
        n_poles, n_air = len(setup.scheme.losses.decay), len(AIR.relaxations)
        numbers += core * (2 + PER_POLE * n_air) + cut * (AT_WALL + PER_POLE * n_poles)
    return 4.0 * numbers


def report(setup: Setup, copied: float | None) -> None:
    """Print the rates of one problem; on a GPU with the bytes per second of a copy there."""
    from acoustube.waves.scheme.cpu_leapfrog import CompiledMarcher

    n_cells = float(np.prod(setup.cells.shape))
    filled = float(np.mean(setup.cells.volume_fraction > 0))
    n_steps = 60 if copied is None else CHUNK
    traced = rate(_TracedMarcher(setup, setup.state), n_cells, n_steps)
    line = f"    JAX: {traced / 1e9:.3f} Gcell/s, open {filled * traced / 1e9:.3f}"
    if copied is not None:
        moved = dense_traffic(setup)
        share = traced / n_cells * moved / copied
        line += f"; {moved / n_cells:.0f} bytes a cell, {100 * share:.0f} % of a copy's"
    print(line)
    for n_threads in (1, 2) if copied is None else ():
        moved = traffic(setup)
        columns = rate(CompiledMarcher(setup, setup.state, n_threads), n_cells, n_steps)
        share = columns / n_cells * moved / triad(moved, n_threads)
        print(
            f"    columns, {n_threads} threads: {columns / 1e9:.3f} Gcell/s, "
            f"open {filled * columns / 1e9:.3f}; {moved / n_cells:.0f} bytes a cell, "
            f"{100 * share:.0f} % of a triad's"
        )
    heard = [
        marcher.advance(source(500))
        for marcher in (_TracedMarcher(setup, setup.state), CompiledMarcher(setup, setup.state))
    ]
    print(
        f"    largest difference {np.abs(heard[0] - heard[1]).max() / np.abs(heard[0]).max():.1e}"
    )


if __name__ == "__main__":
    device = jax.devices()[0]
    print(f"{platform.processor()} x {os.cpu_count()}, jax {jax.__version__}, float32")
    copied = None
    if device.platform == "gpu":
        copied, GRIDS = device_copy(), GRIDS | GPU_GRIDS
        print(f"{device.device_kind}: a copy moves {copied / 1e9:.0f} GB/s")
    for resolution in (16, 32):
        cells, error = far_probe_error(resolution)
        print(f"{resolution} cells per bore, {cells.shape}: error {error:.2e}")
    for name, (resolution, half, length) in GRIDS.items():
        cells = cut_cells(tube(length, 0.6), 2 * RADIUS / resolution, half=half)
        for band in (None, BAND):
            setup = prepare(
                cells, AIR, probes=PROBES, source_end="absorbing", lossy_band=band
            )  # fmt: skip
            print(f"{name}, {setup.cells.shape}, {'lossy' if band else 'lossless'}")
            report(setup, copied)
