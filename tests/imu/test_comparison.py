"""Lag and mounting of measured sensors are those by which they were made."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.imu.comparison import compare
from legsim.imu.recording import ImuRecording
from tests.examples.sensors import still, swaying


def worn(lag: float, turn: list[float], rate_hz: float = 100.0) -> ImuRecording:
    """The swaying sensor with another clock, mounted by ``turn`` (rotation vector)."""
    one = swaying(rate_hz=rate_hz)
    axes = transforms.rotation_from_vector(turn)
    return ImuRecording(
        "m", one.times + lag, one.angular_velocity @ axes, one.specific_force @ axes
    )


@pytest.mark.parametrize("lag", [0.037, -0.2, 0.0])
@pytest.mark.parametrize("turn", [[0, 0, 0], [0.3, -2.0, 0.5], [3.0, 0.5, 0.1]])
def test_a_lag_and_a_mounting_are_recovered(lag, turn):
    found = compare(swaying(rate_hz=120.0), worn(lag, turn))
    assert found.lag == pytest.approx(lag, abs=2e-3)
    back = found.predicted_from_measured @ transforms.rotation_from_vector(turn).T
    assert np.degrees(transforms.rotation_angle(back)) < 0.3
    assert found.correlation > 0.97
    assert found.trusted
    moved = found.bands[0]
    assert (moved.quantity, moved.band_hz) == ("rate", (0.2, 6.0))
    assert moved.measured == pytest.approx(moved.predicted, rel=0.02)
    assert moved.difference < 0.03 * moved.measured


def test_noise_leaves_the_lag_within_two_milliseconds(rng):
    one = worn(0.037, [0.3, -2.0, 0.5])
    noisy = replace(
        one, angular_velocity=one.angular_velocity + 0.02 * rng.normal(size=(len(one.times), 3))
    )
    assert compare(swaying(), noisy).lag == pytest.approx(0.037, abs=2e-3)


def test_a_known_mounting_is_used():
    turn = [0.3, -2.0, 0.5]
    axes = transforms.rotation_from_vector(turn)
    found = compare(swaying(), worn(0.0, turn), rotation=axes)
    np.testing.assert_array_equal(found.predicted_from_measured, axes)
    assert found.bands[0].correlation > 0.999


def test_the_gyroscopes_bias_is_found_in_its_own_axes():
    one, bias = worn(0.037, [0.3, -2.0, 0.5]), np.array([0.01, -0.02, 0.005])
    found = compare(swaying(), replace(one, angular_velocity=one.angular_velocity + bias))
    # whole waves are not cut at their ends: their mean over 12 s is 0.02 deg/s
    np.testing.assert_allclose(found.mean_rate, bias, atol=5e-4)


def test_a_sensor_that_moves_otherwise_is_not_trusted():
    noise = still(count=1200, seed=3)
    assert not compare(swaying(), noise).trusted


def test_a_band_beyond_the_sampling_rate_is_left_out():
    found = compare(swaying(rate_hz=25.0), worn(0.0, [0, 0, 0], rate_hz=25.0))
    assert {agreement.band_hz for agreement in found.bands} == {(0.2, 6.0), (6.0, 12.0)}


def test_clocks_that_never_meet_are_refused():
    with pytest.raises(LegsimError, match=r"share less than 3 s; give clock_offset_s"):
        compare(swaying(), worn(1e6, [0, 0, 0]))


def test_a_short_trial_by_a_stated_clock_has_mounting_and_bias_and_no_lag():
    one, bias, turn = swaying(seconds=1.4), np.array([0.01, -0.02, 0.005]), [0.3, -2.0, 0.5]
    axes = transforms.rotation_from_vector(turn)
    brief = ImuRecording(
        "m", one.times, one.angular_velocity @ axes + bias, one.specific_force @ axes
    )
    with pytest.raises(LegsimError, match=r"too little to find the lag of its clock"):
        compare(swaying(), brief)
    found = compare(swaying(), brief, clock_stated=True)
    assert (found.lag, found.lag_source) == (0.0, "stated")
    assert found.shared_s == pytest.approx(1.39)
    back = found.predicted_from_measured @ axes.T
    assert np.degrees(transforms.rotation_angle(back)) < 0.3
    np.testing.assert_allclose(found.mean_rate, bias, atol=1e-4)
    assert found.correlation > 0.99


def test_a_stated_clock_of_a_long_trial_is_still_checked():
    found = compare(swaying(), worn(0.037, [0.3, -2.0, 0.5]), clock_stated=True)
    assert found.lag == pytest.approx(0.037, abs=2e-3)


def test_half_a_second_is_needed_even_by_a_stated_clock():
    with pytest.raises(LegsimError, match=r"less than 0.5 s.*; record a longer trial"):
        compare(swaying(), swaying(seconds=0.4), clock_stated=True)


def test_a_stated_clock_of_a_short_trial_is_not_searched():
    """A movement that repeats itself agrees elsewhere as well."""
    whole = swaying(seconds=60.0)
    first = whole.times < 2.0
    brief = ImuRecording(
        "shank", whole.times[first], whole.angular_velocity[first], whole.specific_force[first]
    )
    found = compare(whole, brief, clock_stated=True)
    assert (found.lag, found.lag_source) == (0.0, "stated")


def test_the_turn_about_the_vertical_is_known_as_well_as_stated(rng):
    """Of a sensor that sways a little under noise, 12 draws."""
    true, turn = swaying(lean=0.01), [0.0, 0.0, 1.2]
    axes = transforms.rotation_from_vector(turn)
    off = []
    for _ in range(12):
        noise = 0.02 * rng.normal(size=true.angular_velocity.shape)
        read = replace(
            true,
            angular_velocity=true.angular_velocity @ axes + noise,
            specific_force=true.specific_force @ axes,
        )
        found = compare(true, read)
        back = found.predicted_from_measured @ axes.T
        off.append(transforms.vector_from_rotation(back)[2] / found.turn_spread)
    assert 0.4 < np.sqrt(np.mean(np.square(off))) < 2.0
    assert compare(true, true, rotation=np.eye(3)).turn_spread == 0


def test_a_trial_of_less_than_half_a_second_is_too_short_whatever_is_stated():
    one = swaying(seconds=0.4)
    for stated in (False, True):
        with pytest.raises(LegsimError, match=r"too little for any comparison; record a longer"):
            compare(one, one, clock_stated=stated)
