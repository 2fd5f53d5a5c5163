"""Lags of clocks: near by, far away, by unrelated clocks; none where nothing tells them."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from legsim.core import transforms
from legsim.imu.comparison import compare
from legsim.imu.lag import find_far_lag, find_lag
from legsim.imu.recording import ImuRecording

STEP = 0.01


def moving(seconds: float = 30.0, size: float = 1.0, seed: int = 3) -> ImuRecording:
    """A sensor that turns by smooth noise up to 3 Hz, with gravity along its z axis."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(seconds / STEP)) * STEP
    rate = gaussian_filter1d(rng.standard_normal((len(times), 3)), 10, axis=0)
    force = np.tile([0.3, 0.0, 9.8], (len(times), 1))
    return ImuRecording("predicted", times, size * rate / rate.std(), force)


def part(one: ImuRecording, first: float, last: float, clock: float) -> ImuRecording:
    """A part (s) of the same movement, turned and noisy, by a clock that reads ``clock`` more."""
    inside = (one.times >= first) & (one.times <= last)
    axes = transforms.rotation_from_vector([0.3, -2.0, 0.5])
    rate, force = one.angular_velocity[inside] @ axes, one.specific_force[inside] @ axes
    noise = 0.05 * np.random.default_rng(1).standard_normal(rate.shape)
    return ImuRecording("m", one.times[inside] + clock, rate + noise, force)


@pytest.mark.parametrize("clock", [0.2, -0.437])
def test_a_lag_near_by_is_found(clock: float):
    one = moving()
    lag, correlation = find_lag(one, part(one, 0, 30, clock), step=STEP)
    assert lag == pytest.approx(clock, abs=1e-3)
    assert correlation > 0.97


@pytest.mark.parametrize(
    ("first", "last", "clock"),
    [(0, 30, 4.3), (10, 25, -10.0), (8.5, 30, -3.25), (0, 20, 1.7e9), (5, 20, -86400.0)],
)
def test_recordings_started_at_different_times_find_each_other(first, last, clock):
    one = moving()
    found = find_far_lag(one, part(one, first, last, clock), step=STEP)
    assert found is not None
    assert found[0] == pytest.approx(clock, abs=2e-3)
    assert found[1] > 0.97


def test_a_comparison_searches_far_where_nothing_agrees_near_by():
    one = moving()
    near, far = compare(one, part(one, 0, 30, 0.3)), compare(one, part(one, 0, 30, 7.0))
    assert near.lag_source == "nearby"
    assert far.lag_source == "anywhere"
    assert far.lag == pytest.approx(7.0, abs=2e-3)
    assert compare(one, part(one, 0, 30, 1e6)).lag == pytest.approx(1e6, abs=2e-3)


def test_another_movement_has_no_lag():
    one, other = moving(), moving(seed=4)
    assert find_far_lag(one, part(other, 0, 30, 0.0), step=STEP) is None
    assert compare(one, part(other, 0, 30, 0.0)).lag_source == "nearby"


def test_standing_gives_no_far_lag():
    one = moving(size=0.01)
    assert find_far_lag(one, part(one, 10, 25, 0.0), step=STEP) is None


def test_short_recordings_are_compared_and_never_refused():
    """Lags that leave less than 3 s to share are no candidates."""
    one = moving(12.0)
    for start in (1.5, 2.0, 3.0):
        found = compare(part(one, 0, 4, 0.0), part(one, start, start + 4, -start))
        assert np.isfinite(found.lag)
    for seconds in (3.2, 3.6, 5.0):
        short = moving(seconds, seed=5)
        lag, _ = find_lag(short, part(moving(seconds, seed=6), 0, seconds, 0.0), step=STEP)
        assert abs(lag) <= seconds - 3


def test_a_gyroscope_that_is_off_agrees_with_nothing():
    one = moving()
    off = ImuRecording("m", one.times, np.zeros_like(one.angular_velocity), one.specific_force)
    assert find_lag(one, off, step=STEP) == (0.0, 0.0)
    assert not compare(one, off).trusted


def test_a_clock_with_one_wild_sample_is_not_searched():
    one = moving()
    times = np.concatenate([[0.0], one.times[1:] + 1.7e9])
    wild = ImuRecording("m", times, one.angular_velocity, one.specific_force)
    assert wild.is_mostly_gaps
    assert find_far_lag(one, wild, step=STEP) is None
