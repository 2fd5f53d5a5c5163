"""Signals and starts refuse what no sensor could have recorded."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.imu.signals import ImuSignals, SensorStart


def signals(rng: np.random.Generator) -> ImuSignals:
    values = rng.normal(size=(2, 5, 2, 3))
    return ImuSignals(np.arange(5.0), ("thigh", "shank"), values[0], values[1])


def test_a_sensor_is_found_by_its_name(rng: np.random.Generator):
    recorded = signals(rng)
    turn, force = recorded.sensor("shank")
    np.testing.assert_array_equal(turn, recorded.angular_velocity[:, 1])
    np.testing.assert_array_equal(force, recorded.specific_force[:, 1])
    with pytest.raises(LegsimError, match=r"unknown sensor 'foot'; known: thigh, shank"):
        recorded.sensor("foot")


def test_signals_of_another_length_than_their_times_are_refused():
    with pytest.raises(LegsimError, match=r"ImuSignals\.specific_force"):
        ImuSignals(np.arange(3.0), ("shank",), np.zeros((3, 1, 3)), np.zeros((2, 1, 3)))


@pytest.mark.parametrize(
    ("pose", "velocity", "message"),
    [
        (np.diag([1.0, 1, -1, 1]), np.zeros(3), "orthonormal and right-handed"),
        (1.1 * np.eye(4), np.zeros(3), "orthonormal and right-handed"),
        (transforms.translation([0.0, np.nan, 0.0]), np.zeros(3), "not finite"),
        (np.eye(4), np.full(3, np.inf), "not finite"),
        (np.eye(3), np.zeros(3), "world_from_sensor"),
    ],
)
def test_a_start_is_a_finite_rigid_pose(pose: np.ndarray, velocity: np.ndarray, message: str):
    with pytest.raises(LegsimError, match=message):
        SensorStart(pose, velocity)
