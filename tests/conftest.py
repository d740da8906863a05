"""Settings for all tests."""

import gc
import os
from pathlib import Path

import pytest

from acoustube.base import cache
from acoustube.base.compilation import compile_quickly

# Read by jax when it is first imported: an accidental broadcast between ranks fails instead of
# passing with the wrong shape. Set here and not through jax.config, so that tests which need no jax
# do not import it.
os.environ.setdefault("JAX_NUMPY_RANK_PROMOTION", "raise")
os.environ.setdefault("MPLBACKEND", "agg")
os.environ.setdefault("PYVISTA_OFF_SCREEN", "true")
# The processes of pytest-xdist share the cores. Threads of theirs, which poll for work, would take
# three quarters of them from each other where the matrices are small.
if "PYTEST_XDIST_WORKER" in os.environ:
    for name in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
        os.environ.setdefault(f"{name}_NUM_THREADS", "1")
# Presses, scattering and compiled code of the tests, apart from the user's, kept from run to run
# and shared by all processes: the name of an entry holds the hash of the code that computed it. A
# test that must compute sets a folder of its own. Removed by pytest --cache-clear.
os.environ["ACOUSTUBE_CACHE"] = str(Path(__file__).parents[1] / ".pytest_cache/d/acoustube")
cache.keep_compiled_code()
compile_quickly()  # as the command line does
# What JAX has traced, and the modules of all tests, are a million objects or more, which stay. At
# the usual thresholds the collector walks through them so often that it takes 8 % of the time.
gc.set_threshold(100_000, 20, 50)


def pytest_report_header():
    """Report which acoustube is tested: the checkout or an installed wheel."""
    import acoustube

    return f"acoustube {acoustube.__version__} of {Path(acoustube.__file__).parent}"


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish():
    """Collect garbage once, and leave nothing to the five rounds with which pytest ends."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Run the tests of a file on one worker: they share fixtures, presses and what JAX traces."""
    for item in items:
        if not item.get_closest_marker("xdist_group"):
            item.add_marker(pytest.mark.xdist_group(item.path.stem))


@pytest.fixture(autouse=True)
def _in_empty_folder(tmp_path, monkeypatch):
    """Run each test in a folder of its own, so that nothing is written to the checkout."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(autouse=True)
def _as_a_new_process(monkeypatch):
    """Forget which results are in the cache: the advice on a full disk lists them."""
    monkeypatch.setattr(cache, "_KEPT", set())


@pytest.fixture
def double_precision():
    """Compute as presses are computed: in float64, and with sums in a fixed order."""
    import jax
    from threadpoolctl import threadpool_limits

    with jax.enable_x64(True), threadpool_limits(1, user_api="blas"):
        yield


@pytest.fixture
def compilations():
    """Return a list that grows by an entry whenever JAX compiles a function, or loads one."""
    from jax import monitoring

    found = []

    def note(event, _duration, **_details):
        if event == "/jax/core/compile/backend_compile_duration":
            found.append(event)

    monitoring.register_event_duration_secs_listener(note)
    yield found
    monitoring.unregister_event_duration_listener(note)
