"""Points attached to sensors: paths of hip, knee and ankle as the sensors move."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen
from legsim.deformation.models import ControlPointMotion
from legsim.kinematics.skeleton import SegmentPoses


@dataclass(frozen=True, slots=True, eq=False)
class AttachedPoint:
    """A point that a sensor carries with it: a joint whose position in the sensor is known."""

    sensor: str
    position_sensor: FloatArray
    """(3,) m in the sensor frame"""

    def __post_init__(self) -> None:
        object.__setattr__(
            self,
            "position_sensor",
            frozen(f"point at sensor {self.sensor!r}", self.position_sensor, (3,)),
        )

    @classmethod
    def at_start(
        cls, sensor: str, world_from_sensor: ArrayLike, point_world: ArrayLike
    ) -> "AttachedPoint":
        """World position (3,) of the point for the sensor's pose (4, 4)."""
        return cls(
            sensor,
            transforms.apply(
                transforms.inverse(world_from_sensor), np.reshape(point_world, (1, 3))
            )[0],
        )


def track_points(poses: SegmentPoses, points: Sequence[AttachedPoint]) -> ControlPointMotion:
    """Moves the points with the sensors' ``poses`` (under the sensors' names).

    The reference is the first view.
    """
    moved = np.stack(
        [
            transforms.apply(poses.of(point.sensor), point.position_sensor[None])[:, 0]
            for point in points
        ],
        1,
    )
    return ControlPointMotion(poses.times, moved[0], moved)


def contracted(motion: ControlPointMotion, center: int, alpha: float) -> ControlPointMotion:
    """Contracts the motion: all points are drawn to one of them, (1 - alpha) x + alpha x_center.

    It is for joints that lie off the detector. The paper takes alpha = 0.8 and the knee as the
    center for its deformation of the projections.

    Raises:
        LegsimError: alpha outside [0, 1), where points would coincide.
    """
    if not 0 <= alpha < 1:
        raise LegsimError(
            f"control points can be drawn to the knee by 0 <= alpha < 1; got {alpha:g}"
        )
    reference, moved = (
        (1 - alpha) * p + alpha * p[..., center, None, :] for p in (motion.reference, motion.moved)
    )
    return ControlPointMotion(motion.times, reference, moved)
