import numpy as np
import pytest

from legsim.core import transforms
from legsim.deformation.models import ControlPointMotion, RigidMotion
from legsim.evaluation import residual_motion
from legsim.evaluation.residual_motion import Structure
from legsim.geometry.volume import VolumeGrid
from tests.correction.test_bead_tracking import KNEE, TIMES, VIEWS, c_arm, sway

POINTS = KNEE + 0.03 * np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])


def bone(motion: RigidMotion) -> tuple[Structure, ...]:
    return (Structure("femur", True, motion.carry(POINTS)),)


def test_the_truth_leaves_nothing():
    left = residual_motion.of_motion(sway(0), bone(sway(0)), c_arm())[0]
    assert (left.mm, left.degrees, left.pixels) == pytest.approx((0, 0, 0), abs=1e-9)


def test_a_shift_is_left_in_mm_and_pixels():
    """Along the axis of the C-arm: every view sees it whole, 1.198 / 0.78 larger."""
    shift = RigidMotion(
        TIMES, np.broadcast_to(transforms.translation([0, 0.002, 0]), (VIEWS, 4, 4))
    )
    left = residual_motion.of_motion(
        None, (Structure("tibia", True, shift.carry(POINTS)),), c_arm()
    )[0]
    # the first view is the reference: a shift of all views is none
    assert left.mm == pytest.approx(0, abs=1e-9)
    later = shift.moved_from_reference.copy()
    later[0] = np.eye(4)
    left = residual_motion.of_motion(None, bone(RigidMotion(TIMES, later)), c_arm())[0]
    share = np.sqrt((VIEWS - 1) / VIEWS)
    assert left.mm == pytest.approx(2 * share)
    assert left.degrees == pytest.approx(0, abs=1e-6)
    assert left.pixels == pytest.approx(2 * share * 1.198 / 0.78 / 1.232, rel=5e-3)


def test_a_turn_is_left_in_degrees():
    turn = transforms.rigid(transforms.rotation_from_vector(np.radians([0, 1.5, 0])), np.zeros(3))
    poses = np.broadcast_to(turn, (VIEWS, 4, 4)).copy()
    poses[0] = np.eye(4)
    left = residual_motion.of_motion(None, bone(RigidMotion(TIMES, poses)), c_arm())[0]
    assert left.degrees == pytest.approx(1.5 * np.sqrt((VIEWS - 1) / VIEWS), rel=1e-6)


def test_every_kind_of_motion_is_read():
    true = sway(1)
    controls = KNEE + 0.3 * np.eye(3)
    followed = ControlPointMotion(TIMES, controls, true.carry(controls))
    field = followed.on_grid(VolumeGrid.cubic(4, 0.05, KNEE.tolist()).coarse(0.05))
    for motion in (followed, field):
        assert residual_motion.of_motion(motion, bone(true), c_arm())[0].mm == pytest.approx(
            0, abs=1e-4
        )


def test_a_warp_is_read_in_pixels_alone():
    true = sway(2)
    points = bone(true)[0].paths[0]
    exact = ControlPointMotion(TIMES, points, true.carry(points))
    left = residual_motion.of_warp(exact, bone(true), c_arm())[0]
    assert (left.mm, left.degrees) == (None, None)
    # the structure's own points are the control points
    assert left.pixels == pytest.approx(0, abs=1e-6)
    still = ControlPointMotion(TIMES, points, np.broadcast_to(points, (VIEWS, *points.shape)))
    assert residual_motion.of_warp(still, bone(true), c_arm())[0].pixels == pytest.approx(
        residual_motion.of_motion(None, bone(true), c_arm())[0].pixels
    )


def test_bones_together():
    left = residual_motion.of_motion(
        None, (*bone(sway(0)), Structure("skin", False, sway(1).carry(POINTS))), c_arm()
    )
    assert residual_motion.overall_mm(left) == pytest.approx(left[0].mm)
    assert left[1].degrees is None
    assert (
        residual_motion.overall_mm(
            residual_motion.of_warp(
                ControlPointMotion(TIMES, POINTS, bone(sway(0))[0].paths), bone(sway(0)), c_arm()
            )
        )
        is None
    )
