"""Recordings: the same cycles from every file format, and one sentence for unreadable files."""

import io
import json
import struct
import subprocess
import sys
import zipfile

import h5py
import numpy as np
import pytest
import xarray as xr
from children import without
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat, wavfile

from acoustube.base.errors import ConfigError
from acoustube.base.foreign import child
from acoustube.base.version import __version__
from acoustube.ranging import record
from acoustube.recordings import find, read, read_all, write
from acoustube.recordings.formats import KINDS

RATE, LENGTH, N = 200e3, 400, 3
TEMPERATURE = np.array([20.0, 21.5, 19.25])
LABELS = {"distance": [0.5, 1.25, 2.0], "depth_mm": [1.0, 2.0, 4.0], "press": [7, 8, 9]}


def cycles(n=N, length=LENGTH, dtype=np.int16):
    """Decaying bursts of a 12-bit converter, different in each cycle."""
    time = np.arange(length) / RATE
    tone = np.sin(2 * np.pi * 42e3 * time) * np.exp(-time / 5e-4)
    return np.round(2000 * tone * np.linspace(1, 0.5, n)[:, None]).astype(dtype)


def sidecar(path, **values):
    path.with_suffix(".json").write_text(json.dumps(values))


def beside(path):
    """Write the sidecar of a sound file, which has no place for labels."""
    labels = {name: list(values) for name, values in LABELS.items()}
    sidecar(path, temperature_c=TEMPERATURE.tolist(), samples_per_cycle=LENGTH, labels=labels)


def named(signal):
    return {"signal": signal, "fs": RATE, "temperature": TEMPERATURE} | {
        name: np.asarray(values) for name, values in LABELS.items()
    }


def write_npz(path, signal):
    np.savez(path, **named(signal))


def write_npz_packed(path, signal):
    np.savez_compressed(path, **named(signal))


def write_npy(path, signal):
    np.save(path, signal.ravel())
    beside(path)
    extra = json.loads(path.with_suffix(".json").read_text())
    sidecar(path, sampling_rate_hz=RATE, **extra)


def write_wide(path, signal, separator=","):
    header = [f"s{i}" for i in range(LENGTH)]
    rows = [
        [TEMPERATURE[i], *(values[i] for values in LABELS.values()), *signal[i].tolist()]
        for i in range(N)
    ]
    lines = [["temperature", *LABELS, *header], *rows]
    path.write_text(
        "# sampling_rate: 200000\n"
        + "\n".join(separator.join(str(cell) for cell in line) for line in lines)
    )


def write_wide_tabs(path, signal):
    write_wide(path, signal, "\t")


def write_timed(path, signal):
    """Write one cycle per column, which leaves no place for labels but a sidecar."""
    beside(path)
    rows = np.column_stack([np.arange(LENGTH) / RATE, signal.T])
    lines = [",".join([repr(row[0].item()), *(f"{v:g}" for v in row[1:])]) for row in rows]
    path.write_text("\n".join(["time,a,b,c", *lines]))


def write_wav(path, signal):
    wavfile.write(path, int(RATE), signal.ravel())
    beside(path)


def write_wav_24(path, signal):
    """Write three bytes per sample, which scipy reads but cannot write."""
    body = signal.astype("<i4").reshape(-1, 1).view("u1")[:, :3].tobytes()
    form = struct.pack("<HHIIHH", 1, 1, int(RATE), int(RATE) * 3, 3, 24)
    chunks = b"WAVEfmt " + struct.pack("<I", 16) + form + b"data" + struct.pack("<I", len(body))
    path.write_bytes(b"RIFF" + struct.pack("<I", len(chunks) + len(body)) + chunks + body)
    beside(path)


def write_flac(path, signal):
    reason = "needs soundfile (acoustube[audio])"
    soundfile = pytest.importorskip("soundfile", reason=reason, exc_type=ImportError)
    soundfile.write(path, signal.ravel(), int(RATE), subtype="PCM_16")
    beside(path)


def write_flac_24(path, signal):
    reason = "needs soundfile (acoustube[audio])"
    soundfile = pytest.importorskip("soundfile", reason=reason, exc_type=ImportError)
    soundfile.write(path, signal.ravel().astype(np.int32) << 8, int(RATE), subtype="PCM_24")
    beside(path)


def write_mat(path, signal):
    savemat(path, named(signal), do_compression=True)


def write_mat_struct(path, signal):
    savemat(path, {"session": named(signal)})


def write_mat_73(path, signal):
    """Write as MATLAB does with -v7.3: HDF5 behind its own header, with all arrays transposed."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in named(signal).items():
            item = file.create_dataset(name, data=np.atleast_2d(values).T)
            item.attrs["MATLAB_class"] = np.bytes_(
                values.dtype.name if name == "signal" else "double"
            )
        item = file.create_dataset("operator", data=np.array([[72], [73]], "u2"))
        item.attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")


def write_hdf5(path, signal):
    with h5py.File(path, "w") as file:
        group = file.create_group("session")
        group.attrs["sample_rate"] = RATE
        for name, values in named(signal).items():
            if name != "fs":
                group[name.removesuffix("_mm")] = values
        group["depth"].attrs["units"] = "mm"


def write_netcdf(path, signal):
    """Write a file of another program: other names, other dimensions, with a time axis."""
    variables = {
        "adc": (("press_no", "t"), signal),
        "temp": ("press_no", TEMPERATURE),
        **{name: ("press_no", values) for name, values in LABELS.items()},
    }
    time = ("t", np.arange(LENGTH) / RATE * 1e3, {"units": "ms"})
    xr.Dataset(variables, {"t": time}).to_netcdf(path, engine="h5netcdf")


WRITERS = {
    "npz": (".npz", write_npz),
    "npz, compressed": (".npz", write_npz_packed),
    "npy": (".npy", write_npy),
    "csv, wide": (".csv", write_wide),
    "tsv, wide": (".tsv", write_wide_tabs),
    "csv, timed": (".csv", write_timed),
    "wav, 16 bits": (".wav", write_wav),
    "wav, 24 bits": (".wav", write_wav_24),
    "flac, 16 bits": (".flac", write_flac),
    "flac, 24 bits": (".flac", write_flac_24),
    "mat 5": (".mat", write_mat),
    "mat 5, in a structure": (".mat", write_mat_struct),
    "mat 7.3": (".mat", write_mat_73),
    "hdf5": (".h5", write_hdf5),
    "netcdf": (".nc", write_netcdf),
}


def recorded(tmp_path, kind="npz"):
    """Return a new file of the cycles, whose name states its format."""
    suffix, writer = WRITERS[kind]
    path = tmp_path / f"run{suffix}"
    writer(path, cycles())
    return path


def saved(path, signal, **others):
    """Return an NPZ file with rate and temperature, unless others are given."""
    np.savez(path, **({"signal": signal, "fs": RATE, "temperature": 20.0} | others))
    return path


@pytest.mark.parametrize("kind", WRITERS)
def test_every_kind_of_file_gives_the_same_cycles(tmp_path, kind):
    """Times of nine digits give the rate, and a unit's factor costs one rounding."""
    data = read(recorded(tmp_path, kind))
    np.testing.assert_array_equal(data["signal"], cycles())
    assert data["signal"].dtype == (np.int32 if "24" in kind else np.int16)
    assert data["signal"].dims == ("cycle", "time")
    np.testing.assert_array_equal(data["temperature"], TEMPERATURE)
    assert data["temperature"].dtype == float
    assert data.attrs["sampling_rate"] == pytest.approx(RATE, rel=1e-8)
    np.testing.assert_array_equal(data["true_distance"], LABELS["distance"])
    np.testing.assert_allclose(data["depth"], [1e-3, 2e-3, 4e-3], rtol=4e-16)
    np.testing.assert_array_equal(data["press"], LABELS["press"])
    np.testing.assert_allclose(data["time"], np.arange(LENGTH) / RATE, rtol=1e-8)
    assert data.attrs["source"] == "recording"
    assert data.attrs["file"].startswith("run.")
    assert not data.attrs["warnings"]
    assert set(data.data_vars) == {"signal", "temperature", "true_distance", "depth", "press"}
    assert all({"units", "long_name"} <= set(v.attrs) for v in data.variables.values())


@pytest.mark.parametrize("kind", ["npz", "csv, wide", "netcdf"])
def test_written_recording_comes_back_as_it_was(tmp_path, kind):
    data = read(recorded(tmp_path, kind))
    write(data, tmp_path / "copy.nc")
    xr.testing.assert_identical(read(tmp_path / "copy.nc"), data)
    with pytest.raises(ConfigError, match=r"let it end in \.nc"):
        write(data, tmp_path / "copy.mat")


def test_simulated_recording_is_read_as_what_it_is(tmp_path):
    """With the reported temperatures, not the true one of the air, and all of its attributes."""
    simulated = record([], n_cycles=3)
    write(simulated, tmp_path / "free.nc")
    again = read(tmp_path / "free.nc")
    xr.testing.assert_equal(again, simulated)
    assert again.attrs["source"] == "simulation"
    assert again.attrs["tube_length"] == simulated.attrs["tube_length"]


def test_own_name_counts_before_synonyms(tmp_path):
    stored = xr.Dataset(
        {
            "signal": (("cycle", "time"), cycles(2)),
            "temperature": ("cycle", [20.5, 20.4], {"units": "degC"}),
        },
        attrs={"sampling_rate": RATE, "air_temperature": 19.0},
    )
    stored.to_netcdf(tmp_path / "foreign.nc", engine="h5netcdf")
    np.testing.assert_allclose(read(tmp_path / "foreign.nc")["temperature"], [20.5, 20.4])


@pytest.mark.parametrize("dtype", ["u1", "i2", "i4", "f4", "f8"])
def test_wav_keeps_its_type(tmp_path, dtype):
    signal = (cycles(1) // 16 + 128).astype(dtype)
    wavfile.write(tmp_path / "a.wav", int(RATE), signal[0])
    data = read(tmp_path / "a.wav", temperature=20)
    assert data["signal"].dtype == np.dtype(dtype)
    np.testing.assert_array_equal(data["signal"], signal)


def mapped(array):
    while array is not None and not isinstance(array, np.memmap):
        array = getattr(array, "base", None)
    return array is not None


@pytest.mark.parametrize("suffix", [".npy", ".wav"])
def test_large_files_are_mapped_not_copied(tmp_path, suffix):
    path, signal = tmp_path / f"a{suffix}", cycles(100)
    if suffix == ".npy":
        np.save(path, signal)
    else:
        wavfile.write(path, int(RATE), signal.ravel())
    data = read(path, rate=RATE, temperature=20, samples=LENGTH)
    assert mapped(data["signal"].values)
    np.testing.assert_array_equal(data["signal"], signal)


@pytest.mark.parametrize("dtype", ["u2", "f8"])
def test_large_arrays_of_mat_are_mapped_from_where_they_lie(tmp_path, dtype):
    """The arrays are stored by columns; a compressed one is sent through the pipe."""
    signal = np.random.default_rng(0).integers(0, 4096, (300, 4000)).astype(dtype)
    savemat(tmp_path / "a.mat", {"signal": signal, "rate": RATE})
    savemat(tmp_path / "b.mat", {"signal": signal, "rate": RATE}, do_compression=True)
    for name, in_place in (("a.mat", True), ("b.mat", False)):
        found = {label["name"]: v for label, v in child.read("mat", tmp_path / name, "recording")}
        assert mapped(found["signal"]) is in_place
        assert found["signal"].dtype == np.dtype(dtype)
        np.testing.assert_array_equal(found["signal"], signal)


def test_npz_with_a_changed_byte_is_refused(tmp_path):
    path = saved(tmp_path / "a.npz", cycles(100))
    content = bytearray(path.read_bytes())
    content[30_000] ^= 1
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"a\.npz cannot be read as NPZ \(Bad CRC"):
        read(path)


@given(
    shape=st.tuples(st.integers(1, 6), st.integers(3, 12)),
    order=st.randoms(use_true_random=False),
    dtype=st.sampled_from(["i2", "f8"]),
)
@settings(deadline=None, max_examples=40)
def test_columns_of_any_number_and_order_give_the_same_cycles(
    tmp_path_factory, shape, order, dtype
):
    n, length = shape
    signal = np.random.default_rng(n * length).integers(-999, 999, shape).astype(dtype) / 1
    signal = signal.astype(dtype) if dtype == "i2" else signal / 7
    labels = {
        "Temperature (°C)": [20 + i for i in range(n)],
        "force_N": [0.5 * i for i in range(n)],
    }
    slots = [None] * length + list(labels)
    order.shuffle(slots)
    numbers = iter(range(length))
    columns = [
        (f"x{i}", signal[:, i]) if s is None else (s, labels[s])
        for s in slots
        for i in [next(numbers) if s is None else 0]
    ]
    rows = [[name for name, _ in columns]]
    rows += [[repr(np.asarray(c)[i].item()) for _, c in columns] for i in range(n)]
    path = tmp_path_factory.mktemp("any") / "a.csv"
    path.write_text("\n".join(",".join(row) for row in rows), encoding="utf-8")
    data = read(path, rate=RATE)
    np.testing.assert_array_equal(data["signal"], signal)
    assert data["signal"].dtype == dtype
    np.testing.assert_array_equal(data["temperature"], labels["Temperature (°C)"])
    np.testing.assert_array_equal(data["force"], labels["force_N"])


@given(n=st.integers(1, 5), length=st.integers(2, 40), rest=st.integers(0, 39))
@settings(deadline=None, max_examples=40)
def test_continuous_record_is_cut_into_whole_cycles(tmp_path_factory, n, length, rest):
    record = np.arange(n * length + rest % length, dtype=np.int16)
    path = saved(tmp_path_factory.mktemp("cut") / "a.npz", record)
    data = read(path, samples=length)
    np.testing.assert_array_equal(data["signal"], record[: n * length].reshape(n, length))
    assert ("not a complete cycle" in data.attrs["warnings"]) == (rest % length > 0)


def test_temperature_of_each_sample_is_averaged_over_the_cycles(tmp_path):
    """Halves are exact in binary, and so are the means."""
    temperature = np.repeat([20.0, 21.5], LENGTH)
    path = saved(tmp_path / "a.npz", cycles(2).ravel(), temperature=temperature)
    assert read(path, samples=LENGTH)["temperature"].values.tolist() == [20.0, 21.5]


@pytest.mark.parametrize("layout", ["rows", "columns", "counted", "two columns", "semicolons"])
def test_tables_without_labels_are_understood_by_their_shape(tmp_path, layout):
    path, signal = tmp_path / "a.csv", cycles(2)
    if layout == "rows":
        np.savetxt(path, signal, fmt="%d", delimiter=",")
    elif layout == "columns":
        np.savetxt(path, signal.T, fmt="%d", delimiter=",")
    elif layout == "counted":  # as pandas writes it
        header = "," + ",".join(str(i) for i in range(LENGTH))
        rows = [f"{i}," + ",".join(str(v) for v in row) for i, row in enumerate(signal)]
        path.write_text("\n".join([header, *rows]))
    else:
        signal = signal[:1]
        lines = [f"{i / RATE:.6f},{value}" for i, value in enumerate(signal[0])]
        text = "\n".join(lines)
        if layout == "semicolons":
            text = text.replace(",", ";").replace(".", ",")
        path.write_text(text)
    data = read(path, rate=RATE, temperature=20)
    np.testing.assert_array_equal(data["signal"], signal)
    assert np.issubdtype(data["signal"].dtype, np.integer)
    assert bool(data.attrs["warnings"]) == (layout == "columns")


TABLES = {
    "commented header": ("# time,value\n0,5\n5e-6,6\n1e-5,7", [[5, 6, 7]]),
    "named in us": ("# temperature: 21\ntime (µs);v\n0;5\n5;6\n10;7", [[5, 6, 7]]),
    "two columns of one name": ("time,a,a\n0,1,4\n5e-6,2,5\n1e-5,3,6", [[1, 2, 3], [4, 5, 6]]),
    "counted samples": ("sample,value\n0,5\n1,6\n2,7", [[5, 6, 7]]),
    "separators at the ends": ("9,2,3,\n1,2,3,\n", [[9, 2, 3], [1, 2, 3]]),
    "words": ("tube,s0,s1\nA,1,2\nB,3,4", [[1, 2], [3, 4]]),
    "decimal commas after whole numbers": ("time;v\n0;0\n5e-6;0,5\n1e-5;1", [[0, 0.5, 1]]),
    "words with commas": ("tube;s0;s1\nA, 3,5 mm;1.5;2\nB;3;4", [[1.5, 2], [3, 4]]),
    "time of day": ("# time: 12:30:05\n# data: raw\nTime (s),v\n0,5\n5e-6,6", [[5, 6]]),
    "quoted names": ('"time, s","value"\n0,5\n5e-6,6', [[5, 6]]),
    "quoted names, semicolons": ('"tube; its name";"s0";"s1"\n"A";1;2\n"B";3;4', [[1, 2], [3, 4]]),
    "empty lines": ("\n\n9,2,3\n\n1,2,3\n", [[9, 2, 3], [1, 2, 3]]),
}


@pytest.mark.parametrize("what", TABLES)
def test_tables_as_people_write_them_are_understood(tmp_path, what):
    text, signal = TABLES[what]
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    data = read(tmp_path / "a.csv", rate=RATE, temperature=20)
    np.testing.assert_array_equal(data["signal"], signal)
    assert not data.attrs["warnings"]


def test_words_for_nothing_are_labels_and_gaps_between_numbers_are_gaps(tmp_path):
    text = "shape,who,force_n,s0,s1\nNone,NA,1.5,1,2\nrod,NA,NA,3,4\nNA,NA,,5,6\n"
    (tmp_path / "a.csv").write_text(text)
    data = read(tmp_path / "a.csv", rate=RATE, temperature=20)
    assert data["shape"].values.tolist() == ["None", "rod", "NA"]
    assert data["who"].values.tolist() == ["NA"] * 3
    np.testing.assert_array_equal(data["force"], [1.5, np.nan, np.nan])
    np.testing.assert_array_equal(data["signal"], [[1, 2], [3, 4], [5, 6]])


UNITS = {
    "force": [("mN", 1e-3), ("N (newton)", 1), ("1", 1), ("kN", "states force in kN; use N or mN")],
    "depth": [("millimeter", 1e-3), ("", 1), ("inch", "states depth in inch; use m, cm or mm")],
    "temperature": [("℃", 1), ("degrees Celsius", 1), ("degF", "in degF; use degC or C")],
}


@pytest.mark.parametrize("suffix", [".h5", ".csv"])
@pytest.mark.parametrize("quantity", UNITS)
def test_stated_units_are_known_or_refused(tmp_path, quantity, suffix):
    path = tmp_path / f"a{suffix}"
    for unit, found in UNITS[quantity]:
        if suffix == ".csv":
            rows = "\n".join(map(str, cycles(1)[0]))
            path.write_text(f"# {quantity}: 20 {unit}\nsignal\n{rows}\n", encoding="utf-8")
        else:
            with h5py.File(path, "w") as file:
                file["signal"], file[quantity] = cycles(1), 20.0
                file[quantity].attrs["units"] = unit
        given = {"rate": RATE} | ({} if quantity == "temperature" else {"temperature": 20})
        if isinstance(found, str):
            with pytest.raises(ConfigError, match=rf"a\{suffix} states .*{found[-20:]}"):
                read(path, **given)
        else:
            assert read(path, **given)[quantity].values == pytest.approx([20 * found])


@pytest.mark.parametrize("remark", ["(room)", "# wall", "degC # wall", ""])
def test_remarks_behind_a_value_are_no_unit(tmp_path, remark):
    path = tmp_path / "a.csv"
    path.write_text(f"# temperature: 21.5 {remark}\nsignal\n" + "1\n2\n" * 50)
    assert read(path, rate=2e5)["temperature"].values == pytest.approx(21.5)


@pytest.mark.parametrize("head", ["", "signal\n"])
def test_one_column_is_one_record_with_and_without_a_name(tmp_path, head):
    """As an oscilloscope writes it; `samples` divides it into cycles."""
    counts = np.random.default_rng(0).integers(0, 4000, 1200)
    path = tmp_path / "one.csv"
    path.write_text(head + "\n".join(map(str, counts)) + "\n")
    given = {"rate": 2e5, "temperature": 20.0}
    assert np.array_equal(read(path, **given)["signal"].values, counts[None])
    divided = read(path, **given, samples=400)["signal"].values
    assert np.array_equal(divided, counts.reshape(3, 400))


def test_more_rows_than_columns_are_noted_and_turned_by_samples(tmp_path):
    signal = np.random.default_rng(1).integers(0, 99, (12, 5))
    np.savetxt(tmp_path / "a.csv", signal, fmt="%d", delimiter=",")
    data = read(tmp_path / "a.csv", rate=RATE, temperature=20)
    assert data["signal"].shape == (5, 12)
    assert "give samples = 5 if its rows are cycles" in data.attrs["warnings"]
    turned = read(tmp_path / "a.csv", rate=RATE, temperature=20, samples=5)
    np.testing.assert_array_equal(turned["signal"], signal)


def test_time_axis_identifies_the_axis_of_time(tmp_path):
    time = np.arange(LENGTH) / RATE
    path = tmp_path / "a.npz"
    np.savez(path, signal=cycles().T, time_us=1e6 * time + 50, temp=20.0)
    data = read(path)
    np.testing.assert_array_equal(data["signal"], cycles())
    assert data["time"].values[0] == pytest.approx(5e-5)  # as in its own axis


def test_columns_of_matlab_are_cycles_when_samples_says_so(tmp_path):
    savemat(tmp_path / "a.mat", {"data": cycles().T, "Fs": RATE, "temp": TEMPERATURE[:, None]})
    np.testing.assert_array_equal(read(tmp_path / "a.mat", samples=LENGTH)["signal"], cycles())
    with pytest.raises(ConfigError, match="or set samples if the length of the cycles is wrong"):
        read(tmp_path / "a.mat")


def test_argument_goes_before_sidecar_before_file(tmp_path):
    path = saved(tmp_path / "a.npz", cycles(), fs=1e5, temperature=10.0, force=[1, 2, 3])
    data = read(path)
    assert (data.attrs["sampling_rate"], data["temperature"][0], data["force"][0]) == (1e5, 10, 1)
    path.with_suffix(".toml").write_text(
        "sampling_rate_hz = 2e5\ntemperature_c = 20\n[labels]\nforce = 4\ntube = 'A'\n"
    )
    data = read(path)
    assert (data.attrs["sampling_rate"], data["temperature"][0]) == (2e5, 20)
    assert data["force"].values.tolist() == [4, 4, 4]
    assert data["tube"].values.tolist() == ["A"] * 3
    data = read(path, rate=3e5, temperature=[30, 31, 32])
    assert data.attrs["sampling_rate"] == 3e5
    assert data["temperature"].values.tolist() == [30, 31, 32]


@pytest.mark.parametrize("first", ["depth", "depth_mm"])
def test_name_with_a_unit_goes_before_the_same_without(tmp_path, first):
    both = {"depth": [1000, 2000, 3000], "depth_mm": [1.0, 2.0, 3.0]}
    values = {first: both.pop(first)} | both
    data = read(saved(tmp_path / "a.npz", cycles(), temperature_c=20.0, **values))
    np.testing.assert_allclose(data["depth"], [1e-3, 2e-3, 3e-3])
    np.testing.assert_array_equal(data["temperature"], [20, 20, 20])
    assert data.attrs["warnings"] == ("depth is stated twice: the one of unknown unit is left out.")
    time = np.arange(LENGTH) / RATE
    path = saved(tmp_path / "b.npz", cycles(LENGTH), time_ms=1e3 * time, time=np.arange(LENGTH))
    assert "time is stated twice" in read(path).attrs["warnings"]


def test_argument_or_label_keeps_what_a_file_of_our_own_states(tmp_path):
    """But not the error of its thermometer, where the temperature is given."""
    simulated = record([], n_cycles=2)
    write(simulated.assign_attrs(acoustube_version="0.0.1"), tmp_path / "free.nc")
    assert read(tmp_path / "free.nc").attrs["acoustube_version"] == __version__
    warm = read(tmp_path / "free.nc", temperature=30.0)
    assert warm["temperature"].values.tolist() == [30, 30]
    sidecar(tmp_path / "free.nc", labels={"depth_mm": 4})
    labelled = read(tmp_path / "free.nc")
    np.testing.assert_array_equal(labelled["temperature"], simulated["temperature"])
    for data, bias in ((warm, 0.0), (labelled, 0.5)):
        for name, value in simulated.attrs.items():
            if name != "rangefinder":
                np.testing.assert_array_equal(data.attrs[name], value)
        stated = json.loads(data.attrs["rangefinder"])
        assert stated == json.loads(simulated.attrs["rangefinder"]) | {"temperature_bias": bias}
        assert not {"press_positions", "tube_length"} & set(data.data_vars)
        np.testing.assert_array_equal(data["signal"], simulated["signal"])
    np.testing.assert_allclose(labelled["depth"], 4e-3)


@pytest.mark.parametrize("n", [1, 3])
def test_argument_or_label_keeps_the_labels_and_numbers_of_our_own_cycles(tmp_path, n):
    """Also of a single cycle, and with a name that is a synonym of the temperature."""
    labels = {
        "air_temperature": ("cycle", np.full(n, 21.0), {"units": "degC"}),
        "depth": ("cycle", np.full(n, 2e-3), {"units": "m", "long_name": "indentation"}),
    }
    names = {"session": ("cycle", np.arange(n)), "press": ("cycle", list("abc")[:n])}
    simulated = record([], n_cycles=n, first_cycle=5).assign(labels).assign_coords(names)
    write(simulated, tmp_path / "a.nc")
    warm = read(tmp_path / "a.nc", temperature=30.0)
    assert np.all(warm["temperature"] == 30)
    xr.testing.assert_identical(
        warm.drop_attrs(deep=False).drop_vars("temperature"),
        simulated.drop_attrs(deep=False).drop_vars("temperature")
        .assign_coords(time=warm["time"]).assign(signal=warm["signal"]),
    )  # fmt: skip
    np.testing.assert_array_equal(warm["signal"], simulated["signal"])
    sidecar(tmp_path / "a.nc", labels={"depth_mm": 4})
    labelled = read(tmp_path / "a.nc")
    np.testing.assert_allclose(labelled["depth"], 4e-3)
    for name in ("temperature", "air_temperature", "session", "press", "cycle"):
        xr.testing.assert_identical(labelled[name].variable, simulated[name].variable)


def test_label_of_one_value_in_our_own_file_is_that_of_each_cycle(tmp_path):
    write(record([], n_cycles=2).assign(depth=((), 2e-3, {"units": "m"})), tmp_path / "a.nc")
    for words in ({}, {"temperature": 30.0}):
        assert read(tmp_path / "a.nc", **words)["depth"].values.tolist() == [2e-3, 2e-3]


def test_channel_is_chosen_by_argument_or_sidecar(tmp_path):
    path, signal = tmp_path / "a.wav", cycles(2)
    wavfile.write(path, int(RATE), signal.T.copy())
    for channel in (0, 1):
        data = read(path, temperature=20, channel=channel)
        np.testing.assert_array_equal(data["signal"][0], signal[channel])
    sidecar(path, temperature_c=20, channel=1)
    np.testing.assert_array_equal(read(path)["signal"][0], signal[1])


def test_clipped_and_silent_cycles_are_counted(tmp_path):
    signal = cycles(4, 4000)
    signal[:, 2000:2040] = signal[:, :40] // 2  # an echo at 10 ms
    assert not read(saved(tmp_path / "a.npz", signal)).attrs["warnings"]
    signal[1:3, 2000:2040:5] = signal.max()
    text = read(saved(tmp_path / "a.npz", signal)).attrs["warnings"]
    assert text.startswith("2 of 4 cycles reach the extreme codes")
    assert not read(saved(tmp_path / "a.npz", signal.astype(float))).attrs["warnings"]
    signal = cycles()
    signal[1] = 7
    assert "1 of 3 cycles are silent" in read(saved(tmp_path / "a.npz", signal)).attrs["warnings"]


def test_what_is_no_label_is_left_out_with_a_note(tmp_path):
    data = read(saved(tmp_path / "a.npz", cycles(), gains=[1, 2], depth=[1.0, 2.0, 3.0]))
    assert "gains" not in data
    assert data.attrs["warnings"].splitlines() == [
        "depth reaches 3 m; if that is in mm, call it depth_mm.",
        "gains of shape (2,) is not one value per cycle: left out.",
    ]


def test_what_may_be_in_another_unit_or_several_cycles_is_noted(tmp_path):
    far = saved(tmp_path / "a.npz", cycles(), true_distance=[90.0, 90.0, 120.0])
    (note,) = read(far).attrs["warnings"].splitlines()
    assert note == "true_distance reaches 120 m; if that is in cm, call it true_distance_cm."
    whole = saved(tmp_path / "b.npz", cycles(4, 4000).ravel())
    (note,) = read(whole).attrs["warnings"].splitlines()
    assert note.startswith(f"The record of {16000 / RATE:.3g} s was taken for one cycle; give sam")
    assert not read(whole, samples=4000).attrs["warnings"]


BAD = cycles().astype(float)
BAD[1, 7], BAD[2, 0] = np.nan, np.inf
WRONG = {
    "nan": (
        BAD,
        {},
        "a.npz: 2 samples are missing, NaN or infinite, the first in cycle 1 at sample 7",
    ),
    "silence": (np.full((2, 9), 5), {}, "a.npz is silent: all samples are 5; check the sensor"),
    "one sample": (
        np.ones((5, 1)),
        {},
        "a.npz holds 5 cycles of 1 samples; record at least one cycle of two",
    ),
    "no sample": (np.ones((0, 5)), {}, "a.npz holds 0 cycles of 5 samples"),
    "four axes": (np.ones((1, 1, 2, 2)), {}, "shape (1, 1, 2, 2); give real numbers of shape"),
    "complex": (1j * cycles(), {}, "holds a signal of type complex128"),
    "low rate": (
        cycles(),
        {"fs": 200.0},
        "a.npz: rate = 200 is out of range; use 1000 to 1e+07 Hz",
    ),
    "fast": (cycles(), {"fs": 2e7}, "a.npz: rate = 20000000 is out of range"),
    "rate in words": (cycles(), {"fs": "fast"}, "a.npz: rate = 'fast' is not a number"),
    "two rates": (cycles(), {"fs": [1e5, 2e5]}, "sampling rate has 2 different values; give one"),
    "time axis": (
        cycles(),
        {"time": np.arange(LENGTH) / 1e5},
        "a.npz: rate = 200000 Hz contradicts its time axis, which has 100000 Hz; correct one",
    ),
    "uneven": (
        cycles(),
        {"time": np.arange(LENGTH) ** 2},
        "time is not evenly spaced and increasing",
    ),
    "short time": (cycles(), {"time": np.arange(9) / RATE}, "its time axis has 9 values for 400"),
    "hot": (
        cycles(),
        {"temperature": [20, 293, 20]},
        "temperature = 293 degC in cycle 1 is outside -20 to 60 degC; give it in degC",
    ),
    "nan degC": (cycles(), {"temperature": np.nan}, "temperature = nan degC in cycle 0"),
    "temperature in words": (cycles(), {"temperature": "warm"}, "temperature = np.str_('warm')"),
    "labels": (
        cycles(),
        {"force": [1, 2]},
        "a.npz: force has shape (2,) for 3 cycles of 400 samples",
    ),
    "objects": (cycles(), {"note": np.array({})}, "a.npz: note is an array of Python objects"),
}


@pytest.mark.parametrize("what", WRONG)
def test_values_that_cannot_be_used_are_refused(tmp_path, what):
    signal, others, message = WRONG[what]
    with pytest.raises(ConfigError) as caught:
        read(saved(tmp_path / "a.npz", signal, **others))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_crafted_array_of_object_pointers_is_refused_before_one_is_followed(tmp_path):
    """96 kB, stored: of a size and type that were once mapped, with bytes used as pointers."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "|O", "fortran_order": False, "shape": (3, 4000)}
    )
    path = saved(tmp_path / "a.npz", cycles())
    with zipfile.ZipFile(path, "a", zipfile.ZIP_STORED) as archive:
        archive.writestr("x.npy", head.getvalue() + b"\x41" * (3 * 4000 * 8))
    with pytest.raises(ConfigError, match=r"a\.npz: x is an array of Python objects.*save it as"):
        read(path)


def test_an_array_called_note_is_a_label_like_any_other(tmp_path):
    path = saved(tmp_path / "a.npz", cycles(), note=np.array(["dry", "wet", "dry"]))
    data = read(path)
    assert list(data["note"].values) == ["dry", "wet", "dry"]
    assert data.attrs["warnings"] == ""
    assert read(saved(path, cycles(), note=np.array("first try"))).attrs["warnings"] == ""


def test_missing_rate_and_temperature_are_asked_for(tmp_path):
    np.save(tmp_path / "a.npy", cycles())
    with pytest.raises(ConfigError, match=r"give rate in Hz, or sampling_rate_hz in a\.toml"):
        read(tmp_path / "a.npy")
    with pytest.raises(ConfigError, match=r"give temperature in degC, or temperature_c in a\.toml"):
        read(tmp_path / "a.npy", rate=RATE)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "has 2 channels; choose one with channel = 0 to 1"),
        ({"channel": 2}, "channel = 2 is out of range; use a whole number from 0 to 1"),
        ({"channel": 0, "samples": 1}, "samples = 1 is out of range"),
        ({"channel": 0, "samples": 999}, "samples = 999 is longer than the record of 400"),
    ],
)
def test_wrong_options_are_refused(tmp_path, options, message):
    wavfile.write(tmp_path / "a.wav", int(RATE), cycles(2).T.copy())
    with pytest.raises(ConfigError) as caught:
        read(tmp_path / "a.wav", temperature=20, **options)
    assert message in str(caught.value)


def test_samples_that_fit_no_axis_and_unknown_signals_are_refused(tmp_path):
    with pytest.raises(ConfigError, match="samples = 7 does not fit"):
        read(saved(tmp_path / "a.npz", cycles()), samples=7)
    np.savez(tmp_path / "b.npz", left=cycles(), right=cycles())
    with pytest.raises(
        ConfigError, match="holds left, right, none of which is known as the signal"
    ):
        read(tmp_path / "b.npz", rate=RATE, temperature=20)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not valid JSON: Expecting property name"),
        ("[]", "is not a table of names and values in JSON"),
        ('{"sampling_rate": 1}', "sampling_rate is not known; use sampling_rate_hz"),
        ('{"labels": [1]}', "labels must be a table of names and their values"),
        ('{"labels": {"force": [1, [2, 3]]}}', "force is a list of unequal lists"),
        ('{"labels": {"depth_mm": "deep"}}', "depth_mm = 'deep' is not a number"),
        ('{"labels": {"press": [1, 2]}}', "press has shape (2,) for 3 cycles"),
        ('{"labels": {"signal": "good"}}', "state signal, which is not a label; rename it"),
        ('{"sampling_rate_hz": {}}', "is not a number"),
        ('{"temperature_c": null}', "temperature = nan degC"),
    ],
)
def test_wrong_sidecars_are_refused(tmp_path, text, message):
    path = saved(tmp_path / "a.npz", cycles())
    path.with_suffix(".json").write_text(text)
    with pytest.raises(ConfigError) as caught:
        read(path)
    assert message in str(caught.value)


def test_two_sidecars_are_refused(tmp_path):
    path = saved(tmp_path / "a.npz", cycles())
    for suffix in (".toml", ".json"):
        path.with_suffix(suffix).write_text("")
    with pytest.raises(ConfigError, match=r"a\.json both describe a\.npz; keep one"):
        read(path)


JPEG = bytes.fromhex("ffd8ffe000104a46494600010100000100010000") + bytes(range(256)) * 20


@pytest.mark.parametrize("suffix", KINDS)
@pytest.mark.parametrize("content", [JPEG, b"Dear reader,\nthis is a letter.\n", b""])
def test_files_of_another_kind_are_refused(tmp_path, suffix, content):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content)
    with pytest.raises(
        ConfigError, match=rf"a\{suffix} cannot be read as [A-Za-z\d]+ \(.*export it"
    ):
        read(path, rate=RATE, temperature=20)


@pytest.mark.parametrize("share", [0.2, 0.6, 0.99])
@pytest.mark.parametrize(
    "kind", [kind for kind in WRITERS if "csv" not in kind and "tsv" not in kind]
)
def test_files_cut_short_are_refused(tmp_path, kind, share):
    path = recorded(tmp_path, kind)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ConfigError):
        read(path)


@pytest.mark.parametrize("kind", ["csv, wide", "tsv, wide"])
def test_tables_cut_short_are_refused(tmp_path, kind):
    path = recorded(tmp_path, kind)
    path.write_text(path.read_text()[:-100])
    with pytest.raises(
        ConfigError, match="samples are missing, NaN or infinite, the first in cycle 2"
    ):
        read(path)


def test_words_and_wrong_headers_in_tables_are_refused(tmp_path):
    path = tmp_path / "a.csv"
    for text, message in (
        ("temperature,s0,s1\n20,1,off", "holds text: ['off']"),
        ("temperature,s0\n20,1,2", "the header has 2 names for 3 columns"),
        ("temperature\n20", "no column holds samples"),
        ("5,1,3\n1,2,3,4", "Expected 3 fields"),
    ):
        path.write_text(text)
        with pytest.raises(ConfigError) as caught:
            read(path, rate=RATE, temperature=20)
        assert message in str(caught.value)


def test_flac_without_its_library_says_what_to_install(tmp_path, monkeypatch):
    without(monkeypatch, "soundfile", tmp_path)
    (tmp_path / "a.flac").write_bytes(b"fLaC")
    with pytest.raises(ConfigError, match=r"pip install 'acoustube\[audio\]', or convert the file"):
        read(tmp_path / "a.flac")


def test_folders_are_searched_in_natural_order(tmp_path):
    for name in ("run10.wav", "run9.wav", "b/run1.NPZ", ".hidden.wav", "notes.txt", "run9.json"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = [
        path.relative_to(tmp_path).as_posix() for path in find([tmp_path / "run10.wav", tmp_path])
    ]
    assert found == ["run10.wav", "b/run1.NPZ", "run9.wav"]
    assert find(tmp_path / "run9.wav") == [tmp_path / "run9.wav"]


def test_each_wrong_entry_is_named(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "a.txt").touch()
    with pytest.raises(ConfigError) as caught:
        find([tmp_path / "empty", tmp_path / "a.txt", tmp_path / "none.wav"])
    lines = str(caught.value).splitlines()
    assert len(lines) == 3
    assert "empty holds no recordings; name a folder of" in lines[0]
    assert "a.txt is not of a kind that can be read; use .npz" in lines[1]
    assert "none.wav does not exist; name a recording" in lines[2]


def test_reading_many_goes_on_after_a_failure(tmp_path):
    (tmp_path / "empty").mkdir()
    good = saved(tmp_path / "b.npz", cycles(), temperature=99.0)
    (tmp_path / "a.wav").write_bytes(JPEG)
    found = list(read_all([tmp_path / "empty", tmp_path, good], temperature=20))
    assert [path.name for path, _ in found] == ["empty", "a.wav", "b.npz"]
    assert all(isinstance(result, ConfigError) for _, result in found[:2])
    np.testing.assert_array_equal(found[2][1]["signal"], cycles())


def test_written_files_are_checked_like_any_other(tmp_path):
    data = read(saved(tmp_path / "a.npz", cycles()))
    path = tmp_path / "b.nc"
    write(data.assign_attrs(sampling_rate=1e5), path)
    with pytest.raises(ConfigError, match="contradicts its time axis"):
        read(path)
    write(data.drop_vars("time"), path)
    np.testing.assert_array_equal(read(path)["time"], data["time"])
    assert read(path.rename(tmp_path / "c.nc"), temperature=30)["temperature"][0] == 30
    write(data.isel(cycle=slice(0, 0)), path)
    with pytest.raises(ConfigError, match=r"b\.nc holds 0 cycles of 400 samples; record at least"):
        read(path)


def test_reading_needs_no_solver_and_no_drawing():
    code = "import acoustube.recordings, sys; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert not {"jax", "pyvista", "soundfile", "matplotlib"} & set(loaded.stdout.split())


@pytest.mark.parametrize(
    ("name", "value"),
    [("tube_length", "x"), ("tube_length", -1.0), ("tube_length", np.nan), ("full_scale", 0.0),
     ("full_scale", "many"), ("bore_radius", [1.0, 2.0])],
)  # fmt: skip
def test_what_a_file_of_our_own_states_wrongly_is_named(tmp_path, name, value):
    data = xr.Dataset(
        {"signal": (("cycle", "time"), np.arange(80.0).reshape(2, 40) % 7),
         "temperature": ("cycle", [20.0, 20.0]), "depth": ("cycle", [1e-3, 2e-3])},
        {"time": np.arange(40) / 2e5}, {"acoustube_version": "0.1.0", "sampling_rate": 2e5},
    )  # fmt: skip
    good, wrong, odd = (tmp_path / f"{one}.nc" for one in ("good", "wrong", "odd"))
    data.to_netcdf(good, engine="h5netcdf")
    assert read(good).attrs["sampling_rate"] == 2e5
    data.assign_attrs({name: value}).to_netcdf(wrong, engine="h5netcdf")
    with pytest.raises(ConfigError, match=rf"wrong\.nc: {name} = "):
        read(wrong)
    data.assign(depth=("cycle", ["deep", "deeper"])).to_netcdf(odd, engine="h5netcdf")
    with pytest.raises(ConfigError, match=r"odd\.nc: depth has type .* one number a cycle"):
        read(odd)
