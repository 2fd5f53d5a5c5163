"""Joints that two sensors carry, and the corrections that follow them."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction import control_points, nonrigid
from legsim.correction.control_points import AttachedPoint
from legsim.correction.method import Scan
from legsim.correction.nonrigid import NonRigid2D, NonRigid3D
from legsim.deformation.models import ControlPointMotion, FieldMotion, RigidMotion
from legsim.geometry.cone_beam import Projections
from legsim.geometry.volume import VolumeGrid
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.scan.c_arm import CArm
from tests.references.sway import Sway

VIEWS = np.arange(62) / 7.75
SAMPLES = np.arange(966) / 120
SWAY = Sway.standing(3, position_mm=8.0, angle_deg=1.5)
KNEE = SWAY.center
JOINTS = KNEE + np.array([[-0.1, 0.4, 0.0], [0, 0, 0], [-0.05, -0.4, 0.02]])
CARRIERS = ("thigh_l", "shank_l", "shank_l")


def true_motion() -> RigidMotion:
    return RigidMotion.from_poses(VIEWS, SWAY.poses(VIEWS))


@pytest.fixture(scope="module")
def scan() -> Scan:
    """Two sensors on one body that sways as a whole; their frames differ. The images are random."""
    rate, force = SWAY.signals(SAMPLES)
    start = SensorStart(SWAY.poses(VIEWS[:1])[0], SWAY.velocities(VIEWS[:1])[0])
    turned = transforms.rotation_from_vector([0.3, -0.5, 0.2])
    thigh = SensorStart(
        start.world_from_sensor @ transforms.rigid(turned, np.zeros(3)), start.velocity
    )
    signals = ImuSignals(
        SAMPLES,
        ("shank_l", "thigh_l"),
        np.stack([rate, rate @ turned], 1),
        np.stack([force, force @ turned], 1),
    )
    poses = dict(zip(signals.sensor_names, (start, thigh), strict=True))
    points = tuple(
        AttachedPoint.at_start(s, poses[s].world_from_sensor, p)
        for s, p in zip(CARRIERS, JOINTS, strict=True)
    )
    arm = CArm.paper(
        angles=np.radians(3.2) * np.arange(62), shape_vu=(24, 31), pixel_pitch=12.32e-3
    )
    images = np.random.default_rng(0).random((62, 24, 31), np.float32)
    return Scan(
        Projections(arm.geometry(VIEWS, KNEE), images), signals, (start, thigh), joints=(points,)
    )


def test_joints_on_one_body_go_where_it_goes(scan: Scan):
    (leg,) = nonrigid.joint_motions(scan)
    np.testing.assert_allclose(leg.reference, JOINTS, atol=1e-12)
    np.testing.assert_allclose(leg.moved, true_motion().carry(JOINTS), atol=1e-5)


def test_the_published_integration_is_followed_where_it_is_asked_for(scan: Scan):
    accurate, paper = (
        nonrigid.joint_motions(scan, scheme)[0].moved for scheme in ("accurate", "paper")
    )
    assert np.abs(accurate - paper).max() > 1e-4
    followed = NonRigid3D(scheme="paper")(scan).motion
    assert isinstance(followed, ControlPointMotion)
    np.testing.assert_array_equal(followed.moved, paper)


def test_three_points_are_followed_as_they_are_and_images_stay(scan: Scan):
    found = NonRigid3D()(scan)
    assert found.projections is scan.projections
    assert isinstance(found.motion, ControlPointMotion)
    np.testing.assert_array_equal(found.motion.moved, nonrigid.joint_motions(scan)[0].moved)


def test_more_control_points_are_sampled_and_say_the_same(scan: Scan):
    """A field between nodes 3 cm apart is linear: a turn of 3 degrees bends by microns."""
    extra = AttachedPoint.at_start(
        "shank_l", scan.start("shank_l").world_from_sensor, KNEE - [0, 0.2, 0]
    )
    more = replace(scan, joints=((*scan.joints[0], extra),))
    found = NonRigid3D(VolumeGrid.cubic(48, 4e-3, KNEE.tolist()).coarse(0.03))(more)
    assert isinstance(found.motion, FieldMotion)
    points = KNEE + 0.06 * np.eye(3)
    true = true_motion().carry(points)
    np.testing.assert_allclose(found.motion.carry(points), true, atol=2e-5)
    with pytest.raises(LegsimError, match=r"follows 4 points here, .* give nodes"):
        NonRigid3D()(more)


def test_both_legs_are_drawn_each_to_its_own_knee(scan: Scan):
    other = tuple(
        AttachedPoint(p.sensor, p.position_sensor + np.array([0, 0, 0.2])) for p in scan.joints[0]
    )
    both = replace(scan, joints=(scan.joints[0], other))
    found = NonRigid2D()(both)
    assert found.warped_by is not None
    each = [
        control_points.contracted(leg, 1, nonrigid.PAPER_ALPHA).moved
        for leg in nonrigid.joint_motions(both)
    ]
    np.testing.assert_allclose(found.warped_by.moved, np.concatenate(each, 1))


def test_images_are_warped_and_voxels_stay(scan: Scan):
    found = NonRigid2D()(scan)
    assert found.motion is None
    first, last = (
        np.abs(found.projections.line_integrals[k] - scan.projections.line_integrals[k]).max()
        for k in (0, -1)
    )
    assert first < 1e-4
    assert last > 0.01


def test_a_scan_that_knows_no_joint_is_refused(scan: Scan):
    for method in (NonRigid2D(), NonRigid3D()):
        with pytest.raises(LegsimError, match="knows their place on no sensor"):
            method(replace(scan, joints=()))
