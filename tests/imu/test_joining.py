"""Recordings of one clock become one set."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu.joining import join, merged
from tests.examples.sensors import still, swaying


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


def test_what_an_instrument_lost_for_long_is_in_no_recording_of_both():
    """Readings of the other one there would stand beside a spline through nothing."""
    one = swaying()
    times = one.times + 0.003
    there = (times < 4) | (times > 6)
    both = merged(
        "shank", (one.times, one.specific_force), (times[there], one.angular_velocity[there])
    )
    assert not ((both.times > 4.01) & (both.times < 6)).any()
    assert both.times[-1] > 11


def test_what_one_of_several_sensors_lost_for_long_is_marked():
    one, other = swaying(), swaying().named("thigh").shifted(0.004)
    kept = (one.times < 4) | (one.times > 6)
    gappy = replace(
        one,
        times=one.times[kept],
        angular_velocity=one.angular_velocity[kept],
        specific_force=one.specific_force[kept],
    )
    signals = join([gappy, other]).signals
    lost = np.isnan(signals.sensor("shank")[0]).all(-1)
    np.testing.assert_array_equal(lost, (signals.times > 3.9901) & (signals.times < 6.0099))
    assert lost.sum() > 190
    assert np.isfinite(signals.sensor("thigh")[0]).all()
    assert len(signals.samples("shank")[0]) == (~lost).sum()


def test_a_gap_of_the_fastest_sensor_is_none_of_the_others():
    """Its times lack what they recorded."""
    slow = swaying(rate_hz=100.0)
    fast = swaying(rate_hz=128.0).named("fast")
    kept = np.abs(fast.times - 6.0) > 0.4
    gappy = replace(fast, times=fast.times[kept], angular_velocity=fast.angular_velocity[kept],
                    specific_force=fast.specific_force[kept])  # fmt: skip
    signals = join([slow, gappy]).signals
    assert np.diff(signals.samples("shank")[0]).max() < 0.011
    assert np.diff(signals.samples("fast")[0]).max() == np.diff(gappy.times).max()
    times, rate, _ = signals.samples("shank")
    true = swaying(rate_hz=100.0)
    for k in range(3):
        np.testing.assert_allclose(
            rate[:, k], np.interp(times, true.times, true.angular_velocity[:, k]), atol=2e-3
        )
    both = replace(slow, times=slow.times[np.abs(slow.times - 6.0) > 0.4],
                   angular_velocity=slow.angular_velocity[np.abs(slow.times - 6.0) > 0.4],
                   specific_force=slow.specific_force[np.abs(slow.times - 6.0) > 0.4])  # fmt: skip
    assert np.diff(join([both, gappy]).signals.times).max() > 0.7


def test_parts_days_apart_are_not_filled_by_a_stray_sample_between_them():
    two_days = 172_800.0
    between = 86_401.0031
    fast, slow = swaying(rate_hz=128.0), swaying(rate_hz=100.0).named("thigh")
    parts = [replace(one, times=np.r_[one.times, one.times + two_days],
                     angular_velocity=np.tile(one.angular_velocity, (2, 1)),
                     specific_force=np.tile(one.specific_force, (2, 1)))
             for one in (fast, slow)]  # fmt: skip
    stray = len(slow.times)
    with_stray = replace(
        parts[1],
        times=np.insert(parts[1].times, stray, between),
        angular_velocity=np.insert(parts[1].angular_velocity, stray, 0.0, axis=0),
        specific_force=np.insert(parts[1].specific_force, stray, [0.0, 0.0, 9.8], axis=0),
    )
    signals = join([parts[0], with_stray]).signals
    within = (signals.times > 12) & (signals.times < two_days)
    np.testing.assert_array_equal(signals.times[within], [between])
    np.testing.assert_allclose(signals.sensor("thigh")[1][within], [[0.0, 0.0, 9.8]], atol=1e-12)
    assert np.isnan(signals.sensor("shank")[1][within]).all()
