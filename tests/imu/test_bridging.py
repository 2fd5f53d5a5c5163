"""Gaps in samples, filled such that no noise grows in them."""

import numpy as np
import pytest

from legsim.imu import strapdown
from legsim.imu.bridging import about, bridged
from legsim.imu.signals import SensorStart
from tests.references.sway import Sway

RATE_HZ = 100.0


def with_gap(count: int, first: int = 200, total: int = 500) -> tuple[np.ndarray, np.ndarray]:
    """Times of all samples, and which of them are there."""
    there = np.ones(total, bool)
    there[first : first + count] = False
    return np.arange(total) / RATE_HZ, there


@pytest.mark.parametrize("count", [3, 10, 30, 100])
def test_a_cubic_is_bridged_exactly_and_samples_are_kept(count):
    times, there = with_gap(count)
    values = np.polynomial.Polynomial([1.0, -2.0, 0.5, 0.3])(times - 2.5)[:, None] * [1.0, 3.0]
    new, filled = bridged(times[there], values[there], times)
    np.testing.assert_allclose(new, times, atol=1e-12)
    np.testing.assert_allclose(filled, values, atol=1e-9)
    np.testing.assert_array_equal(filled[there], values[there])


def test_short_gaps_and_none_are_left_to_the_spline():
    for count in (0, 1, 2):
        times, there = with_gap(count)
        np.testing.assert_array_equal(bridged(times[there], times[there], times)[0], times[there])


def test_gaps_apart_from_what_is_wanted_are_left():
    times, there = with_gap(30)
    for at, filled in ((times[:190], 0), (times[240:], 0), (times[100:210], 30)):
        assert len(bridged(times[there], times[there], at)[0]) == there.sum() + filled


@pytest.mark.parametrize("count", [3, 10, 30])
def test_noise_does_not_grow_in_a_gap(rng, count):
    times, there = with_gap(count)
    filled = bridged(times[there], rng.normal(size=(there.sum(), 400)), times)[1]
    # a cubic of 8 samples or more has at most their noise between them
    assert filled[~there].std() < 1.0


@pytest.mark.parametrize("after", [7, 8, 200])
@pytest.mark.parametrize("before", [1, 2, 3, 4, 7, 30])
@pytest.mark.parametrize("count", [3, 8, 10, 30, 100, 300])
def test_noise_does_not_grow_where_a_side_is_short(count, before, after):
    times, there = with_gap(count, before, before + count + after)
    # column k is how much of sample k's noise each filled sample has
    gain = bridged(times[there], np.eye(there.sum()), times)[1][~there]
    assert np.sqrt((gain**2).sum(1).mean()) < 1.0
    np.testing.assert_allclose(gain.sum(1), 1.0, atol=1e-9)
    np.testing.assert_allclose(gain @ times[there], times[~there], atol=1e-9)


def test_uneven_samples_are_bridged_by_cubics_without_more_noise(rng):
    """At random times there are gaps everywhere, and samples that crowd beside them."""
    times = np.sort(rng.uniform(0, 8, 800))
    values = np.column_stack([times**3, np.eye(len(times))])
    new, filled = bridged(times, values, times)
    inside = ~np.isin(new, times)
    assert inside.sum() > 200
    gain = np.sqrt((filled[inside, 1:] ** 2).sum(1))
    off = np.abs(filled[inside, 0] - new[inside] ** 3)
    assert np.sqrt(np.mean(gain**2)) < 1
    assert np.median(off) < 1e-9
    assert (off > 1e-9).mean() < 0.1


def test_noise_adds_little_to_what_a_third_of_a_second_costs(rng):
    """Of somebody who stands, through sensors with ordinary noise (2 mg, 0.1 deg/s); a spline
    through them would add 10 m.
    """
    views, added = np.arange(248) / 31, []
    for seed in range(10):
        sway = Sway.standing(seed)
        times, there = with_gap(30, total=820)
        rate, force = exact = sway.signals(times)
        noisy = (
            rate + np.radians(0.1) * rng.normal(size=rate.shape),
            force + 0.02 * rng.normal(size=force.shape),
        )
        start = SensorStart(sway.poses(views[:1])[0], sway.velocities(views[:1])[0])
        ends = [
            strapdown.integrate(times[kept], read[0][kept], read[1][kept], start, views)[-1, :3, 3]
            for read in (exact, noisy)
            for kept in (np.ones(len(times), bool), there)
        ]
        added.append(np.linalg.norm((ends[3] - ends[2]) - (ends[1] - ends[0])))
    assert np.sqrt(np.mean(np.square(added))) < 0.1


def test_samples_about_a_scan_reach_beyond_gaps():
    times = np.r_[0:4, 4.0, 4.7:8:0.1, 8.0]
    for at, beside, ends in (
        ([4.85, 7.95], 4, [3.0, 8.0]),
        ([4.85, 7.95], 1, [4.7, 8.0]),
        ([4.25], 1, [4.0, 4.7]),
        ([5.55, 6.55], 1, [5.4, 6.7]),
    ):
        near = times[about(times, np.array(at), 0.2, beside)]
        np.testing.assert_allclose(near[[0, -1]], ends)
