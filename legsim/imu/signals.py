"""IMU signals and the pose and velocity from which their integration starts."""

from dataclasses import dataclass

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen, increasing_times, index_of, unique_names
from legsim.imu.sensors import Sensor


@dataclass(frozen=True, slots=True, eq=False)
class ImuSignals:
    """Signals of strapped-down sensors, each in its own frame."""

    times: FloatArray
    """(n,) s"""
    sensor_names: tuple[str, ...]
    angular_velocity: FloatArray
    """(n, k, 3) rad/s in the sensor frame"""
    specific_force: FloatArray
    """(n, k, 3) m/s^2 in the sensor frame: acceleration minus gravity

    It is +9.80665 upwards at rest.
    """
    sensors: tuple[Sensor, ...] = ()
    """where the sensors are strapped on, in the order of their names; empty where unknown"""
    rest_force: FloatArray | None = None
    """(k, 3) m/s^2: mean specific force at rest in the pose of the first view, from which the
    starts are levelled; None without a calibration at rest
    """

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("ImuSignals.times", self.times))
        object.__setattr__(self, "sensor_names", unique_names("sensor", self.sensor_names))
        shape = (len(self.times), len(self.sensor_names), 3)
        for name in ("angular_velocity", "specific_force"):
            object.__setattr__(self, name, frozen(f"ImuSignals.{name}", getattr(self, name), shape))
        object.__setattr__(self, "sensors", tuple(self.sensors))
        if self.rest_force is not None:
            rest = frozen("ImuSignals.rest_force", self.rest_force, shape[1:])
            object.__setattr__(self, "rest_force", rest)
        placed = tuple(sensor.name for sensor in self.sensors)
        if placed and placed != self.sensor_names:
            raise LegsimError(
                f"the signals are of {', '.join(self.sensor_names)}, the placed sensors are "
                f"{', '.join(placed)}; give one for each, in order"
            )

    def __repr__(self) -> str:
        seconds = self.times[-1] - self.times[0]
        names = ", ".join(self.sensor_names)
        return f"ImuSignals({names}: {len(self.times)} samples over {seconds:.4g} s)"

    def sensor(self, name: str) -> tuple[FloatArray, FloatArray]:
        """(angular_velocity (n, 3), specific_force (n, 3)) of one sensor."""
        k = index_of("sensor", self.sensor_names, name)
        return self.angular_velocity[:, k], self.specific_force[:, k]

    def samples(self, name: str) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(times (m,), angular_velocity (m, 3), specific_force (m, 3)) that one sensor has.

        Lost samples are left out: those without any reading. One that lacks only some is kept, so
        that the integration refuses it.
        """
        rate, force = self.sensor(name)
        there = ~(np.isnan(rate).all(-1) & np.isnan(force).all(-1))
        if there.all():
            return self.times, rate, force
        return self.times[there], rate[there], force[there]


@dataclass(frozen=True, slots=True, eq=False)
class SensorStart:
    """Pose and velocity of a sensor at the first view."""

    world_from_sensor: FloatArray
    """(4, 4)"""
    velocity: FloatArray
    """(3,) m/s of the sensor's origin in world"""

    def __post_init__(self) -> None:
        object.__setattr__(
            self,
            "world_from_sensor",
            frozen("SensorStart.world_from_sensor", self.world_from_sensor, (4, 4)),
        )
        object.__setattr__(self, "velocity", frozen("SensorStart.velocity", self.velocity, (3,)))
        rotation = self.world_from_sensor[:3, :3]
        if (
            not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
            or np.linalg.det(rotation) < 0
        ):
            raise LegsimError(
                "SensorStart.world_from_sensor is not a rigid pose: its rotation must be "
                "orthonormal and right-handed"
            )
        if not np.isfinite(self.world_from_sensor).all() or not np.isfinite(self.velocity).all():
            raise LegsimError(
                "SensorStart holds a number that is not finite; give the pose and velocity of the "
                "first view"
            )
