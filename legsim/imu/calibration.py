"""Calibration of sensors before a scan: at rest, or in six positions.

"rest": the sensors keep the pose of the first view for some seconds. The mean rate is the
gyroscope's bias and is subtracted. The mean specific force is vertical: it levels the start of the
integration (:func:`leveled`), which also cancels the horizontal part of the accelerometer's bias.

"six-positions": before that, each of the accelerometer's axes points up and down, exactly and for
as long. Twelve numbers follow: the bias (3) and the matrix of scales and cross-axis readings
(3, 3). Readings are corrected by them. What noise and in-run bias leave over those seconds remains.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from legsim.core import transforms
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.imu.signals import SensorStart

CalibrationKind = Literal["none", "rest", "six-positions"]

UP = np.array([0.0, 1.0, 0.0])

POSITIONS = np.concatenate([np.eye(3), -np.eye(3)])
"""(6, 3) the direction that is up, in the sensor's axes"""


_LONGEST = 100_000
"""Samples of a rest"""


@dataclass(frozen=True, slots=True)
class Calibration:
    """What is recorded before the scan, and what is corrected by it."""

    kind: CalibrationKind = "none"
    seconds: float = 10.0
    """of each rest"""

    def __post_init__(self) -> None:
        if self.kind not in ("none", "rest", "six-positions"):
            raise LegsimError(
                f"unknown calibration {self.kind!r}; known: none, rest, six-positions"
            )
        if not (np.isfinite(self.seconds) and self.seconds > 0):
            raise LegsimError(f"a calibration rests for some seconds; got {self.seconds:g}")

    def samples(self, rate_hz: float) -> int:
        """Number of samples of one rest."""
        count = round(self.seconds * rate_hz)
        if count < 1:
            raise LegsimError(
                f"a rest of {self.seconds:g} s has no sample at {rate_hz:g} Hz; rest longer"
            )
        if count > _LONGEST:
            raise LegsimError(
                f"a rest of {self.seconds:g} s has {count} samples at {rate_hz:g} Hz, at most "
                f"{_LONGEST} are simulated; rest for less time"
            )
        return count

    def forces(self, rest_force: FloatArray, rate_hz: float) -> FloatArray:
        """True specific force (m, 3) over all rests, the one in the pose of the scan last.

        ``rest_force`` (3,) is that of a rest in the pose of the first view.
        """
        if self.kind == "none":
            return np.zeros((0, 3))
        before = STANDARD_GRAVITY * POSITIONS if self.kind == "six-positions" else np.zeros((0, 3))
        return np.repeat(np.vstack([before, rest_force]), self.samples(rate_hz), axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class Corrections:
    """What a calibration found for one sensor."""

    rate_bias: FloatArray
    """(3,) rad/s"""
    force_bias: FloatArray
    """(3,) m/s^2"""
    force_matrix: FloatArray
    """(3, 3) readings per true specific force"""
    rest_force: FloatArray
    """(3,) m/s^2, corrected"""

    @classmethod
    def found(cls, rate: FloatArray, force: FloatArray, calibration: Calibration) -> "Corrections":
        """Evaluates the readings (m, 3) of all rests, in the order of ``Calibration.forces``."""
        rests = 7 if calibration.kind == "six-positions" else 1
        means = force.reshape(rests, -1, 3).mean(1)
        bias, matrix = np.zeros(3), np.eye(3)
        if calibration.kind == "six-positions":
            up, down = means[:3], means[3:6]
            bias = means[:6].mean(0)
            matrix = ((up - down) / (2 * STANDARD_GRAVITY)).T
        corrected = np.linalg.solve(matrix, means[-1] - bias)
        return cls(rate.reshape(rests, -1, 3)[-1].mean(0), bias, matrix, corrected)

    def applied(self, rate: FloatArray, force: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Corrects readings (n, 3) of rate and specific force."""
        solved = np.linalg.solve(self.force_matrix, (force - self.force_bias).T).T
        return rate - self.rate_bias, np.asarray(solved, float)


def leveled(start: SensorStart, rest_force: ArrayLike) -> SensorStart:
    """The same start, tilted by the least angle that makes the specific force at rest vertical.

    Heading, position and velocity stay.

    Raises:
        LegsimError: the sensor felt no gravity at rest, or stands upside down.
    """
    felt = start.world_from_sensor[:3, :3] @ np.asarray(rest_force, float)
    size = float(np.linalg.norm(felt))
    if not size > 0.5 * STANDARD_GRAVITY or felt[1] <= 0:
        raise LegsimError(
            f"the sensor reads {size:.3g} m/s^2 at rest, and not upwards: its start cannot be "
            "leveled; check the calibration at rest and the sensor's rotation"
        )
    axis = np.cross(felt / size, UP)
    sine = float(np.linalg.norm(axis))
    turn = axis * (np.arctan2(sine, felt[1] / size) / sine if sine > 0 else 1.0)
    pose = start.world_from_sensor.copy()
    pose[:3, :3] = transforms.rotation_from_vector(turn) @ pose[:3, :3]
    return SensorStart(pose, start.velocity)
