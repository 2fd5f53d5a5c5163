"""Rough starts: the spread of the draws, and what each turn does to gravity."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction.rough_start import EXACT, StartErrors, rough, turned
from legsim.imu.signals import SensorStart

UP = np.array([0.0, 1.0, 0.0])
POSE = transforms.rigid(transforms.rotation_from_vector([0.4, -1.1, 0.3]), [0.1, 0.5, -0.2])


def test_a_heading_leaves_gravity_where_it_is():
    rotation = POSE[:3, :3]
    tilted = turned(rotation, np.array([0.02, 0.0, -0.03]))
    headed = turned(rotation, np.array([0.02, 0.5, -0.03]))
    np.testing.assert_allclose(headed.T @ UP, tilted.T @ UP, atol=1e-15)
    assert np.degrees(np.arccos((tilted.T @ UP) @ (rotation.T @ UP))) > 1


def test_draws_have_the_stated_spread(rng: np.random.Generator):
    """500 draws: a standard deviation is known to 3 %."""
    errors = StartErrors()
    start = SensorStart(POSE, np.array([0.01, 0.0, 0.02]))
    drawn = rough([start] * 500, errors, rng)
    places = np.stack([d.world_from_sensor[:3, 3] for d in drawn]) - POSE[:3, 3]
    turns = np.stack(
        [
            transforms.vector_from_rotation(d.world_from_sensor[:3, :3] @ POSE[:3, :3].T)
            for d in drawn
        ]
    )
    np.testing.assert_allclose(places.std(0), errors.place, rtol=0.12)
    np.testing.assert_allclose(turns.std(0), [errors.tilt, errors.heading, errors.tilt], rtol=0.12)
    assert all((d.velocity == 0).all() for d in drawn)


def test_a_seed_decides_the_draws_and_exact_errors_draw_none():
    start = SensorStart(POSE, np.zeros(3))
    one, two = (rough([start], StartErrors(), np.random.default_rng(4))[0] for _ in range(2))
    np.testing.assert_array_equal(one.world_from_sensor, two.world_from_sensor)
    (same,) = rough([start], EXACT, np.random.default_rng(4))
    np.testing.assert_allclose(same.world_from_sensor, POSE, atol=1e-15)


def test_errors_that_are_no_sizes_are_refused():
    with pytest.raises(LegsimError, match="tilt"):
        StartErrors(tilt=-1.0)
    with pytest.raises(LegsimError, match="place"):
        StartErrors(place=float("nan"))
