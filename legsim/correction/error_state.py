"""What may be wrong with one strapped-down sensor, and what that does to its poses.

A sensor's path is the integral of its signals from a start. Both are a little wrong: tilt, heading,
velocity and place of the start; bias, scale and cross-talk of the signals; their white noise, as
hat functions over time; and the clock. All are numbers of one vector. Every number is counted in
standard deviations of what the sensor's data sheet and the start allow, so that what is known
exactly has no effect and needs no case of its own.

First-order propagation in world, with R the rotation, f the specific force, w the angular velocity,
df and dw the errors taken off them, phi a left rotation of R:

    phi' = -R dw,    v' = phi x (R f) - R df,    p' = v

by trapezoids at the sensor's own rate. A pose changes by the twist (phi, p + p0 x phi).
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from legsim.core import transforms
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen_owned, increasing_times
from legsim.correction.rough_start import StartErrors, turned
from legsim.imu import strapdown
from legsim.imu.bridging import about, bridged
from legsim.imu.errors import SensorErrors, TriadErrors
from legsim.imu.signals import ImuSignals, SensorStart

_START = 9
"""numbers of the start: turns 3, velocity 3, place 3"""

_KNOT_SECONDS = 0.2
"""between the knots of the white noise: what it integrates to in less is far below a pixel"""

_MARGIN = 0.3
"""s of signal kept before and after the views at least, for the splines and the clock"""

_SPLINES = 0.1
"""s of it beyond the reach of the clock"""

_STANDING_TURN = np.radians(5.0)
"""rad by which a standing person may turn over a scan: enough for a first guess of the bias"""

CLOCK_REACH = 5.0
"""standard deviations of the clock that a step of an estimate may reach; what lies beyond is never
an offset, and a recording need not go so far beyond the views
"""

_TURN_STEP, _CLOCK_STEP = 1e-6, 1e-4
"""rad and s of the central differences"""


@dataclass(frozen=True, slots=True, eq=False)
class SensorPath:
    """Poses at the views for one vector of errors, and how they change with each number."""

    poses: FloatArray
    """(v, 4, 4) world_from_sensor"""
    twists: FloatArray
    """(v, 6, n) of the poses, from the left and about world's origin: rotation, then shift"""

    def motion(self) -> FloatArray:
        """M(i) (v, 4, 4) against the first view."""
        return self.poses @ transforms.inverse(self.poses[0])

    def of_points(self, at_first_view: FloatArray) -> FloatArray:
        """Changes (v, p, 3, n) of where M(i) carries points (p, 3): dM = E(i) M - M E(0)."""
        motion = self.motion()
        first = _twisted(at_first_view, self.twists[0])
        moved = _twisted(transforms.apply(motion, at_first_view), self.twists[:, None])
        return moved - np.einsum("vij,pjn->vpin", motion[:, :3, :3], first)

    def of_attached(self, in_sensor: FloatArray) -> FloatArray:
        """Changes (v, p, 3, n) in world of points (p, 3) fixed in the sensor."""
        return _twisted(transforms.apply(self.poses, in_sensor), self.twists[:, None])

    def of_rotation(self) -> FloatArray:
        """Changes (v, 3, n) of the rotation of M(i), in rad from the left."""
        turns = self.twists[:, :3]
        return turns - np.einsum("vij,jn->vin", self.motion()[:, :3, :3], turns[0])


def _twisted(points: FloatArray, twists: FloatArray) -> FloatArray:
    """Displacement (..., 3, n) of points (..., 3) by twists (..., 6, n)."""
    return -transforms.cross_matrix(points) @ twists[..., :3, :] + twists[..., 3:, :]


@dataclass(frozen=True, slots=True, eq=False)
class ErrorState:
    """The errors of one sensor over a scan, in standard deviations: a vector of ``size``."""

    times: FloatArray
    """(m,) s of the samples about the scan"""
    rate: FloatArray
    """(m, 3) rad/s as read"""
    force: FloatArray
    """(m, 3) m/s^2 as read"""
    start: SensorStart
    views: FloatArray
    """(v,) s"""
    start_sigmas: FloatArray
    """(9,) see :class:`legsim.correction.rough_start.StartErrors`"""
    force_errors: FloatArray
    """(m, 3, k) m/s^2 per standard deviation of each error of the accelerometer"""
    rate_errors: FloatArray
    """(m, 3, k) rad/s per standard deviation of each error of the gyroscope"""
    clock_sigma: float
    """s"""
    nodes: FloatArray
    """(k,) s of samples and views from the first view to the last, where poses are propagated"""
    errors_at_nodes: tuple[FloatArray, FloatArray]
    """(k, 3, ...) both kinds of errors there"""

    @property
    def size(self) -> int:
        """Number of errors: start, accelerometer, gyroscope, clock."""
        return _START + self.force_errors.shape[-1] + self.rate_errors.shape[-1] + 1

    def first_guess(self) -> FloatArray:
        """Errors (n,) of a person who does not turn: the gyroscope's bias from its mean."""
        during = (self.times >= self.views[0]) & (self.times <= self.views[-1])
        mean = self.rate[during].mean(0)
        sigma = self.rate_errors[0, 0, 0]
        slow = _STANDING_TURN / (self.views[-1] - self.views[0])
        errors = np.zeros(self.size)
        at = _START + self.force_errors.shape[-1]
        errors[at : at + 3] = mean * sigma / (sigma**2 + slow**2)
        return errors

    def poses(self, errors: FloatArray, at: FloatArray | None = None) -> FloatArray:
        """Poses (k, 4, 4) by exact integration of the corrected signals; at the views, or ``at``.

        ``at`` begins with the first view.
        """
        rate, force = self._corrected(errors)
        wanted = self.views if at is None else at
        late = float(np.clip(errors[-1], -CLOCK_REACH, CLOCK_REACH))
        times = self.times - self.clock_sigma * late
        return strapdown.integrate(times, rate, force, self._start(errors), wanted)

    def path(self, errors: FloatArray) -> SensorPath:
        """Poses at the views and their derivatives."""
        poses = self.poses(errors, self.nodes)
        turn, shift = self._propagated(errors, poses)
        wanted = np.searchsorted(self.nodes, self.views)
        poses, turn, shift = poses[wanted], turn[wanted], shift[wanted]
        twists = np.concatenate(
            [turn, shift + transforms.cross_matrix(poses[:, :3, 3]) @ turn], axis=1
        )
        if self.clock_sigma:
            twists[..., -1] = self._by_clock(errors)
        return SensorPath(poses, twists)

    def _corrected(self, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
        of_force, of_rate = self._split(errors)
        return self.rate - self.rate_errors @ of_rate, self.force - self.force_errors @ of_force

    def _split(self, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
        end = _START + self.force_errors.shape[-1]
        return errors[_START:end], errors[end:-1]

    def _start(self, errors: FloatArray) -> SensorStart:
        by = errors[:_START] * self.start_sigmas
        pose = self.start.world_from_sensor
        rotation = turned(pose[:3, :3], by[:3])
        return SensorStart(
            transforms.rigid(rotation, pose[:3, 3] + by[6:]), self.start.velocity + by[3:6]
        )

    def _propagated(self, errors: FloatArray, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Changes (k, 3, n) of rotation and of place at the nodes."""
        nodes, rotation, count = self.nodes, poses[:, :3, :3], self.size
        force_errors, rate_errors = self.errors_at_nodes
        of_force = slice(_START, _START + self.force_errors.shape[-1])
        of_rate = slice(of_force.stop, count - 1)
        _, force = self._corrected(errors)
        up = np.einsum("nij,nj->ni", rotation, _at(nodes, self.times, force))
        turn = np.zeros((len(nodes), 3, count))
        turn[:, :, :3] = self._turn_columns(errors[:3] * self.start_sigmas[:3])
        turn[:, :, of_rate] = -_summed(nodes, rotation @ rate_errors)
        gain = -transforms.cross_matrix(up) @ turn
        gain[:, :, of_force] -= rotation @ force_errors
        speed = _summed(nodes, gain)
        speed[:, :, 3:6] += np.diag(self.start_sigmas[3:6])
        place = _summed(nodes, speed)
        place[:, :, 6:9] += np.diag(self.start_sigmas[6:9])
        return turn, place

    def _turn_columns(self, turns: FloatArray) -> FloatArray:
        """Left rotation (3, 3) of the start per standard deviation of each of its turns."""
        base, columns = self.start.world_from_sensor[:3, :3], []
        for sigma, axis in zip(self.start_sigmas[:3], np.eye(3), strict=True):
            after, before = (turned(base, turns + k * _TURN_STEP * axis) for k in (1, -1))
            change = transforms.vector_from_rotation(after @ before.T)
            columns.append(sigma * change / (2 * _TURN_STEP))
        return np.stack(columns, -1)

    def _by_clock(self, errors: FloatArray) -> FloatArray:
        """Twists (v, 6) per standard deviation of the clock's offset."""
        step = np.zeros(self.size)
        step[-1] = _CLOCK_STEP / self.clock_sigma
        after, before = self.poses(errors + step), self.poses(errors - step)
        change = after @ transforms.inverse(before)
        turn = transforms.vector_from_rotation(change[:, :3, :3])
        # to first order a twist's shift is that of world's origin, half way between both poses
        middle = 0.5 * (after + before)[:, :3, 3]
        shift = (after - before)[:, :3, 3] - np.cross(turn, middle)
        return np.concatenate([turn, shift], -1) / (2 * step[-1])


def error_state(
    signals: ImuSignals,
    sensor: str,
    start: SensorStart,
    views: FloatArray,
    errors: SensorErrors,
    start_errors: StartErrors,
    *,
    clock: float = 0.0,
) -> ErrorState:
    """Sets up the errors of one sensor.

    Args:
        signals: of the sensors, covering the views.
        sensor: which of them.
        start: pose and velocity at the first view, as far as known.
        views: (v,) s, three or more.
        errors: of the sensor, as its data sheet states them: white noise, bias, scale,
            misalignment, sensitivity to g and to temperature (1 K) count, the rest does not.
        start_errors: how far the start may be off.
        clock: s, standard deviation of the offset between the sensor's clock and the scanner's.

    Raises:
        LegsimError: fewer than three views, a clock that is no size, or views outside the
            recording.
    """
    views = increasing_times("views", views)
    if len(views) < 3:
        raise LegsimError(f"an estimate over a scan needs three views or more; got {len(views)}")
    if not (np.isfinite(clock) and clock >= 0):
        raise LegsimError(f"clock must be finite and not negative, in s; got {clock:g}")
    times, rate, force = _about_scan(signals.samples(sensor), views, CLOCK_REACH * clock)
    of_both = (
        _triad_errors(errors.accelerometer, times, views, force),
        _triad_errors(errors.gyroscope, times, views, rate),
    )
    nodes = strapdown.with_samples(views, times)
    at_nodes = _at(nodes, times, of_both[0]), _at(nodes, times, of_both[1])
    return ErrorState(
        times, rate, force, start, views, start_errors.sigmas, *of_both, clock, nodes, at_nodes
    )


def _about_scan(
    samples: tuple[FloatArray, FloatArray, FloatArray], views: FloatArray, reach: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times (m,), rates and forces (m, 3) without gaps where the clock may put the views."""
    times, rate, force = samples
    heard = np.array([views[0] - reach, views[-1] + reach])
    # a gap is filled from all that is beside it, before anything is cut off
    times, both = bridged(times, np.stack([rate, force], 1), heard)
    near = about(times, heard, max(_MARGIN - reach, _SPLINES))
    return times[near], both[near, 0], both[near, 1]


def _triad_errors(
    errors: TriadErrors, times: FloatArray, views: FloatArray, read: FloatArray
) -> FloatArray:
    """(m, 3, k) change of the readings (m, 3) by each error: bias, scale, noise over time."""
    bias = np.sqrt(
        errors.turn_on_bias**2
        + errors.instability**2
        + errors.bias_per_kelvin**2
        + (STANDARD_GRAVITY * errors.g_sensitivity) ** 2
    )
    mixing = np.full((3, 3), errors.misalignment) + np.diag(
        [errors.scale_error - errors.misalignment] * 3
    )
    # column (i, j): what axis i reads of axis j
    mixed = np.einsum("ik,ij,mj->mkij", np.eye(3), mixing, read).reshape(len(read), 3, 9)
    hats, spacing = _hats(times, views)
    # independent coefficients of this variance add up to the white noise's random walk
    size = errors.noise_density / np.sqrt(2 * spacing)
    noise = size * np.einsum("mk,ij->mikj", hats, np.eye(3)).reshape(len(read), 3, -1)
    constant = np.broadcast_to(bias * np.eye(3), (len(read), 3, 3))
    return frozen_owned(np.concatenate([constant, mixed, noise], -1))


def _hats(times: FloatArray, views: FloatArray) -> tuple[FloatArray, float]:
    """Hat functions (m, k) over the views, and the time (s) between their knots."""
    count = max(2, int(np.ceil((views[-1] - views[0]) / _KNOT_SECONDS)) + 1)
    knots = np.linspace(views[0], views[-1], count)
    spacing = float(knots[1] - knots[0])
    within = np.clip(times, views[0], views[-1])
    return np.maximum(0.0, 1 - np.abs(within[:, None] - knots) / spacing), spacing


def _at(nodes: FloatArray, times: FloatArray, values: FloatArray) -> FloatArray:
    """Values (m, ...) between the samples, by a cubic spline."""
    degree = min(3, 2 * (len(times) // 2) - 1)
    return make_interp_spline(times, values, k=degree)(nodes)


def _summed(nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Integral (k, ...) from the first node to each, by trapezoids."""
    total = np.zeros_like(values)
    np.add(values[1:], values[:-1], out=total[1:])
    total[1:] *= 0.5 * np.diff(nodes)[:, None, None]
    return np.cumsum(total, axis=0, out=total)
