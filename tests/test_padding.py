"""Padding of element arrays, by which meshes of different size share compiled code."""

import numpy as np
import pytest

from acoustube.indentation import Indenter, MeshSize, indent
from acoustube.indentation.padding import padded, padded_count
from acoustube.tube import Tube


@pytest.mark.parametrize("count", [1, 63, 64, 65, 520, 1000, 1025, 20_000])
def test_counts_grow_to_few_values_by_little(count):
    """By less than 64, or above 512 by an eighth; and a padded count stays."""
    larger = padded_count(count)
    assert count <= larger < count + max(64, count / 8 + 1)
    assert padded_count(larger) == larger


def test_last_row_is_repeated():
    rows = np.arange(6).reshape(3, 2)
    assert padded(rows)[:3].tolist() == rows.tolist()
    assert np.unique(padded(rows)[3:], axis=0).tolist() == [[4, 5]]
    assert len(padded(rows)) == 64


def test_meshes_of_like_size_are_pressed_by_the_same_compiled_code(compilations):
    """Of 64 and of 60 elements, both of which are padded to 64."""
    tool = Indenter(diameter=21e-3)
    for around, along in ((8, 8), (10, 6)):
        compilations.clear()
        indent(
            Tube(), tool, depth=0.2e-3, mesh=MeshSize(through_wall=1, around=around, along=along)
        )
    assert not compilations
