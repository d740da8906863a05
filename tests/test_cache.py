"""Remembered results: found again, never trusted when damaged, listed and cleared."""

import numpy as np
import pytest

from acoustube import cache, mechanics
from acoustube.config import Config, Mechanics, load_config
from acoustube.indentation import indent
from acoustube.indentation.press import MeshSize

ARRAYS = {"depth": np.linspace(0, 1, 5), "count": np.arange(3), "none": np.zeros((0, 2))}


@pytest.fixture(autouse=True)
def _empty(tmp_path, monkeypatch):
    monkeypatch.setenv("ACOUSTUBE_CACHE", str(tmp_path / "cache"))


def test_what_is_stored_is_recalled_bit_by_bit():
    assert cache.recall("a") is None
    cache.store("a", ARRAYS)
    found = cache.recall("a")
    assert found.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert found[name].dtype == array.dtype
        assert np.array_equal(found[name], array)


@pytest.mark.parametrize("kept", [0, 1, 30, 100, -200, -1])
def test_entry_that_was_cut_short_counts_as_missing_and_is_replaced(kept):
    cache.store("a", ARRAYS)
    path = cache.folder() / "a.npz"
    path.write_bytes(path.read_bytes()[:kept])
    assert cache.recall("a") is None
    cache.store("a", ARRAYS)
    assert np.array_equal(cache.recall("a")["depth"], ARRAYS["depth"])


def test_entry_whose_content_changed_counts_as_missing():
    """A flipped byte anywhere, or an archive that somebody else wrote."""
    cache.store("a", ARRAYS)
    path = cache.folder() / "a.npz"
    good = path.read_bytes()
    for place in range(0, len(good), 37):
        path.write_bytes(good[:place] + bytes([good[place] ^ 1]) + good[place + 1 :])
        found = cache.recall("a")
        # A byte of the archive's own bookkeeping may not matter; then the content is what it was.
        assert found is None or all(np.array_equal(found[n], ARRAYS[n]) for n in ARRAYS)
    np.savez(path, depth=np.zeros(3))
    assert cache.recall("a") is None


def test_name_depends_on_everything_given_and_on_the_code(monkeypatch):
    name = cache.key("press", {"depth": 1.0, "tube": {"wall": 2}})
    assert name == cache.key("press", {"tube": {"wall": 2}, "depth": 1.0})
    assert name != cache.key("press", {"tube": {"wall": 3}, "depth": 1.0})
    assert name != cache.key("scattering", {"depth": 1.0, "tube": {"wall": 2}})
    monkeypatch.setattr(cache, "_code", lambda _: "changed")
    assert name != cache.key("press", {"depth": 1.0, "tube": {"wall": 2}})


def test_entries_are_listed_sized_and_cleared():
    assert cache.entries() == []
    names = {letter: 32 * letter for letter in "ab"}
    for letter, name in names.items():
        cache.store(name, ARRAYS, f"press {letter}")
    (cache.folder() / "acoustube-left-over.part").write_bytes(b"x")
    foreign = cache.folder() / "recordings.npz"
    foreign.write_bytes(b"somebody's")
    found = cache.entries()
    labels = {entry.path.stem: entry.label for entry in found}
    assert labels == {name: f"press {letter}" for letter, name in names.items()}
    assert all(entry.size == entry.path.stat().st_size > 0 for entry in found)
    assert {entry.path.stem for entry in cache.clear()} == set(names.values())
    assert list(cache.folder().iterdir()) == [foreign]


def test_folder_that_cannot_be_written_only_forgets(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ACOUSTUBE_CACHE", str(tmp_path / "file" / "cache"))
    cache.store("a", ARRAYS)
    assert cache.recall("a") is None
    assert cache.entries() == []


def test_press_is_computed_once_for_all_frequencies(monkeypatch):
    """And again for another depth, another tube, or when its entry is damaged."""
    calls = []

    def counted(*arguments, **options):
        calls.append(options["depth"])
        options["mesh"] = MeshSize(through_wall=1, around=6, along=5)
        return indent(*arguments, **options)

    coarse = MeshSize(through_wall=1, around=6, along=5)
    recalled = mechanics.restored
    monkeypatch.setattr(mechanics, "indent", counted)
    monkeypatch.setattr(
        mechanics, "restored", lambda *a, **o: recalled(*a, **(o | {"mesh": coarse}))
    )
    first = mechanics.pressed(Config(), [1e-4])
    again = mechanics.pressed(load_config(frequency_khz=30), [1e-4])
    assert len(calls) == 1
    assert np.array_equal(first.displacement, again.displacement)
    assert again.presses == first.presses
    mechanics.pressed(Config(), [2e-4])
    mechanics.pressed(load_config(None, Mechanics, wall_mm=1.5), [1e-4])
    assert len(calls) == 3
    for entry in cache.entries():
        entry.path.write_bytes(entry.path.read_bytes()[:500])
    repaired = mechanics.pressed(Config(), [1e-4])
    assert len(calls) == 4
    assert np.array_equal(first.displacement, repaired.displacement)
