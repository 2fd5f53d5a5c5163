import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from legsim.core import transforms
from legsim.deformation import moving_least_squares
from legsim.deformation.models import ControlPointMotion
from legsim.opencl.device import Device
from tests.examples.bent_leg import LEG, STRAIGHT, around_the_knee, on_device, random_motion
from tests.references import mls as reference_mls
from tests.references.sway import Sway


@pytest.mark.parametrize("count", [3, 4, 7])
def test_general_form_is_the_best_rigid_motion_at_every_point(rng: np.random.Generator, count: int):
    reference = rng.normal(0, 0.3, (count, 3))
    moved = reference + rng.normal(0, 0.05, (count, 3))
    points = rng.normal(0, 0.3, (50, 3))
    expected = np.array([reference_mls.displaced_in_space(p, reference, moved) for p in points])
    np.testing.assert_allclose(
        moving_least_squares.warp_points(points, reference, moved), expected, atol=1e-8
    )


def test_plane_form_is_the_published_one(rng: np.random.Generator):
    reference = rng.uniform(0, 600, (3, 2))
    moved, points = reference + rng.normal(0, 15, (3, 2)), rng.uniform(0, 600, (50, 2))
    expected = np.array([reference_mls.displaced_in_image(p, reference, moved) for p in points])
    np.testing.assert_allclose(
        moving_least_squares.warp_points(points, reference, moved), expected, atol=1e-6
    )


def test_no_motion_is_exactly_none(rng: np.random.Generator):
    for reference in (LEG, STRAIGHT, rng.normal(size=(6, 3)), rng.normal(size=(3, 2))):
        points = rng.normal(size=(100, reference.shape[1]))
        np.testing.assert_array_equal(
            moving_least_squares.warp_points(points, reference, reference), points
        )


def test_one_rigid_motion_of_all_points_moves_space_with_it(
    device: Device, rng: np.random.Generator
):
    poses = Sway.standing(1, position_mm=20, angle_deg=10).poses(np.arange(20) / 31)
    motions = poses @ transforms.inverse(poses[0])
    points, motion = (
        around_the_knee(rng),
        ControlPointMotion(np.arange(20) / 31, LEG, transforms.apply(motions, LEG)),
    )
    expected = transforms.apply(motions, points)
    for k in range(20):
        np.testing.assert_allclose(
            moving_least_squares.warp_points(points, LEG, motion.moved[k]), expected[k], atol=1e-9
        )
    np.testing.assert_allclose(on_device(device, motion, points), expected, atol=1e-6)


def test_control_points_go_where_they_were_seen(device: Device, rng: np.random.Generator):
    motion = random_motion(rng, size=0.05)
    nearby = np.concatenate([LEG, LEG + 1e-9, LEG - 1e-6])
    for k, moved in enumerate(motion.moved):
        np.testing.assert_allclose(
            moving_least_squares.warp_points(nearby, LEG, moved), np.tile(moved, (3, 1)), atol=3e-6
        )
        np.testing.assert_allclose(
            moving_least_squares.warp_points(LEG, LEG, moved), moved, atol=1e-15
        )
        np.testing.assert_allclose(
            on_device(device, motion, nearby)[k], np.tile(moved, (3, 1)), atol=3e-6
        )


def test_straight_leg_turns_as_little_as_it_can(device: Device, rng: np.random.Generator):
    """Rigid up to the twist, which three points on a line cannot tell: the smallest rotation
    between the lines.
    """
    turn = transforms.rotation_from_vector([0.1, 0.0, -0.2])  # across the leg: no twist in it
    moved = STRAIGHT @ turn.T + [0.01, 0.02, 0.03]
    points = around_the_knee(rng)
    expected = points @ turn.T + [0.01, 0.02, 0.03]
    np.testing.assert_allclose(
        moving_least_squares.warp_points(points, STRAIGHT, moved), expected, atol=1e-8
    )
    np.testing.assert_allclose(
        on_device(device, ControlPointMotion([0.0], STRAIGHT, moved[None]), points)[0],
        expected,
        atol=1e-6,
    )


@settings(max_examples=60)
@given(
    reference=hnp.arrays(float, (3, 3), elements=st.integers(-2, 2).map(float)),
    moved=hnp.arrays(float, (3, 3), elements=st.integers(-2, 2).map(float)),
    points=hnp.arrays(float, (4, 3), elements=st.integers(-2, 2).map(float)),
)
def test_never_a_number_that_is_none(reference: np.ndarray, moved: np.ndarray, points: np.ndarray):
    found = moving_least_squares.warp_points(points, reference, moved)
    assert np.isfinite(found).all()
    # no rotation stretches: at most the farthest arm beyond the farthest moved point
    assert np.abs(found).max() < 30


def test_fewer_points_leave_less_to_know(rng: np.random.Generator):
    points = rng.normal(size=(20, 3))
    np.testing.assert_allclose(
        moving_least_squares.warp_points(points, [[0, 0, 0]], [[1, 2, 3]]),
        points + np.array([1, 2, 3]),
    )
    turn = transforms.axis_rotation([0, 0, 1], 0.3)
    pair = np.array([[1.0, 0, 0], [-1, 0, 0]])
    np.testing.assert_allclose(
        moving_least_squares.warp_points(points, pair, pair @ turn.T), points @ turn.T, atol=1e-8
    )
