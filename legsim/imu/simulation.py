"""Exact signals of sensors strapped to the leg, from splines of the joint coordinates.

Nothing is differentiated numerically. Splines give rates and accelerations of the coordinates. The
leg's kinematics turns them into angular velocity and specific force of a frame on a segment (van
den Bogert et al. 1996).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, increasing_times
from legsim.imu import skin_mount as skin
from legsim.imu.clock import SensorClock
from legsim.imu.sensors import Sensor, default_sensors
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.imu.skin_mount import SkinMount
from legsim.imu.vibration import Vibration, vibrate
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg import Leg
from legsim.kinematics.leg_model import SensorMotion
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.moving_leg import MovingLeg
from legsim.kinematics.skeleton import SegmentPoses

_Each = TypeVar("_Each", SkinMount, Vibration)


def simulate_imu(
    person: MovingLeg,
    sensors: Sequence[Sensor] | None = None,
    *,
    rate_hz: float = 120.0,
    skin_mount: SkinMount | Sequence[SkinMount | None] | None = None,
    vibration: Vibration | Sequence[Vibration | None] | None = None,
    clock_offset: float = 0.0,
    clock_drift: float = 0.0,
    rng: np.random.Generator | None = None,
) -> ImuSignals:
    """Simulates noise-free sensors on a person, over the whole recording.

    Args:
        person: who moves.
        sensors: where they are strapped on; None for the two of the published study.
        rate_hz: samples per second.
        skin_mount: how the sensors swing on soft tissue, one for all or one per sensor; None fixes
            them to the bone.
        vibration: of the skin under them, one for all or one per sensor.
        clock_offset: s, the sensors' clock minus the recording's, which is the C-arm's. The times
            of the signals are shifted by it; poses and views stay in the recording's time.
        clock_drift: s per s by which the sensors' clock is fast, see
            :class:`legsim.imu.clock.SensorClock`; samples are even on that clock.
        rng: draws the vibration.

    Raises:
        LegsimError: a rate that is not positive, segments that are missing, sensor names that
            repeat, a recording too short for splines, a vibration without ``rng``, another number
            of mounts or vibrations than of sensors.

    >>> signals = simulate_imu(solve_kinematics("subject01/squat_60.trc"))
    >>> signals.sensor_names, len(signals.times)
    (('shank_l', 'thigh_l'), 2400)
    """
    if not rate_hz > 0:
        raise LegsimError(f"the rate of a sensor is {rate_hz:g} Hz; give a positive number")
    placed = default_sensors() if sensors is None else tuple(sensors)
    first, last = person.trajectories.times[[0, -1]]
    clock = SensorClock(clock_offset, clock_drift)
    times = clock.sample_times(float(first), float(last), rate_hz)
    signals = simulate(person.leg, person.splines, placed, times)
    signals = _on_skin(signals, skin_mount)
    signals = _vibrating(signals, vibration, rng)
    return replace(signals, times=clock.stamps(signals.times), sensors=placed)


def _on_skin(
    signals: ImuSignals, mounts: SkinMount | Sequence[SkinMount | None] | None
) -> ImuSignals:
    for k, mount in enumerate(_one_each("skin mounts", mounts, signals)):
        if mount is not None and mount.moves:
            signals = _with(signals, k, skin.swing(_only(signals, k), mount).signals)
    return signals


def _vibrating(
    signals: ImuSignals,
    vibrations: Vibration | Sequence[Vibration | None] | None,
    rng: np.random.Generator | None,
) -> ImuSignals:
    each = _one_each("vibrations", vibrations, signals)
    if not any(vibration is not None and vibration.moves for vibration in each):
        return signals
    if rng is None:
        raise LegsimError("vibration is drawn at random: give a numpy.random.Generator as rng")
    # a stream for each, so that no sensor's vibration depends on another's
    for k, (vibration, drawing) in enumerate(zip(each, rng.spawn(len(each)), strict=True)):
        if vibration is not None and vibration.moves:
            signals = _with(signals, k, vibrate(_only(signals, k), vibration, drawing))
    return signals


def _one_each(
    what: str, given: _Each | Sequence[_Each | None] | None, signals: ImuSignals
) -> list[_Each | None]:
    names = signals.sensor_names
    if not isinstance(given, Sequence):
        return [given] * len(names)
    if len(given) != len(names):
        raise LegsimError(
            f"{len(given)} {what} are given for {len(names)} sensors ({', '.join(names)}); give "
            "one for each, in order, or one for all"
        )
    return list(given)


def _only(signals: ImuSignals, k: int) -> ImuSignals:
    """Signals of one sensor."""
    return ImuSignals(
        signals.times,
        signals.sensor_names[k : k + 1],
        signals.angular_velocity[:, k : k + 1],
        signals.specific_force[:, k : k + 1],
    )


def _with(signals: ImuSignals, k: int, one: ImuSignals) -> ImuSignals:
    """The same signals with those of sensor ``k`` in place of its own."""
    rate, force = np.array(signals.angular_velocity), np.array(signals.specific_force)
    rate[:, k], force[:, k] = one.angular_velocity[:, 0], one.specific_force[:, 0]
    return replace(signals, angular_velocity=rate, specific_force=force)


def simulate(
    leg: Leg, splines: JointSplines, sensors: Sequence[Sensor], times: ArrayLike
) -> ImuSignals:
    """Simulates noise-free sensors at ``times`` (n,) s, exact for the splines.

    Raises:
        LegsimError: times outside the recording, coordinates or segments that are missing, sensor
            names that repeat.
    """
    times = increasing_times("sensor times", times)
    motions = [_motion(leg, splines, sensor, times) for sensor in sensors]
    rate = np.stack([motion.angular_velocity for motion in motions], 1)
    force = np.stack([motion.specific_force for motion in motions], 1)
    names = tuple(sensor.name for sensor in sensors)
    return ImuSignals(times, names, rate, force, tuple(sensors))


def sensor_poses(
    leg: Leg, splines: JointSplines, sensors: Sequence[Sensor], times: ArrayLike
) -> SegmentPoses:
    """True world_from_sensor (n, k, 4, 4), as segments under the sensors' names."""
    times = increasing_times("sensor times", times)
    poses = np.stack(
        [_motion(leg, splines, sensor, times).world_from_sensor for sensor in sensors], 1
    )
    return SegmentPoses(times, tuple(sensor.name for sensor in sensors), poses)


def true_start(leg: Leg, splines: JointSplines, sensor: Sensor, time: float) -> SensorStart:
    """True pose and velocity of a sensor at one time.

    Initialization from the projections has to find them.

    Raises:
        LegsimError: as :func:`simulate`; a sensor on a patella.
    """
    values, rates, _ = splines.at([time], leg.coordinate_names)
    site = MarkerSites(
        (sensor.name,), (sensor.segment,), sensor.segment_from_sensor[None, :3, 3], np.ones(1)
    )
    pose = _motion(leg, splines, sensor, np.array([time])).world_from_sensor[0]
    return SensorStart(pose, leg.marker_jacobians(values, site)[0, 0] @ rates[0])


def _motion(leg: Leg, splines: JointSplines, sensor: Sensor, times: FloatArray) -> SensorMotion:
    state = splines.at(times, leg.coordinate_names)
    return leg.attached_motion(
        *state, segment=sensor.segment, segment_from_sensor=sensor.segment_from_sensor
    )
