"""Outputs appear in one step, complete or not at all, and replace no files of others."""

import ast
import errno
import os
import re
import signal
import subprocess
import sys
import threading
from importlib import import_module
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from commands import run_here

import acoustube
from acoustube.base import cache, interrupts, remnants, writing
from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.files import partial_folder, publish
from acoustube.base.writing import DiskFullError, write, write_all
from acoustube.cli import cite, main, show
from acoustube.reports.export import vtu

resource = pytest.importorskip("resource")


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ACOUSTUBE_CACHE", str(tmp_path / "cache"))


def names(folder="."):
    return sorted(path.name for path in Path(folder).iterdir() if path.name != "cache")


@pytest.fixture
def small_disk():
    """Limit files to 3000 bytes, so that longer writes fail as on a full disk."""
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
    with pytest.raises(DiskFullError, match=r"^log.csv: .*; 0.02 MB are needed$"):
        writing.begin(Path("log.csv"), b"x" * 19_000)
    assert names() == []


@pytest.mark.parametrize(
    ("links", "step"),
    [(True, "os.fsync"), (True, "os.link"), (True, "os.path.lexists"), (False, "os.fsync"),
     (False, "pathlib.Path.replace"), (False, "os.path.lexists")],
)  # fmt: skip
def test_file_that_grows_is_never_without_its_head(links, step, monkeypatch):
    """An interrupt at any step leaves no file, or one with a head; an existing name is refused."""
    if not links:
        refused = Mock(side_effect=OSError(errno.EPERM, "no links here"))
        monkeypatch.setattr("os.link", refused)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(step, Mock(side_effect=KeyboardInterrupt))
        writing.begin(Path("log.csv"), b"head\n")
    writing.discard()
    assert {Path(name).read_bytes() for name in names()} <= {b"head\n"}
    for name in names():
        Path(name).unlink()
    with writing.begin(Path("log.csv"), b"head\n") as file:
        file.write(b"row\n")
        assert file.tell() == len(b"head\nrow\n")
    with pytest.raises(FileExistsError):
        writing.begin(Path("log.csv"), b"other\n")
    assert Path("log.csv").read_bytes() == b"head\nrow\n"
    assert names() == ["log.csv"]


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
    """VTK would end the process with ``free(): invalid pointer`` if it wrote the file itself."""
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
    with partial_folder("other"):  # in the making
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
    """In the hook that raises the first one again Python would print and ignore it."""
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
    """The command would end before the interrupt is raised; it ends as interrupted all the same."""
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
            "COLUMNS=1 {} cache size", "LC_ALL=POSIX PYTHONCOERCECLOCALE=0 {} --help",
            "LC_ALL=C PYTHONCOERCECLOCALE=0 PYTHONUTF8=0 {} cite nö.npz",
            "PYTHONIOENCODING=ascii {} cite nö.npz"],
)  # fmt: skip
def test_closed_streams_odd_locales_and_narrow_terminals_are_ordinary(how):
    """Where the terminal lacks a letter, its code is printed."""
    command = how.format(f"{sys.executable} -m acoustube")
    result = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert not re.search("Traceback|Error|Exception", result.stderr)
    assert result.returncode == (2 if "live" in how or "cite" in how else 0)
    assert "cite" not in how or re.search(r"n\\\S+\.npz does not exist", result.stderr)


def test_full_standard_output_is_named():
    """The message names it, rather than "[Errno 28]" without a file."""
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
    """One trial of ``python -m tests.fuzz.kills``, another one in each run."""
    monkeypatch.syspath_prepend(Path(__file__).parents[1])
    from tests.fuzz import kills
    from tests.fuzz.corpus import recording

    np.savez("good.npz", **recording())
    (tmp_path / "bench").mkdir()
    monkeypatch.setattr(kills, "_make", lambda _: None)  # files of other commands
    bench = kills.Bench(tmp_path / "bench", tmp_path)
    random = np.random.default_rng()
    how, delay = random.choice(["KILL", "TERM"]), random.random() * bench.expected("process")[0]
    wrong = bench.trial("process", how, delay, again=how == "KILL")
    assert wrong == [], f"{how} after {delay} s"


MAY_WRITE = {
    "base/console.py", "base/remnants.py", "base/writing.py", "reports/scenes/offscreen.py",
    "reports/scenes/sleeve.py",
}  # fmt: skip
"""Modules that write files that no user sees, or files of a temporary folder."""
MAY_REPLACE = {
    "cli/reproduce.py", "recordings/reading.py", "reports/studies/report.py",
    "runs/libraries/files.py", "runs/sweep/dataset.py", "runs/sweep/run.py", "runs/sweep/store.py",
}  # fmt: skip
"""Modules that replace files in resumed folders; and `recordings.write`, as documented."""


def writers(tree):
    """Yield the names of calls that write to a file of a given name."""
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        name = getattr(call.func, "attr", getattr(call.func, "id", ""))
        modes = [a.value for a in call.args if isinstance(a, ast.Constant)]
        opens = any(re.fullmatch("[wax]b?", str(mode)) for mode in modes)
        if name in {"write_text", "write_bytes"} or (name == "open" and opens):
            yield "write"
        if any(
            k.arg == "overwrite" and getattr(k.value, "value", 0) is True for k in call.keywords
        ):
            yield "replace"


def test_every_output_is_written_in_one_place_and_replaces_nothing():
    root = Path(acoustube.__file__).parent
    found = {"write": set(), "replace": set()}
    for path in root.rglob("*.py"):
        for what in writers(ast.parse(path.read_text())):
            found[what].add(str(path.relative_to(root)))
    assert found["write"] == MAY_WRITE
    assert found["replace"] == MAY_REPLACE


def test_second_of_two_commands_with_one_output_keeps_the_first(monkeypatch):
    """Both began at the same time, and the other one ended first."""
    signal = np.random.default_rng(0).normal(size=(3, 4000))
    np.savez("a.npz", signal=signal, sampling_rate=200e3, temperature=20.0)
    put = writing._to_disk

    def late(path, content):
        put(path, content)
        Path("two.csv").write_text("of the other")

    monkeypatch.setattr(writing, "_to_disk", late)
    told = run_here("process", "a.npz", "--out", "two.csv")
    assert told.returncode == 1
    assert "nothing is overwritten; this result is in two-2.csv" in told.stderr.replace("\n", " ")
    assert Path("two.csv").read_text() == "of the other"
    assert len(Path("two-2.csv").read_text().splitlines()) == 4


def test_full_disk_leaves_no_empty_picture_that_blocks_the_repeated_command(monkeypatch):
    put = writing._to_disk
    drawn = b"\x89PNG" + bytes(1000), "8 cases"
    monkeypatch.setattr(show, "_sweep_figure", lambda *_given: drawn)

    def full(path, content):
        put(path, content[:10])
        path.unlink()
        raise OSError(errno.ENOSPC, "full")

    with monkeypatch.context() as patched:
        patched.setattr(writing, "_to_disk", full)
        refused = run_here("show", "study", "--out", "a.png")
    assert refused.returncode == 1
    assert refused.stderr.startswith("acoustube: a.png: no space left on the device; 0.01 MB are")
    assert names() == []
    assert run_here("show", "study", "--out", "a.png").returncode == 0


def test_full_disk_costs_neither_a_press_nor_the_repeated_command(monkeypatch):
    """The press is cached before anything is written, and no folder remains."""
    monkeypatch.syspath_prepend(Path(__file__).parents[1])
    from acoustube.indentation import restored
    from acoustube.runs import presses
    from tests.fuzz.costly import _press

    results = _press()[0].results

    def first_touch(tube, indenter, *, depth, progress, **given):  # noqa: ARG001
        mesh = restored(tube, indenter, results, **given).mesh
        displacement = np.zeros((2, *mesh.points.shape))
        found = results | {"depth": np.array(depth), "displacement": displacement}
        return restored(tube, indenter, found, **given)

    monkeypatch.setattr(presses, "indent", first_touch)
    put, words = writing._to_disk, ("indent", "--depth", "2", "--steps", "2", "--out", "run")

    def full(path, content):
        if path.suffix == ".vtu":
            raise OSError(errno.ENOSPC, "full")
        put(path, content)

    with monkeypatch.context() as patched:
        patched.setattr(writing, "_to_disk", full)
        refused = run_here(*words)
    assert refused.returncode == 1
    assert re.search(r"run/vtu/press-0001\.vtu: no space left on the device; ", refused.stderr)
    assert names() == []
    monkeypatch.setattr(presses, "indent", None)
    again = run_here(*words)
    assert again.returncode == 0, again.stderr
    assert names() == ["run"]


def test_full_disk_does_not_cost_a_scattering_matrix(monkeypatch):
    """The repeated command finds the matrix in the cache, as the error states."""
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
