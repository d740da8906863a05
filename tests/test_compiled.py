"""The compiled columns against the JAX form of the same finite-difference scheme."""

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from wave_lumens import BORE, pinched_tube

from acoustube.air import air_at
from acoustube.base.errors import SimulationError
from acoustube.waves import cut_cells
from acoustube.waves.grid.small_cells import share_small_volumes
from acoustube.waves.grid.straight_part import straight_ends_cut
from acoustube.waves.port_waves import PortProblem
from acoustube.waves.propagation import audible_layers
from acoustube.waves.scheme import cpu_layout
from acoustube.waves.scheme.cpu_leapfrog import CompiledMarcher
from acoustube.waves.scheme.leapfrog import initial_state, march
from acoustube.waves.scheme.losses import Losses, RelaxationState
from acoustube.waves.scheme.operator import Operator
from acoustube.waves.scheme.pml import Absorber
from acoustube.waves.scheme.problem import prepare

AIR = air_at(20.0)
ROUNDING = {jnp.float64: 1e-12, jnp.float32: 2e-4}
"""Largest allowed difference, relative to the peak, after some hundred steps.

Each step rounds a few times. Errors of the pressure change accumulate in the pressure, so that n
steps give up to n^1.5 rounding errors: 300^1.5 times 6e-8 is 3e-4, and times 1.1e-16 it is 6e-13.
"""


@pytest.fixture(scope="module")
def pinched():
    """A pinched half tube with cells small enough to share volume with their neighbours."""
    cells = cut_cells(pinched_tube(0.03, 0.8), 2 * BORE / 16, half=True)
    volume = cells.volume_fraction
    assert volume[(volume > 0)].min() < 0.1
    assert np.any(share_small_volumes(cells).volume_fraction != volume)
    return cells


def noisy(setup):
    """A start from noise in all open cells except those in or near the absorbers."""
    noise = np.random.default_rng(0).normal(size=setup.cells.shape)
    ahead = 0 if setup.state.before is None else setup.state.before.transverse.shape[2] + 3
    behind = 0 if setup.state.behind is None else setup.state.behind.transverse.shape[2] + 3
    noise[:, :, :ahead] = 0.0
    noise[:, :, noise.shape[2] - behind :] = 0.0
    return initial_state(setup, noise)


def difference(found, expected):
    """Largest difference relative to the peak."""
    found, expected = np.asarray(found, float), np.asarray(expected, float)
    assert found.shape == expected.shape
    return np.abs(found - expected).max() / np.abs(expected).max()


def assert_same(setup, state, source, tolerance):
    """March with both forms; compare recordings, and all fields that later steps use."""
    traced, heard = march(setup, state, source, compiled=False)
    found, heard_too = march(setup, state, source, compiled=True)
    assert np.abs(heard).max() > 0.0
    assert difference(heard_too, heard) < tolerance
    assert difference(found.pressure, traced.pressure) < tolerance
    assert difference(found.change, traced.change) < tolerance
    assert jax.tree.structure(found) == jax.tree.structure(traced)
    for name in ("before", "behind"):
        for part, wanted in zip(
            getattr(found, name) or (), getattr(traced, name) or (), strict=True
        ):
            if not isinstance(wanted, tuple):
                assert difference(part, wanted) < tolerance
    return found, traced


ENDS = ("release", "absorbing"), ("absorbing", "absorbing"), ("rigid", "rigid")
BAND = 5e3, 60e3
OFTEN = {(ENDS[1], None, jnp.float32), (ENDS[2], BAND, jnp.float32)}
"""Cases that are not marked long. A release end is marched both ways by
`test_a_march_goes_on_from_either_form`, in double precision by tests of energy."""


@pytest.mark.parametrize(
    ("ends", "lossy_band", "dtype"),
    [
        pytest.param(*case, marks=() if case in OFTEN else pytest.mark.long)
        for case in product(ENDS, (None, BAND), (jnp.float32, jnp.float64))
    ],
)
def test_columns_march_as_jax_does(pinched, ends, lossy_band, dtype):
    """From noise and with a source; several probes, two of them in one layer, in any order."""
    with jax.enable_x64(dtype == jnp.float64):
        setup = prepare(
            pinched, AIR, probes=(0.02, 0.005, 0.02), source_end=ends[0], far_end=ends[1],
            lossy_band=lossy_band, dtype=dtype,
        )  # fmt: skip
        source = np.sin(0.3 * np.arange(300))
        assert_same(setup, noisy(setup), source, ROUNDING[dtype])


@pytest.mark.parametrize(
    ("lossy_band", "dtype"),
    [
        (BAND, jnp.float32),
        pytest.param(BAND, jnp.float64, marks=pytest.mark.long),
        pytest.param(None, jnp.float64, marks=pytest.mark.long),
    ],
)
def test_a_march_goes_on_from_either_form(pinched, lossy_band, dtype):
    """Two halves of an odd number of steps, each in either form, equal one march."""
    with jax.enable_x64(dtype == jnp.float64):
        setup = prepare(pinched, AIR, probes=(0.01,), lossy_band=lossy_band, dtype=dtype)
        source = np.sin(0.3 * np.arange(202))
        whole, heard = march(setup, noisy(setup), source, compiled=False)
        for first in (True, False):
            middle, begun = march(setup, noisy(setup), source[:101], compiled=first)
            for second in (True, False):
                end, ended = march(setup, middle, source[101:], compiled=second)
                assert difference(np.concatenate([begun, ended], axis=-1), heard) < ROUNDING[dtype]
                assert difference(end.pressure, whole.pressure) < ROUNDING[dtype]
                assert difference(end.change, whole.change) < ROUNDING[dtype]


@pytest.mark.parametrize("lossy", [pytest.param(False, marks=pytest.mark.long), True])
def test_antisymmetric_halves_march_as_jax_does(lossy):
    """At x = 0 open faces border on zero pressure; the source has the mode's shape."""
    cells = straight_ends_cut(cut_cells(pinched_tube(0.02, 0.5, width=2e-3), 2 * BORE / 16))
    part = PortProblem(cells, AIR, np.array([42e3]), (8e3, 60e3), True, lossy, 0.005)
    modes, setup = part.modes, part.setup
    assert np.any(np.asarray(setup.scheme.operator.area_x[0]) > 0)
    weights = np.tile(modes.weights, (4, 1, 1)).transpose(1, 2, 0)
    layers = np.repeat(np.ravel(part.probes), len(modes.squares))
    scheme = setup.scheme._replace(
        source=jnp.asarray(modes.shapes[0], jnp.float32),
        probe_layers=jnp.asarray(layers, jnp.int32),
        probe_weights=jnp.asarray(weights, jnp.float32),
    )
    driven = replace(setup, scheme=scheme, source_layer=part.sources[0])
    source = np.sin(0.3 * np.arange(300))
    assert_same(driven, setup.state, source, ROUNDING[jnp.float32])


def test_march_ends_where_a_thread_cannot_be_started(pinched, monkeypatch):
    """The threads that have started end as well, and the state is unchanged."""
    setup = prepare(pinched, AIR, probes=(0.01,))
    alone, refused = (CompiledMarcher(setup, noisy(setup), n) for n in (1, 3))
    start, started = threading.Thread.start, []

    def start_two(thread):
        if len(started) == 2:
            raise RuntimeError("can't start new thread")
        started.append(thread)
        start(thread)

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", start_two)
        with pytest.raises(SimulationError):
            refused.advance(np.ones(4))
    for thread in started:
        thread.join(10)
        assert not thread.is_alive()
    heard = [marcher.advance(np.ones(4)) for marcher in (alone, refused)]
    assert difference(heard[1], heard[0]) < ROUNDING[jnp.float32]


@pytest.mark.parametrize("n_threads", [1, 2, 3, 5])
def test_threads_share_the_columns(pinched, n_threads):
    """Fields are those of one thread bit by bit; recordings are summed in another order."""
    setup = prepare(pinched, AIR, probes=(0.01,), lossy_band=(5e3, 60e3))
    source = np.sin(0.3 * np.arange(50))
    alone, shared = (CompiledMarcher(setup, noisy(setup), n) for n in (1, n_threads))
    assert difference(shared.advance(source), alone.advance(source)) < 1e-6
    assert np.array_equal(shared.state().pressure, alone.state().pressure)


@pytest.mark.parametrize("source_end", ["release", "absorbing"])
@pytest.mark.parametrize("lossy_band", [None, BAND])
def test_layers_that_cannot_reach_a_probe_are_left_out(source_end, lossy_band):
    """The recording of noise, which has no smooth front, equals that of a march of all layers."""
    long = cut_cells(pinched_tube(0.1, 0.8), 2 * BORE / 16, half=True)
    setup = prepare(long, AIR, probes=(0.01, 0.004), source_end=source_end, lossy_band=lossy_band)
    n_steps = int(2.2 * long.length / AIR.sound_speed / setup.time_step)
    source = np.random.default_rng(3).normal(size=n_steps)
    layers = audible_layers(setup, AIR, n_steps, n_steps + 1)
    assert layers.mean() < 0.75 * setup.cells.shape[2]
    assert layers.max() == setup.cells.shape[2]
    _, whole = march(setup, setup.state, source, compiled=True)
    _, heard = march(setup, setup.state, source, layers=layers, compiled=True)
    assert difference(heard, whole) < ROUNDING[jnp.float32]
    _, late = march(setup, setup.state, source, layers=layers - 40, compiled=True)
    assert difference(late, whole) > 1e-2  # sound is cut off


def test_marches_in_several_threads_at_once(pinched):
    """Concurrent marches, each with its own memory and threads, give the same recording."""
    setup = prepare(pinched, AIR, probes=(0.01,))
    source = np.sin(0.3 * np.arange(100))
    _, expected = march(setup, setup.state, source, compiled=True)
    with ThreadPoolExecutor(4) as pool:
        runs = [pool.submit(march, setup, setup.state, source, compiled=True) for _ in range(8)]
        for run in runs:
            assert np.array_equal(run.result()[1], expected)


def test_a_start_is_not_changed(pinched):
    setup = prepare(pinched, AIR, probes=(0.01,), lossy_band=(5e3, 60e3))
    before = [np.array(leaf) for leaf in jax.tree.leaves(setup.state)]
    march(setup, setup.state, np.ones(3), compiled=True)
    for leaf, was in zip(jax.tree.leaves(setup.state), before, strict=True):
        assert np.array_equal(leaf, was)


def test_threads_are_bounded_by_the_environment():
    """NUMBA_NUM_THREADS=1 limits a march to one thread, for use by many processes."""
    code = (
        "from acoustube.waves.scheme.cpu_leapfrog import default_threads; print(default_threads())"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"NUMBA_NUM_THREADS": "1"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert run.stdout.strip() == "1"


def test_numba_is_imported_by_a_march_only():
    code = "import sys, acoustube.waves, acoustube.waves.scattering; print('numba' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"


@pytest.mark.parametrize(
    ("scheme", "columns", "apart"),
    [
        # 1 / volume becomes the weight with the time step; response and rate are the scalars.
        (Operator, cpu_layout.Stencil, {"inverse_volume"}),
        (
            Losses, cpu_layout.LossCoefficients,
            {"response", "rate"},
        ),
        (RelaxationState, cpu_layout.Fields, set()),
        (Absorber, cpu_layout.AbsorberColumns, set()),
    ],
)  # fmt: skip
def test_both_schemes_have_the_same_coefficients_and_states(scheme, columns, apart):
    """A field added to one implementation alone fails here; `apart` lists those named otherwise."""
    assert set(scheme._fields) - set(columns._fields) == apart
