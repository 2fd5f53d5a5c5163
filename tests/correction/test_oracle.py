from functools import cache

import numpy as np

from legsim.core import transforms
from legsim.correction import oracle
from legsim.correction.method import Scan
from legsim.correction.oracle import Oracle
from legsim.deformation.models import FieldMotion, RigidMotion
from legsim.geometry.cone_beam import Projections
from legsim.geometry.volume import VolumeGrid
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.kinematics.skeleton import SEGMENTS, SegmentPoses
from legsim.opencl import device
from legsim.phantom import leg_phantom
from legsim.phantom.leg_phantom import LegPhantom
from legsim.phantom.skinning import swing_of
from legsim.scan.c_arm import CArm


def scan() -> Scan:
    """Two views of nothing."""
    geometry = CArm.half(angles=[0.0, 0.1], shape_vu=(8, 8)).geometry([0.0, 1.0], [0.0, 0.0, 0.0])
    signals = ImuSignals(np.arange(2.0), ("s",), np.zeros((2, 1, 3)), np.zeros((2, 1, 3)))
    start = SensorStart(np.eye(4), np.zeros(3))
    return Scan(Projections(geometry, np.zeros((2, 8, 8), np.float32)), signals, (start,))


def test_it_hands_over_the_true_motion_and_leaves_images():
    given, motion = scan(), RigidMotion.identity([0.0, 1.0])
    found = Oracle(motion)(given)
    assert found.projections is given.projections
    assert (found.method, found.motion) == ("oracle", motion)


def test_a_motion_that_takes_time_is_made_when_the_method_runs():
    made: list[RigidMotion] = []

    def make() -> RigidMotion:
        made.append(RigidMotion.identity([0.0, 1.0]))
        return made[-1]

    oracle = Oracle(make, "slow")
    assert made == []
    found = oracle(scan())
    assert (found.method, found.motion) == ("slow", made[0])


@cache
def phantom() -> LegPhantom:
    return leg_phantom.load_leg_phantom()


def bent(degrees: float, tilt: float = 0.0) -> np.ndarray:
    """(13, 4, 4): the left shank and foot turned about the knee, the whole tilted."""
    poses = np.array(phantom().reference_world_from_segment)
    knee = poses[SEGMENTS.index("tibia_l")][:3, 3]
    turn = transforms.rigid(transforms.axis_rotation([0, 0, 1], np.radians(-degrees)), np.zeros(3))
    turn = transforms.translation(knee) @ turn @ transforms.translation(-knee)
    for name in ("tibia_l", "talus_l", "calcn_l", "toes_l"):
        poses[SEGMENTS.index(name)] = turn @ poses[SEGMENTS.index(name)]
    return (
        transforms.rigid(transforms.axis_rotation([1, 0, 0], np.radians(tilt)), [0.003, 0, 0.002])
        @ poses
        if tilt
        else poses
    )


def field(*poses: np.ndarray, spacing: float = 0.012) -> tuple[FieldMotion, SegmentPoses]:
    over = SegmentPoses(np.arange(float(len(poses))), SEGMENTS, np.stack(poses))
    knee = over.of("tibia_l")[0, :3, 3]
    nodes = VolumeGrid.cubic(10, 0.012, knee.tolist()).coarse(spacing)
    return oracle.phantom_motion(phantom(), over, nodes, device.open_device()), over


def test_bones_and_soft_tissue_go_where_the_phantom_has_them():
    """One degree is 0.4 mm between the joint faces, less than a node apart: most of that is resolved,
    and all of it away from the joint.
    """
    motion, poses = field(bent(30), bent(31), spacing=0.006)
    for name, bound in (
        ("femur_cortex_l", 0.05e-3),
        ("tibia_cortex_l", 0.05e-3),
        ("patella_cortex_l", 0.02e-3),
        ("skin_l", 0.1e-3),
    ):
        k = phantom().part_index(name)
        before, after = (phantom().posed(pose, SEGMENTS)[k] for pose in poses.world_from_segment)
        near = (np.abs(before - np.array(motion.grid.center)) < 0.055).all(-1)
        error = np.linalg.norm(motion.carry(before[near])[1] - after[near], axis=-1)
        assert near.sum() > 20
        assert np.sqrt((error**2).mean()) < bound, name


def test_nothing_moves_at_the_first_view_and_rigidly_where_all_moves_as_one():
    whole = bent(20)
    turned = transforms.rigid(transforms.axis_rotation([1, 0, 0], 0.01), [0.003, 0, 0.002])
    motion, _ = field(whole, turned @ whole)
    points = motion.grid.positions()
    assert np.abs(motion.displacements[0]).max() < 1e-6
    expected = transforms.apply(turned, points) - points
    np.testing.assert_allclose(motion.displacements[1].reshape(-1, 3), expected, atol=2e-6)


def test_a_swing_of_the_soft_tissue_is_in_the_field():
    """The skin goes with it, the bones do not; 4 mm, which fades out over 20 mm, is resolved to a tenth
    by nodes 6 mm apart.
    """
    swinging = leg_phantom.load_leg_phantom(swinging=True)
    names = (
        *SEGMENTS,
        *(swing_of(f"{bone}_{side}") for bone in ("femur", "tibia") for side in "lr"),
    )
    swings = [[np.eye(4)] * 4, [transforms.translation([0.004, 0.0, 0.0])] * 4]
    poses = SegmentPoses(
        np.arange(2.0), names, np.stack([np.concatenate([bent(30), swing]) for swing in swings])
    )
    center = poses.of("tibia_l")[0, :3, 3].tolist()
    nodes = VolumeGrid.cubic(10, 0.008, center).coarse(0.006)
    motion = oracle.phantom_motion(swinging, poses, nodes, device.open_device())
    for name, least, bound in (("skin_l", 2e-3, 0.4e-3), ("femur_cortex_l", 0.0, 0.02e-3)):
        k = swinging.part_index(name)
        before, after = (swinging.posed(pose, names)[k] for pose in poses.world_from_segment)
        near = (np.abs(before - np.array(motion.grid.center)) < 0.045).all(-1)
        assert np.linalg.norm(after - before, axis=-1)[near].max() >= least
        error = np.linalg.norm(motion.carry(before[near])[1] - after[near], axis=-1)
        assert np.sqrt((error**2).mean()) < bound, name
