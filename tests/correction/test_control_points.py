"""Points that are followed by sensors."""

import numpy as np

from legsim.core import transforms
from legsim.correction import control_points
from legsim.correction.control_points import AttachedPoint
from legsim.kinematics.skeleton import SegmentPoses
from tests.examples.bent_leg import LEG
from tests.references.sway import Sway


def test_joints_follow_the_sensors():
    times = np.arange(30) / 31
    shank, thigh = Sway.standing(1).poses(times), Sway.standing(2).poses(times)
    poses = SegmentPoses(times, ("shank_l", "thigh_l"), np.stack([shank, thigh], 1))
    joints = [
        AttachedPoint.at_start("thigh_l", thigh[0], LEG[0]),
        *(AttachedPoint.at_start("shank_l", shank[0], LEG[k]) for k in (1, 2)),
    ]
    motion = control_points.track_points(poses, joints)
    np.testing.assert_allclose(motion.reference, LEG, atol=1e-12)
    expected = transforms.apply(shank @ transforms.inverse(shank[0]), LEG[1:])
    np.testing.assert_allclose(motion.moved[:, 1:], expected, atol=1e-12)
    drawn = control_points.contracted(motion, 1, 0.8)
    np.testing.assert_allclose(
        drawn.moved[:, 0], 0.2 * motion.moved[:, 0] + 0.8 * motion.moved[:, 1], atol=1e-15
    )
    np.testing.assert_allclose(drawn.moved[:, 1], motion.moved[:, 1], atol=1e-15)
