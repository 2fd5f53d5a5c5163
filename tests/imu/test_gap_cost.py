"""What gaps cost, by gaps of the same length where nothing was lost."""

import numpy as np
import pytest

from legsim.imu import strapdown
from legsim.imu.gap_cost import gap_cost, longest_gap
from legsim.imu.signals import SensorStart
from tests.references.sway import Sway

VIEWS = np.arange(248) / 31


def test_only_gaps_within_the_views_count():
    times = np.r_[np.arange(100), 130 + np.arange(700), 900 + np.arange(50)] / 100
    assert longest_gap(times, VIEWS) == np.float64(times[100] - times[99])
    assert longest_gap(times, VIEWS[VIEWS > 2]) == 0
    assert longest_gap(np.delete(times, [300, 301]), VIEWS[VIEWS > 2]) == 0


def test_the_cost_is_that_of_a_gap_which_is_there(rng):
    stated, costs = [], []
    for seed in range(8):
        sway, times = Sway.standing(seed), np.arange(820) / 100
        rate, force = sway.signals(times)
        force = force + 0.02 * rng.normal(size=force.shape)
        start = SensorStart(sway.poses(VIEWS[:1])[0], sway.velocities(VIEWS[:1])[0])
        kept = np.delete(np.arange(820), np.arange(400, 430))
        poses = [
            strapdown.integrate(times[k], rate[k], force[k], start, VIEWS)[-1, :3, 3]
            for k in (np.arange(820), kept)
        ]
        costs.append(np.linalg.norm(poses[1] - poses[0]))
        samples = (times[kept], rate[kept], force[kept])
        stated.append(gap_cost(samples, start, VIEWS, longest_gap(times[kept], VIEWS)))
    # of eight draws, and gaps over all of the scan beside one in its middle
    assert 0.4 < np.sqrt(np.mean(np.square(costs)) / np.mean(np.square(stated))) < 1.6


def test_what_is_recorded_long_before_and_after_the_scan_changes_nothing():
    """Two gaps touch the ends of the views; a spline forgets what is 0.3 s away, to 1e-9."""
    views, times, sway = VIEWS[:93], np.arange(-1000, 1300) / 100, Sway.standing(1)
    kept = (np.abs(times + 0.1) > 0.15) & (np.abs(times - 3.0) > 0.15)
    times = times[kept]
    rate, force = sway.signals(times)
    start = SensorStart(sway.poses(views[:1])[0], sway.velocities(views[:1])[0])
    near = (times > -2) & (times < 5)
    cost, short = (
        gap_cost((times[k], rate[k], force[k]), start, views, 0.3) for k in (kept[kept], near)
    )
    assert cost == pytest.approx(short, rel=1e-6)


def test_the_scan_alone_is_integrated(monkeypatch):
    """A recording of 100 s for a scan of 3 s."""
    seen, integrate = [], strapdown.integrate
    monkeypatch.setattr(
        strapdown,
        "integrate",
        lambda times, *a, **k: seen.append(len(times)) or integrate(times, *a, **k),
    )
    times = np.arange(-5000, 5000) / 100
    still = np.zeros((len(times), 3)), np.tile([0.0, 9.81, 0.0], (len(times), 1))
    start = SensorStart(np.eye(4), np.zeros(3))
    gap_cost((times, *still), start, VIEWS[:93], 0.2)
    assert max(seen) < 100 * (3 + 2 * 0.6)


def test_each_scheme_has_its_own_cost():
    """The paper's recursion reads a straight line across a gap; of a parabola it misses more."""
    times = np.arange(-100, 500) / 100
    force = np.array([0.0, 9.80665, 0.0]) + np.outer(times**2, [1.0, 0, 0])
    samples = (times, np.zeros_like(force), force)
    start, views = SensorStart(np.eye(4), np.zeros(3)), VIEWS[:93]
    assert gap_cost(samples, start, views, 0.3) < 1e-9
    # the area between parabola and chord, T^3 / 6, moves on from the gap to the last view
    begins = np.linspace(views[0], views[-1] - 0.3, 10)[1:-1]
    moved = 0.3**3 / 6 * (views[-1] - begins - 0.15)
    expected = np.sqrt(np.mean(moved**2))
    assert gap_cost(samples, start, views, 0.3, "paper") == pytest.approx(expected, rel=0.15)
