"""Outputs appear in one step, complete or not at all, and never over what others have written."""

import errno
import os
import re
import signal
import subprocess
import sys
import threading
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from commands import run_here

from acoustube.base import cache, interrupts, remnants, writing
from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.files import partial_folder, publish
from acoustube.base.writing import DiskFullError, write, write_all
from acoustube.cli import cite, main
from acoustube.reports.export import vtu

resource = pytest.importorskip("resource")


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ACOUSTUBE_CACHE", str(tmp_path / "cache"))


def names(folder="."):
    return sorted(path.name for path in Path(folder).iterdir() if path.name != "cache")


@pytest.fixture
def small_disk():
    """Let files of over 3000 bytes end half way, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


def test_file_is_written_and_nothing_else_is_left():
    write("a.txt", "±\udce9")
    assert Path("a.txt").read_text(encoding="utf-8") == "±\\udce9"
    assert names() == ["a.txt"]
    assert list((cache.folder() / remnants.BEGUN).iterdir()) == []


def test_file_that_was_there_is_replaced_only_on_request():
    write("a.txt", b"first")
    with pytest.raises(SimulationError, match=r"nothing is overwritten; .* in .*a-2.txt"):
        write("a.txt", b"second")
    assert Path("a.txt").read_bytes() == b"first"
    assert Path("a-2.txt").read_bytes() == b"second"
    write("a.txt", b"third", overwrite=True)
    assert Path("a.txt").read_bytes() == b"third"
    assert names() == ["a-2.txt", "a.txt"]


@pytest.mark.parametrize("links", [True, False], ids=["with links", "without links"])
def test_many_writers_of_one_name_overwrite_nothing(links, monkeypatch):
    if not links:

        def refuse(*_names):
            raise OSError(errno.EPERM, "no links here")

        monkeypatch.setattr(writing.os, "link", refuse)
    told = []

    def attempt(number):
        try:
            write("a.csv", f"{number}")
        except SimulationError as error:
            told.append(str(error))

    threads = [threading.Thread(target=attempt, args=[number]) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(told) == 7
    assert len(names()) == 8
    assert {Path(name).read_text() for name in names()} == {str(number) for number in range(8)}


@pytest.mark.usefixtures("small_disk")
def test_full_disk_names_the_file_and_the_space_and_leaves_nothing():
    with pytest.raises(DiskFullError, match=r"^b.csv: .*; 0.02 MB are needed$"):
        write_all({"a.csv": "small", "b.csv": b"x" * 19_000})
    assert names() == []
    told = pytest.raises(
        DiskFullError, match=r"^run/b.csv: .*; 0.03 MB are needed; the files after it need more$"
    )
    with told, partial_folder("run") as partial:
        write(partial / "a.csv", b"x" * 2_900)
        write(partial / "b.csv", b"x" * 20_000)
    assert names() == []


def test_folder_that_took_the_name_meanwhile_is_kept():
    for taken in ("folder", "file"):
        with partial_folder(taken) as partial:
            write(partial / "a", "mine")
            Path(taken).touch() if taken == "file" else Path(taken).mkdir()
            if taken == "folder":
                (Path(taken) / "theirs").touch()
            assert publish(partial, taken).name == f"{taken}-2"
    assert names() == ["file", "file-2", "folder", "folder-2"]


def test_file_that_cannot_be_written_for_another_reason_is_a_wrong_name():
    with pytest.raises(ConfigError, match=r"^missing/a.csv cannot be written \(No such file"):
        write("missing/a.csv", "x")


@pytest.mark.usefixtures("small_disk")
@pytest.mark.parametrize("kind", ["vtp", "vtu"])
def test_vtk_survives_a_full_disk(kind):
    """ROBUSTNESS 3: it wrote itself, and ended the process with ``free(): invalid pointer``."""
    import pyvista

    points = np.random.default_rng(0).random((500, 3))
    shape = pyvista.PolyData(points)
    with pytest.raises(DiskFullError):
        write(
            f"a.{kind}", vtu.in_xml(shape if kind == "vtp" else shape.cast_to_unstructured_grid())
        )
    assert names() == []


@pytest.mark.parametrize("kind", ["vtp", "vtu"])
def test_vtk_reads_what_was_written(kind):
    import pyvista

    points = np.random.default_rng(0).random((50, 3))
    shape = pyvista.PolyData(points)
    write(f"a.{kind}", vtu.in_xml(shape if kind == "vtp" else shape.cast_to_unstructured_grid()))
    assert np.array_equal(pyvista.read(f"a.{kind}").points, shape.points)


KILLED = """
import os, signal
from acoustube.base.files import partial_folder
with partial_folder("run") as partial:
    (partial / "run.nc").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_remnant_of_a_killed_run_is_told_and_cleared():
    subprocess.run([sys.executable, "-c", KILLED], check=False)
    (hidden,) = names()
    assert hidden.startswith(".acoustube-partial-")
    (found,) = remnants.remnants()
    assert (found.path.name, found.size) == (hidden, 4)
    with partial_folder("other"):  # which is being made
        assert [remnant.path.name for remnant in remnants.remnants()] == [hidden]
        cleared = run_here("cache", "clear")
    assert cleared.stdout.startswith("deleted 0 results and 1 incomplete output")
    assert names() == []
    assert remnants.remnants() == []


def test_register_that_was_tampered_with_deletes_nothing_else():
    Path("precious").mkdir()
    begun = cache.folder() / remnants.BEGUN
    begun.mkdir(parents=True)
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    for name in ("precious", "acoustube-partial-1", "damaged"):
        words = "?" if name == "damaged" else f"{gone.pid} {remnants.platform.node()}"
        (begun / name).write_text(f"{words}\n{Path('precious').absolute()}")
    assert remnants.clear() == []
    assert names() == ["precious"]


def test_interrupt_in_a_destructor_is_not_lost():
    """Python prints and ignores an exception there."""

    class Slow:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)
            threading.Event().wait(0.2)

    with pytest.raises(KeyboardInterrupt), interrupts.watched_interrupts():
        Slow()
        threading.Event().wait(5)


def test_second_interrupt_while_a_lost_one_is_raised_again_is_not_lost(monkeypatch, capfd):
    """In the hook that raises it again Python would print and ignore it."""
    again, sent = interrupts._Interrupt.again, []

    def interrupted(handler):
        if not sent:
            sent.append(True)
            os.kill(os.getpid(), signal.SIGINT)
        again(handler)

    class Slow:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)
            threading.Event().wait(0.2)

    monkeypatch.setattr(interrupts._Interrupt, "again", interrupted)
    with pytest.raises(KeyboardInterrupt), interrupts.watched_interrupts():
        Slow()
        threading.Event().wait(5)
    assert sent
    assert "ignored" not in capfd.readouterr().err


def test_interrupt_that_a_library_takes_for_an_error_is_one(monkeypatch, capsys):
    def damaged(_):
        try:
            os.kill(os.getpid(), signal.SIGINT)
            threading.Event().wait(5)
        except KeyboardInterrupt as error:
            raise ConfigError("a.nc is damaged") from error

    monkeypatch.setattr(cite, "references", damaged)
    assert main(["cite"]) == 130
    assert capsys.readouterr().err.startswith("acoustube: interrupted")


def test_interrupt_during_the_last_import_is_not_too_late(monkeypatch, capsys, tmp_path):
    """The command ends before it would be raised; it ends as interrupted all the same."""
    (tmp_path / "importing.py").write_text(
        "import os\nos.kill(os.getpid(), 2)\nx = sum(range(9))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)

    def cited(_):
        import_module("importing")
        return []

    monkeypatch.setattr(cite, "references", cited)
    assert main(["cite"]) == 130
    assert capsys.readouterr().err.startswith("acoustube: interrupted")


def test_nothing_is_written_after_an_interrupt_that_was_lost():
    with pytest.raises(KeyboardInterrupt), interrupts.watched_interrupts():
        try:
            os.kill(os.getpid(), signal.SIGINT)
            threading.Event().wait(1)
        except BaseException:
            pass
        write("a.txt", "late")
    assert names() == []


STUCK = """
import os, signal, sys, threading
sys.argv = ["acoustube", "check"]
from acoustube import __main__
from acoustube.base.files import partial_folder

def stuck():
    with partial_folder("run"):
        for number in [signal.{signal}] * {times} + [0] * 9:
            try:  # as a library that takes every exception for its own
                os.kill(os.getpid(), number)
                threading.Event().wait(60)
            except BaseException:
                pass

__main__._run = stuck
__main__.entry()
"""


@pytest.mark.parametrize(("name", "times"), [("SIGTERM", 1), ("SIGINT", 2)])
def test_command_that_is_stuck_ends_in_time_after_an_interrupt(name, times):
    code = STUCK.format(signal=name, times=times)
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert result.returncode == 128 + getattr(signal, name)
    assert result.stderr == "acoustube: interrupted; no incomplete run is left\n"
    assert names() == []


@pytest.mark.parametrize(
    "how", ["{} cache size >&-", "{} cache size >&- 2>&-", "{} cache size | true", "{} live 2>&-",
            "COLUMNS=1 {} cache size", "LC_ALL=POSIX PYTHONCOERCECLOCALE=0 {} --help"],
)  # fmt: skip
def test_closed_streams_odd_locales_and_narrow_terminals_are_ordinary(how):
    """ROBUSTNESS 19: of a closed stream there was a traceback."""
    command = how.format(f"{sys.executable} -m acoustube")
    result = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert not re.search("Traceback|Error|Exception", result.stderr)
    assert result.returncode == (2 if "live" in how else 0)


def test_full_standard_output_is_named():
    """ROBUSTNESS 21: it was "[Errno 28]" without a file."""
    if not Path("/dev/full").exists():
        pytest.skip("needs /dev/full")
    with Path("/dev/full").open("w") as full:
        result = subprocess.run(
            [sys.executable, "-m", "acoustube", "cache", "size"], check=False, text=True,
            stdout=full, stderr=subprocess.PIPE,
        )  # fmt: skip
    assert result.returncode == 1
    assert result.stderr == "acoustube: standard output: no space left on the device; make room\n"


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="needs POSIX signals")
def test_commands_that_are_ended_at_random_moments_leave_whole_outputs_or_none(
    tmp_path, monkeypatch
):
    """A few of what ``python -m tests.fuzz.kills`` does by the hundred."""
    monkeypatch.syspath_prepend(Path(__file__).parents[1])
    from tests.fuzz.corpus import recording
    from tests.fuzz.kills import Bench

    np.savez("good.npz", **recording())
    (tmp_path / "bench").mkdir()
    bench = Bench(tmp_path / "bench", tmp_path)
    for how, share in zip(("KILL", "TERM"), np.random.default_rng().random(2), strict=True):
        delay = share * bench.expected("process")[0]
        wrong = bench.trial("process", how, delay, again=how == "KILL")
        assert wrong == [], f"{how} after {delay} s"


def test_full_disk_does_not_cost_a_scattering_matrix(monkeypatch):
    """The repeated command finds it in the cache, and says so before."""
    import trimesh

    from acoustube.ranging import blockage
    from acoustube.waves import scattering

    found = blockage(np.array([10e3, 15e3]), 0.0).scattering
    monkeypatch.setattr(scattering, "scatter", lambda *_given, **_settings: found)
    lumen = trimesh.creation.cylinder(radius=4, height=16, sections=8)
    lumen.export("lumen.stl")
    words = ("scatter", "lumen.stl", "--resolution", "8", "--band", "10", "15", "--step", "5")

    def full(*_arguments):
        raise OSError(errno.ENOSPC, "full")

    with monkeypatch.context() as patched:
        patched.setattr(writing, "_to_disk", full)
        refused = run_here(*words, "--out", "s.nc")
    assert refused.returncode == 1
    assert re.fullmatch(
        r"acoustube: s.nc: no space left on the device; 0.0\d MB are needed; make room and repeat "
        r"the command; its presses and scattering matrices are in the cache\n",
        refused.stderr,
    )
    monkeypatch.setattr(scattering, "scatter", None)
    assert run_here(*words, "--out", "s.nc").returncode == 0
    assert names() == ["lumen.stl", "s.nc"]
