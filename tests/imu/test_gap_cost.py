"""What gaps cost, by gaps of the same length where nothing was lost."""

import numpy as np

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
