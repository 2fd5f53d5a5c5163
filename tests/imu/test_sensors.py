"""Sensors on their segments."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.imu import simulation
from legsim.imu.sensors import Sensor, default_sensors
from legsim.kinematics import joint_splines
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg_model import LegModel
from tests.examples.sway_of_joints import swaying

VIEWS = 0.3 + np.arange(248) / 31


@pytest.fixture(scope="module")
def leg() -> LegModel:
    return LegModel.load()


def test_default_sensors_sit_where_the_paper_puts_them(leg: LegModel):
    splines = JointSplines(swaying(leg))
    poses, segments = (
        simulation.sensor_poses(leg, splines, default_sensors(), VIEWS),
        joint_splines.segment_poses_at(leg, splines, VIEWS),
    )
    for sensor, segment, distance in (("shank_l", "tibia_l", 0.14), ("thigh_l", "femur_l", 0.25)):
        offset = transforms.inverse(segments.of(segment)) @ poses.of(sensor)
        np.testing.assert_allclose(
            offset,
            np.broadcast_to(transforms.translation([0, -distance, 0]), offset.shape),
            atol=1e-9,
        )
        assert (poses.of(sensor)[:, 1, 3] < segments.of(segment)[:, 1, 3]).all()


def test_refuses_sensors_that_are_no_frames():
    with pytest.raises(LegsimError, match="right-handed"):
        Sensor("s", "tibia_l", 0.1, np.zeros(3), np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(LegsimError, match="finite number"):
        Sensor.placed("s", "tibia_l", np.nan)
