"""The place of a sensor comes back from what it reads of the turns, or is not known."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.imu.recording import ImuRecording
from legsim.imu.worn_place import find_place
from tests.examples.sensors import swaying

STEP = 0.01
SHIFT = np.array([0.03, -0.19, 0.05])


def moved(one: ImuRecording, shift: np.ndarray, tilt: np.ndarray, noise: float) -> ImuRecording:
    """The readings ``shift`` further on the same rigid segment: a second derivative of places.

    The turns are integrated from the rates, independently of the formula under test.
    """
    times, rate = one.times, one.angular_velocity
    poses = np.empty((len(times), 3, 3))
    poses[0] = np.eye(3)
    for k in range(len(times) - 1):
        step = 0.5 * (rate[k] + rate[k + 1]) * (times[k + 1] - times[k])
        poses[k + 1] = poses[k] @ transforms.rotation_from_vector(step)
    places = poses @ shift
    acceleration = np.gradient(np.gradient(places, times, axis=0), times, axis=0)
    force = one.specific_force + np.einsum("nij,ni->nj", poses, acceleration)
    force = force @ transforms.rotation_from_vector(tilt).T
    force = force + noise * np.random.default_rng(4).standard_normal(force.shape)
    return ImuRecording("m", times, rate, force)


@pytest.mark.parametrize("tilt", [np.zeros(3), np.array([0.02, -0.03, 0.01])])
def test_a_place_is_found_whatever_small_tilt_is_left(tilt: np.ndarray):
    one = swaying(lean=0.5)
    found = find_place(one, moved(one, SHIFT, tilt, 0.02), step=STEP)
    np.testing.assert_allclose(found.shift, SHIFT, atol=0.008)
    assert found.is_elsewhere
    assert found.left_there < 0.2 * found.left


def test_the_spread_covers_the_error_that_noise_makes():
    one = swaying(lean=0.5)
    found = find_place(one, moved(one, SHIFT, np.zeros(3), 0.3), step=STEP)
    assert (np.abs(found.shift - SHIFT) < 4 * found.spread + 0.005).all()
    assert found.spread.max() > 0.002


def test_a_sensor_in_its_place_is_not_elsewhere():
    one = swaying(lean=0.5)
    found = find_place(one, moved(one, np.zeros(3), np.zeros(3), 0.1), step=STEP)
    assert np.linalg.norm(found.shift) < 0.01
    assert not found.is_elsewhere


def test_a_sway_does_not_tell_the_place():
    one = swaying(lean=0.005)
    found = find_place(one, moved(one, SHIFT, np.zeros(3), 0.05), step=STEP)
    assert found.spread.max() > 0.03
    assert not found.is_elsewhere


def test_a_place_two_centimeters_away_is_left_alone():
    one = swaying(lean=0.5)
    found = find_place(one, moved(one, SHIFT / 10, np.zeros(3), 0.0), step=STEP)
    assert np.linalg.norm(found.shift) > 3 * np.linalg.norm(found.spread)
    assert not found.is_elsewhere
