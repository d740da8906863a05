"""The reader of netCDF files, compared with xarray's engine h5netcdf."""

import shutil
from io import BytesIO

import h5py
import numpy as np
import pytest
import xarray as xr

from acoustube.base import netcdf_reader
from acoustube.base.netcdf import to_netcdf, write_dataset
from acoustube.base.netcdf_reader import Reader


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
        identical(expected.load(), xr.load_dataset(path, engine=Reader))


def test_groups_are_read_from_a_file_in_memory():
    wall = xr.Dataset({"ring": (("around", "axis"), np.ones((4, 2)))}, attrs={"title": "a wall"})
    tree = xr.DataTree.from_dict({"/": example(), "/walls": wall})
    content = to_netcdf(tree)
    for group in ("/", "walls"):
        with xr.open_dataset(BytesIO(content), engine="h5netcdf", group=group) as expected:
            found = xr.load_dataset(BytesIO(content), engine=Reader, group=group)
            identical(expected.load(), found)


def test_large_variables_are_read_when_used(tmp_path, monkeypatch):
    """Parts of one, after the file was opened and while its values change."""
    monkeypatch.setattr(netcdf_reader, "SMALL", 100)
    path = tmp_path / "one.nc"
    given = example()
    write_dataset(given, path)
    found = xr.open_dataset(path, engine=Reader)
    part = {"press": [2, 0], "time": slice(40, 3, -7)}
    xr.testing.assert_identical(found["single"].isel(part), given["single"].isel(part))
    with h5py.File(path, "r+") as file:
        file["counts"][1, 4] = 7
        file["square"][0, 0, 0] = 9.0
    assert found["counts"].values[1, 4] == 7
    assert found["square"].values[0, 0, 0] == given["square"].values[0, 0, 0]


def test_a_file_of_many_variables_is_opened_from_several_places(tmp_path):
    """Opened files are not kept open: a folder with them can be removed, or a file replaced."""
    path = tmp_path / "some" / "one.nc"
    path.parent.mkdir()
    write_dataset(example(5000), path)
    found = xr.open_dataset(path, engine=Reader)
    write_dataset(example(5000).assign_attrs(title="another"), path, overwrite=True)
    assert xr.open_dataset(path, engine=Reader).attrs["title"] == "another"
    shutil.rmtree(path.parent)
    with pytest.raises(FileNotFoundError):
        found["single"].load()
