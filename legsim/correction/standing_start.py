"""Start of a sensor on a person who stands: tilt and velocity that keep him where he is.

Where a sensor's pose at the first view is known roughly only, gravity and the scan's length say the
rest. Integrated from a tilt that is off by e, the sensor runs away by g e t^2 / 2; from a velocity
that is off by d, by d t. A person who stands through the scan does neither, so that both are chosen
to leave no such trend over the views. What cannot be known from the sensor stays as given: its
place and its turn about the vertical.
"""

from dataclasses import dataclass

import numpy as np

from legsim.core import transforms
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen, increasing_times
from legsim.imu import strapdown
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.imu.strapdown import Scheme

_ROUNDS = 12
_SETTLED = 1e-10
"""rad of tilt"""

_UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class StandingStart:
    """A start that keeps the sensor in place, and what was needed for that."""

    start: SensorStart
    tilted: float
    """rad by which the given pose was turned about a horizontal axis"""
    vertical_acceleration: float
    """m/s^2 that is left along the vertical: an error of the accelerometer's scale or bias"""


def standing_start(
    signals: ImuSignals,
    sensor: str,
    rough_pose: FloatArray,
    views: FloatArray,
    *,
    scheme: Scheme = "accurate",
) -> StandingStart:
    """Finds tilt and velocity at the first view from a rough pose.

    Args:
        signals: of the sensors, covering the views.
        sensor: which of them.
        rough_pose: (4, 4) world_from_sensor at the first view; its tilt may be off by any angle.
        views: (v,) s.
        scheme: of the integration that will be used over the scan.

    Raises:
        LegsimError: fewer than three views, or views outside the recording.
    """
    views, (times, rate, force) = increasing_times("views", views), signals.samples(sensor)
    if len(views) < 3:
        raise LegsimError(f"a standing start needs three views or more; got {len(views)}")
    pose = np.array(frozen("rough pose", rough_pose, (4, 4)))
    pose[:3, :3] = _upright(pose[:3, :3], times, force, views) @ pose[:3, :3]
    velocity, trend = np.zeros(3), np.zeros(3)
    for _ in range(_ROUNDS):
        path = strapdown.integrate(
            times, rate, force, SensorStart(pose, np.zeros(3)), views, scheme=scheme
        )[:, :3, 3]
        velocity, trend = _trends(views, path)
        # a world acceleration a to the side is gravity seen through a tilt of a / g
        turn = np.cross(trend, _UP) / STANDARD_GRAVITY
        if np.linalg.norm(turn) < _SETTLED:
            break
        pose[:3, :3] = transforms.rotation_from_vector(turn) @ pose[:3, :3]
    tilted = np.arccos(np.clip(_tilt_between(rough_pose, pose), -1, 1))
    return StandingStart(SensorStart(pose, -velocity), float(tilted), float(trend[1]))


def _upright(
    rotation: FloatArray, times: FloatArray, force: FloatArray, views: FloatArray
) -> FloatArray:
    """The smallest turn (3, 3) that puts the mean specific force over the views upwards."""
    during = (times >= views[0]) & (times <= views[-1])
    seen = rotation @ force[during].mean(0)
    seen = seen / np.linalg.norm(seen)
    axis = np.cross(seen, _UP)
    sine, cosine = float(np.linalg.norm(axis)), float(seen @ _UP)
    if sine < 1e-12:
        axis = np.array([1.0, 0.0, 0.0])
    return transforms.axis_rotation(axis, np.array(np.arctan2(sine, cosine)))


def _trends(views: FloatArray, path: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Velocity (3,) at the first view and acceleration (3,) of the parabola through a path."""
    since = views - views[0]
    design = np.stack([np.ones_like(since), since, 0.5 * since**2], -1)
    (_, velocity, acceleration), *_ = np.linalg.lstsq(design, path, rcond=None)
    return velocity, acceleration


def _tilt_between(before: FloatArray, after: FloatArray) -> float:
    """Cosine of the angle between the directions that both poses give the vertical."""
    return float((before[:3, :3].T @ _UP) @ (after[:3, :3].T @ _UP))
