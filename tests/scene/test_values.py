"""Scenes: what belongs together is checked, slices lie as their orientation labels say."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.scene.values import SegmentMesh
from tests.examples import scene as example_scene


@pytest.fixture
def replay():
    return example_scene.replay_scene(0.2)


def test_bones_whose_ends_are_not_there_are_left_out(replay):
    lines = replay.bone_lines()
    assert lines.shape == (
        25,
        11,
        2,
        3,
    )  # across the hips; thigh, shank and a triangle of the foot on each side: no pelvis
    knee, ankle = (replay.joint_centers.of(n) for n in ("knee_r", "ankle_r"))
    assert any(
        (lines[:, k, 0] == knee).all() and (lines[:, k, 1] == ankle).all()
        for k in range(lines.shape[1])
    )
    assert replace(replay, bones=()).bone_lines().shape == (25, 0, 2, 3)


def test_a_bone_may_end_at_the_origin_of_a_segment(replay):
    lines = replace(replay, bones=(("knee_r", "calcn_r"),)).bone_lines()
    np.testing.assert_array_equal(lines[:, 0, 1], replay.poses.of("calcn_r")[:, :3, 3])


def test_poses_and_joint_centers_need_the_same_times(replay):
    later = replace(replay.poses, times=replay.poses.times + 0.001)
    with pytest.raises(LegsimError, match="same times"):
        replace(replay, poses=later)


def test_residuals_are_distances_and_unknown_where_not_seen(replay):
    residuals = replay.marker_residuals()
    assert np.isnan(residuals[12, 2])
    expected = np.linalg.norm(replay.modelled.marker("M1") - replay.measured.marker("M1"), axis=-1)
    np.testing.assert_allclose(residuals[:, 1], expected)
    assert replace(replay, modelled=None).marker_residuals() is None


def test_modelled_markers_must_match_the_measured(replay):
    other = replace(replay.modelled, marker_names=tuple(f"X{k}" for k in range(12)))
    with pytest.raises(LegsimError, match="same names and times"):
        replace(replay, modelled=other)
    with pytest.raises(LegsimError, match="same names and times"):
        replace(replay, measured=None)


def test_a_mesh_needs_a_segment_with_a_pose(replay):
    mesh = SegmentMesh("patella", "patella_r", *example_scene.tube(0.01, 0.02))
    with pytest.raises(LegsimError, match=r"without a pose: patella_r; known: femur_r"):
        replace(replay, segment_meshes=(mesh,))
