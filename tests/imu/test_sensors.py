"""Sensors and where they are strapped to the leg."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.imu import simulation
from legsim.imu.sensors import Sensor, default_sensors
from legsim.kinematics import joint_splines
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.mocap.trajectories import JointTrajectories

TIMES = np.arange(60) / 60


def squat() -> JointTrajectories:
    """Knees bent a little more at every sample, and the whole turning."""
    bend = 0.5 + 0.1 * TIMES
    angles = {"hip_flexion": 0.5 * bend, "knee_angle": -bend, "ankle_angle": 0.5 * bend}
    values = np.zeros((len(TIMES), len(COORDINATES)))
    values[:, COORDINATES.index("pelvis_rotation")] = 0.05 * TIMES
    for name, angle in angles.items():
        for side in "lr":
            values[:, COORDINATES.index(f"{name}_{side}")] = angle
    return JointTrajectories(TIMES, COORDINATES, values)


@pytest.mark.parametrize("side", ["left", "right"])
def test_default_sensors_sit_where_the_paper_puts_them(side):
    leg, splines, end = LegModel.load(), JointSplines(squat()), side[0]
    sensors = default_sensors(side)
    poses, segments = (
        simulation.sensor_poses(leg, splines, sensors, TIMES),
        joint_splines.segment_poses_at(leg, splines, TIMES),
    )
    for sensor, segment, distance in (("shank", "tibia", 0.14), ("thigh", "femur", 0.25)):
        held, carrier = poses.of(f"{sensor}_{end}"), segments.of(f"{segment}_{end}")
        offset = transforms.inverse(carrier) @ held
        np.testing.assert_allclose(
            offset,
            np.broadcast_to(transforms.translation([0, -distance, 0]), offset.shape),
            atol=1e-9,
        )
        assert (held[:, 1, 3] < carrier[:, 1, 3]).all()


def test_what_is_no_side_is_refused():
    with pytest.raises(LegsimError, match="side is 'l'; give left or right"):
        default_sensors("l")  # type: ignore[arg-type]


def test_a_sensor_goes_down_the_segment_then_out_and_turns():
    sensor = Sensor.placed("s", "tibia_l", 0.1, (0.02, 0.01, 0.03), (0.0, np.pi / 2, 0.0))
    np.testing.assert_allclose(sensor.segment_from_sensor[:3, 3], [0.02, 0.01 - 0.1, 0.03])
    np.testing.assert_allclose(
        sensor.segment_from_sensor[:3, :3] @ [1, 0, 0], [0, 0, -1], atol=1e-12
    )


def test_refuses_sensors_that_are_no_frames():
    with pytest.raises(LegsimError, match="right-handed"):
        Sensor("s", "tibia_l", 0.1, np.zeros(3), np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(LegsimError, match="finite number"):
        Sensor.placed("s", "tibia_l", np.nan)
