"""Motions that no scanned person makes are doubted or refused, others are not."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.deformation.models import ControlPointMotion, RigidMotion
from legsim.deformation.plausibility import objections

TIMES = np.arange(20) / 30
CENTER = np.array([0.3, 0.5, -0.2])


def raised(by: float, times: np.ndarray = TIMES) -> RigidMotion:
    moved = np.tile(np.eye(4), (len(TIMES), 1, 1))
    moved[:, 1, 3] = np.linspace(0, by, len(TIMES))
    return RigidMotion(times, moved)


def test_a_motion_of_this_scan_is_not_doubted():
    assert objections(raised(0.03), CENTER, TIMES) == ()
    assert objections(raised(0.03), CENTER, TIMES + 0.004) == ()
    assert objections(raised(0.03, TIMES + 5), CENTER, None) == ()


@pytest.mark.parametrize("times", [1e3 * TIMES, TIMES + 0.1, 0.5 * TIMES])
def test_other_times_than_the_views_are_doubted(times):
    (line,) = objections(raised(0.03, times), CENTER, TIMES)
    assert "is it of this scan?" in line


def test_more_than_anybody_moves_is_doubted_and_meters_are_refused():
    (line,) = objections(raised(0.15), CENTER, TIMES)
    assert "moves the rotation center by 150 mm" in line
    with pytest.raises(LegsimError, match="by 30 m: is it in mm"):
        objections(raised(30.0), CENTER, TIMES)


def test_any_kind_of_motion_is_looked_at():
    points = CENTER + 0.1 * np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0]])
    moved = points + np.linspace(0, 0.2, len(TIMES))[:, None, None] * np.array([0, 0, 1.0])
    assert objections(ControlPointMotion(TIMES, points, moved), CENTER, TIMES)
