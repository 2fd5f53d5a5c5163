"""Poses of one strapped-down sensor from its signals, from a known pose and velocity.

The accurate scheme integrates at the sensor's own rate, with splines through the samples and a
fourth-order rotation, and ends exactly on the wanted times; longer gaps are bridged first
(:mod:`legsim.imu.bridging`). The paper's scheme is the recursion of
Maier et al. (2020; 2022, section 2.3) as published: signals resampled to the wanted times,
everything counted per sample, the acceleration one sample late. It is kept to show the difference.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline

from legsim.core import transforms
from legsim.core.constants import GRAVITY_WORLD
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen, increasing_times
from legsim.imu.bridging import MOST, about, bridged
from legsim.imu.signals import SensorStart

Scheme = Literal["accurate", "paper"]

_HIGHEST_DEGREE = 5

_BESIDE = 128
"""samples before and after the wanted times: a quintic spline forgets 0.43 of each to the next"""

_ROUNDING = 1e-9
"""s between equal times: rounding of clocks written as text"""

# Gauss-Legendre on [0, 1]: two nodes for rates (fourth order), three for forces (sixth)
_GAUSS2 = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3)

_GAUSS3 = 0.5 + np.array([-0.5, 0.0, 0.5]) * np.sqrt(0.6)

_WEIGHT3 = np.array([5.0, 8.0, 5.0]) / 18


def integrate(
    times: ArrayLike,
    angular_velocity: ArrayLike,
    specific_force: ArrayLike,
    start: SensorStart,
    at: ArrayLike,
    *,
    scheme: Scheme = "accurate",
) -> FloatArray:
    """Integrates to world_from_sensor (k, 4, 4) at the times ``at`` (k,).

    ``start`` holds at the first of them.

    Args:
        times: (n,) s of the samples, at any rate, even or not; they need not contain ``at``.
        angular_velocity: (n, 3) rad/s in the sensor frame.
        specific_force: (n, 3) m/s^2 in the sensor frame, +9.80665 upwards at rest.
        start: pose and velocity at ``at[0]``.
        at: (k,) s, inside the recording.
        scheme: "accurate" or "paper" (see the module).

    Raises:
        LegsimError: fewer than two samples, samples that are not numbers, or times outside the
            recording.
    """
    times, at = (
        increasing_times("sensor times", times),
        increasing_times("times of the wanted poses", at),
    )
    rate = frozen("angular_velocity", angular_velocity, (len(times), 3))
    force = frozen("specific_force", specific_force, (len(times), 3))
    _check(times, rate, force, at)
    if scheme == "accurate":
        near = _near(times, at)
        times, both = bridged(times[near], np.stack([rate[near], force[near]], 1), at)
        return _accurate(times, both[:, 0], both[:, 1], start, at)
    if scheme == "paper":
        return _published(times, rate, force, start, at)
    raise LegsimError(f"unknown pose estimation scheme {scheme!r}; known: accurate, paper")


def _check(times: FloatArray, rate: FloatArray, force: FloatArray, at: FloatArray) -> None:
    if len(times) < 2 or len(at) < 1:
        raise LegsimError(
            f"pose estimation has {len(times)} samples and {len(at)} wanted times; it needs at "
            "least 2 samples and 1 time"
        )
    bad = ~(np.isfinite(rate).all(-1) & np.isfinite(force).all(-1))
    if bad.any():
        raise LegsimError(
            f"sensor sample {int(np.argmax(bad))} ({times[np.argmax(bad)]:g} s) is not a number; "
            "fill or cut the gap first"
        )
    if at[0] < times[0] - _ROUNDING or at[-1] > times[-1] + _ROUNDING:
        raise LegsimError(
            f"poses are wanted from {at[0]:.13g} to {at[-1]:.13g} s, but the sensor recorded "
            f"{times[0]:.13g} to {times[-1]:.13g} s; "
            "record longer, scan less, or fix the offset of the clocks"
        )


def _near(times: FloatArray, at: FloatArray) -> slice:
    """Samples (of n) that decide the poses at ``at``, to rounding: of a long recording, those of a
    scan, and beside them what its gaps are bridged by and what its splines remember.
    """
    during = (times[1:] > at[0]) & (times[:-1] < at[-1])
    steps = np.diff(times)
    missing = float(steps[during].max(initial=0.0) / np.median(steps))
    return about(times, at, 0.0, 2 * min(int(np.ceil(missing)), MOST) + _BESIDE)


def with_samples(at: FloatArray, times: FloatArray) -> FloatArray:
    """The wanted times ``at`` and the samples between them, but for those that are one of them."""
    between = times[(times > at[0]) & (times < at[-1])]
    after = np.searchsorted(at, between)  # the wanted times around each sample
    apart = np.minimum(at[after] - between, between - at[after - 1]) > _ROUNDING
    return np.union1d(at, between[apart])


def _accurate(
    times: FloatArray, rate: FloatArray, force: FloatArray, start: SensorStart, at: FloatArray
) -> FloatArray:
    rate_spline, force_spline = _interpolating(times, rate), _interpolating(times, force)
    # steps never cross a sample (a knot) or a wanted time, so that each sees one polynomial
    nodes = with_samples(at, times)
    begin, length = nodes[:-1], np.diff(nodes)
    rotations = _chained(start.world_from_sensor[:3, :3], _turn(rate_spline, begin, length))
    velocity_gain, position_gain = np.zeros((len(length), 3)), np.zeros((len(length), 3))
    for fraction, weight in zip(_GAUSS3, _WEIGHT3, strict=True):
        world_from_then = rotations[:-1] @ _turn(rate_spline, begin, fraction * length)
        acceleration = (
            np.einsum("nij,nj->ni", world_from_then, force_spline(begin + fraction * length))
            + GRAVITY_WORLD
        )
        velocity_gain += weight * length[:, None] * acceleration
        position_gain += weight * (1 - fraction) * length[:, None] ** 2 * acceleration
    velocities = _accumulated(start.velocity, velocity_gain)
    positions = _accumulated(
        start.world_from_sensor[:3, 3], velocities[:-1] * length[:, None] + position_gain
    )
    wanted = np.searchsorted(nodes, at)
    return transforms.rigid(rotations[wanted], positions[wanted])


def _interpolating(times: FloatArray, values: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Builds a spline of odd degree through all samples, quintic where there are six of them."""
    degree = min(_HIGHEST_DEGREE, 2 * (len(times) // 2) - 1)
    return make_interp_spline(times, values, k=degree)


def _turn(
    rate: Callable[[FloatArray], FloatArray], begin: FloatArray, length: FloatArray
) -> FloatArray:
    """Rotation (n, 3, 3) accumulated from ``begin`` over ``length``.

    Fourth-order Magnus with two Gauss nodes (Iserles et al. 2000). For R' = R [w]x the commutator
    term is + sqrt(3)/12 h^2 (w1 x w2): the coning correction.
    """
    first, second = (rate(begin + node * length) for node in _GAUSS2)
    span = length[:, None]
    return transforms.rotation_from_vector(
        span / 2 * (first + second) + np.sqrt(3) / 12 * span**2 * np.cross(first, second)
    )


def _chained(first: FloatArray, steps: FloatArray) -> FloatArray:
    """Running product (n + 1, 3, 3): first, first @ steps[0], ..."""
    rotations = np.empty((len(steps) + 1, 3, 3))
    rotations[0] = first
    for k, step in enumerate(steps):
        rotations[k + 1] = rotations[k] @ step
    return rotations


def _accumulated(first: FloatArray, gains: FloatArray) -> FloatArray:
    """Running sum (n + 1, 3) that starts at ``first``."""
    return np.concatenate([first[None], first + np.cumsum(gains, 0)])


def _published(
    times: FloatArray, rate: FloatArray, force: FloatArray, start: SensorStart, at: FloatArray
) -> FloatArray:
    """The paper's recursion: omega in rad per sample, a and g in m/sample^2, v in m/sample.

    Samples are at the rate of ``at``.
    """
    resampled_rate = np.stack([np.interp(at, times, rate[:, k]) for k in range(3)], -1)
    resampled_force = np.stack([np.interp(at, times, force[:, k]) for k in range(3)], -1)
    poses = np.empty((len(at), 4, 4))
    poses[0] = start.world_from_sensor
    steps = np.diff(at)
    local_velocity = poses[0, :3, :3].T @ start.velocity * (steps[0] if len(steps) else 0.0)
    for k, step in enumerate(steps):
        turn = transforms.rotation_from_vector(resampled_rate[k] * step)
        poses[k + 1] = poses[k] @ transforms.rigid(turn, local_velocity)
        gravity = poses[k, :3, :3].T @ GRAVITY_WORLD
        following = steps[k + 1] if k + 1 < len(steps) else step
        # the ratio corrects m/sample where views are not evenly spaced; on an even clock it is
        # 1, as in the paper
        local_velocity = (
            turn.T
            @ ((resampled_force[k] + gravity) * step**2 + local_velocity)
            * (following / step)
        )
    return poses
