"""The tube's material constants, and sizes that are refused."""

import numpy as np
import pytest
from refusals import refused

from acoustube.tube import Tube, shear_modulus_from_shore


def test_shore_35_has_the_papers_shear_modulus():
    """The paper rounds to 0.5074 MPa; the tolerance is half of the last digit."""
    assert shear_modulus_from_shore(35.0) == pytest.approx(0.5074e6, abs=50.0)
    assert Tube().shear_modulus == shear_modulus_from_shore(35.0)


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.int8])
def test_shear_modulus_of_hardnesses_does_not_depend_on_their_type(kind):
    found = shear_modulus_from_shore(np.array([20, 35], kind))
    assert found == pytest.approx([shear_modulus_from_shore(20), shear_modulus_from_shore(35)])


def test_bulk_modulus_of_silicone_is_50_shear_moduli():
    """nu = 0.49: K / mu = 2 x 1.49 / 0.06 = 49.67. nu = 0 leaves K = 2 mu / 3."""
    tube = Tube(poisson_ratio=0.49)
    assert tube.bulk_modulus / tube.shear_modulus == pytest.approx(49.67, abs=0.005)
    assert Tube(poisson_ratio=0.0, shear_modulus=3.0).bulk_modulus == pytest.approx(2.0)


@pytest.mark.parametrize("name", ["inner_diameter", "wall_thickness", "length", "shear_modulus"])
@pytest.mark.parametrize("value", [0.0, -1e-3, np.nan, np.inf])
def test_impossible_sizes_are_refused_by_name(name, value):
    assert str(refused(lambda: Tube(**{name: value}), setting=name).value) == str(value)


@pytest.mark.parametrize("value", [0.5, -0.1, np.nan])
def test_impossible_poisson_ratio_is_refused(value):
    refused(lambda: Tube(poisson_ratio=value), setting="poisson_ratio", allowed=(0, 0.4999))
