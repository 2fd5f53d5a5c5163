"""Calibration before a scan: what exact readings give back, and how a start is leveled."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.imu.calibration import POSITIONS, Calibration, Corrections, leveled
from legsim.imu.signals import SensorStart

GRAVITY = 9.80665


def test_six_positions_give_bias_scale_and_misalignment_back(rng: np.random.Generator):
    plan = Calibration("six-positions", 0.5)
    rest = GRAVITY * np.array([0.6, 0.8, 0.0])
    true = plan.forces(rest, 100.0)
    assert true.shape == (7 * 50, 3)
    matrix, bias = np.eye(3) + 0.03 * rng.normal(size=(3, 3)), rng.normal(size=3)
    rate_bias = rng.normal(size=3)
    found = Corrections.found(np.tile(rate_bias, (350, 1)), true @ matrix.T + bias, plan)
    np.testing.assert_allclose(found.force_matrix, matrix, atol=1e-12)
    np.testing.assert_allclose(found.force_bias, bias, atol=1e-12)
    np.testing.assert_allclose(found.rest_force, rest, atol=1e-12)
    force, rate = rng.normal(size=(20, 3)), rng.normal(size=(20, 3))
    corrected = found.applied(rate + rate_bias, force @ matrix.T + bias)
    np.testing.assert_allclose(corrected[0], rate, atol=1e-12)
    np.testing.assert_allclose(corrected[1], force, atol=1e-12)


def test_a_rest_takes_the_rate_bias_alone(rng: np.random.Generator):
    plan, rest = Calibration("rest", 1.0), np.array([0.0, GRAVITY, 0.0])
    true, bias = plan.forces(rest, 20.0), rng.normal(size=3)
    found = Corrections.found(np.tile(bias, (20, 1)), true + np.array([0.1, 0.0, 0.0]), plan)
    np.testing.assert_allclose(found.rate_bias, bias)
    np.testing.assert_array_equal(found.force_bias, np.zeros(3))
    np.testing.assert_allclose(found.rest_force, [0.1, GRAVITY, 0.0])


def test_positions_hold_each_axis_up_and_down():
    assert {tuple(p) for p in POSITIONS} == {tuple(s * e) for s in (1.0, -1.0) for e in np.eye(3)}
    assert Calibration().forces(np.zeros(3), 100.0).shape == (0, 3)


@pytest.mark.parametrize("seed", range(5))
def test_leveling_restores_the_tilt_and_keeps_the_heading(seed: int):
    rng = np.random.default_rng(seed)
    true = transforms.rotation_from_vector(rng.normal(size=3))
    tilt = transforms.rotation_from_vector([0.02, 0.0, -0.03])
    start = SensorStart(transforms.rigid(tilt @ true, [1.0, 2.0, 3.0]), np.array([0.1, 0, 0]))
    found = leveled(start, true.T @ [0.0, GRAVITY, 0.0])
    np.testing.assert_allclose(found.world_from_sensor[:3, :3], true, atol=1e-3)
    np.testing.assert_allclose(
        found.world_from_sensor[:3, :3] @ true.T @ [0, 1, 0], [0, 1, 0], atol=1e-12
    )
    np.testing.assert_array_equal(found.world_from_sensor[:3, 3], [1, 2, 3])
    np.testing.assert_array_equal(found.velocity, start.velocity)


def test_a_level_start_stays():
    start = SensorStart(np.eye(4), np.zeros(3))
    np.testing.assert_array_equal(leveled(start, [0.0, GRAVITY, 0.0]).world_from_sensor, np.eye(4))


def test_impossible_calibrations_are_refused():
    with pytest.raises(LegsimError, match="unknown calibration 'cube'"):
        Calibration("cube")
    with pytest.raises(LegsimError, match="rests for some seconds"):
        Calibration("rest", 0.0)
    with pytest.raises(LegsimError, match="no sample at 10 Hz"):
        Calibration("rest", 0.01).samples(10.0)
    with pytest.raises(LegsimError, match="rest for less time"):
        Calibration("rest", 1e9).samples(100.0)
    start = SensorStart(np.eye(4), np.zeros(3))
    for felt in ([0.0, -GRAVITY, 0.0], [0.0, 0.1, 0.0]):
        with pytest.raises(LegsimError, match="cannot be leveled"):
            leveled(start, felt)
