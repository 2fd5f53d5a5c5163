"""Units that cannot be are refused; recordings of one clock become one set."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu.recording import (
    ImuRecording,
    check_plausible,
    check_steady,
    gyroscope_scale,
    join,
)
from tests.examples.sensors import still, swaying


def test_gravity_turns_as_fast_in_both_instruments_of_a_sensor_in_si():
    scale, correlation = gyroscope_scale(swaying())
    assert scale == pytest.approx(1, abs=0.02)  # small angles, and the filter's ends
    assert correlation > 0.98
    check_plausible(swaying())


@pytest.mark.parametrize(
    ("factor", "said"),
    [(np.pi / 180, "as rad/s"), (180 / np.pi, "as deg/s")],
    ids=["radians read as degrees", "degrees read as radians"],
)
def test_a_gyroscope_in_the_other_unit_is_refused_by_how_gravity_turns(factor, said):
    one = swaying()
    with pytest.raises(LegsimError, match=f"gravity turn .*{said}"):
        check_plausible(replace(one, angular_velocity=factor * one.angular_velocity))


def test_a_gyroscope_that_turns_the_other_way_is_refused():
    one = swaying()
    with pytest.raises(LegsimError, match=r"turns the other way.*turn the sign"):
        check_plausible(replace(one, angular_velocity=-one.angular_velocity))


def test_a_rate_beyond_all_gyroscopes_is_refused():
    one = still()
    with pytest.raises(LegsimError, match=r"2000 deg/s"):
        check_plausible(replace(one, angular_velocity=one.angular_velocity + 40.0))


@pytest.mark.parametrize("factor", [1e3, 1e-3])
def test_times_in_another_unit_are_refused(factor):
    one = still()
    with pytest.raises(LegsimError, match=r"samples per second.*unit of the times"):
        check_plausible(replace(one, times=factor * one.times))


def test_a_dead_gyroscope_is_refused():
    one = still()
    with pytest.raises(LegsimError, match=r"reads one value"):
        check_plausible(replace(one, angular_velocity=np.zeros_like(one.angular_velocity)))


def test_numbers_that_are_not_finite_are_refused():
    one = still()
    broken = one.specific_force.copy()
    broken[7, 1] = np.nan
    with pytest.raises(LegsimError, match=r"specific_force of sensor 'shank'.* 0.07 s"):
        replace(one, specific_force=broken)


def test_recordings_of_equal_times_are_joined_to_the_last_bit():
    one, other = still(seed=1), still(seed=2).named("thigh")
    joined = join([one, other])
    assert joined.signals.sensor_names == ("shank", "thigh")
    np.testing.assert_array_equal(joined.signals.sensor("thigh")[1], other.specific_force)
    assert joined.notes == ()


def test_recordings_of_two_rates_meet_where_both_are():
    slow, fast = swaying(rate_hz=60.0), swaying(rate_hz=100.0).named("thigh").shifted(0.5)
    joined = join([slow, fast])
    times = joined.signals.times
    assert (times[0], times[-1]) == (0.5, pytest.approx(slow.times[-1], abs=0.01))
    exact = np.stack([np.interp(times, slow.times, v) for v in slow.specific_force.T], -1)
    assert np.abs(joined.signals.sensor("shank")[1] - exact).max() < 1e-3
    assert "those of thigh by cubic splines" in joined.notes[0]


def test_clocks_that_never_meet_are_refused():
    with pytest.raises(LegsimError, match=r"do not overlap.*clock_offset_s"):
        join([still(), still().named("b").shifted(1e9)])


def test_no_recording_is_no_set():
    with pytest.raises(LegsimError, match=r"at least one"):
        join([])


def test_a_recording_says_what_it_is():
    assert repr(still()) == "ImuRecording(shank: 100 samples over 0.99 s, 100 Hz)"
    with pytest.raises(LegsimError, match=r"increase"):
        ImuRecording("a", np.zeros(2), np.zeros((2, 3)), np.zeros((2, 3)))


def test_a_recording_that_is_mostly_a_gap_says_nothing_of_the_gyroscopes_unit():
    one = swaying()
    gap = replace(one, times=np.append(one.times[:-1], 1e12))
    assert gyroscope_scale(gap) == (1.0, 0.0)


@pytest.mark.parametrize("bias_deg", [0.0, 0.6])
def test_a_quiet_standers_gyroscope_in_the_other_unit_is_refused(bias_deg):
    """Its sway is too small, and too shaken by the muscles, to correlate."""
    rng = np.random.default_rng(3)
    one = swaying(seconds=20.0, lean=np.radians(0.15))
    noise = 0.05 * rng.normal(size=one.specific_force.shape)
    drift = np.cumsum(0.004 * rng.normal(size=noise.shape), axis=0)
    rate = one.angular_velocity + np.radians([bias_deg, bias_deg, 0])
    calm = replace(one, specific_force=one.specific_force + noise + drift, angular_velocity=rate)
    check_plausible(calm)
    assert abs(gyroscope_scale(calm)[1]) < 0.6
    with pytest.raises(LegsimError, match="the accelerometer does not see it; state the unit of"):
        check_plausible(replace(calm, angular_velocity=np.degrees(rate)))


def test_a_poor_gyroscope_at_rest_is_taken():
    """Off by 15 deg/s, and with 20 times the noise of a good one."""
    one = still(count=6000)
    rng = np.random.default_rng(5)
    noise = np.radians(1.0) * rng.normal(size=one.angular_velocity.shape)
    check_plausible(replace(one, angular_velocity=noise + np.radians([15.0, 0, 0])))


def test_losses_and_late_samples_are_no_bursts():
    rng = np.random.default_rng(1)
    times = np.arange(3000) / 100
    kept = rng.random(600) < 0.4
    for some in (
        times[np.repeat(kept, 5)],
        times[rng.random(3000) < 0.4],
        np.sort(times + rng.uniform(-0.004, 0.004, 3000)),
        np.r_[times[:1000], times[2000:]],
        np.r_[times[:1000], 10 + np.arange(3000) / 400],
        np.r_[times[:300], 9.2 + times[:300]],  # a pause
    ):
        check_steady("shank", some)


def test_a_shaken_sensor_is_not_held_to_gravity_alone():
    """Impacts in step with turns, more in some strides than in others, as of somebody who runs."""
    one = swaying(seconds=20.0, lean=0.02)
    stride = 2 * np.pi * 2.8 * one.times
    strength = 1 + 0.5 * np.sin(2 * np.pi * 0.22 * one.times)
    rate, force = np.array(one.angular_velocity), np.array(one.specific_force)
    rate[:, 0] += 5 * np.sin(stride)
    force[:, 2] += 12 * strength * np.sin(stride)
    check_plausible(replace(one, angular_velocity=rate, specific_force=force))
