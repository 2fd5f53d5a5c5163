import numpy as np
import pytest

from legsim.evaluation.residual_motion import Residual
from legsim.evaluation.scores import MeanAndDeviation, MethodResult, spread
from legsim.evaluation.similarity import Scores


def test_equal_values_have_no_deviation():
    assert spread([0.25] * 4) == MeanAndDeviation(0.25, 0.0, 4, 0.25)


def test_the_deviation_is_that_of_a_sample():
    found = spread([1.0, 2.0, 4.0])
    assert found is not None
    assert found.mean == pytest.approx(7 / 3)
    assert found.deviation == pytest.approx(
        np.sqrt(((1 - 7 / 3) ** 2 + (2 - 7 / 3) ** 2 + (4 - 7 / 3) ** 2) / 2)
    )
    assert (found.count, found.largest) == (3, 4.0)


def test_one_value_has_no_deviation_to_tell():
    found = spread([3.0])
    assert found is not None
    assert np.isnan(found.deviation)


def test_no_values_have_no_spread():
    assert spread([]) is None


def test_pixels_are_the_bones_rms_and_the_skin_is_left_out():
    left = (
        Residual("femur", 1.0, 1.0, 3.0, 1.0),
        Residual("tibia", 1.0, 1.0, 4.0, 7.0),
        Residual("skin", 1.0, None, 99.0, 99.0),
    )
    found = MethodResult("rigid", Scores((), None, 1.0, "gaussian"), 1.0, 1.0, left)
    assert found.residual_px == pytest.approx(np.sqrt(12.5))
    assert found.residual_px_after_similarity == pytest.approx(5.0)
    bare = MethodResult("rigid", Scores((), None, 1.0, "gaussian"), 1.0, 1.0, left[2:])
    assert np.isnan([bare.residual_px, bare.residual_px_after_similarity]).all()
