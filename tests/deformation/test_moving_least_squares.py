from importlib import resources

import numpy as np
import pyopencl as cl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction import control_points
from legsim.correction.control_points import AttachedPoint
from legsim.deformation import moving_least_squares, three_points
from legsim.deformation.models import ControlPointMotion
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.kinematics.skeleton import SegmentPoses
from legsim.opencl import discovery
from legsim.opencl.device import Device
from tests.references import mls as reference_mls
from tests.references.sway import Sway

# hip, knee and ankle of a leg bent by 30 degrees, m
LEG = np.array([[0.05, 0.85, -0.09], [0.15, 0.47, -0.1], [0.02, 0.08, -0.11]])
STRAIGHT = np.array([[0.0, 0.9, 0.0], [0.0, 0.5, 0.0], [0.0, 0.1, 0.0]])


def random_motion(
    rng: np.random.Generator, views: int = 5, size: float = 0.01, reference: np.ndarray = LEG
) -> ControlPointMotion:
    return ControlPointMotion(
        np.arange(views) / 31, reference, reference + rng.normal(0, size, (views, 3, 3))
    )


def around_the_knee(rng: np.random.Generator, count: int = 200) -> np.ndarray:
    return LEG[1] + rng.uniform(-0.13, 0.13, (count, 3))


def on_device(
    device: Device,
    motion: ControlPointMotion,
    points: np.ndarray,
    maps: np.ndarray | None = None,
    **options: float,
) -> np.ndarray:
    """H f(v) (v, n, 3) of every point by kernels/mls.cl."""
    maps = np.tile(np.eye(3, 4), (len(motion.times), 1, 1)) if maps is None else maps
    numbers = three_points.three_points(motion, maps, anchor=LEG[1], **options)
    source = (
        resources.files("legsim.opencl").joinpath("kernels", "moving_least_squares.cl").read_text()
        + """
    __kernel void map_points(__global const float *positions, __constant float *rest, __constant float *views, __global float *out)
    {
        const int i = get_global_id(0), view = get_global_id(1), n = get_global_size(0);
        vstore3(mls_moved(mls_prepare(vload3(i, positions), rest), views + 24 * view), view * n + i, out);
    }"""
    )
    program = discovery.build_program(device.context, source, [])
    out = np.empty((len(motion.times), len(points), 3), np.float32)
    target = device.zeros(out.size)
    positions = device.upload((points - LEG[1]).astype(np.float32))
    cl.Kernel(program, "map_points")(
        device.queue,
        (len(points), len(motion.times)),
        None,
        positions,
        device.upload(numbers.rest),
        device.upload(numbers.views),
        target,
    )
    return device.download(target, out).astype(float)


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


def test_no_motion_is_exactly_none(rng: np.random.Generator):
    for reference in (LEG, STRAIGHT, rng.normal(size=(6, 3)), rng.normal(size=(3, 2))):
        points = rng.normal(size=(100, reference.shape[1]))
        np.testing.assert_array_equal(
            moving_least_squares.warp_points(points, reference, reference), points
        )


def test_no_motion_on_the_device_is_rounding(device: Device, rng: np.random.Generator):
    points = around_the_knee(rng)
    for reference in (LEG, STRAIGHT):
        motion = ControlPointMotion([0.0], reference, reference[None])
        np.testing.assert_allclose(on_device(device, motion, points)[0], points, atol=3e-7)


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


def test_joints_follow_the_sensors():
    times = np.arange(30) / 31
    shank, thigh = Sway.standing(1).poses(times), Sway.standing(2).poses(times)
    poses = SegmentPoses(times, ("shank_l", "thigh_l"), np.stack([shank, thigh], 1))
    joints = [
        AttachedPoint.at_start("thigh_l", thigh[0], LEG[0]),
        *(AttachedPoint.at_start("shank_l", shank[0], LEG[k]) for k in (1, 2)),
    ]
    motion = control_points.track_points(poses, joints)
    np.testing.assert_allclose(motion.reference, LEG, atol=1e-12)
    expected = transforms.apply(shank @ transforms.inverse(shank[0]), LEG[1:])
    np.testing.assert_allclose(motion.moved[:, 1:], expected, atol=1e-12)
    drawn = control_points.contracted(motion, 1, 0.8)
    np.testing.assert_allclose(
        drawn.moved[:, 0], 0.2 * motion.moved[:, 0] + 0.8 * motion.moved[:, 1], atol=1e-15
    )
    np.testing.assert_allclose(drawn.moved[:, 1], motion.moved[:, 1], atol=1e-15)


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
