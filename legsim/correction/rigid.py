"""Rigid corrections: the motion of a body from its poses, and the method that uses a sensor."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen, increasing_times
from legsim.correction.method import Correction, Scan
from legsim.deformation.models import RigidMotion
from legsim.imu import strapdown
from legsim.imu.strapdown import Scheme

Order = Literal["pose", "paper"]


def rigid_motion(
    times: ArrayLike, world_from_body: ArrayLike, *, order: Order = "pose"
) -> RigidMotion:
    """Computes the motion of a body against its pose at the first time, from its poses.

    Args:
        times: (v,) s.
        world_from_body: (v, 4, 4) of a sensor, a segment, anything rigid. Any frame fixed in the
            body gives the same motion.
        order: "pose" is M(i) = S(i) S(0)^-1, which carries the first pose to the current one.
            "paper" is the recursion M(i+1) = M(i) Dg(i) with Dg(i) = S(i+1) S(i)^-1 as published in
            Maier et al. 2022, section 2.5: it multiplies from the wrong side and misses by a third
            of a millimeter for a few millimeters of sway.

    Raises:
        LegsimError: a wrong shape, times that do not increase, or an unknown order.
    """
    times = increasing_times("motion times", times)
    poses = frozen("world_from_body", world_from_body, (len(times), 4, 4))
    if order == "pose":
        return RigidMotion.from_poses(times, poses)
    if order == "paper":
        return RigidMotion(times, _paper_product(poses))
    raise LegsimError(f"unknown order {order!r} of the rigid motion; known: pose, paper")


def _paper_product(poses: FloatArray) -> FloatArray:
    motion = np.empty_like(poses)
    motion[0] = np.eye(4)
    changes = poses[1:] @ transforms.inverse(poses[:-1])
    for i, change in enumerate(changes):
        motion[i + 1] = motion[i] @ change
    return motion


def sensor_path(scan: Scan, sensor: str, scheme: Scheme = "accurate") -> FloatArray:
    """Poses world_from_sensor (v, 4, 4) at the views, from that sensor's signals and its start."""
    return strapdown.integrate(
        *scan.signals.samples(sensor), scan.start(sensor), scan.times, scheme=scheme
    )


@dataclass(frozen=True, slots=True)
class Uncorrected:
    """Everything as recorded: the baseline of every comparison.

    >>> Uncorrected()(scan).motion is None
    True
    """

    def __call__(self, scan: Scan, /) -> Correction:
        return Correction("uncorrected", scan.projections, None)


@dataclass(frozen=True, slots=True)
class Rigid:
    """Rigid motion of the segment that carries one sensor.

    Images stay as recorded; the back-projection follows the matrices P(i) M(i).

    >>> Rigid("shank_l")(scan).motion
    RigidMotion(248 views)
    """

    sensor: str = ""
    """the sensor to follow; empty: the first one of the scan"""
    scheme: Scheme = "accurate"
    """of the integration; "paper" is the published recursion"""
    order: Order = "pose"
    """of the product of rigid changes; "paper" is the published one"""

    def __call__(self, scan: Scan, /) -> Correction:
        sensor = scan.sensor(self.sensor)
        motion = rigid_motion(scan.times, sensor_path(scan, sensor, self.scheme), order=self.order)
        name = "rigid" if self.order == "pose" else "rigid-paper-order"
        return Correction(name, scan.projections, motion)
