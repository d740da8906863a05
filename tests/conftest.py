"""Settings for all tests."""

import os
from pathlib import Path

import pytest

# Read by jax when it is first imported: an accidental broadcast between ranks fails instead of
# passing with the wrong shape. Set here and not through jax.config, so that tests which need no jax
# do not import it.
os.environ.setdefault("JAX_NUMPY_RANK_PROMOTION", "raise")
os.environ.setdefault("MPLBACKEND", "agg")
os.environ.setdefault("PYVISTA_OFF_SCREEN", "true")


def pytest_report_header():
    """Tell which acoustube is tested: the checkout or an installed wheel."""
    import acoustube

    return f"acoustube {acoustube.__version__} of {Path(acoustube.__file__).parent}"


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory):
    """Keep the user's remembered presses out of the tests, and theirs out of the cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ACOUSTUBE_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(autouse=True)
def _in_empty_folder(tmp_path, monkeypatch):
    """Run each test in a folder of its own, so that nothing is written to the checkout."""
    monkeypatch.chdir(tmp_path)
