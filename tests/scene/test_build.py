"""Scenes built from the values of the stages."""

import numpy as np
import pytest

from legsim.imu import simulation
from legsim.imu.sensors import Sensor
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.mocap.trajectories import JointTrajectories
from legsim.scene import build
from legsim.scene.values import ReplayScene

SENSOR = Sensor.placed("shank_l", "tibia_l", 0.14, (0.02, 0.0, 0.0))


@pytest.fixture(scope="module")
def standing() -> ReplayScene:
    """A leg at rest."""
    times = np.arange(60) / 60
    still = JointTrajectories(times, COORDINATES, np.zeros((60, len(COORDINATES))))
    moving = MovingLeg("rest", LegModel.load(), still, fit=None)
    signals = simulation.simulate(moving.leg, moving.splines, (SENSOR,), times)
    return build.replay_scene(moving, signals)


def test_bones_lie_at_their_joints_and_stand_on_the_floor(standing):
    meshes = {mesh.name: mesh for mesh in standing.segment_meshes}
    assert set(meshes) == {
        f"{bone}_cortex_{side}" for bone in ("patella", "femur", "tibia", "fibula") for side in "lr"
    }
    knee = standing.joint_centers.of("knee_l")[0]
    tibia = meshes["tibia_cortex_l"]
    pose = standing.poses.of(tibia.segment)[0]
    top = (tibia.vertices @ pose[:3, :3].T + pose[:3, 3])[:, 1].max()
    assert abs(top - knee[1]) < 0.03
    assert -0.05 < standing.floor_height - standing.poses.of("toes_l")[0, 1, 3] < 0


def test_without_markers_nothing_is_measured(standing):
    assert standing.measured is None
    assert standing.modelled is None
