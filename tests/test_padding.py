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
    """Of 2 x 5 x 9 and 1 x 10 x 9 elements, both of which are padded to 128."""
    tool = Indenter(diameter=21e-3)
    indent(Tube(), tool, depth=0.2e-3, mesh=MeshSize(through_wall=2, around=5, along=9))
    compilations.clear()
    indent(Tube(), tool, depth=0.2e-3, mesh=MeshSize(through_wall=1, around=10, along=9))
    assert not compilations
