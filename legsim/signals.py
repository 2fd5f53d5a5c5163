"""Values over time: markers, joint coordinates, segment poses, IMU signals, rigid motion. Time is the first axis, in seconds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from legsim import transforms
from legsim.arrays import FloatArray, frozen, increasing_times
from legsim.errors import LegsimError

STANDARD_GRAVITY = 9.80665
"""m/s^2 in one g (3rd General Conference on Weights and Measures, 1901)"""
GRAVITY_WORLD = frozen("gravity", (0.0, -STANDARD_GRAVITY, 0.0), (3,))


def _names(kind: str, names: Sequence[str]) -> tuple[str, ...]:
    names = tuple(names)
    doubles = sorted({n for n in names if names.count(n) > 1})
    if doubles:
        raise LegsimError(f"{kind} names must differ; twice: {', '.join(doubles)}")
    return names


def _index(kind: str, names: tuple[str, ...], name: str) -> int:
    if name not in names:
        raise LegsimError(f"no {kind} named {name!r}; there are: {', '.join(names)}")
    return names.index(name)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Marker trajectories; a marker that is not seen is NaN in all three coordinates."""

    times: FloatArray
    """(n,) s"""
    marker_names: tuple[str, ...]
    positions_world: FloatArray
    """(n, m, 3) m, in world"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("Motion.times", self.times))
        object.__setattr__(self, "marker_names", _names("marker", self.marker_names))
        shape = (len(self.times), len(self.marker_names), 3)
        object.__setattr__(self, "positions_world", frozen("Motion.positions_world", self.positions_world, shape))

    @property
    def rate_hz(self) -> float:
        """Mean sampling rate."""
        return (len(self.times) - 1) / float(self.times[-1] - self.times[0])

    def marker(self, name: str) -> FloatArray:
        """Positions (n, 3) of one marker in world."""
        return self.positions_world[:, _index("marker", self.marker_names, name)]


@dataclass(frozen=True, slots=True, eq=False)
class JointTrajectories:
    """Independent coordinates of the leg model over time, under OpenSim's names."""

    times: FloatArray
    """(n,) s"""
    coordinate_names: tuple[str, ...]
    values: FloatArray
    """(n, c) rad, and m for pelvis_tx, pelvis_ty, pelvis_tz"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("JointTrajectories.times", self.times))
        object.__setattr__(self, "coordinate_names", _names("coordinate", self.coordinate_names))
        shape = (len(self.times), len(self.coordinate_names))
        object.__setattr__(self, "values", frozen("JointTrajectories.values", self.values, shape))

    def coordinate(self, name: str) -> FloatArray:
        """Values (n,) of one coordinate."""
        return self.values[:, _index("coordinate", self.coordinate_names, name)]


@dataclass(frozen=True, slots=True, eq=False)
class SegmentPoses:
    """Pose of every segment (OpenSim body) at every time."""

    times: FloatArray
    """(n,) s"""
    segment_names: tuple[str, ...]
    world_from_segment: FloatArray
    """(n, s, 4, 4)"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("SegmentPoses.times", self.times))
        object.__setattr__(self, "segment_names", _names("segment", self.segment_names))
        shape = (len(self.times), len(self.segment_names), 4, 4)
        object.__setattr__(self, "world_from_segment", frozen("SegmentPoses.world_from_segment", self.world_from_segment, shape))

    def of(self, segment: str) -> FloatArray:
        """world_from_segment (n, 4, 4) of one segment."""
        return self.world_from_segment[:, _index("segment", self.segment_names, segment)]

    def held_at(self, index: int) -> "SegmentPoses":
        """The motion-free counterpart: the pose of sample ``index`` at every time."""
        held = np.broadcast_to(self.world_from_segment[index], self.world_from_segment.shape)
        return replace(self, world_from_segment=held)


@dataclass(frozen=True, slots=True, eq=False)
class ImuSignals:
    """What strapped-down sensors read, each in its own frame."""

    times: FloatArray
    """(n,) s"""
    sensor_names: tuple[str, ...]
    angular_velocity: FloatArray
    """(n, k, 3) rad/s in the sensor frame"""
    specific_force: FloatArray
    """(n, k, 3) m/s^2 in the sensor frame: acceleration minus gravity, so +9.80665 upwards at rest"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("ImuSignals.times", self.times))
        object.__setattr__(self, "sensor_names", _names("sensor", self.sensor_names))
        shape = (len(self.times), len(self.sensor_names), 3)
        for name in ("angular_velocity", "specific_force"):
            object.__setattr__(self, name, frozen(f"ImuSignals.{name}", getattr(self, name), shape))

    def sensor(self, name: str) -> tuple[FloatArray, FloatArray]:
        """(angular_velocity (n, 3), specific_force (n, 3)) of one sensor."""
        k = _index("sensor", self.sensor_names, name)
        return self.angular_velocity[:, k], self.specific_force[:, k]


@dataclass(frozen=True, slots=True, eq=False)
class SensorStart:
    """Where a sensor is, and how fast it moves, at the first view."""

    world_from_sensor: FloatArray
    """(4, 4)"""
    velocity: FloatArray
    """(3,) m/s of the sensor's origin in world"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "world_from_sensor", frozen("SensorStart.world_from_sensor", self.world_from_sensor, (4, 4)))
        object.__setattr__(self, "velocity", frozen("SensorStart.velocity", self.velocity, (3,)))
        rotation = self.world_from_sensor[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
            raise LegsimError("SensorStart.world_from_sensor is no rigid pose: its rotation must be orthonormal and right-handed")
        if not np.isfinite(self.world_from_sensor).all() or not np.isfinite(self.velocity).all():
            raise LegsimError("SensorStart holds a number that is not finite; give the pose and velocity of the first view")


@dataclass(frozen=True, slots=True, eq=False)
class RigidMotion:
    """How everything moved against a reference time, as one rigid transform a view, in world."""

    times: FloatArray
    """(v,) s"""
    moved_from_reference: FloatArray
    """(v, 4, 4): carries a point at the reference time to where it is at times[v]"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("RigidMotion.times", self.times))
        shape = (len(self.times), 4, 4)
        object.__setattr__(self, "moved_from_reference", frozen("RigidMotion.moved_from_reference", self.moved_from_reference, shape))
        if not np.isfinite(self.moved_from_reference).all():
            bad = int(np.argwhere(~np.isfinite(self.moved_from_reference))[0, 0])
            raise LegsimError(f"RigidMotion.moved_from_reference holds a value that is not a finite number in view {bad}")

    @classmethod
    def identity(cls, times: FloatArray) -> "RigidMotion":
        """Nothing moves."""
        return cls(times, np.broadcast_to(np.eye(4), (len(times), 4, 4)))

    @classmethod
    def from_poses(cls, times: FloatArray, world_from_body: FloatArray) -> "RigidMotion":
        """Motion of a body against its first pose: M(i) = S(i) S(0)^-1, the order that is right (not the printed one)."""
        return cls(times, world_from_body @ transforms.inverse(world_from_body[0]))
