"""The numbers of a measured scan's page."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.report.measured_page import SHARPNESS_COLUMNS, Sharpness, largest_turn


def test_rows_stand_beside_the_uncorrected_scan():
    before = Sharpness("uncorrected", 12.5, None, None, 1.0)
    after = Sharpness("rigid", 12.25, 3.21, 0.5, 2.0)
    assert before.row(before) == ("uncorrected", "12.5000", "–", "–", "–", "1.0")
    assert after.row(before) == ("rigid", "12.2500", "-0.2500", "3.21", "0.500", "2.0")
    assert len(SHARPNESS_COLUMNS) == len(after.row(before))


def test_the_largest_turn_is_that_of_the_farthest_view():
    angles = np.radians([0.0, 2.0, -3.0])
    turned = transforms.axis_rotation([1, 2, 3], angles)
    assert largest_turn(transforms.rigid(turned, np.zeros(3))) == pytest.approx(3.0)
