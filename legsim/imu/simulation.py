"""Exact signals of sensors strapped to the leg, from splines of the joint coordinates.

Nothing is differentiated numerically: splines give rates and accelerations of the coordinates, the
leg's kinematics turns them into angular velocity and specific force of a frame on a segment (van
den Bogert et al. 1996).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen, increasing_times
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg_model import LegModel, SensorMotion
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import SegmentPoses


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """One sensor strapped to a segment. Segment frames sit at the proximal joint with y up along
    the segment.
    """

    name: str
    segment: str
    distance: float
    """m from the segment's proximal joint (hip for the femur, knee for the tibia) along the
    segment, downwards
    """
    offset: FloatArray
    """(3,) m further, in the segment's axes (x forward, z to the subject's right): how far out on
    the skin it sits
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
        """A sensor whose axes are the segment's, turned by a rotation vector (3,) in rad."""
        return cls(
            name,
            segment,
            distance,
            np.asarray(offset, float),
            transforms.rotation_from_vector(rotation_vector),
        )

    @property
    def segment_from_sensor(self) -> FloatArray:
        """(4, 4)"""
        return transforms.rigid(
            self.segment_from_sensor_rotation, self.offset - [0.0, self.distance, 0.0]
        )


def default_sensors() -> tuple[Sensor, Sensor]:
    """The two of Maier et al. 2022, section 2.1.3: shin 14 cm below the left knee, thigh 25 cm
    below the left hip, both aligned.
    """
    return Sensor.placed("shank_l", "tibia_l", 0.14), Sensor.placed("thigh_l", "femur_l", 0.25)


def simulate(
    leg: LegModel, splines: JointSplines, sensors: Sequence[Sensor], times: ArrayLike
) -> ImuSignals:
    """What noise-free sensors read at ``times`` (n,) s, exact for the splines.

    Raises:
        LegsimError: times outside the recording, coordinates or segments that are missing, sensor
            names that repeat.
    """
    times = increasing_times("sensor times", times)
    motions = [_motion(leg, splines, sensor, times) for sensor in sensors]
    rate = np.stack([motion.angular_velocity for motion in motions], 1)
    force = np.stack([motion.specific_force for motion in motions], 1)
    return ImuSignals(times, tuple(sensor.name for sensor in sensors), rate, force)


def sensor_poses(
    leg: LegModel, splines: JointSplines, sensors: Sequence[Sensor], times: ArrayLike
) -> SegmentPoses:
    """True poses of the sensors, as segments under the sensors' names: world_from_sensor (n, k, 4,
    4).
    """
    times = increasing_times("sensor times", times)
    poses = np.stack(
        [_motion(leg, splines, sensor, times).world_from_sensor for sensor in sensors], 1
    )
    return SegmentPoses(times, tuple(sensor.name for sensor in sensors), poses)


def true_start(leg: LegModel, splines: JointSplines, sensor: Sensor, time: float) -> SensorStart:
    """True pose and velocity of a sensor at one time: what initialization from the projections has
    to find.

    Raises:
        LegsimError: as :func:`simulate`; a sensor on a patella.
    """
    values, rates, _ = splines.at([time], leg.coordinate_names)
    site = MarkerSites(
        (sensor.name,), (sensor.segment,), sensor.segment_from_sensor[None, :3, 3], np.ones(1)
    )
    pose = _motion(leg, splines, sensor, np.array([time])).world_from_sensor[0]
    return SensorStart(pose, leg.marker_jacobians(values, site)[0, 0] @ rates[0])


def _motion(
    leg: LegModel, splines: JointSplines, sensor: Sensor, times: FloatArray
) -> SensorMotion:
    state = splines.at(times, leg.coordinate_names)
    return leg.attached_motion(
        *state, segment=sensor.segment, segment_from_sensor=sensor.segment_from_sensor
    )
