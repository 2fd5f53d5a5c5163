"""How still ankles are: of walks whose steps are known."""

import numpy as np
import pytest

from legsim.mocap.trajectories import MarkerTrajectories
from tools.experiments.still_ankles import ankles, calmest, steps

TIMES = np.arange(0, 40, 0.01)


def walk(rng: np.random.Generator, size: float) -> np.ndarray:
    """(n, 3) m that wander by ``size`` per root of a second."""
    return size * np.sqrt(0.01) * np.cumsum(rng.standard_normal((len(TIMES), 3)), 0)


def test_steps_of_a_walk_grow_with_the_root_of_time(rng: np.random.Generator):
    at = walk(rng, 2e-4)
    assert steps(at, 1) == pytest.approx(2e-5, rel=0.05)
    assert steps(at, 100) == pytest.approx(2e-4, rel=0.25)


def test_the_ankle_is_between_the_malleoli_that_are_marked(rng: np.random.Generator):
    names = ("RLMAL", "RMMAL", "LLMAL")
    at = rng.standard_normal((len(TIMES), 3, 3))
    found = ankles(MarkerTrajectories(TIMES, names, at))
    np.testing.assert_allclose(found["r"], at[:, :2].mean(1))
    np.testing.assert_allclose(found["l"], at[:, 2])


def test_the_calmest_eight_seconds_count(rng: np.random.Generator):
    at = walk(rng, 1e-3)
    at[1500:2500] = at[1500]
    found = calmest(TIMES, at)
    assert found is not None
    assert len(found) == 801
    assert np.ptp(found, axis=0).max() == 0


def test_who_walks_away_or_is_hardly_seen_does_not_count(rng: np.random.Generator):
    assert calmest(TIMES, TIMES[:, None] * [0.1, 0, 0]) is None
    hidden = walk(rng, 1e-5)
    hidden[::5] = np.nan
    assert calmest(TIMES, hidden) is None
    assert calmest(TIMES[:150], np.zeros((150, 3))) is None
