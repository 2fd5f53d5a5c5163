"""Points attached to sensors: where hip, knee and ankle go while the sensors that carry them
move.
"""

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
    """A point that a sensor carries with it: a joint whose place relative to the sensor is
    known.
    """

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
        """The point (3,) of world that the sensor, at its pose (4, 4) of the same moment,
        carries.
        """
        return cls(
            sensor,
            transforms.apply(
                transforms.inverse(world_from_sensor), np.reshape(point_world, (1, 3))
            )[0],
        )


def track_points(poses: SegmentPoses, points: Sequence[AttachedPoint]) -> ControlPointMotion:
    """Where the points go as the sensors' ``poses`` (under the sensors' names) say; at rest they
    are as in the first view.
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
    """The same motion with all points drawn to one of them, (1 - alpha) x + alpha x_center: joints
    that lie off the detector.

    The paper takes alpha = 0.8 and the knee as the center for its deformation of the projections.

    Raises:
        LegsimError: alpha outside [0, 1), where points would fall together.
    """
    if not 0 <= alpha < 1:
        raise LegsimError(
            f"control points can be drawn to the knee by 0 <= alpha < 1; got {alpha:g}"
        )
    reference, moved = (
        (1 - alpha) * p + alpha * p[..., center, None, :] for p in (motion.reference, motion.moved)
    )
    return ControlPointMotion(motion.times, reference, moved)
