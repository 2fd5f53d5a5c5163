"""Non-rigid corrections: hip, knee and ankle tracked by two sensors, space between them warped.

In 2D the images are deformed before reconstruction, in 3D the back-projection follows moving least
squares of the joints (Maier et al. 2022, sections 2.5.2 and 2.5.3).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from legsim.core.errors import LegsimError
from legsim.correction import control_points, image_warp
from legsim.correction.method import Correction, Scan
from legsim.correction.rigid import sensor_path
from legsim.deformation.models import ControlPointMotion
from legsim.geometry.volume import VolumeGrid
from legsim.imu.strapdown import Scheme
from legsim.kinematics.skeleton import SegmentPoses
from legsim.opencl.device import Device, open_device

PAPER_ALPHA = 0.8
"""Contraction of hip and ankle to the knee before projection in the study (eq. 22, 23)"""

_KNEE = 1
"""index of the knee among a leg's points"""


def joint_motions(scan: Scan, scheme: Scheme = "accurate") -> tuple[ControlPointMotion, ...]:
    """Tracks the joints of each leg by the signals of the sensors that carry them.

    Raises:
        LegsimError: the scan has no joint on a sensor.
    """
    if not scan.joints:
        raise LegsimError(
            "non-rigid methods follow hip, knee and ankle, and this scan knows their place on no "
            "sensor: configure a sensor on the femur and one on the tibia (imu.sensors)"
        )
    names = tuple(dict.fromkeys(point.sensor for leg in scan.joints for point in leg))
    poses = np.stack([sensor_path(scan, name, scheme) for name in names], 1)
    moved = SegmentPoses(scan.times, names, poses)
    return tuple(control_points.track_points(moved, leg) for leg in scan.joints)


def _together(motions: Sequence[ControlPointMotion]) -> ControlPointMotion:
    reference = np.concatenate([m.reference for m in motions])
    moved = np.concatenate([m.moved for m in motions], 1)
    return ControlPointMotion(motions[0].times, reference, moved)


@dataclass(frozen=True, slots=True)
class NonRigid2D:
    """Images warped by moving least squares of the projected joints."""

    alpha: float = PAPER_ALPHA
    """contraction of hip and ankle to the knee, 0 to below 1"""
    scheme: Scheme = "accurate"
    device: Device | None = None
    """None opens the fastest"""

    def __call__(self, scan: Scan, /) -> Correction:
        motions = joint_motions(scan, self.scheme)
        near = _together([control_points.contracted(leg, _KNEE, self.alpha) for leg in motions])
        device = self.device or open_device()
        images = image_warp.warp_images(scan.projections, near, device)
        return Correction("nonrigid-2d", images, None, warped_by=near)


@dataclass(frozen=True, slots=True)
class NonRigid3D:
    """Back-projection along moving least squares of the joints."""

    nodes: VolumeGrid | None = None
    """coarse grid over the volume, on which more control points than three are sampled"""
    scheme: Scheme = "accurate"

    def __call__(self, scan: Scan, /) -> Correction:
        motion = _together(joint_motions(scan, self.scheme))
        # the device's closed form is for three points; any other number is sampled
        if len(motion.reference) == 3:
            return Correction("nonrigid-3d", scan.projections, motion)
        if self.nodes is None:
            raise LegsimError(
                f"NonRigid3D follows {len(motion.reference)} points here, which need a coarse grid "
                "to be sampled on; give nodes, for instance grid.coarse(0.008)"
            )
        return Correction("nonrigid-3d", scan.projections, motion.on_grid(self.nodes))
