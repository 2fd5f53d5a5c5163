"""Readings that no leg makes are named with sensor and time."""

import numpy as np
import pytest

from legsim.imu.plausibility import objections
from legsim.imu.signals import ImuSignals


def signals(*, turn: tuple[int, float] = (0, 0.0), force: tuple[int, float] = (0, 1.0)):
    """Two sensors at rest for 1 s at 100 Hz, but one sample (index, deg/s or g) of the second."""
    turns, forces = np.zeros((100, 2, 3)), np.zeros((100, 2, 3))
    forces[..., 1] = 9.80665
    turns[turn[0], 1, 2] = np.radians(turn[1])
    forces[force[0], 1, 0] = 9.80665 * force[1]
    return ImuSignals(np.arange(100) / 100, ("thigh", "shank"), turns, forces)


def test_a_runner_is_plausible():
    assert objections(signals(turn=(50, 1200.0), force=(50, 12.0))) == ()


@pytest.mark.parametrize(("sample", "time"), [(0, "0.000"), (57, "0.570"), (99, "0.990")])
def test_a_blow_and_a_whirl_are_named_wherever_they_are(sample: int, time: str):
    (blow,) = objections(signals(force=(sample, 30.0)))
    assert blow.startswith(f"sensor shank is accelerated by 30 g at {time} s, and in 1 samples")
    (whirl,) = objections(signals(turn=(sample, -6870.0)))
    assert whirl.startswith(f"sensor shank turns by 6870 deg/s at {time} s")


def test_lost_samples_hide_no_blow():
    given = signals(force=(57, 30.0))
    turn, force = given.angular_velocity.copy(), given.specific_force.copy()
    turn[20, 1], force[20, 1] = np.nan, np.nan
    (blow,) = objections(ImuSignals(given.times, given.sensor_names, turn, force))
    assert "30 g at 0.570 s" in blow
