"""Files of others that crash, stall or exceed a reader: one sentence, within seconds."""

import io
import json
import os
import re
import resource
import struct
import time
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest
import trimesh
import xarray as xr
from commands import run_here
from hypothesis import given, settings
from hypothesis import strategies as st

from acoustube import estimation, recordings, signals
from acoustube.base.console import ConsoleReporter, plain_console
from acoustube.base.errors import ConfigError
from acoustube.base.foreign import child, limits
from acoustube.base.foreign.documents import parsed, read_document
from acoustube.base.netcdf import MARK, Seal, seal_of, write_dataset
from acoustube.base.surfaces import load, read_lumen
from acoustube.recordings.markers import read_markers
from acoustube.runs.opening import ORDER, open_dataset
from acoustube.signals.calibration import Calibration, Estimate

DAMAGED = Path(__file__).parent / "data" / "damaged"


def read(path):
    return recordings.read(path, rate=200e3, temperature=20.0)


@pytest.mark.parametrize(
    ("name", "reader", "words"),
    [
        ("segfault.mat", read, "MAT (its reader crashed); it is cut short, damaged"),
        ("many_points.vtp", read_lumen, "a surface (its reader crashed); use STL, PLY, OBJ or VTP"),
    ],
)
def test_crash_of_a_library_is_a_sentence_and_the_next_file_is_read(name, reader, words, tmp_path):
    with pytest.raises(ConfigError) as caught:
        reader(DAMAGED / name)
    assert f"{name} cannot be read as {words}" in str(caught.value)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["signal"] = np.eye(3, 9)
    assert np.array_equal(read(tmp_path / "a.h5")["signal"], np.eye(3, 9))


@pytest.mark.slow
def test_reader_that_does_not_end_is_stopped():
    """It is limited by its processor time, so that good files are read on a busy machine too."""
    pytest.importorskip("ezc3d", reason="needs ezc3d (acoustube[c3d])")
    started = time.process_time() + sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
    with pytest.raises(ConfigError, match=r"markers \(it takes longer than any"):
        read_markers(DAMAGED / "cut_short.c3d")
    child._end()
    spent = time.process_time() + sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2]) - started
    assert spent < 8


@pytest.mark.parametrize("content", [b"", bytes(1000), b"hello", b"\x02\x50" + b"\xff" * 1000])
def test_markers_of_another_content_are_refused(tmp_path, content):
    pytest.importorskip("ezc3d", reason="needs ezc3d (acoustube[c3d])")
    (tmp_path / "a.c3d").write_bytes(content)
    with pytest.raises(ConfigError, match=r"a\.c3d cannot be read as markers .*: export it again"):
        read_markers(tmp_path / "a.c3d")


def test_dataset_that_claims_more_than_the_limit_is_not_read(tmp_path, monkeypatch):
    """It declares 600 MB, none of which are in the file."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("signal", (30_000, 20_000), "i1", chunks=(1000, 1000), fillvalue=3)
    monkeypatch.setitem(limits.SIZES, "recording", 1_000_000)
    with pytest.raises(ConfigError, match=r"declares 600 MB of arrays, over the limit of 1 MB"):
        read(tmp_path / "a.h5")


def test_what_is_no_file_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "q.csv")
    (tmp_path / "zero.npz").symlink_to("/dev/zero")
    for name, words in (("q.csv", "is a pipe, not a file"), ("zero.npz", "is a device, not a")):
        with pytest.raises(ConfigError, match=f"{name} {words}"):
            read(tmp_path / name)
    if Path("/proc/self/status").is_file():  # kmsg beside it would make the reader wait
        (tmp_path / "status.csv").symlink_to("/proc/self/status")
        with pytest.raises(ConfigError, match=r"status\.csv is of the operating system"):
            read(tmp_path / "status.csv")
    (tmp_path / "settings.toml").symlink_to("/dev/zero")
    with pytest.raises(ConfigError, match="is a device, not a file; name a file"):
        read_document(tmp_path / "settings.toml")
    os.mkfifo(tmp_path / "plan.toml")
    for words in (
        ("simulate", "--config", "/dev/zero"), ("sweep", "--plan", "plan.toml", "--dry-run"),
        ("process", "q.csv"), ("scatter", "q.csv", "--out", "s.nc"),
        ("sleeve", "q.csv", "--loops", "9"),
        ("live", "--port", "none", "--calibration", "plan.toml"),
    ):  # fmt: skip
        told = run_here(*words)
        assert told.returncode == 2
        assert re.search(r"is (a (device|pipe)\b.*, )?not a file", told.stderr), told.stderr


def sparse(path, size):
    with path.open("wb") as file:
        file.truncate(size)
    return path


@pytest.mark.parametrize(
    ("name", "kind"), [("a.csv", "table"), ("a.npy", "recording"), ("a.mat", "recording")]
)
def test_files_over_their_limit_are_refused_unread_and_the_limit_can_be_raised(
    name, kind, tmp_path, monkeypatch
):
    size = limits.SIZES[kind] + 1
    path = sparse(tmp_path / name, size)
    with pytest.raises(ConfigError, match=rf"{name} holds .* MB, over the limit.*--limits FACTOR"):
        read(path)
    monkeypatch.setenv(limits.VARIABLE, "1.5")
    assert limits.check_file(path, kind) == size
    monkeypatch.setenv(limits.VARIABLE, "many")
    with pytest.raises(ConfigError, match="ACOUSTUBE_LIMITS = many is not a number over 0"):
        read(path)


def archive(path, members, compression=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return path


def header(shape, dtype="<i2"):
    head = io.BytesIO()
    words = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(head, words)
    return head.getvalue()


def changed(path, offset, content):
    """Change some bytes in the central directory's only entry."""
    found = bytearray(path.read_bytes())
    start = found.rindex(b"PK\x01\x02") + offset
    found[start : start + len(content)] = content
    path.write_bytes(found)
    return path


def test_archives_that_claim_what_they_do_not_hold_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "a.npz"
    eight_gb = archive(path, {"signal.npy": header((1_000_000, 4000)) + bytes(100)})
    with pytest.raises(
        ConfigError, match=r"signal declares 8000000000 bytes but only 228 are stored"
    ):
        read(eight_gb)
    monkeypatch.setitem(limits.SIZES, "recording", 10_000_000)
    zeros = archive(path, {"signal.npy": header((5000, 4000)) + bytes(40_000_000)})
    assert zeros.stat().st_size < 100_000
    with pytest.raises(ConfigError, match=r"a\.npz unpacks to 40 MB, over the limit of 10 MB"):
        read(zeros)
    # Its directory claims less than it holds.
    with pytest.raises(ConfigError, match=r"a\.npz cannot be read as NPZ"):
        read(changed(zeros, 24, struct.pack("<I", 1000)))


@pytest.mark.parametrize(
    ("offset", "content", "words"),
    [(8, b"\x01", "encrypted"), (10, b"\x63", "compression"), (10, b"\x0c", "")],
)
def test_encrypted_or_oddly_compressed_members_are_refused(tmp_path, offset, content, words):
    path = archive(tmp_path / "a.npz", {"signal.npy": header((3, 4)) + bytes(24)})
    with pytest.raises(ConfigError, match=rf"a\.npz cannot be read as NPZ .*{words}"):
        read(changed(path, offset, content))


@pytest.mark.parametrize(
    ("header_of", "change", "words"),
    [
        (header((3, 4)), (8, b"\x01"), "encrypted"),
        (header((3, 4)), (10, b"\x63"), "compression"),
        (
            header((1_000_000, 4000)),
            (0, b"P"),
            "header declares 8000000000 bytes but only 152 are stored",
        ),
        (header((), "<f8"), (0, b"P"), "its header holds no settings"),
    ],
)
def test_archives_that_are_no_models_are_refused(tmp_path, header_of, change, words):
    path = archive(tmp_path / "a.model", {"header.npy": header_of + bytes(24)})
    with pytest.raises(ConfigError, match=rf"a\.model is not a model .*{words}.*; acoustube train"):
        estimation.load(changed(path, *change))


def test_many_members_and_long_names_are_refused(tmp_path):
    whole = header((3, 4)) + bytes(range(24))
    path = archive(tmp_path / "a.npz", {"signal.npy": whole, f"{'x' * 60_000}.npy": whole})
    with pytest.raises(ConfigError, match=r"holds a name of 60000 characters, x{20}\.\.\., over"):
        read(path)
    many = {f"{i}.npy": b"" for i in range(limits.ENTRIES + 1)}
    with pytest.raises(ConfigError, match="has 10001 members, over the limit of 10000"):
        read(archive(tmp_path / "b.npz", many))


def test_rows_that_no_table_has_are_refused(tmp_path):
    (tmp_path / "a.csv").write_text(",".join(["1"] * 1_000_000))
    with pytest.raises(ConfigError, match="has 1000000 columns, over the limit of 50000"):
        read(tmp_path / "a.csv")


@pytest.mark.parametrize("bracket", ["a = [", "a = {b = ", "a.", "[a."])
def test_deeply_nested_settings_are_refused(tmp_path, bracket):
    (tmp_path / "a.toml").write_text(bracket * 20_000)
    with pytest.raises(ConfigError, match=r"a\.toml (is nested|is not valid TOML|cannot be read)"):
        read_document(tmp_path / "a.toml")
    (tmp_path / "b.toml").write_text("a = " + 101 * "[" + 101 * "]")
    with pytest.raises(ConfigError, match="nested over 100 levels, the limit"):
        read_document(tmp_path / "b.toml")


def test_deeply_nested_json_and_numbers_of_400_digits_are_refused():
    for text, words in (
        ("[" * 20_000, "attribute cannot be read .it is nested too deeply"),
        ("[" * 110 + "]" * 110, "nested over 100 levels"),
        (json.dumps({"a": 10**400}), "a is an integer of more than 64 bits"),
        (json.dumps({"a" * 300: 1}), "holds a name of 300 characters"),
        ('{"a": ' + "9" * 5000 + "}", "cannot be read .Exceeds the limit"),
    ):
        with pytest.raises(ConfigError, match=words):
            parsed(text, "attribute")


def test_limits_are_raised_by_an_option_for_one_command(tmp_path, monkeypatch):
    monkeypatch.setitem(limits.SIZES, "recording", 1000)
    np.savez(tmp_path / "a.npz", signal=np.random.default_rng(0).normal(size=(3, 4000)))
    words = ("process", tmp_path / "a.npz", "--rate", 2e5, "--temperature", 20)
    refused = run_here(*words)
    assert "over the limit of 0.001 MB for a recording; give --limits FACTOR" in refused.stderr
    assert refused.returncode == 2
    assert run_here(*words, "--limits", 200).returncode == 0
    assert run_here(*words).returncode == 2
    assert "limits = 0 is out of range" in run_here(*words, "--limits", 0).stderr


MARKUP = "a[/ [red]b[/red] :smile: \x1b[31m\udc80"
SHOWN = "a[/ [red]b[/red] :smile: \\x1b[31m\\udc80"


def test_what_a_user_supplies_is_no_markup_in_the_terminal(capsys):
    """Brackets, emoji codes, control characters and invalid UTF-8 are printed literally."""
    report = ConsoleReporter(plain_console())
    report.title(MARKUP)
    report.line(MARKUP)
    report.note(MARKUP)
    report.rows([(MARKUP, "1")])
    report.failure(MARKUP)
    terminal = plain_console()
    terminal._force_terminal = True
    with ConsoleReporter(terminal).progress() as show:
        show(MARKUP, 0.5)
    told = capsys.readouterr()
    assert told.out.count(SHOWN) == 4
    assert told.err.count(SHOWN) == 1
    assert "\x1b[31m" not in told.out + told.err


def test_written_path_is_told_as_it_is(monkeypatch):
    monkeypatch.setattr("acoustube.reports.scenes.sleeve.draw", lambda *_: True)
    told = run_here("sleeve", "--forearm", 25, 17, 26, "--loops", 9, "--out", "[red]a[/b")
    assert told.returncode == 0
    assert "Written to " in told.stdout
    assert "/[red]a[/b in " in told.stdout.replace("\n", "")


def test_values_of_100_kb_are_shortened():
    told = run_here("simulate", "--depth", "9x" * 50_000)
    assert told.returncode == 2
    assert "characters)" in told.stderr
    assert len(told.stderr) < 1500
    told = run_here("cite", "x " * 50_000, "--limits", "2")
    assert len(told.stderr) < 700


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('channel = "left"', "channel = 'left' is not a number; use a whole number from 0 to 0"),
        ("channel = [1]", "channel = [1] is not a number"),
        ("channel = 1e300", "channel = 1e+300, but the file has one channel"),
        ("channel = 7", "channel = 7, but the file has one channel; leave it out"),
        ("sampling_rate_hz = [[1], [2, 3]]", "sampling rate is not a number; give one"),
        ("[sampling_rate_hz]\na = 1", "is not a number"),
        (f"sampling_rate_hz = {10**400}", "sampling_rate_hz is an integer of more than 64 bits"),
        (f"temperature_c = [{10**400}]", "temperature_c is an integer of more than 64 bits"),
        ("[labels]\nsignal = [1, 2, 3]", "state signal, which is not a label; rename it"),
        ("[labels]\ntime = [1, 2, 3]", "state time, which is not a label; rename it"),
        ("[labels.a]\nb = 1", "a is neither numbers nor words"),
        ("labels = {press = [{x = 1}, 2, 3]}", "press"),
    ],
)
def test_nonsense_in_a_sidecar_is_a_sentence(tmp_path, text, words):
    np.savez(tmp_path / "a.npz", signal=np.eye(3, 4), fs=2e5, temperature=20.0)
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        recordings.read(tmp_path / "a.npz")
    assert words in str(caught.value)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 20_000, "a.json cannot be read (it is nested too deeply); correct it"),
        ('{"channel": 1' + "0" * 400 + "}", "channel is an integer of more than 64 bits"),
        ('{"sampling_rate_hz": [[1], [2, 3]]}', "sampling rate is not a number; give one"),
    ],
)
def test_nonsense_in_a_sidecar_in_json_is_a_sentence(tmp_path, text, words):
    np.savez(tmp_path / "a.npz", signal=np.eye(3, 4), fs=2e5, temperature=20.0)
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(ConfigError) as caught:
        recordings.read(tmp_path / "a.npz")
    assert words in str(caught.value)


CALIBRATION = Calibration(
    processing=signals.Processing(gain=signals.TimeGain(-0.2, 1.0, 1.0, 0.3)), sampling_rate=2e5,
    **dict.fromkeys(("c1", "c2", "c3", "c4", "slope", "intercept"), Estimate(1.0, 0.1)),
    **dict.fromkeys(("amplitude_rmse", "distance_rmse", "false_alarms"), 0.0),
    **dict.fromkeys(("true_distance", "estimated_distance", "amplitude"), np.ones(3)),
)  # fmt: skip


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("template_cycles", "1e308"), ("offset_cutoff", "1e-320"), ("farthest", "1e300"),
        ("pulse_cycles", "1e300"), ("nearest", "-1e300"), ("frequency", "1e-9"),
        ("frequency", "1e-320"),
        ("cutoff", "inf"), ("gain", "[1, 2]"), ("gain", '"steep"'), ("send_shift", "nan"),
        ("prominence", "[]"), ("sampling_rate", "nan"), ("sampling_rate", "1e-320"),
        ("c1", "1.0"), ("true_distance", '["far"]'), ("frequency", "1" * 500),
    ],
)  # fmt: skip
def test_absurd_numbers_in_a_calibration_are_a_sentence(tmp_path, name, value):
    """Refused when read, or when applied, if they need more than a cycle holds."""
    signals.save(CALIBRATION, tmp_path / "c.toml")
    text = (tmp_path / "c.toml").read_text()
    (tmp_path / "c.toml").write_text(re.sub(rf"(?m)^{name} = .*", f"{name} = {value}", text))
    signal = np.random.default_rng(0).normal(size=(3, 4000))
    np.savez(tmp_path / "a.npz", signal=signal, fs=2e5, temperature=20.0)
    told = run_here("process", tmp_path / "a.npz", "--calibration", tmp_path / "c.toml")
    assert told.returncode == 2
    assert "Traceback" not in told.stderr
    assert "c.toml" in told.stderr or "a.npz" in told.stderr
    assert "; " in told.stderr


def result(path):
    """A dataset of cycles, as `acoustube dataset` writes it."""
    cycles = np.random.default_rng(0).integers(0, 4096, (5, 400))
    labels = {"press": list("abcde"), "temperature": np.full(5, 20.0)}
    data = xr.Dataset({"signal": (("cycle", "time"), cycles)}, attrs={"sampling_rate": 2e5})
    write_dataset(data.assign({n: ("cycle", v) for n, v in labels.items()}), path)
    return path


@given(share=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
@settings(max_examples=30, deadline=None)
def test_one_changed_bit_of_a_result_is_found_before_hdf5_opens_it(tmp_path_factory, share, bit):
    path = result(tmp_path_factory.mktemp("a") / "cycles-1.nc")
    content = bytearray(path.read_bytes())
    # Except in the mark at the end, without which a file counts as one of an earlier version.
    content[int(share * (len(content) - len(MARK) - 32))] ^= 1 << bit
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"cycles-1\.nc is damaged: its checksum is wrong"):
        open_dataset(path)


def test_results_of_earlier_versions_open_and_damaged_ones_are_refused(tmp_path):
    path = result(tmp_path / "cycles-1.nc")
    assert seal_of(path) is Seal.INTACT
    old = path.read_bytes()[: -len(MARK) - 32]
    path.write_bytes(old)
    assert seal_of(path) is Seal.NONE
    assert open_dataset(path).sizes["cycle"] == 5
    path.write_bytes(old[: len(old) // 2])
    with pytest.raises(ConfigError, match=r"cycles-1\.nc cannot be read as a result .*; repeat"):
        open_dataset(path)


@pytest.mark.parametrize(
    "command", ["show . --html a.html", "export . --format stl --out new", "cite ."]
)
@pytest.mark.parametrize("name", ["run.nc", "cases-1.nc", "cycles-1.nc"])
@pytest.mark.parametrize("what", ["other names", "odd settings", "zeros"])
def test_foreign_and_odd_results_are_a_sentence(tmp_path, command, name, what):
    names = (*ORDER, "signal", "node_position", "lumen_face")
    odd = {n: (("press",), np.arange(2.0)) for n in names} | {
        "configuration": ("press", ["[" * 20_000, '{"tube": 1}'])
    }
    data = xr.Dataset({"x": 1.0} if what == "other names" else odd, attrs={"configuration": "[]"})
    data.to_netcdf(tmp_path / name, engine="h5netcdf")
    if what == "zeros":
        (tmp_path / name).write_bytes(bytes(5000))
    told = run_here(*command.split())
    assert told.returncode == 2, told.stdout
    (line,) = told.stderr.splitlines()
    assert "; " in line
    assert len(line) < 800


def cylinder(path, scale=1.0, offset=0.0):
    """Write a lumen of 8 mm by 40 cm, scaled, and shifted along x, in mm."""
    surface = trimesh.creation.cylinder(4, 400, sections=16)
    surface.apply_scale(scale)
    surface.apply_translation([offset, 0, 0])
    surface.export(path)
    return path


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl"])
def test_surfaces_of_kilometres_or_far_from_the_origin_are_refused(tmp_path, suffix):
    for values in ({"scale": 1e6}, {"offset": 1e9}, {"scale": 1e30}):
        path = cylinder(tmp_path / f"a.{suffix}", **values)
        for command in ("scatter a --out s.nc", "indent --tube a --depth 1 --out o"):
            told = run_here(*command.replace(" a ", f" {path} ").split())
            assert told.returncode == 2
            assert "mm from the origin, more than the limit of 100000 mm" in told.stderr
            assert "move it to the origin" in told.stderr


def test_lumen_that_needs_too_large_a_grid_is_refused(tmp_path):
    for scale in ([1, 1, 200], [1e-3, 1e-3, 1]):
        path = cylinder(tmp_path / "a.stl", scale)
        told = run_here("scatter", path, "--out", "s.nc", "--resolution", 64)
        assert told.returncode == 2
        assert re.search(
            r"a.stl takes a grid of \S+ cells, over 5e\+07; give a shorter", told.stderr
        )


def test_surface_reads_no_other_file(tmp_path):
    """The surface names a material library whose reading would never end."""
    path = cylinder(tmp_path / "a.obj")
    text = path.read_text()
    path.write_text(f"mtllib ../../../../../../dev/zero\nmtllib /dev/zero\nusemtl x\n{text}")
    assert load(path).is_watertight


def test_nothing_is_printed_before_the_sentence(tmp_path, capfd):
    """The library logs the traceback of an error that it handles."""
    text = (
        "solid a\nfacet normal 0 0 x\nouter loop\n" + 3 * "vertex 0 1 y\n" + "endloop\nendfacet\n"
    )
    (tmp_path / "a.stl").write_text(text + "endsolid\n")
    with pytest.raises(ConfigError, match=r"a\.stl"):
        load(tmp_path / "a.stl")
    assert capfd.readouterr() == ("", "")
