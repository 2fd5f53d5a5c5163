"""Soft tissue of the phantom that swings on the bones.

The poses of a scan are extended by the swing of each thigh and shank. A thigh's or shank's tissue
hangs on the middle of its bone by a spring and a damper and is driven by the acceleration of that
place. :mod:`legsim.phantom.skinning` decides how much of it a point takes. Gravity is left out: the
phantom's shape has its sag already.
"""

import numpy as np
from scipy.interpolate import CubicSpline

from legsim.core.constants import GRAVITY_WORLD
from legsim.core.errors import LegsimError
from legsim.imu import simulation, skin_mount
from legsim.imu.sensors import Sensor
from legsim.imu.skin_mount import SkinMount
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg import Leg
from legsim.kinematics.skeleton import SegmentPoses
from legsim.phantom.skinning import FARTHEST_SWING, swing_of

_LEAST_RATE_HZ, _SAMPLES_A_PERIOD = 120.0, 12.0


def with_swing(
    poses: SegmentPoses, leg: Leg, splines: JointSplines, tissue: SkinMount
) -> SegmentPoses:
    """Adds the shift of each bone's soft tissue to ``poses``.

    The shifts (m, in world) are further segments named by :func:`legsim.phantom.skinning.swing_of`.

    Raises:
        LegsimError: the tissue would swing farther than its layers allow.
    """
    first, last = splines.trajectories.times[[0, -1]]
    rate = max(_LEAST_RATE_HZ, _SAMPLES_A_PERIOD * tissue.frequency_hz)
    times = np.linspace(first, last, int(np.ceil((last - first) * rate)) + 1)
    middles = [
        Sensor.placed(swing_of(f"{bone}_{side}"), f"{bone}_{side}", 0.5 * length(side))
        for bone, length in (("femur", leg.thigh_length), ("tibia", leg.shank_length))
        for side in "lr"
    ]
    force = simulation.simulate(leg, splines, middles, times).specific_force
    turned = simulation.sensor_poses(leg, splines, middles, times).world_from_segment[..., :3, :3]
    acceleration = np.einsum("nkij,nkj->nki", turned, force) + GRAVITY_WORLD
    shift = skin_mount.shift(acceleration, (len(times) - 1) / float(last - first), tissue)
    at_views = CubicSpline(times, shift)(poses.times)
    farthest = float(np.linalg.norm(at_views, axis=-1).max())
    if farthest > FARTHEST_SWING:
        raise LegsimError(
            f"the phantom's soft tissue would swing {1e3 * farthest:.1f} mm; its layers allow "
            f"{1e3 * FARTHEST_SWING:.1f} mm: "
            "lower phantom.tissue_swing.amplitude or raise phantom.tissue_swing.frequency_hz"
        )
    swings = np.broadcast_to(np.eye(4), (*at_views.shape[:2], 4, 4)).copy()
    swings[..., :3, 3] = at_views
    names = (*poses.segment_names, *(middle.name for middle in middles))
    return SegmentPoses(
        poses.times, names, np.concatenate([poses.world_from_segment, swings], axis=1)
    )
