"""The chain from what a sensor feels to what its file holds.

In the order of the physics: misalignment and scale, g-sensitivity, bias and temperature; the
sensor's own low-pass and its sampling; in-run bias, random walk and white noise; the full scale;
rounding to bits; the calibration. Lost samples (:mod:`legsim.imu.clock`) come after it.

Each sensor, triad and term draws from a random stream of its own, so that switching one term on or
off leaves the draws of all others.
"""

import warnings
import zlib
from dataclasses import dataclass, replace

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.imu.calibration import Calibration, Corrections
from legsim.imu.errors import SensorErrors, TemperatureCourse, TriadErrors
from legsim.imu.processes import coloured, instability_response, low_pass, walk_response
from legsim.imu.signals import ImuSignals

FINE_HZ = 960.0
"""Least rate at which a low-pass is fed: motion of 10 Hz is straight between samples to 0.04 %"""


def oversampling(errors: SensorErrors, rate_hz: float) -> int:
    """Number of samples to simulate per sample of the file: 1 where no low-pass needs more."""
    if not (errors.accelerometer.bandwidth_hz or errors.gyroscope.bandwidth_hz):
        return 1
    return max(1, int(np.ceil(FINE_HZ / rate_hz)))


def read_out(
    felt: ImuSignals,
    errors: SensorErrors,
    rng: np.random.Generator,
    *,
    every: int = 1,
    temperature: TemperatureCourse | None = None,
    calibration: Calibration | None = None,
    rest_force: FloatArray | None = None,
) -> ImuSignals:
    """Readings of sensors with these errors.

    Args:
        felt: exact signals, ``every`` times as dense as the file's samples.
        errors: of each of the sensors, which draw independently.
        rng: decides all draws.
        every: samples of ``felt`` per sample of the file; see :func:`oversampling`.
        temperature: course over the recording; None stays at that of the factory's calibration.
        calibration: before the scan; its rests are at the recording's first temperature.
        rest_force: (k, 3) m/s^2, true specific force of each sensor at rest in the pose of the
            first view; needed by a calibration.

    Raises:
        LegsimError: fewer than two samples, or a calibration without the pose of its rest.

    Warns:
        UserWarning: readings are at their full scale.
    """
    done, course = calibration or Calibration(), temperature or TemperatureCourse()
    if len(felt.times) < 1 + every:
        raise LegsimError("readings need at least 2 samples: their rate decides the noise")
    if done.kind != "none" and rest_force is None:
        raise LegsimError(
            "a calibration rests in the pose of the first view: give rest_force, the specific "
            "force of each sensor in that pose"
        )
    root = int(rng.integers(2**63))
    rates, forces, rests = [], [], []
    for k, name in enumerate(felt.sensor_names):
        still = np.zeros(3) if rest_force is None else np.asarray(rest_force, float)[k]
        sensor = _Sensor(name, errors, root, course, every)
        rate, force, rest = sensor.read(
            felt.times, felt.angular_velocity[:, k], felt.specific_force[:, k], still, done
        )
        rates.append(rate)
        forces.append(force)
        rests.append(rest)
    return replace(
        felt,
        times=felt.times[::every],
        angular_velocity=np.stack(rates, 1),
        specific_force=np.stack(forces, 1),
        rest_force=None if done.kind == "none" else np.stack(rests),
    )


@dataclass(frozen=True, slots=True)
class _Sensor:
    name: str
    errors: SensorErrors
    root: int
    course: TemperatureCourse
    every: int

    def read(
        self,
        times: FloatArray,
        rate: FloatArray,
        force: FloatArray,
        rest_force: FloatArray,
        calibration: Calibration,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Rate and specific force (n, 3) of the file, and the specific force (3,) at rest."""
        fine_hz = (len(times) - 1) / float(times[-1] - times[0])
        rate_hz = fine_hz / self.every
        before = calibration.forces(rest_force, rate_hz)
        kelvin = self.course.at(times - times[0])
        cold = np.full(len(before), kelvin[0])
        read = []
        for triad, errors, of_scan, of_rests in (
            ("gyroscope", self.errors.gyroscope, rate, np.zeros_like(before)),
            ("accelerometer", self.errors.accelerometer, force, before),
        ):
            axes = _Triad(errors, _Streams(self.root, self.name, triad))
            moving = axes.feel(of_scan, force, kelvin)
            if errors.bandwidth_hz:
                moving = low_pass(moving, errors.bandwidth_hz, errors.filter_order, fine_hz)
            still = axes.feel(of_rests, before, cold)
            analog = np.concatenate([still, moving[:: self.every]])
            read.append(self._digital(triad, errors, analog + axes.noise(len(analog), rate_hz)))
        turned, pushed = read
        count = len(before)
        if not count:
            return turned, pushed, rest_force
        found = Corrections.found(turned[:count], pushed[:count], calibration)
        return *found.applied(turned[count:], pushed[count:]), found.rest_force

    def _digital(self, triad: str, errors: TriadErrors, values: FloatArray) -> FloatArray:
        """Readings within the full scale, in whole bits."""
        if errors.step:
            values = errors.step * np.round(values / errors.step)
        if not errors.full_scale:
            return values
        top = errors.full_scale - errors.step
        share = float(((values > top) | (values < -errors.full_scale)).any(-1).mean())
        if share:
            warnings.warn(
                f"sensor {self.name}: {100 * share:.2g} % of the {triad}'s samples are at its full "
                "scale; choose a sensor of a greater range",
                stacklevel=2,
            )
        return np.clip(values, -errors.full_scale, top)


@dataclass(frozen=True, slots=True)
class _Streams:
    """One random stream per term of a triad of a sensor."""

    root: int
    sensor: str
    triad: str

    def of(self, term: str) -> np.random.Generator:
        names = (self.sensor, self.triad, term)
        return np.random.default_rng([self.root, *(zlib.crc32(n.encode()) for n in names)])


@dataclass(frozen=True, slots=True)
class _Triad:
    errors: TriadErrors
    streams: _Streams

    def feel(self, true: FloatArray, force: FloatArray, kelvin: FloatArray) -> FloatArray:
        """What the axes feel of the true values (n, 3), under a specific force (n, 3).

        ``kelvin`` (n,) is the temperature.
        """
        errors = self.errors
        scale, cross, by_force, warm = (
            self.streams.of(term)
            for term in ("scale", "misalignment", "g-sensitivity", "temperature")
        )
        matrix = np.diag(1 + errors.scale_error * scale.standard_normal(3))
        matrix += errors.misalignment * cross.standard_normal((3, 3)) * (1 - np.eye(3))
        bent = errors.g_sensitivity * by_force.standard_normal((3, 3))
        bias = errors.turn_on_bias * self.streams.of("turn-on-bias").standard_normal(3)
        bias_slope = errors.bias_per_kelvin * warm.standard_normal(3)
        scale_slope = errors.scale_per_kelvin * warm.standard_normal(3)
        drift = kelvin[:, None] * (bias_slope + scale_slope * true)
        return true @ matrix.T + force @ bent.T + bias + drift

    def noise(self, count: int, rate_hz: float) -> FloatArray:
        """White noise, in-run bias and random walk (count, 3)."""
        errors = self.errors
        total = errors.sample_rms(rate_hz) * self._white("white-noise", count)
        if errors.instability:
            response = instability_response(errors, count, rate_hz)
            total = total + coloured(self._white("instability", count), response)
        if errors.random_walk:
            response = walk_response(errors, count, rate_hz)
            total = total + coloured(self._white("random-walk", count), response)
        return total

    def _white(self, term: str, count: int) -> FloatArray:
        return self.streams.of(term).standard_normal((count, 3))
