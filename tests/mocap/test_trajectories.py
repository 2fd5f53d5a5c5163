import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.deformation.models import RigidMotion
from legsim.imu.signals import ImuSignals
from legsim.kinematics.skeleton import SegmentPoses
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories


def test_rate_is_the_mean_rate():
    assert MarkerTrajectories(
        np.arange(5) / 120, ("a",), np.zeros((5, 1, 3))
    ).rate_hz == pytest.approx(120)


def test_values_copy_what_they_are_given():
    positions = np.zeros((2, 1, 3))
    motion = MarkerTrajectories([0, 1], ("a",), positions)
    positions[:] = 5
    assert (motion.positions_world == 0).all()


def test_things_are_found_by_name():
    motion = MarkerTrajectories([0, 1], ("a", "b"), np.arange(12.0).reshape(2, 2, 3))
    np.testing.assert_array_equal(motion.marker("b"), [[3, 4, 5], [9, 10, 11]])
    with pytest.raises(LegsimError, match="unknown marker 'c'; known: a, b"):
        motion.marker("c")
    trajectories = JointTrajectories([0, 1], ("knee_angle_l",), [[1], [2]])
    np.testing.assert_array_equal(trajectories.coordinate("knee_angle_l"), [1, 2])
    signals = ImuSignals([0], ("s",), [[[1, 2, 3]]], [[[4, 5, 6]]])
    np.testing.assert_array_equal(signals.sensor("s"), [[[1, 2, 3]], [[4, 5, 6]]])


def test_held_poses_are_one_pose_for_ever():
    poses = SegmentPoses([0, 1], ("a",), transforms.translation([[[1.0, 0, 0]], [[2.0, 0, 0]]]))
    np.testing.assert_array_equal(poses.held_at(1).of("a")[:, 0, 3], [2, 2])


def test_motion_of_a_body_carries_its_reference_pose_to_each_later_one(rng):
    poses = transforms.rigid(
        transforms.rotation_from_vector(rng.normal(size=(4, 3))), rng.normal(size=(4, 3))
    )
    motion = RigidMotion.from_poses(np.arange(4.0), poses)
    np.testing.assert_allclose(motion.moved_from_reference @ poses[0], poses, atol=1e-14)
    np.testing.assert_allclose(
        RigidMotion.identity(np.arange(4.0)).moved_from_reference, np.tile(np.eye(4), (4, 1, 1))
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: MarkerTrajectories([0, 0], ("a",), np.zeros((2, 1, 3))), "must increase strictly"),
        (
            lambda: MarkerTrajectories([0, np.nan], ("a",), np.zeros((2, 1, 3))),
            "not a number, or too large a one, at index 1",
        ),
        (lambda: MarkerTrajectories([0, 1], ("a", "a"), np.zeros((2, 2, 3))), "repeated: a"),
        (
            lambda: MarkerTrajectories([0, 1], ("a",), np.zeros((2, 3, 1))),
            r"shape \(2, 3, 1\); expected \(2, 1, 3\)",
        ),
        (lambda: RigidMotion([0, 1], np.zeros((1, 4, 4))), r"expected \(2, 4, 4\)"),
    ],
)
def test_impossible_values_are_refused(make, message):
    with pytest.raises(LegsimError, match=message):
        make()


def test_a_motion_of_no_numbers_is_refused():
    matrices = np.tile(np.eye(4), (3, 1, 1))
    matrices[2, 0, 3] = np.nan
    with pytest.raises(LegsimError, match="not a finite number in view 2"):
        RigidMotion(np.arange(3.0), matrices)
