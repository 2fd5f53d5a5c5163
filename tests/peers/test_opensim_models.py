"""Legs read from OpenSim models move as OpenSim moves them (pip install opensim; python -m pytest
-m peer).
"""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.kinematics import osim_file
from legsim.kinematics.osim_leg import OsimLeg
from legsim.kinematics.skeleton import JOINT_CENTERS
from legsim.mocap.trajectories import JointTrajectories

pytestmark = [pytest.mark.peer, pytest.mark.filterwarnings("ignore::DeprecationWarning")]
POSTURES = 500
MODELS = (
    "gait2392_thelen2003muscle",
    "gait2392_subject01_scaled",
    "gait10dof18musc",
    "FullBodyModel_Hamner2010_v2_0",
    "Rajagopal2016",
)
CENTER_OF = {"hip": "femur", "knee": "tibia", "ankle": "talus"}


@pytest.fixture(scope="session")
def opensim_peer():
    pytest.importorskip("opensim", reason="pip install opensim")
    from tools.benchmarks.peers import opensim_kinematics as opensim_peer

    return opensim_peer


@pytest.mark.parametrize("name", MODELS)
def test_bodies_markers_and_centers_agree_in_random_postures(opensim_peer, shared_data, rng, name):
    path = shared_data / f"opensim/{name}.osim"
    theirs = opensim_peer.random_postures(path, POSTURES, rng)
    leg = OsimLeg(osim_file.read(path))
    columns = [theirs.coordinates.index(n) for n in leg.coordinate_names]
    values = theirs.values[:, columns]
    ours = leg.body_poses(values)
    assert set(ours) >= {"pelvis", "femur_r", "tibia_l", "talus_r", "calcn_l", "toes_r"}
    for body, pose in ours.items():
        away = pose[:, :3, 3] - theirs.bodies[body][:, :3, 3]
        assert np.linalg.norm(away, axis=-1).max() < 0.05e-3
        turned = np.swapaxes(pose[:, :3, :3], 1, 2) @ theirs.bodies[body][:, :3, :3]
        assert np.degrees(transforms.rotation_angle(turned).max()) < 0.01
    times = np.arange(POSTURES, dtype=float)
    poses = leg.segment_poses(JointTrajectories(times, leg.coordinate_names, values))
    centers = leg.joint_centers(poses)
    for center in JOINT_CENTERS:
        joint, side = center.split("_")
        true = theirs.centers[f"{CENTER_OF[joint]}_{side}"]
        assert np.linalg.norm(centers.of(center) - true, axis=-1).max() < 0.05e-3
    sites, _ = leg.marker_sites()
    for k, marker in enumerate(sites.names):
        away = leg.marker_positions(values, sites)[:, k] - theirs.markers[marker]
        assert np.abs(away).max() < 0.05e-3
