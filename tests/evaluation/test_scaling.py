"""Which values become 0 and 1, and which volumes have no scale."""

from typing import get_args

import numpy as np
import pytest

from legsim.config.reconstruction import EvaluationConfig
from legsim.core.errors import LegsimError
from legsim.evaluation import scaling
from legsim.evaluation.scaling import Scaling, value_range
from legsim.evaluation.ssim import WINDOWS

GRID_VALUES = np.arange(-50, 1050, dtype=np.float32)
INSIDE = np.arange(0, 1001, dtype=np.float32)


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("reference", -50, 1049),
        ("extremes", -50, 1049),
        ("reference-leg", 0, 1000),
        ("percentiles", 5, 995),
    ],
)
def test_each_scaling_has_its_range(name, low, high):
    found = value_range(GRID_VALUES, INSIDE, name, "volume")
    assert (found.low, found.high) == pytest.approx((low, high))
    np.testing.assert_allclose(found.scaled(np.array([low, high], np.float32)), [0, 1], atol=1e-6)


def test_the_settings_offer_what_there_is_in_words():
    fields = EvaluationConfig.model_fields
    assert get_args(fields["scaling"].annotation) == get_args(Scaling) == tuple(scaling.SCALINGS)
    assert get_args(fields["window"].annotation) == tuple(WINDOWS)


@pytest.mark.parametrize("name", get_args(Scaling))
@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.full(9, 3.0, np.float32), "the volume is 3 everywhere inside the regions"),
        (np.array([0, np.nan, 1], np.float32), "not numbers inside the regions"),
        (np.array([0, np.inf, 1], np.float32), "not numbers inside the regions"),
    ],
)
def test_what_has_no_scale_is_refused(name, values, message):
    with pytest.raises(LegsimError, match=message):
        value_range(GRID_VALUES, values, name, "volume")


def test_a_hole_outside_the_regions_spoils_the_range_over_the_grid_alone():
    holed = np.append(GRID_VALUES, np.float32(np.nan))
    with pytest.raises(LegsimError, match=r"outside the regions.*\"reference-leg\""):
        value_range(holed, INSIDE, "reference", "reference")
    assert value_range(holed, INSIDE, "reference-leg", "reference").high == 1000
