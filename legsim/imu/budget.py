"""What each error of a sensor costs in dead reckoning: a linear budget of pose errors.

The estimated orientation is exp(theta) R, the estimated velocity and position are off by v and p,
all in world. With the errors w of the angular velocity and a of the specific force, and the true
specific force f, to first order (Titterton and Weston 2004, chapter 12):

    theta' = R w,    v' = R a - [R f]x theta,    p' = v.

Integrated, p(t) is a weighted sum of all earlier errors. With W(s, t) the integral of
(t - u) [R(u) f(u)]x over u from s to t, the weights are (t - s) R(s) for a, -W(s, t) R(s) for w,
and -W(0, t) for the error of the start's orientation. A calibration subtracts weighted means of
earlier readings, so that it only changes the weights. Variances then follow for each term by
itself: constants are summed with the weights, noise is filtered backwards by its own response.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import cumulative_trapezoid, simpson
from scipy.signal import fftconvolve

from legsim.core import transforms
from legsim.core.constants import GRAVITY_WORLD, STANDARD_GRAVITY
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen, increasing_times
from legsim.imu.calibration import POSITIONS, UP, Calibration
from legsim.imu.errors import SensorErrors, TriadErrors
from legsim.imu.processes import instability_response, walk_response

START_TILT = "start-tilt"

BUDGET_TERMS = (
    *("white-noise", "turn-on-bias", "instability", "random-walk", "scale", "misalignment"),
    *("g-sensitivity", "temperature", "quantisation"),
)
"""terms of a sensor that a budget has, for gyroscope and accelerometer"""

_EVALUATIONS = 24
"""Intervals of the scan between times at which errors are evaluated for their mean"""

_MOST_SAMPLES = 1_000_000
"""Samples of a scan whose weights still fit a common memory"""

_DITHER = 0.5
"""white noise in bits above which rounding is white noise too, and below which it is constant"""


@dataclass(frozen=True, slots=True, eq=False)
class NominalMotion:
    """True motion of a sensor over a scan; the errors are linear about it."""

    times: FloatArray
    """(n,) s, even; the samples of the sensor from the first view to the last"""
    world_from_sensor: FloatArray
    """(n, 3, 3) rotations"""
    angular_velocity: FloatArray
    """(n, 3) rad/s in the sensor frame"""
    specific_force: FloatArray
    """(n, 3) m/s^2 in the sensor frame"""

    def __post_init__(self) -> None:
        times = increasing_times("NominalMotion.times", self.times)
        object.__setattr__(self, "times", times)
        if len(times) < 3 or np.ptp(np.diff(times)) > 1e-6:
            raise LegsimError("a budget needs at least 3 samples at even times")
        count = len(times)
        for name, shape in (
            ("world_from_sensor", (count, 3, 3)),
            ("angular_velocity", (count, 3)),
            ("specific_force", (count, 3)),
        ):
            object.__setattr__(self, name, frozen(name, getattr(self, name), shape))

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return (len(self.times) - 1) / float(self.times[-1] - self.times[0])

    @classmethod
    def swaying(
        cls, seconds: float, rate_hz: float, *, angle: float = 0.0, period: float = 5.0
    ) -> "NominalMotion":
        """A sensor that stays where it is, its y axis up, and turns about z, x and y as a sine.

        Args:
            seconds: of the scan.
            rate_hz: of the sensor.
            angle: rad, amplitude about each axis; 0 stands still.
            period: s of the turn about z; about x and y it is 1.3 and 1.7 times as long.
        """
        if not (np.isfinite(seconds) and np.isfinite(rate_hz) and seconds > 0 and rate_hz > 0):
            raise LegsimError(
                f"a scan of {seconds:g} s at {rate_hz:g} Hz cannot be budgeted; give positive "
                "numbers"
            )
        count = round(seconds * rate_hz) + 1
        if not (np.isfinite(angle) and count <= _MOST_SAMPLES):
            raise LegsimError(
                f"a budget of {count} samples and a sway of {angle:g} rad is out of reach; at most "
                f"{_MOST_SAMPLES} samples and a finite sway"
            )
        times = np.arange(count) / rate_hz
        rotation = np.broadcast_to(np.eye(3), (len(times), 3, 3))
        rate = np.zeros((len(times), 3))
        for axis, stretch in (([0, 0, 1], 1.0), ([1, 0, 0], 1.3), ([0, 1, 0], 1.7)):
            w = 2 * np.pi / (period * stretch)
            turn = transforms.axis_rotation(axis, angle * np.sin(w * times))
            rate = np.einsum("nji,nj->ni", turn, rate)
            rate = rate + np.multiply.outer(angle * w * np.cos(w * times), axis)
            rotation = rotation @ turn
        return cls(times, rotation, rate, np.einsum("nji,j->ni", rotation, -GRAVITY_WORLD))


@dataclass(frozen=True, slots=True)
class PoseError:
    """Expected errors of the estimated pose: roots of mean squares over the draws of a sensor."""

    translation: float
    """m, length of the vector, over the whole scan"""
    rotation: float
    """rad, over the whole scan"""
    translation_at_end: float
    """m, at the last view"""
    rotation_at_end: float
    """rad"""

    @classmethod
    def together(cls, errors: Sequence["PoseError"]) -> "PoseError":
        """Errors of independent causes: roots of sums of squares."""
        return cls(
            *(float(np.sqrt(sum(getattr(e, name) ** 2 for e in errors))) for name in cls.__slots__)
        )


@dataclass(frozen=True, slots=True)
class BudgetLine:
    """One cause of error."""

    term: str
    triad: str
    """"gyroscope", "accelerometer", or "" for the start"""
    error: PoseError


@dataclass(frozen=True, slots=True)
class BudgetConditions:
    """Under which sensors dead-reckon."""

    start_tilt: float = float(np.radians(0.1))
    """rad about each of the two horizontal axes, standard deviation; levelling replaces it"""
    temperature_change: float = 1.0
    """K off the temperature of the last calibration"""
    calibration: Calibration = field(default_factory=Calibration)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.start_tilt) and self.start_tilt >= 0):
            raise LegsimError(
                f"the start tilt must be finite and not negative; got {self.start_tilt:g} rad"
            )
        if not np.isfinite(self.temperature_change):
            raise LegsimError(
                f"the temperature change must be finite; got {self.temperature_change:g} K"
            )


def sensor_budget(
    errors: SensorErrors, motion: NominalMotion, conditions: BudgetConditions | None = None
) -> tuple[BudgetLine, ...]:
    """Budgets dead reckoning over a scan: one line per term and triad, and one for the start.

    Terms of size 0 are left out. Temperature: the sensors are off the factory's temperature by
    the given change; a calibration at rest was made before the change.

    >>> lines = sensor_budget(load_sensor("bmi160").errors, NominalMotion.swaying(8.0, 120.0))
    >>> PoseError.together([line.error for line in lines]).translation
    """
    return sensor_budgets([errors], motion, conditions)[0]


def sensor_budgets(
    sensors: Sequence[SensorErrors],
    motion: NominalMotion,
    conditions: BudgetConditions | None = None,
) -> tuple[tuple[BudgetLine, ...], ...]:
    """Budgets several sensors on one motion; see :func:`sensor_budget`."""
    given = conditions or BudgetConditions()
    budget = _Budget(motion, given)
    causes = [
        _Cause(k, term, triad, of_triad)
        for k, sensor in enumerate(sensors)
        for triad, of_triad in (
            ("gyroscope", sensor.gyroscope),
            ("accelerometer", sensor.accelerometer),
        )
        for term in BUDGET_TERMS
        if budget.has(term, of_triad)
    ]
    if given.calibration.kind == "none" and given.start_tilt:
        causes += [_Cause(k, START_TILT, "", TriadErrors()) for k in range(len(sensors))]
    found = budget.errors(causes)
    return tuple(
        tuple(
            BudgetLine(cause.term, cause.triad, error)
            for cause, error in zip(causes, found, strict=True)
            if cause.sensor == k
        )
        for k in range(len(sensors))
    )


@dataclass(frozen=True, slots=True)
class _Cause:
    """A line to come."""

    sensor: int
    term: str
    triad: str
    errors: TriadErrors


@dataclass(frozen=True, slots=True, eq=False)
class _Weights:
    """Weights of all errors in the pose at one time: position and orientation (N, 3, 3)."""

    gyroscope: tuple[FloatArray, FloatArray]
    accelerometer: tuple[FloatArray, FloatArray]
    tilt: tuple[FloatArray, FloatArray]
    """(3, 3) of the start's orientation"""


class _Budget:
    """The weights over rests and scan, and what errors of each kind make of them."""

    def __init__(self, motion: NominalMotion, given: BudgetConditions) -> None:
        self.motion, self.given = motion, given
        self.rate_hz = motion.rate_hz
        # a rest holds the pose of the first view, where gravity alone is felt
        self.rest_force = motion.world_from_sensor[0].T @ -GRAVITY_WORLD
        before = given.calibration.forces(self.rest_force, self.rate_hz)
        self.rests = len(before)
        if self.rests + len(motion.times) > _MOST_SAMPLES:
            raise LegsimError(
                f"rests of {self.rests} samples are out of reach with this scan; at most "
                f"{_MOST_SAMPLES} samples in all: rest for less time"
            )
        self.force = np.concatenate([before, motion.specific_force])
        self.rate = np.concatenate([np.zeros_like(before), motion.angular_velocity])
        self.kelvin = np.concatenate(
            [np.zeros(self.rests), np.full(len(motion.times), given.temperature_change)]
        )
        turned = transforms.cross_matrix(
            np.einsum("nij,nj->ni", motion.world_from_sensor, motion.specific_force)
        )
        seconds = (motion.times - motion.times[0])[:, None, None]
        # integrals of [R f]x and of u [R f]x
        self._zeroth = cumulative_trapezoid(turned, dx=1 / self.rate_hz, axis=0, initial=0)
        self._first = cumulative_trapezoid(turned * seconds, dx=1 / self.rate_hz, axis=0, initial=0)

    def has(self, term: str, errors: TriadErrors) -> bool:
        """Whether the triad has this term under the conditions."""
        if term == "temperature":
            warmed = self.given.temperature_change != 0
            return warmed and (errors.bias_per_kelvin > 0 or errors.scale_per_kelvin > 0)
        size = {
            "white-noise": errors.noise_density,
            "turn-on-bias": errors.turn_on_bias,
            "instability": errors.instability,
            "random-walk": errors.random_walk,
            "scale": errors.scale_error,
            "misalignment": errors.misalignment,
            "g-sensitivity": errors.g_sensitivity,
            "quantisation": errors.step,
        }[term]
        return size > 0

    def errors(self, causes: Sequence[_Cause]) -> list[PoseError]:
        """Roots of mean squares over the scan, and of squares at its end."""
        last = len(self.motion.times) - 1
        ends = np.unique(np.linspace(0, last, _EVALUATIONS + 1).round().astype(int))
        squares = np.empty((len(ends), len(causes), 2))
        for row, end in enumerate(ends):
            weights = self._weights(end)
            for column, cause in enumerate(causes):
                squares[row, column] = [(part**2).sum() for part in self._parts(cause, weights)]
        mean = simpson(squares, x=self.motion.times[ends], axis=0)
        mean = mean / (self.motion.times[-1] - self.motion.times[0])
        return [
            PoseError(*np.sqrt(over).tolist(), *np.sqrt(at_end).tolist())
            for over, at_end in zip(mean, squares[-1], strict=True)
        ]

    def _parts(self, cause: _Cause, weights: _Weights) -> tuple[FloatArray, FloatArray]:
        """Position and orientation per unit normal draw of a cause: arrays of any shape."""
        if cause.term == START_TILT:
            size = self.given.start_tilt
            return size * weights.tilt[0][:, [0, 2]], size * weights.tilt[1][:, [0, 2]]
        position, turn = getattr(weights, cause.triad)
        shift = self._response(cause.term, cause.triad, cause.errors, position)
        if not turn.any():
            return shift, np.zeros(1)
        return shift, self._response(cause.term, cause.triad, cause.errors, turn)

    def _weights(self, end: int) -> _Weights:
        rotations = self.motion.world_from_sensor
        samples = np.arange(len(rotations))
        seconds = self.motion.times - self.motion.times[0]
        step = np.where(samples <= end, 1 / self.rate_hz, 0.0)
        # trapezoidal rule
        step[[0, end]] *= 0.5 if end else 0.0
        left = seconds[end] * (self._zeroth[end] - self._zeroth) - (self._first[end] - self._first)
        weighted = rotations * step[:, None, None]
        gyroscope = [-left @ weighted, weighted]
        accelerometer = [(seconds[end] - seconds)[:, None, None] * weighted, 0 * weighted]
        tilt = (-left[0], np.eye(3))
        if self.rests:
            gyroscope = [self._without_mean(part) for part in gyroscope]
            accelerometer = [
                self._calibrated(part, of_tilt)
                for part, of_tilt in zip(accelerometer, tilt, strict=True)
            ]
        return _Weights((gyroscope[0], gyroscope[1]), (accelerometer[0], accelerometer[1]), tilt)

    def _without_mean(self, weights: FloatArray) -> FloatArray:
        """Weights of a gyroscope whose mean over the last rest is subtracted."""
        count = self.given.calibration.samples(self.rate_hz)
        before = np.zeros((self.rests, 3, 3))
        before[-count:] = -weights.sum(0) / count
        return np.concatenate([before, weights])

    def _calibrated(self, weights: FloatArray, of_tilt: FloatArray) -> FloatArray:
        """Weights of an accelerometer that levels the start and may be calibrated itself."""
        count = self.given.calibration.samples(self.rate_hz)
        start = self.motion.world_from_sensor[0]
        level = -transforms.cross_matrix(UP) @ start / STANDARD_GRAVITY
        before = np.zeros((self.rests, 3, 3))
        before[-count:] = of_tilt @ level / count
        if self.given.calibration.kind == "six-positions":
            everything = np.concatenate([before[-count:], weights])
            force = self.force[-len(everything) :]
            for k, up in enumerate(POSITIONS):
                share = 1 / 6 + (force @ up) / (2 * STANDARD_GRAVITY)
                before[k * count : (k + 1) * count] = (
                    -np.einsum("n,nij->ij", share, everything) / count
                )
        return np.concatenate([before, weights])

    def _response(
        self, term: str, triad: str, errors: TriadErrors, weights: FloatArray
    ) -> FloatArray:
        true = self.rate if triad == "gyroscope" else self.force
        if term == "white-noise":
            return errors.sample_rms(self.rate_hz) * weights
        if term == "quantisation":
            return self._rounding(errors, weights)
        if term == "instability":
            response = instability_response(errors, len(weights), self.rate_hz)
            return _filtered_backwards(weights, response)
        if term == "random-walk":
            return _filtered_backwards(weights, walk_response(errors, len(weights), self.rate_hz))
        if term == "turn-on-bias":
            return errors.turn_on_bias * weights.sum(0)
        if term == "scale":
            return errors.scale_error * np.einsum("nij,nj->ij", weights, true)
        if term == "misalignment":
            crossed = np.einsum("nij,nk->ijk", weights, true) * (1 - np.eye(3))
            return errors.misalignment * crossed
        if term == "g-sensitivity":
            return errors.g_sensitivity * np.einsum("nij,nk->ijk", weights, self.force)
        offset = np.einsum("nij,n->ij", weights, self.kelvin)
        gain = np.einsum("nij,nj,n->ij", weights, true, self.kelvin)
        return np.stack([errors.bias_per_kelvin * offset, errors.scale_per_kelvin * gain])

    def _rounding(self, errors: TriadErrors, weights: FloatArray) -> FloatArray:
        """Rounding to bits has the variance step^2 / 12: white where noise dithers it, else
        constant, which is its worst.
        """
        size = errors.step / np.sqrt(12)
        if errors.sample_rms(self.rate_hz) > _DITHER * errors.step:
            return size * weights
        return size * weights.sum(0)


def _filtered_backwards(weights: FloatArray, response: FloatArray) -> FloatArray:
    """Weights (N, 3, 3) of the white noise that a causal response (N,) turns into the errors."""
    backwards = fftconvolve(weights[::-1], response[:, None, None], axes=0)
    return backwards[: len(weights)][::-1]
