"""A leg in 1/m is not doubted; the same in other units is."""

import numpy as np
import pytest

from legsim.geometry import attenuation_range
from legsim.geometry.attenuation_range import AttenuationRange


@pytest.fixture
def leg(rng) -> np.ndarray:
    """Air, soft tissue and bone with noise, and some voxels of metal."""
    values = rng.choice([0.0, 20.0, 40.0, 100.0], p=[0.5, 0.35, 0.1, 0.05], size=(20, 20, 20))
    values[0, 0, :5] = 900.0
    return values + rng.normal(0, 2.0, values.shape)


def test_a_leg_is_not_doubted(leg):
    assert attenuation_range.objection(leg) is None
    assert attenuation_range.is_attenuation(leg)


@pytest.mark.parametrize(
    ("factor", "said"), [(1e3, "as no body does"), (10, "as no body does"), (1e-3, "of water")]
)
def test_a_leg_in_another_unit_is(leg, factor, said):
    assert said in str(attenuation_range.objection(factor * leg))


def test_slabs_give_what_the_whole_gives(leg):
    slabs = AttenuationRange()
    for first in range(0, 20, 3):
        slabs.add(10 * leg[first : first + 3])
    assert slabs.objection() == attenuation_range.objection(10 * leg)


def test_hounsfield_units_and_other_units_of_length_are_no_attenuation_in_1_per_mm(leg):
    hounsfield_units = 1e3 * (leg / 20 - 1)
    assert not attenuation_range.is_attenuation(1e3 * hounsfield_units)
    assert not attenuation_range.is_attenuation(1e3 * leg)


@pytest.mark.parametrize("factor", [0.1, 10, 1e3])
def test_two_volumes_of_one_leg_have_one_unit_or_are_doubted(leg, factor, rng):
    other = leg + rng.normal(0, 5.0, leg.shape)
    assert attenuation_range.other_unit(other, leg) is None
    assert "those of the reference" in str(attenuation_range.other_unit(factor * other, leg))
