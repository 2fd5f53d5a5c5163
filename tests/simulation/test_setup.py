"""A person in the C-arm: the scanned knee on the axis, sensors and joints where they truly are."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu import simulation
from legsim.simulation.setup import PhantomOptions, Side, joints_on_sensors, prepare_scan
from tests.examples.standing_person import c_arm, person


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_axis_passes_through_the_scanned_knee_at_the_first_view(side: Side):
    setup = prepare_scan(person(), c_arm(), side=side)
    knee = setup.person.leg.joint_centers(setup.poses).of(setup.named("knee"))[0]
    np.testing.assert_allclose(setup.geometry.rotation_center()[[0, 2]], knee[[0, 2]], atol=1e-9)
    assert [s.segment for s in setup.sensors] == [setup.named("tibia"), setup.named("femur")]


def test_a_point_to_turn_about_can_be_given():
    center = np.array([0.3, 0.2, -0.4])
    setup = prepare_scan(person(), c_arm(), center=center)
    np.testing.assert_allclose(setup.geometry.rotation_center(), center, atol=1e-9)


def test_followed_joints_are_the_true_ones_carried_by_their_sensors():
    setup = prepare_scan(person(), c_arm())
    (leg,) = joints_on_sensors(setup)
    poses = simulation.sensor_poses(
        setup.person.leg, setup.person.splines, setup.sensors, setup.times[:2]
    )
    centers = setup.person.leg.joint_centers(setup.poses)
    for point, joint in zip(leg, ("hip_l", "knee_l", "ankle_l"), strict=True):
        pose = poses.of(point.sensor)[0]
        place = pose[:3, :3] @ point.position_sensor + pose[:3, 3]
        np.testing.assert_allclose(place, centers.of(joint)[0], atol=1e-9)


def test_the_scanned_leg_alone_has_no_part_of_the_other():
    setup = prepare_scan(person(), c_arm(), phantom=PhantomOptions(legs="scanned"))
    assert not any(part.name.endswith("_r") for part in setup.phantom.phantom.parts)


def test_what_does_not_fit_together_is_refused():
    with pytest.raises(LegsimError, match="give left or right"):
        prepare_scan(person(), c_arm(), side="both")  # type: ignore[arg-type]
    setup = prepare_scan(person(), c_arm())
    later = replace(setup.poses, times=setup.times + 1e-3)
    with pytest.raises(LegsimError, match="poses are those at the views"):
        replace(setup, poses=later)
