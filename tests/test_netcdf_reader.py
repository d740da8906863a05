"""The reader of netCDF files, compared with xarray's engine h5netcdf."""

from io import BytesIO

import h5py
import numpy as np
import pytest
import xarray as xr

from acoustube.base.netcdf import to_netcdf, write_dataset
from acoustube.base.netcdf_reader import read_group


def example(size=60):
    rng = np.random.default_rng(2)
    single = rng.normal(size=(3, size)).astype(np.float32)
    single[1, 5] = np.nan
    return xr.Dataset(
        {
            "single": (("press", "time"), single, {"units": "Pa", "long_name": "pressure"}),
            "counts": (("press", "time"), rng.integers(0, 4096, (3, size)).astype(np.uint16)),
            "square": (("press", "port", "port_in"), rng.normal(size=(3, 2, 2))),
            "flag": (("press",), [True, False, True], {"units": "1"}),
            "name": (("press",), ["a", "längere", ""]),
            "alone": ((), 3.5, {"units": "m"}),
            "none": (("empty",), np.zeros(0)),
        },
        coords={"press": ["p1", "p20", "p3"], "time": 1e-6 * np.arange(size)},
        attrs={
            "title": "a tube", "empty": "", "number": 3, "fraction": 0.25, "several": [1.0, 2.0],
            "texts": ["x", "yz"],
        },
    )  # fmt: skip


def identical(one, other):
    xr.testing.assert_identical(one, other)
    for name in one.variables:
        assert one[name].dtype == other[name].dtype
        assert one[name].encoding.get("_FillValue") is other[name].encoding.get("_FillValue") or (
            np.isnan(other[name].encoding["_FillValue"])
        )
    for name, value in one.attrs.items():
        assert type(value) is type(other.attrs[name])


@pytest.mark.parametrize("size", [60, 5000])
def test_variables_and_attributes_are_those_of_h5netcdf(tmp_path, size):
    """Of a file with small variables alone, and of one with large, compressed ones."""
    path = tmp_path / "one.nc"
    write_dataset(example(size), path)
    with xr.open_dataset(path, engine="h5netcdf") as expected:
        identical(expected.load(), read_group(path))


def test_groups_are_read_from_a_file_in_memory():
    wall = xr.Dataset({"ring": (("around", "axis"), np.ones((4, 2)))}, attrs={"title": "a wall"})
    tree = xr.DataTree.from_dict({"/": example(), "/walls": wall})
    content = to_netcdf(tree)
    for group in ("/", "walls"):
        with xr.open_dataset(BytesIO(content), engine="h5netcdf", group=group) as expected:
            found = read_group(BytesIO(content), group)
            identical(expected.load(), found)


def test_attributes_that_another_library_wrote_are_texts(tmp_path):
    """Texts of fixed length, one that is not ASCII, and empty ones; a variable without scales."""
    path = tmp_path / "other.nc"
    with h5py.File(path, "w") as file:
        file.attrs["scattering"] = np.bytes_("yes")
        file.attrs["names"] = np.array([b"one", b"two"])
        file.attrs["nothing"] = h5py.Empty("S1")
        file.attrs["odd"] = np.bytes_(b"k\xe4se")
        file["x"] = np.arange(6.0).reshape(2, 3)
        file["x"].attrs["units"] = np.bytes_("Pa")
    found = read_group(path)
    assert found.attrs["scattering"] == "yes"
    assert found.attrs["names"] == ["one", "two"]
    assert found.attrs["nothing"] == ""
    assert found.attrs["odd"] == "k\ufffdse"
    assert found["x"].attrs == {"units": "Pa"}
    assert found["x"].shape == (2, 3)


def test_a_file_without_the_group_is_an_error(tmp_path):
    write_dataset(example(), tmp_path / "one.nc")
    with pytest.raises(KeyError):
        read_group(tmp_path / "one.nc", "walls")
