"""Inertial sensors and where they are strapped to the leg."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """One sensor strapped to a segment.

    Segment frames are at the proximal joint with y up along the segment.
    """

    name: str
    segment: str
    distance: float
    """m downwards along the segment from its proximal joint (hip: femur, knee: tibia)"""
    offset: FloatArray
    """(3,) m further, in the segment's axes: how far out on the skin it is

    The x axis points forward, z to the subject's right.
    """
    segment_from_sensor_rotation: FloatArray
    """(3, 3); the identity where the sensor is aligned with the segment"""

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "offset", frozen(f"offset of sensor {self.name!r}", self.offset, (3,))
        )
        rotation = frozen(
            f"rotation of sensor {self.name!r}", self.segment_from_sensor_rotation, (3, 3)
        )
        object.__setattr__(self, "segment_from_sensor_rotation", rotation)
        if (
            not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
            or np.linalg.det(rotation) < 0
        ):
            raise LegsimError(
                f"rotation of sensor {self.name!r} is not orthonormal and right-handed"
            )
        if not np.isfinite(self.distance) or not np.isfinite(self.offset).all():
            raise LegsimError(
                f"sensor {self.name!r} has a distance or an offset that is not a finite number"
            )

    @classmethod
    def placed(
        cls,
        name: str,
        segment: str,
        distance: float,
        offset: ArrayLike = (0.0, 0.0, 0.0),
        rotation_vector: ArrayLike = (0.0, 0.0, 0.0),
    ) -> "Sensor":
        """Builds a sensor whose axes are the segment's, turned by a rotation vector (3,) in rad."""
        return cls(
            name,
            segment,
            distance,
            np.asarray(offset, float),
            transforms.rotation_from_vector(rotation_vector),
        )

    @property
    def segment_from_sensor(self) -> FloatArray:
        """Pose of the sensor in its segment, (4, 4)."""
        return transforms.rigid(
            self.segment_from_sensor_rotation, self.offset - [0.0, self.distance, 0.0]
        )


def default_sensors(side: Literal["left", "right"] = "left") -> tuple[Sensor, Sensor]:
    """Shank and thigh sensor of the published study, on the leg of ``side``.

    Maier et al. 2022, section 2.1.3: 14 cm below the knee and 25 cm below the hip, both aligned
    with their segment.

    Raises:
        LegsimError: an unknown side.
    """
    if side not in ("left", "right"):
        raise LegsimError(f"sensors are on one leg, and side is {side!r}; give left or right")
    end = side[0]
    return (
        Sensor.placed(f"shank_{end}", f"tibia_{end}", 0.14),
        Sensor.placed(f"thigh_{end}", f"femur_{end}", 0.25),
    )
