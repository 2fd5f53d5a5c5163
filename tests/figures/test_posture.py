"""A still shows one frame from three sides in one scale."""

import io
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from legsim import figures
from legsim.core import transforms
from legsim.kinematics.skeleton import SegmentPoses
from tests.examples import scene as example_scene


def decoded(figure: Figure) -> np.ndarray:
    with Image.open(io.BytesIO(figures.png(figure, dpi=60))) as picture:
        return np.asarray(picture.convert("RGB"))


@pytest.fixture(scope="module")
def scan():
    return example_scene.scan_scene()


@pytest.fixture(scope="module")
def replay(scan):
    return scan.replay


def test_the_still_shows_the_frame_asked_for_with_the_subjects_right_on_the_left(replay):
    figure = figures.still(replay, 0.25)
    front = figure.axes[2]
    joints = next(line for line in front.lines if line.get_label() == "joint center")
    frame = round(0.25 * 120)
    np.testing.assert_allclose(
        np.asarray(joints.get_xdata()), -replay.joint_centers.positions_world[frame, :, 2]
    )
    np.testing.assert_allclose(
        np.asarray(joints.get_ydata()), replay.joint_centers.positions_world[frame, :, 1]
    )
    assert "0.250 s" in figure.get_suptitle()


def test_the_stills_views_turn_with_the_body(replay):
    """All three pictures of somebody who faces elsewhere are the same but for the floor's lines."""
    turn = transforms.rigid(transforms.rotation_from_vector([0, np.radians(137), 0]), np.zeros(3))
    upright = np.broadcast_to(np.eye(4), (len(replay.poses.times), 1, 4, 4))
    poses = np.concatenate([upright, replay.poses.world_from_segment], 1)
    names = ("pelvis", *replay.poses.segment_names)
    ahead = replace(replay, poses=SegmentPoses(replay.poses.times, names, poses))
    turned = replace(
        ahead,
        poses=SegmentPoses(replay.poses.times, names, turn @ poses),
        joint_centers=replace(
            replay.joint_centers,
            positions_world=transforms.apply(turn, replay.joint_centers.positions_world),
        ),
    )
    drawn = [
        [
            line.get_xydata()
            for ax in figures.still(scene, 0.25).axes
            for line in ax.lines
            if line.get_label() == "joint center"
        ]
        for scene in (ahead, turned)
    ]
    np.testing.assert_allclose(np.asarray(drawn[0]), np.asarray(drawn[1]), atol=1e-12)


def test_all_pictures_of_a_still_have_one_scale(replay):
    figure = figures.still(replay, 0.25)
    figures.png(figure)  # lays it out
    scales = [
        np.hypot(*(ax.transData.transform((0, 1)) - ax.transData.transform((0, 0))))
        for ax in figure.axes
    ]
    np.testing.assert_allclose(scales, scales[0], rtol=1e-3)


def test_a_still_needs_only_joint_centers(replay):
    bare = replace(replay, measured=None, modelled=None, sensor_poses=None, segment_meshes=())
    assert decoded(figures.still(bare, 0.0)).std() > 2
    assert decoded(figures.marker_residuals(bare)).std() > 2
