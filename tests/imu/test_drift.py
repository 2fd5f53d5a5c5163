"""Errors of estimated motion under white noise: known shifts and turns, the law of double
integration, equal draws.
"""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.imu import drift
from legsim.imu.noise import ImuNoise
from legsim.imu.signals import ImuSignals, SensorStart

RATE_HZ, SECONDS = 120.0, 8.0
TIMES = np.arange(int(RATE_HZ * SECONDS) + 1) / RATE_HZ
VIEWS = np.arange(248) / 31.0


def resting() -> tuple[ImuSignals, SensorStart]:
    """A sensor that lies still and level."""
    force = np.zeros((len(TIMES), 1, 3))
    force[..., 1] = 9.80665
    start = SensorStart(np.eye(4), np.zeros(3))
    return ImuSignals(TIMES, ("s",), np.zeros_like(force), force), start


def test_a_known_shift_and_turn_are_reported():
    clean = np.tile(np.eye(4), (5, 1, 1))
    moved = clean.copy()
    moved[:, :3, 3] = [0.003, 0.0, -0.006]
    moved[:, :3, :3] = transforms.rotation_from_vector([0.0, 0.03, 0.0])
    found = drift.deviation(moved, clean)
    assert found.translation == pytest.approx((0.003 + 0.0 + 0.006) / 3)
    assert found.rotation == pytest.approx(0.03 / 3)


def test_clean_sensors_deviate_by_nothing():
    signals, start = resting()
    none = ImuNoise(0.0, 0.0)
    assert drift.deviations(signals, start, VIEWS, none, "accurate", [0]) == (
        drift.Drift(0.0, 0.0),
    )


def test_accelerometer_noise_grows_as_its_double_integral():
    signals, start = resting()
    noise = ImuNoise.paper(acceleration_exponent=0, angular_velocity_exponent=None)
    found = drift.deviations(signals, start, VIEWS, noise, "accurate", range(40))
    # white noise of one-sided density d, integrated twice, has variance d^2 / 2 * t^3 / 3; its mean
    # from 0 to T is a fourth of that at T
    expected = noise.acceleration_density / np.sqrt(2) * np.sqrt(SECONDS**3 / 12)
    values = [d.translation for d in found]
    # mean of square roots lies below the root of the mean: 20 % for a random walk, 6 % of chance
    # for 40 draws of three axes
    assert np.sqrt(np.mean(np.square(values))) == pytest.approx(expected, rel=0.25)
    assert max(d.rotation for d in found) == 0


def test_equal_seeds_draw_equal_noise_at_every_level():
    signals, start = resting()
    levels = [
        ImuNoise.paper(acceleration_exponent=f, angular_velocity_exponent=None) for f in (3, 4)
    ]
    louder, softer = (
        drift.deviations(signals, start, VIEWS, level, "accurate", [7])[0] for level in levels
    )
    assert louder.translation == pytest.approx(10 * softer.translation, rel=1e-6)
