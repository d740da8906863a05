"""Padding of arrays to few lengths and to blocks, so that all meshes share compiled code."""

import numpy as np
import pytest

from acoustube.indentation import Indenter, MeshSize, indent
from acoustube.indentation.padding import counts_of_blocks, in_blocks, padded, padded_count
from acoustube.tube import Tube


@pytest.mark.parametrize("count", [1, 63, 64, 65, 520, 1000, 1025, 20_000])
def test_counts_grow_to_few_values_by_little(count):
    """Counts grow by less than 64, or above 512 by an eighth; a padded count is unchanged."""
    larger = padded_count(count)
    assert count <= larger < count + max(64, count / 8 + 1)
    assert padded_count(larger) == larger


def test_last_row_is_repeated():
    rows = np.arange(6).reshape(3, 2)
    assert padded(rows)[:3].tolist() == rows.tolist()
    assert np.unique(padded(rows)[3:], axis=0).tolist() == [[4, 5]]
    assert len(padded(rows)) == 64


@pytest.mark.parametrize("count", [1, 64, 65, 200])
def test_blocks_hold_every_row_once_and_repeat_the_last(count):
    rows = np.arange(2 * count).reshape(count, 2)
    blocks, counts = in_blocks(rows), counts_of_blocks(count)
    assert blocks.shape == (len(counts), 64, 2)
    kept = [block[:n] for block, n in zip(blocks, counts, strict=True)]
    np.testing.assert_array_equal(np.concatenate(kept), rows)
    assert np.all(blocks[-1, counts[-1] :] == rows[-1])


def test_meshes_of_other_blocks_are_pressed_by_the_same_compiled_code(compilations):
    """Meshes of 64 and 66 elements: one and two blocks; their points are padded to one count."""
    tool = Indenter(diameter=21e-3)
    for around, along in ((8, 8), (11, 6)):
        compilations.clear()
        indent(
            Tube(), tool, depth=0.2e-3, mesh=MeshSize(through_wall=1, around=around, along=along)
        )
    assert not compilations
