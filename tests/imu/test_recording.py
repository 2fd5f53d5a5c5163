"""Units that cannot be are refused."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu.recording import (
    ImuRecording,
    check_plausible,
    check_steady,
    checked,
    gyroscope_scale,
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
    # gravity's sign is no part of it, as the axes' handedness is
    with pytest.raises(LegsimError, match="turns the other way"):
        check_plausible(replace(one, angular_velocity=-one.angular_velocity,
                                specific_force=-one.specific_force))  # fmt: skip
    left = np.array([1, 1, -1])
    mirrored = replace(one, angular_velocity=one.angular_velocity * left,
                       specific_force=one.specific_force * left)  # fmt: skip
    with pytest.raises(LegsimError, match="or, where the axes are left-handed, the sign of one"):
        check_plausible(mirrored)


def test_a_rate_beyond_all_gyroscopes_is_refused():
    one = still()
    with pytest.raises(LegsimError, match=r"2000 deg/s"):
        check_plausible(replace(one, angular_velocity=one.angular_velocity + 40.0))


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (1e3, ": ms taken for s have 100 per second"),
        (1e7, ": ticks of 100 ns taken for s have 100 per second"),
        (1 / 86400, ": days taken for s have 100 per second"),
        (1e-3, "or the rate$"),
        (100.0, "its times count the samples: leave the column of times out, and give rate_hz"),
    ],
)
def test_times_in_another_unit_are_refused(factor, said):
    one = still()
    with pytest.raises(LegsimError, match=rf"samples per second.*{said}"):
        check_plausible(replace(one, times=np.round(factor * one.times, 12)))


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


def test_of_a_foot_that_runs_only_the_calm_part_feels_gravity():
    """The median of its specific force is 2 g, which is no unit."""
    one = still(count=1000)
    running = np.arange(1000) % 100 >= 20
    rate, force = np.array(one.angular_velocity), np.array(one.specific_force)
    rate[running] += np.radians(400) * np.sin(np.arange(running.sum()))[:, None]
    force[running] *= 2.2
    foot = replace(one, angular_velocity=rate, specific_force=force)
    check_plausible(foot)
    with pytest.raises(LegsimError, match="it is g; state its unit as g"):
        check_plausible(replace(foot, specific_force=force / 9.80665))


def test_a_sensor_that_is_pushed_about_is_in_doubt_and_not_refused():
    """On a cart that rolls against its small tilts, gravity seems to turn the other way."""
    one = swaying(lean=0.03)
    mean = one.specific_force.mean(0)
    pushed = replace(one, specific_force=mean - 3 * (one.specific_force - mean))
    assert gyroscope_scale(pushed)[0] == pytest.approx(-3, abs=0.3)
    (note,) = checked(pushed).notes
    assert note.startswith("In doubt: sensor shank: its accelerometer sees gravity turn -3 times")
    assert checked(one).notes == ()


def test_a_wrong_sampling_rate_is_in_doubt():
    one = swaying()
    (note,) = checked(replace(one, times=one.times / 3)).notes
    assert "sees gravity turn 3 times as fast" in note


def test_a_calm_accelerometer_that_is_far_off_gravity_is_in_doubt():
    one = still()
    (note,) = checked(replace(one, specific_force=0.86 * one.specific_force)).notes
    assert note.startswith("In doubt: sensor shank reads 8.43 m/s2 while it is calm, -14 % off")
    assert checked(replace(one, specific_force=1.03 * one.specific_force)).notes == ()
