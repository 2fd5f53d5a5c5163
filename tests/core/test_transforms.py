import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from legsim.core import transforms

vectors = arrays(float, 3, elements=st.floats(-3, 3))


def random_poses(rng, count):
    return transforms.rigid(
        transforms.rotation_from_vector(rng.normal(size=(count, 3))), rng.normal(size=(count, 3))
    )


def test_transforms_form_a_group(rng):
    a, b, c = random_poses(rng, 3)
    np.testing.assert_allclose((a @ b) @ c, a @ (b @ c), atol=1e-14)
    np.testing.assert_allclose(a @ transforms.inverse(a), np.eye(4), atol=1e-14)
    np.testing.assert_allclose(
        transforms.inverse(a @ b), transforms.inverse(b) @ transforms.inverse(a), atol=1e-14
    )


def test_apply_is_the_matrix_product(rng):
    poses, points = random_poses(rng, 5), rng.normal(size=(7, 3))
    moved = transforms.apply(poses, points)
    assert moved.shape == (5, 7, 3)
    np.testing.assert_allclose(moved[2, 3], (poses[2] @ [*points[3], 1])[:3])


@given(vectors)
def test_rotation_agrees_with_scipy(vector):
    np.testing.assert_allclose(
        transforms.rotation_from_vector(vector),
        Rotation.from_rotvec(vector).as_matrix(),
        atol=1e-14,
    )


@given(vectors)
def test_rotation_vector_round_trip(vector):
    vector = vector * min(1.0, 3.1 / max(np.linalg.norm(vector), 1e-300))
    np.testing.assert_allclose(
        transforms.vector_from_rotation(transforms.rotation_from_vector(vector)), vector, atol=1e-13
    )


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6])
def test_small_angles_keep_their_digits(angle):
    matrix = transforms.rotation_from_vector([0.0, angle, 0.0])
    assert transforms.rotation_angle(matrix) == pytest.approx(angle, rel=1e-9)


@pytest.mark.parametrize("axis", np.vstack([np.eye(3), np.ones(3) / np.sqrt(3)]))
def test_quaternions_of_half_turns(axis):
    rotation = transforms.rotation_from_vector(np.pi * axis)
    np.testing.assert_allclose(
        Rotation.from_quat(
            transforms.quaternion_from_rotation(rotation), scalar_first=True
        ).as_matrix(),
        rotation,
        atol=1e-14,
    )


@given(vectors)
def test_quaternion_is_scipys_and_has_positive_scalar(vector):
    rotation = transforms.rotation_from_vector(vector)
    quaternion = transforms.quaternion_from_rotation(rotation)
    assert quaternion[0] >= 0
    xyzw = Rotation.from_matrix(rotation).as_quat(canonical=True)
    assert abs(quaternion @ xyzw[[3, 0, 1, 2]]) == pytest.approx(1)


def test_axis_rotation_turns_about_the_axis(rng):
    axis = rng.normal(size=3)
    turned = transforms.axis_rotation(axis, np.array([0.3, 1.2]))
    np.testing.assert_allclose(turned @ axis, [axis, axis], atol=1e-14)
    np.testing.assert_allclose(transforms.rotation_angle(turned), [0.3, 1.2])


def test_best_rigid_recovers_a_pose_and_never_reflects(rng):
    pose, points = random_poses(rng, 1)[0], rng.normal(size=(6, 3))
    np.testing.assert_allclose(
        transforms.best_rigid(points, transforms.apply(pose, points)), pose, atol=1e-12
    )
    mirrored = transforms.best_rigid(points, points * [1, 1, -1])
    assert np.linalg.det(mirrored[:3, :3]) == pytest.approx(1)
    plane = points * [1, 1, 0]
    np.testing.assert_allclose(
        transforms.best_rigid(plane, transforms.apply(pose, plane)), pose, atol=1e-12
    )


def test_best_rigid_of_a_stack_is_that_of_each(rng):
    points, stack = rng.normal(size=(5, 3)), rng.normal(size=(4, 2, 5, 3))
    weights = rng.uniform(0.5, 2, 5)
    found = transforms.best_rigid(points, stack, weights)
    for k in np.ndindex(4, 2):
        np.testing.assert_allclose(
            found[k], transforms.best_rigid(points, stack[k], weights), atol=1e-12
        )


def test_best_rigid_follows_its_weights(rng):
    points = rng.normal(size=(5, 3))
    target = points.copy()
    target[4] += 10
    np.testing.assert_allclose(
        transforms.best_rigid(points, target, [1, 1, 1, 1, 0]), np.eye(4), atol=1e-12
    )


def test_the_cross_product_is_numpys_to_the_bit(rng):
    one, other = rng.normal(size=(2, 4, 5, 3))
    np.testing.assert_array_equal(transforms.cross(one, other), np.cross(one, other))
    np.testing.assert_array_equal(transforms.cross(one, other[:, :1]), np.cross(one, other[:, :1]))
