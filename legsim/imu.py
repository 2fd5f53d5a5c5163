"""Exact signals of sensors strapped to the leg, from splines of the joint coordinates.

Nothing is differentiated numerically: splines give rates and accelerations of the coordinates, the leg's kinematics turns them
into angular velocity and specific force of a frame on a segment (van den Bogert et al. 1996).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_interp_spline

from legsim import transforms
from legsim.anatomy import MarkerSites
from legsim.arrays import FloatArray, frozen, increasing_times
from legsim.errors import LegsimError
from legsim.leg import Leg, SensorMotion
from legsim.signals import ImuSignals, JointTrajectories, SegmentPoses, SensorStart

_ROUNDING = 1e-9
"""s by which a time may lie outside the recording: clocks written as text"""


@dataclass(frozen=True, slots=True, eq=False)
class JointSplines:
    """Quintic splines through every sample of the joint coordinates: four continuous derivatives, two of them used.

    Raises:
        LegsimError: fewer than six samples, or a sample that is not a number.
    """

    trajectories: JointTrajectories
    _spline: BSpline

    def __init__(self, trajectories: JointTrajectories) -> None:
        count, values = len(trajectories.times), trajectories.values
        if count < 6:
            raise LegsimError(f"the motion has {count} samples; splines with accelerations need at least 6: record longer")
        if not np.isfinite(values).all():
            row, column = np.argwhere(~np.isfinite(values))[0]
            name = trajectories.coordinate_names[column]
            raise LegsimError(f"coordinate {name} is not a number at {trajectories.times[row]:g} s; fill or cut the gap first")
        object.__setattr__(self, "trajectories", trajectories)
        object.__setattr__(self, "_spline", make_interp_spline(trajectories.times, values, k=5))

    def at(self, times: ArrayLike, coordinate_names: Sequence[str]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Values, rates and accelerations, each (n, c), of the named coordinates at any times (n,) of the recording.

        Raises:
            LegsimError: a time before the first or after the last sample, or a coordinate that was not recorded.
        """
        times = np.asarray(times, float)
        first, last = self.trajectories.times[[0, -1]]
        if len(times) and not (times.min() >= first - _ROUNDING and times.max() <= last + _ROUNDING):
            raise LegsimError(
                f"times from {times.min():g} to {times.max():g} s are wanted of a motion recorded from {first:g} to {last:g} s; "
                "choose a start and a length of the scan inside it"
            )
        known = self.trajectories.coordinate_names
        missing = [name for name in coordinate_names if name not in known]
        if missing:
            raise LegsimError(f"the motion lacks the coordinates {', '.join(missing)}; it has: {', '.join(known)}")
        columns = [known.index(name) for name in coordinate_names]
        inside = np.clip(times, first, last)
        return self._spline(inside)[:, columns], self._spline(inside, 1)[:, columns], self._spline(inside, 2)[:, columns]


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """One sensor strapped to a segment. Segment frames sit at the proximal joint with y up along the segment."""

    name: str
    segment: str
    distance: float
    """m from the segment's proximal joint (hip for the femur, knee for the tibia) along the segment, downwards"""
    offset: FloatArray
    """(3,) m further, in the segment's axes (x forward, z to the subject's right): how far out on the skin it sits"""
    segment_from_sensor_rotation: FloatArray
    """(3, 3); the identity where the sensor is aligned with the segment"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "offset", frozen(f"offset of sensor {self.name!r}", self.offset, (3,)))
        rotation = frozen(f"rotation of sensor {self.name!r}", self.segment_from_sensor_rotation, (3, 3))
        object.__setattr__(self, "segment_from_sensor_rotation", rotation)
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9) or np.linalg.det(rotation) < 0:
            raise LegsimError(f"rotation of sensor {self.name!r} is not orthonormal and right-handed")
        if not np.isfinite(self.distance) or not np.isfinite(self.offset).all():
            raise LegsimError(f"sensor {self.name!r} has a distance or an offset that is not a finite number")

    @classmethod
    def placed(
        cls, name: str, segment: str, distance: float, offset: ArrayLike = (0.0, 0.0, 0.0), rotation_vector: ArrayLike = (0.0, 0.0, 0.0)
    ) -> "Sensor":
        """A sensor whose axes are the segment's, turned by a rotation vector (3,) in rad."""
        return cls(name, segment, distance, np.asarray(offset, float), transforms.rotation_from_vector(rotation_vector))

    @property
    def segment_from_sensor(self) -> FloatArray:
        """(4, 4)"""
        return transforms.rigid(self.segment_from_sensor_rotation, self.offset - [0.0, self.distance, 0.0])


def default_sensors() -> tuple[Sensor, Sensor]:
    """The two of Maier et al. 2022, section 2.1.3: shin 14 cm below the left knee, thigh 25 cm below the left hip, both aligned."""
    return Sensor.placed("shank_l", "tibia_l", 0.14), Sensor.placed("thigh_l", "femur_l", 0.25)


def simulate(leg: Leg, splines: JointSplines, sensors: Sequence[Sensor], times: ArrayLike) -> ImuSignals:
    """What noise-free sensors read at ``times`` (n,) s, exact for the splines.

    Raises:
        LegsimError: times outside the recording, coordinates or segments that are missing, sensor names that repeat.
    """
    times = increasing_times("sensor times", times)
    motions = [_motion(leg, splines, sensor, times) for sensor in sensors]
    rate = np.stack([motion.angular_velocity for motion in motions], 1)
    force = np.stack([motion.specific_force for motion in motions], 1)
    return ImuSignals(times, tuple(sensor.name for sensor in sensors), rate, force)


def sensor_poses(leg: Leg, splines: JointSplines, sensors: Sequence[Sensor], times: ArrayLike) -> SegmentPoses:
    """True poses of the sensors, as segments under the sensors' names: world_from_sensor (n, k, 4, 4)."""
    times = increasing_times("sensor times", times)
    poses = np.stack([_motion(leg, splines, sensor, times).world_from_sensor for sensor in sensors], 1)
    return SegmentPoses(times, tuple(sensor.name for sensor in sensors), poses)


def true_start(leg: Leg, splines: JointSplines, sensor: Sensor, time: float) -> SensorStart:
    """True pose and velocity of a sensor at one time: what initialization from the projections has to find.

    Raises:
        LegsimError: as :func:`simulate`; a sensor on a patella.
    """
    values, rates, _ = splines.at([time], leg.coordinate_names)
    site = MarkerSites((sensor.name,), (sensor.segment,), sensor.segment_from_sensor[None, :3, 3], np.ones(1))
    pose = _motion(leg, splines, sensor, np.array([time])).world_from_sensor[0]
    return SensorStart(pose, leg.marker_jacobians(values, site)[0, 0] @ rates[0])


def segment_poses_at(leg: Leg, splines: JointSplines, times: ArrayLike) -> SegmentPoses:
    """Poses of all segments at any times of the recording, such as those of the views; no pose is interpolated."""
    times = increasing_times("view times", times)
    names = leg.coordinate_names
    return leg.segment_poses(JointTrajectories(times, names, splines.at(times, names)[0]))


def _motion(leg: Leg, splines: JointSplines, sensor: Sensor, times: FloatArray) -> SensorMotion:
    state = splines.at(times, leg.coordinate_names)
    return leg.attached_motion(*state, segment=sensor.segment, segment_from_sensor=sensor.segment_from_sensor)
