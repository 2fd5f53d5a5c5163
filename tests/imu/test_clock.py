"""Clocks that are off, and lost samples."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu import strapdown
from legsim.imu.clock import SensorClock, lose_samples
from legsim.imu.signals import ImuSignals, SensorStart
from tests.references.sway import Sway


def signals(count: int = 1200, sensors: int = 1, rate_hz: float = 120.0) -> ImuSignals:
    times = np.arange(count) / rate_hz
    rate, force = Sway.standing(3).signals(times)
    names = tuple(f"s{k}/a" for k in range(sensors))
    return ImuSignals(times, names, np.stack([rate] * sensors, 1), np.stack([force] * sensors, 1))


def streams(count: int) -> tuple[np.random.Generator, ...]:
    return tuple(np.random.default_rng([5, k]) for k in range(count))


def test_a_clock_without_errors_is_the_recordings_to_the_last_digit():
    clock = SensorClock()
    times = clock.sample_times(0.3, 20.29, 120.0)
    np.testing.assert_array_equal(times, np.minimum(0.3 + np.arange(2399) / 120.0, 20.29))
    np.testing.assert_array_equal(clock.stamps(times), times)


@pytest.mark.parametrize("drift", [-2e-4, 5e-5, 1e-2])
def test_samples_are_even_on_the_clock_that_drifts(drift: float):
    clock = SensorClock(0.25, drift)
    times = clock.sample_times(1.0, 21.0, 100.0)
    stamps = clock.stamps(times)
    np.testing.assert_allclose(np.diff(stamps), 0.01, rtol=1e-9)
    assert stamps[0] == 1.25
    # after 20 s a fast clock has taken more samples and shows more
    assert len(times) == np.floor(2000 * (1 + drift) + 1e-6) + 1
    assert stamps[-1] - 0.25 - times[-1] == pytest.approx(drift * (times[-1] - 1.0))
    assert times[-1] <= 21.0


def test_impossible_clocks_are_refused():
    with pytest.raises(LegsimError, match="drift below 100000 ppm"):
        SensorClock(0.0, 0.5)
    with pytest.raises(LegsimError, match="finite offset"):
        SensorClock(float("nan"))


def test_marked_samples_are_nan_and_left_out_of_the_samples():
    given = signals(sensors=2)
    lost = lose_samples(given, 0.1, "marked", streams(2))
    gone = np.isnan(lost.angular_velocity).all(-1)
    assert gone.mean() == pytest.approx(0.1, abs=0.03)
    assert not gone[0].any()
    # both triads at once, sensors for themselves
    np.testing.assert_array_equal(gone, np.isnan(lost.specific_force).all(-1))
    assert (gone[:, 0] != gone[:, 1]).any()
    times, rate, force = lost.samples("s1/a")
    np.testing.assert_array_equal(times, given.times[~gone[:, 1]])
    np.testing.assert_array_equal(rate, given.angular_velocity[~gone[:, 1], 1])
    np.testing.assert_array_equal(force, given.specific_force[~gone[:, 1], 1])


def test_held_samples_repeat_the_one_before():
    given = signals()
    lost = lose_samples(given, 0.3, "held", streams(1))
    gone = np.isnan(lose_samples(given, 0.3, "marked", streams(1)).specific_force[:, 0, 0])
    for k in np.flatnonzero(gone):
        np.testing.assert_array_equal(lost.specific_force[k], lost.specific_force[k - 1])
    there = ~gone
    np.testing.assert_array_equal(lost.specific_force[there], given.specific_force[there])


def test_the_first_sample_is_there_even_where_nearly_all_are_lost():
    for how in ("marked", "held"):
        lost = lose_samples(signals(50, 8), 0.95, how, streams(8))
        np.testing.assert_array_equal(lost.specific_force[0], signals(50, 8).specific_force[0])


def test_no_loss_is_the_same_signals():
    given = signals()
    assert lose_samples(given, 0.0, "held", streams(1)) is given
    with pytest.raises(LegsimError, match="below 1"):
        lose_samples(given, 1.0, "held", streams(1))


def test_integration_bridges_marked_gaps_better_than_held_samples():
    given, sway, views = signals(), Sway.standing(3), np.arange(240) / 31
    start = SensorStart(sway.poses(views[:1])[0], sway.velocities(views[:1])[0])
    errors = {}
    for how in ("marked", "held"):
        lost = lose_samples(given, 0.05, how, streams(1))
        poses = strapdown.integrate(*lost.samples("s0/a"), start, views)
        errors[how] = np.abs(poses[:, :3, 3] - sway.poses(views)[:, :3, 3]).max()
    # a spline through what is there loses nothing of a sway below 2 Hz
    assert errors["marked"] < 1e-6
    assert errors["held"] > 100 * errors["marked"]


def test_a_sample_that_lacks_only_some_readings_is_not_a_gap():
    given = signals(10)
    rate = given.angular_velocity.copy()
    rate[4, 0, 1] = np.nan
    broken = ImuSignals(given.times, given.sensor_names, rate, given.specific_force)
    start = SensorStart(np.eye(4), np.zeros(3))
    with pytest.raises(LegsimError, match="sample 4"):
        strapdown.integrate(*broken.samples("s0/a"), start, given.times[:2])
