"""Output folders: refused when they exist, and complete or absent after writing."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from acoustube.base.errors import ConfigError
from acoustube.base.files import check_new_file, check_out, fresh_folder, partial_folder, publish


def test_new_nested_and_empty_folders_are_accepted_without_a_trace(tmp_path):
    (tmp_path / "empty").mkdir()
    for name in ("new", "a/b/c", "empty"):
        assert check_out(tmp_path / name) == tmp_path / name
    assert [path.name for path in tmp_path.iterdir()] == ["empty"]


def test_taken_names_are_refused(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.nc").write_text("kept")
    (tmp_path / "file").write_text("kept")
    for name, reason in (
        ("run", "is not empty"),
        ("file", "is a file"),
        ("file/run", "cannot be written"),
        (".", "is not empty"),
    ):
        with pytest.raises(ConfigError, match=reason):
            check_out(tmp_path / name)
    assert (tmp_path / "run" / "run.nc").read_text() == "kept"


def test_current_folder_is_refused_even_when_empty():
    with pytest.raises(ConfigError, match="name a new folder inside it"):
        check_out(".")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder that takes no files")
def test_folder_that_even_root_cannot_write_is_refused():
    with pytest.raises(ConfigError, match="cannot be written"):
        check_out("/proc/run")


@pytest.mark.parametrize("name", ["run", "a/run", "empty"])
def test_folder_appears_when_the_block_ends(tmp_path, name):
    (tmp_path / "empty").mkdir()
    final = tmp_path / name
    with partial_folder(final) as partial:
        (partial / "run.nc").write_text("data")
        assert not (final / "run.nc").exists()
        assert partial.parent == final.parent
        assert publish(partial, final) == final
    assert [path.name for path in final.iterdir()] == ["run.nc"]
    assert not partial.exists()


def test_folder_in_the_home_is_published_there(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    with partial_folder("~/run") as partial:
        assert publish(partial, "~/run") == tmp_path / "run"


def test_name_longer_than_a_file_can_have_is_refused(tmp_path):
    path = tmp_path / f"{300 * 'a'}.csv"
    with pytest.raises(ConfigError, match=r"table = .* is no name of a file"):
        check_new_file(path, "table")


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("name", ["run", "new/parents/run"])
def test_nothing_stays_when_the_block_is_left_by_an_exception(tmp_path, error, name):
    with pytest.raises(error), partial_folder(tmp_path / name) as partial:
        (partial / "run.nc").write_text("half")
        raise error
    assert list(tmp_path.iterdir()) == []


def test_run_that_came_first_is_not_overwritten_and_the_second_is_kept(tmp_path):
    final = tmp_path / "run"
    with partial_folder(final) as partial:
        (partial / "run.nc").write_text("second")
        final.mkdir()
        (final / "run.nc").write_text("first")
        assert publish(partial, final) == tmp_path / "run-2"
    assert (final / "run.nc").read_text() == "first"
    assert (tmp_path / "run-2" / "run.nc").read_text() == "second"
    assert len(list(tmp_path.iterdir())) == 2


def test_name_too_long_is_refused_without_a_trace(tmp_path):
    with pytest.raises(ConfigError, match=r"out = .* cannot be"):
        partial_folder(tmp_path / ("x" * 300)).__enter__()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="needs POSIX signals")
def test_interrupt_leaves_no_folder(tmp_path):
    code = (
        "import sys, time\n"
        "from acoustube.base.files import partial_folder\n"
        "with partial_folder('run') as partial:\n"
        "    (partial / 'run.nc').write_text('half')\n"
        "    print('writing', flush=True)\n"
        "    time.sleep(60)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # Tests that run in the background inherit that interrupts are ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as process:
        assert process.stdout.readline() == b"writing\n"
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
    assert list(tmp_path.iterdir()) == []


def test_fresh_folder_skips_what_is_there(tmp_path):
    (tmp_path / "simulate-1").mkdir()
    assert str(fresh_folder("simulate")) == "simulate-2"
