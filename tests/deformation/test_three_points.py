"""Three control points on a device are the general form's closed solution."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.correction import control_points
from legsim.deformation import moving_least_squares, three_points
from legsim.deformation.models import ControlPointMotion
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.opencl.device import Device
from tests.examples.bent_leg import LEG, STRAIGHT, around_the_knee, on_device, random_motion


@pytest.mark.parametrize("size", [1e-3, 0.02, 0.2])
def test_three_points_on_the_device_are_the_svd_form(
    device: Device, rng: np.random.Generator, size: float
):
    motion, points = random_motion(rng, size=size), around_the_knee(rng)
    expected = np.stack(
        [
            moving_least_squares.warp_points(points, motion.reference, moved)
            for moved in motion.moved
        ]
    )
    np.testing.assert_allclose(on_device(device, motion, points), expected, atol=1e-6)


def test_device_applies_the_views_maps(device: Device, rng: np.random.Generator):
    geometry = ConeBeamGeometry.circular(
        times=np.arange(5) / 31,
        angles=np.arange(5) * 0.4,
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(480, 620),
        pixel_pitch=0.616e-3,
        isocenter=LEG[1],
    )
    motion, points = random_motion(rng), around_the_knee(rng)
    homogeneous = on_device(device, motion, points, geometry.matrices)
    moved = np.stack(
        [moving_least_squares.warp_points(points, motion.reference, q) for q in motion.moved]
    )
    pixels, depth = geometry.project(moved)
    np.testing.assert_allclose(homogeneous[..., :2] / homogeneous[..., 2:], pixels, atol=1e-3)
    np.testing.assert_allclose(homogeneous[..., 2], depth, rtol=1e-6)


def test_no_motion_on_the_device_is_rounding(device: Device, rng: np.random.Generator):
    points = around_the_knee(rng)
    for reference in (LEG, STRAIGHT):
        motion = ControlPointMotion([0.0], reference, reference[None])
        np.testing.assert_allclose(on_device(device, motion, points)[0], points, atol=3e-7)


def test_leg_that_is_straight_in_one_view_stays_smooth(device: Device, rng: np.random.Generator):
    """Bending through straight: points near the leg move by what its joints do, never farther."""
    points, bends = around_the_knee(rng), np.linspace(-0.02, 0.02, 41)
    moved = np.repeat(STRAIGHT[None], 41, 0)
    moved[:, 1, 0] += bends
    motion = ControlPointMotion(
        np.arange(41) / 31, STRAIGHT + np.array([[0, 0, 0], [0.02, 0, 0], [0, 0, 0]]), moved
    )
    steps = np.diff(on_device(device, motion, points), axis=0)
    assert np.linalg.norm(steps, axis=-1).max() < 3 * 0.001


def test_refusals(rng: np.random.Generator):
    motion = random_motion(rng)
    with pytest.raises(LegsimError, match="fall together"):
        three_points.three_points(
            random_motion(rng, size=0.0, reference=LEG[[0, 1, 1]]), np.zeros((5, 3, 4))
        )
    with pytest.raises(LegsimError, match="3 control points; there are 4"):
        four = np.concatenate([LEG, LEG[:1] + 0.1])
        three_points.three_points(ControlPointMotion([0.0], four, four[None]), np.zeros((1, 3, 4)))
    with pytest.raises(LegsimError, match="0 <= alpha < 1"):
        control_points.contracted(motion, 1, 1.0)


@pytest.mark.parametrize("bend", [1.5e-3, 4e-3, 7e-3])
def test_a_knee_that_bends_backwards_does_not_turn_the_leg_around(
    device: Device, rng: np.random.Generator, bend: float
):
    """Of a leg nearly straight, points move by what its joints do, by both forms alike."""
    reference = np.array([[0, 0.4, 0], [bend, 0, 0], [0, -0.4, 0]])
    moved = np.array([reference * (s, 1, 1) for s in (1, 0.8, -0.8, -1)])
    points = 0.1 * rng.normal(size=(200, 3))
    general = np.stack([moving_least_squares.warp_points(points, reference, q) for q in moved])
    closed = on_device(device, ControlPointMotion(np.arange(4) / 31, reference, moved), points)
    assert np.linalg.norm(general - points, axis=-1).max() < 4 * bend
    np.testing.assert_allclose(closed, general, atol=1e-6)


def test_a_bent_leg_may_turn_around(device: Device, rng: np.random.Generator):
    half = np.diag([-1.0, 1, -1, 1])
    motion = ControlPointMotion([0.0, 1.0], LEG, np.stack([LEG, LEG @ half[:3, :3]]))
    points = around_the_knee(rng)
    np.testing.assert_allclose(
        on_device(device, motion, points)[1], points @ half[:3, :3], atol=1e-6
    )
    np.testing.assert_allclose(
        moving_least_squares.warp_points(points, LEG, motion.moved[1]),
        points @ half[:3, :3],
        atol=1e-9,
    )
