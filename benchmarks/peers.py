"""How fast and how accurate are acoustube, j-Wave, k-Wave-python and Devito on one problem?

The problem, which all can solve: a plane packet of 42 kHz in a square duct of air, 32 x 32 x 512
cells, 20 per wavelength, absorbing at both ends, float32. It propagates both ways; a plane records
one half. Each row: cell updates per second, and the relative L2 error of the recording against
d'Alembert's solution. The duct has rigid walls in acoustube and Devito, and is periodic in the two
spectral codes, which for this packet is the same. Round bores, wall losses and modes are beyond
the others, and are not compared; spectral codes need fewer cells per wavelength for this error.

Each peer runs in its own environment, made beforehand:

    python -m venv ENV && ENV/bin/pip install jwave         (or k-wave-python, or devito)
    python benchmarks/peers.py jwave=ENV kwave=ENV devito=ENV

A peer's row is printed by this same file, run by its environment's interpreter. Devito needs a C
compiler; k-wave-python tries to download its C++ programs on import, which is prevented here: its
NumPy backend is meant.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np

ACROSS, ALONG, CELLS_PER_WAVELENGTH = 32, 512, 20
SPEED, DENSITY, FREQUENCY = 343.2, 1.204, 42e3
SPACING = SPEED / FREQUENCY / CELLS_PER_WAVELENGTH
STEP = 0.5 * SPACING / SPEED
N_STEPS, START, PROBE = 500, 200, 320

Heard = tuple[np.ndarray, float, int]
"""Pressure after each step, seconds, and cells of the grid that was marched."""


def packet(distance: np.ndarray) -> np.ndarray:
    """Return the packet of three wavelengths at distances from its middle in m."""
    width = SPEED / FREQUENCY
    return np.exp(-0.5 * (distance / width) ** 2) * np.cos(2 * np.pi * distance / width)


def start() -> np.ndarray:
    """Return the pressure at the start."""
    along = packet((np.arange(ALONG) - START) * SPACING)
    return np.broadcast_to(along, (ACROSS, ACROSS, ALONG)).astype(np.float32)


def acoustube() -> Heard:
    """March whole, full cells; the second of two runs is timed."""
    from acoustube.air import Air
    from acoustube.waves.grid.cells import CutCells
    from acoustube.waves.scheme.leapfrog import initial_state, march
    from acoustube.waves.scheme.problem import prepare

    shape = ACROSS, ACROSS, ALONG
    faces = [np.ones([n + (axis == k) for k, n in enumerate(shape)]) for axis in range(3)]
    cells = CutCells(
        spacing=(SPACING,) * 3, origin=(0.0, 0.0, 0.0), length=(ALONG - 1) * SPACING,
        volume_fraction=np.ones(shape), open_x=faces[0], open_y=faces[1], open_z=faces[2],
    )  # fmt: skip
    setup = prepare(
        cells, Air(sound_speed=SPEED, density=DENSITY), probes=(PROBE * SPACING,),
        source_end="absorbing", time_step=STEP,
    )  # fmt: skip
    field = np.zeros(setup.cells.shape)
    field[:, :, setup.source_layer : setup.source_layer + ALONG] = start()
    state = initial_state(setup, field)
    march(setup, state, np.zeros(N_STEPS))
    begin = perf_counter()
    _, pressure = march(setup, state, np.zeros(N_STEPS))
    return pressure[0], perf_counter() - begin, int(np.prod(setup.cells.shape))


def jwave() -> Heard:
    """March j-Wave's Fourier scheme, compiled; the second of two runs is timed."""
    import jax
    import jax.numpy as jnp
    from jaxdf import FourierSeries
    from jwave.acoustics import simulate_wave_propagation
    from jwave.acoustics.time_varying import TimeWavePropagationSettings
    from jwave.geometry import Domain, Medium, Sensors, TimeAxis

    shape = ACROSS, ACROSS, ALONG
    domain = Domain(shape, (SPACING,) * 3)
    # Its layer would absorb on all sides: none here; the run ends before sound wraps round.
    medium = Medium(domain=domain, sound_speed=SPEED, density=DENSITY, pml_size=0)
    middle = (np.array([ACROSS // 2]), np.array([ACROSS // 2]), np.array([PROBE]))
    axis = TimeAxis(dt=STEP, t_end=N_STEPS * STEP)
    sensors = Sensors(positions=middle)

    @jax.jit
    def run(pressure: jax.Array) -> jax.Array:
        field = FourierSeries(pressure[..., None], domain)
        settings = TimeWavePropagationSettings(smooth_initial=False)
        return simulate_wave_propagation(medium, axis, settings=settings, p0=field, sensors=sensors)

    pressure = jnp.asarray(start())
    jax.block_until_ready(run(pressure))
    begin = perf_counter()
    found = jax.block_until_ready(run(pressure))
    return np.asarray(found).ravel(), perf_counter() - begin, int(np.prod(shape))


def kwave() -> Heard:
    """March k-Wave's scheme in NumPy."""
    import urllib.request

    # It checks for the file that it would have downloaded: an empty one.
    urllib.request.urlretrieve = lambda _, path, *__: Path(path).touch()  # type: ignore[assignment]
    from kwave.kgrid import kWaveGrid
    from kwave.kmedium import kWaveMedium
    from kwave.ksensor import kSensor
    from kwave.ksource import kSource
    from kwave.kspaceFirstOrder import kspaceFirstOrder

    grid = kWaveGrid([ACROSS, ACROSS, ALONG], [SPACING] * 3)
    grid.setTime(N_STEPS, STEP)
    source = kSource()
    source.p0 = start()
    mask = np.zeros((ACROSS, ACROSS, ALONG), bool)
    mask[ACROSS // 2, ACROSS // 2, PROBE] = True
    begin = perf_counter()
    found = kspaceFirstOrder(
        grid, kWaveMedium(sound_speed=SPEED, density=DENSITY), source, kSensor(mask),
        pml_size=(0, 0, 20), smooth_p0=False, dtype="float32", quiet=True,
    )  # fmt: skip
    seconds = perf_counter() - begin
    return np.asarray(found["p"]).ravel(), seconds, ACROSS * ACROSS * (ALONG + 40)


def devito() -> Heard:
    """March a second-order stencil that Devito writes in C; the second of two runs is timed."""
    from devito import Eq, Grid, Operator, TimeFunction, configuration, solve

    configuration["log-level"] = "ERROR"
    configuration["language"] = "openmp"
    shape = ACROSS, ACROSS, ALONG
    grid = Grid(shape, extent=tuple((n - 1) * SPACING for n in shape), dtype=np.float32)
    u = TimeFunction(name="u", grid=grid, time_order=2, space_order=2, save=N_STEPS + 2)
    x, y, z = grid.dimensions
    stencil = Eq(u.forward, solve(u.dt2 - SPEED**2 * u.laplace, u.forward))
    t = grid.stepping_dim if u.save is None else u.time_dim
    walls = [
        Eq(u[t + 1, -1, y, z], u[t + 1, 0, y, z]),
        Eq(u[t + 1, ACROSS, y, z], u[t + 1, ACROSS - 1, y, z]),
        Eq(u[t + 1, x, -1, z], u[t + 1, x, 0, z]),
        Eq(u[t + 1, x, ACROSS, z], u[t + 1, x, ACROSS - 1, z]),
    ]
    operator = Operator([stencil, *walls])
    seconds = 0.0
    for _ in range(2):
        u.data_with_halo[:] = 0.0
        u.data[0] = u.data[1] = start()
        for wide in (u.data_with_halo[0], u.data_with_halo[1]):
            wide[:] = np.pad(start(), [(h[0], h[1]) for h in u.halo[1:]], mode="edge")
        begin = perf_counter()
        operator.apply(time_m=1, time_M=N_STEPS, dt=STEP)
        seconds = perf_counter() - begin
    return np.array(u.data[2:, ACROSS // 2, ACROSS // 2, PROBE]), seconds, int(np.prod(shape))


PEERS: dict[str, Callable[[], Heard]] = {
    "acoustube": acoustube, "jwave": jwave, "kwave": kwave, "devito": devito
}  # fmt: skip


def row(name: str) -> str:
    """Return one row of the table."""
    pressure, seconds, cells = PEERS[name]()
    time = STEP * (np.arange(len(pressure)) + 1)
    errors = []
    for late in (0.0, STEP, STEP / 2):  # codes differ in the instant of a recorded sample
        distance = (PROBE - START) * SPACING - SPEED * (time - late)
        exact = packet(distance) / 2
        errors.append(np.linalg.norm(pressure - exact) / np.linalg.norm(exact))
    rate = cells * len(pressure) / seconds / 1e9
    return f"| {name} | {rate:.3f} | {100 * min(errors):.2f} % |"


def main() -> None:
    """Print the table: acoustube, then the peers whose environments are given."""
    if sys.argv[1:2] == ["--row"]:
        print(row(sys.argv[2]))
        return
    environments = dict(word.split("=", 1) for word in sys.argv[1:])
    print("| code | Gcell/s | error |\n|---|---|---|")
    for name, folder in {"acoustube": sys.prefix, **environments}.items():
        python = str(Path(folder).absolute() / "bin" / "python")
        found = subprocess.run(
            [python, __file__, "--row", name], capture_output=True, text=True, check=False
        )
        last = (found.stdout.strip() or found.stderr.strip()).splitlines()[-1]
        print(last if found.returncode == 0 else f"| {name} | failed: {last} | |", flush=True)


if __name__ == "__main__":
    main()
