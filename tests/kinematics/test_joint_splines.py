"""Splines of the joint coordinates: values, rates and accelerations at any time."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.kinematics import joint_splines
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg_model import LegModel
from legsim.mocap.trajectories import JointTrajectories
from tests.examples.sway_of_joints import TIMES, swaying


@pytest.fixture(scope="module")
def leg() -> LegModel:
    return LegModel.load()


def test_splines_pass_through_every_sample(leg: LegModel):
    given = swaying(leg)
    values, _, _ = JointSplines(given).at(TIMES, leg.coordinate_names)
    np.testing.assert_allclose(values, given.values, atol=1e-12)


def test_splines_rates_and_accelerations_match_the_sines():
    wave = np.sin(4 * TIMES)
    splines = JointSplines(JointTrajectories(TIMES, ("a", "b"), np.stack([wave, wave**2], -1)))
    at = np.linspace(0, TIMES[-1], 777)
    _, rates, accelerations = splines.at(at, ("b", "a"))
    np.testing.assert_allclose(
        rates, np.stack([4 * np.sin(8 * at), 4 * np.cos(4 * at)], -1), atol=1e-6
    )
    np.testing.assert_allclose(
        accelerations, np.stack([32 * np.cos(8 * at), -16 * np.sin(4 * at)], -1), atol=5e-4
    )


def test_segment_poses_are_exact_at_any_time(leg: LegModel):
    splines = JointSplines(swaying(leg))
    at = np.array([0.1234, 3.21])
    expected = leg.segment_poses(
        JointTrajectories(at, leg.coordinate_names, splines.at(at, leg.coordinate_names)[0])
    )
    np.testing.assert_array_equal(
        joint_splines.segment_poses_at(leg, splines, at).world_from_segment,
        expected.world_from_segment,
    )


def test_refuses_motions_too_short_or_with_gaps(leg: LegModel):
    given = swaying(leg)
    with pytest.raises(LegsimError, match=r"has 5 samples; .* at least 6"):
        JointSplines(JointTrajectories(TIMES[:5], given.coordinate_names, given.values[:5]))
    broken = given.values.copy()
    broken[7, 3] = np.nan
    with pytest.raises(
        LegsimError, match=rf"coordinate {given.coordinate_names[3]} is not a number at 0\.0583"
    ):
        JointSplines(JointTrajectories(TIMES, given.coordinate_names, broken))
