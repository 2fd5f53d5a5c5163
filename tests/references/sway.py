"""A standing sway in closed form: pose, velocity and exact sensor signals at any time, for tests of
everything that reads an IMU.
"""

from dataclasses import dataclass

import numpy as np

from legsim.core import transforms
from legsim.core.values import FloatArray

GRAVITY = np.array([0.0, -9.80665, 0.0])


@dataclass(frozen=True)
class Waves:
    """Three sums of sines (3 axes, w waves): value, first and second derivative."""

    amplitude: FloatArray
    rate: FloatArray
    phase: FloatArray

    def __call__(self, times: FloatArray, derivative: int) -> FloatArray:
        angle = (
            np.asarray(times, float)[:, None, None] * self.rate
            + self.phase
            + derivative * np.pi / 2
        )
        return (self.amplitude * self.rate**derivative * np.sin(angle)).sum(-1)


@dataclass(frozen=True)
class Sway:
    """Position p(t) and rotation R = base Rz(a) Rx(b) Ry(c), every term a sum of sines."""

    position: Waves
    angles: Waves
    base: FloatArray
    center: FloatArray

    @classmethod
    def standing(cls, seed: int, *, position_mm: float = 3.0, angle_deg: float = 0.6) -> "Sway":
        """Three waves an axis from 0.15 to 1.7 Hz, the slow ones larger, as people sway."""
        rng = np.random.default_rng(seed)
        frequency = np.geomspace(0.15, 1.7, 3) * rng.uniform(0.9, 1.1, (3, 3))
        fall = frequency.min() / frequency
        waves = [
            Waves(size * fall, 2 * np.pi * frequency, rng.uniform(0, 2 * np.pi, (3, 3)))
            for size in (position_mm * 1e-3, np.radians(angle_deg))
        ]
        return cls(
            waves[0],
            waves[1],
            transforms.rotation_from_vector(rng.normal(size=3)),
            np.array([0.05, 0.4, -0.1]),
        )

    def poses(self, times: FloatArray) -> FloatArray:
        a, b, c = self.angles(times, 0).T
        turned = (
            transforms.axis_rotation([0, 0, 1], a)
            @ transforms.axis_rotation([1, 0, 0], b)
            @ transforms.axis_rotation([0, 1, 0], c)
        )
        return transforms.rigid(self.base @ turned, self.center + self.position(times, 0))

    def velocities(self, times: FloatArray) -> FloatArray:
        return self.position(times, 1)

    def signals(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(angular velocity (n, 3) rad/s, specific force (n, 3) m/s^2), both in the sensor frame,
        exact.
        """
        _, b, c = self.angles(times, 0).T
        da, db, dc = self.angles(times, 1).T
        turn_c = transforms.axis_rotation([0, 1, 0], -c)
        turn_b = transforms.axis_rotation([1, 0, 0], -b)
        ex, ey, ez = np.eye(3)
        rate = (turn_c @ turn_b @ ez) * da[:, None] + (turn_c @ ex) * db[:, None] + ey * dc[:, None]
        rotation = self.poses(times)[:, :3, :3]
        return rate, np.einsum("nji,nj->ni", rotation, self.position(times, 2) - GRAVITY)
