"""Skeleton, segments and markers of a recording are where the motion has them."""

import re
from typing import cast

import numpy as np
from scipy.spatial.transform import Rotation

from legsim.kinematics.skeleton import SegmentPoses
from legsim.view import motion
from legsim.view.stream import Recorder
from tests.examples.recordings import read


def test_joint_centers_on_both_timelines(scene, written):
    centers = scene.replay.joint_centers
    times, positions = read(written, "/world/joints", "Points3D:positions")
    assert times is not None
    np.testing.assert_allclose(times, centers.times, atol=1e-9)
    np.testing.assert_allclose(np.stack(positions), centers.positions_world, atol=1e-6)
    frames, _ = read(written, "/world/joints", "Points3D:positions", "frame")
    np.testing.assert_array_equal(frames, np.arange(len(centers.times)))


def test_bones_join_the_joints_they_name(scene, written):
    centers = scene.replay.joint_centers
    _, strips = read(written, "/world/bones", "LineStrips3D:strips")
    expected = np.stack([centers.of("hip_r"), centers.of("knee_r")], 1)
    assert len(strips) == len(centers.times)
    for k in (0, 60):
        assert min(np.abs(bone - expected[k]).max() for bone in strips[k]) < 1e-6


def test_segment_poses_come_back_as_transforms(scene, written):
    _, translations = read(written, "/world/segments/tibia_r", "Transform3D:translation")
    _, quaternions = read(written, "/world/segments/tibia_r", "Transform3D:quaternion")
    poses = scene.replay.poses.of("tibia_r")
    xyzw = np.stack(quaternions)[:, 0]
    np.testing.assert_allclose(np.stack(translations)[:, 0], poses[:, :3, 3], atol=1e-6)
    np.testing.assert_allclose(Rotation.from_quat(xyzw).as_matrix(), poses[:, :3, :3], atol=1e-6)


def test_only_seen_markers_are_drawn_and_keep_their_names(scene, written):
    measured = scene.replay.measured
    _, positions = read(written, "/world/markers/measured", "Points3D:positions")
    _, labels = read(written, "/world/markers/measured", "Points3D:labels")
    seen = np.isfinite(measured.positions_world).all(-1)
    assert seen.sum() < seen.size
    for k in (0, 15, 40):
        np.testing.assert_allclose(positions[k], measured.positions_world[k, seen[k]], atol=1e-6)
        assert list(labels[k]) == [
            n for n, s in zip(measured.marker_names, seen[k], strict=True) if s
        ]


def test_residual_arrows_lead_from_measured_to_model(scene, written):
    _, vectors = read(written, "/world/markers/residual", "Arrows3D:vectors")
    _, origins = read(written, "/world/markers/residual", "Arrows3D:origins")
    seen = np.isfinite(scene.replay.measured.positions_world[20]).all(-1)
    np.testing.assert_allclose(
        origins[20] + vectors[20], scene.replay.modelled.positions_world[20, seen], atol=1e-6
    )


def test_sensors_with_slashes_in_their_names_are_not_hung_on_each_other():
    logged = []

    class Written:
        def poses(self, entity: str, *_: object) -> None:
            logged.append(entity)

        def static(self, *_: object) -> None:
            pass

    poses = SegmentPoses(np.arange(2.0), ("left", "left/a [b]"), np.tile(np.eye(4), (2, 2, 1, 1)))
    motion.log_sensors(cast(Recorder, Written()), poses)
    parts = [split(entity) for entity in logged]
    assert [len(part) for part in parts] == [3, 3]


def split(entity: str) -> list[str]:
    """Parts of an entity's path, escaped slashes kept in them."""
    return re.split(r"(?<!\\)/", entity)
