"""The soft map of a leg: laws of rigid motion, orientation and volume."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from legsim.core import transforms
from legsim.phantom import skinning
from legsim.phantom.skinning import FAR, NEAR, LegAxes, SoftWeights, TissueMobility

AXES = LegAxes((-0.0045, -0.3958, 0.0), (-0.0045, -0.8258, 0.0), (0.044, -0.397, -0.003), 1.0)


def random_pose(rng):
    return transforms.rigid(transforms.rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))


def leg_points(rng, count=2000):
    angle, radius = rng.uniform(0, 2 * np.pi, count), 0.06 * np.sqrt(rng.uniform(0, 1, count))
    return np.stack(
        [radius * np.cos(angle), rng.uniform(-0.85, -0.05, count), radius * np.sin(angle)], -1
    )


def knee_turn(degrees, way=(0.0, 0.0)):
    """Motion of the tibia in the femur's frame: flexion about the knee and a shift of its
    origin.
    """
    knee = np.array(AXES.knee)
    turn = transforms.axis_rotation((0, 0, 1), -np.radians(degrees))
    return transforms.rigid(turn, knee + np.array([*way, 0.0]) - turn @ knee)


def flexed(points, degrees, way=(0.0, 0.0)):
    tibia = knee_turn(degrees, way)
    patella = knee_turn(0.86 * degrees)
    return skinning.deform(
        points,
        SoftWeights.at(points, AXES),
        femur=np.eye(4),
        tibia=tibia,
        patella=patella,
        foot=tibia,
    )


def way_of(degrees):
    """About what gait2392's tibia does."""
    return 0.008 * np.sin(np.radians(degrees)), -0.018 * (1 - np.cos(np.radians(degrees)))


def test_a_straight_leg_and_a_common_motion_are_carried_exactly(rng):
    points = leg_points(rng)
    weights = SoftWeights.at(points, AXES)
    pose = random_pose(rng)
    moved = skinning.deform(points, weights, femur=pose, tibia=pose, patella=pose, foot=pose)
    np.testing.assert_allclose(moved, transforms.apply(pose, points), atol=1e-12)


def test_a_motion_of_the_world_moves_the_result(rng):
    points, pose = leg_points(rng), random_pose(rng)
    weights = SoftWeights.at(points, AXES)
    bones = {
        "femur": np.eye(4),
        "tibia": knee_turn(70, way_of(70)),
        "patella": knee_turn(60),
        "foot": knee_turn(60),
    }
    still = skinning.deform(points, weights, **bones)
    moved = skinning.deform(points, weights, **{name: pose @ bone for name, bone in bones.items()})
    np.testing.assert_allclose(moved, transforms.apply(pose, still), atol=1e-12)


def test_far_from_the_joints_tissue_follows_its_bone_rigidly(rng):
    points = leg_points(rng)
    points = points[np.abs(points[:, 1] + 0.84) > 0.1]
    tibia, femur = knee_turn(95, way_of(95)), points[:, 1] > -0.12
    shank = (points[:, 1] < -0.66) & (points[:, 1] > -0.75)
    moved = flexed(points, 95, way_of(95))
    np.testing.assert_allclose(moved[femur], points[femur], atol=2e-3)
    np.testing.assert_allclose(moved[shank], transforms.apply(tibia, points[shank]), atol=2e-3)


def test_the_foot_follows_the_foot(rng):
    sole = np.stack(
        [rng.uniform(-0.05, 0.15, 50), rng.uniform(-0.92, -0.88, 50), rng.uniform(-0.03, 0.03, 50)],
        -1,
    )
    foot = random_pose(rng)
    moved = skinning.deform(
        sole,
        SoftWeights.at(sole, AXES),
        femur=np.eye(4),
        tibia=np.eye(4),
        patella=np.eye(4),
        foot=foot,
    )
    np.testing.assert_allclose(moved, transforms.apply(foot, sole), atol=1e-12)


def test_a_shared_turn_agrees_with_the_plain_blend_of_quaternions(rng):
    points = leg_points(rng, 40)
    tibia = random_pose(rng)
    weights = SoftWeights.at(points, AXES)
    points, share, slide = (
        points[weights.patella_share == 0],
        *(w[weights.patella_share == 0] for w in (weights.knee_share, weights.knee_slide)),
    )
    weights = SoftWeights(AXES, share, 0 * share, slide, 0 * share, 0 * share)
    moved = skinning.deform(
        points, weights, femur=np.eye(4), tibia=tibia, patella=np.eye(4), foot=tibia
    )
    knee, quaternion = np.array(AXES.knee), transforms.quaternion_from_rotation(tibia[:3, :3])
    for point, s, t, result in zip(points, share, slide, moved, strict=True):
        if s == 1:
            expected = transforms.apply(tibia, point[None])[0]
        else:
            turn = Rotation.from_quat(
                (1 - s) * np.array([1, 0, 0, 0]) + s * quaternion, scalar_first=True
            ).as_matrix()
            expected = (
                knee
                + turn @ (point - knee)
                + t * (transforms.apply(tibia, knee[None])[0] - knee) * (s > 0)
            )
        np.testing.assert_allclose(result, expected, atol=1e-12)


@pytest.mark.parametrize("degrees", [-5, 30, 60, 90, 110])
def test_tissue_is_never_turned_inside_out(degrees):
    axes = (
        np.arange(-0.064, 0.066, 0.008),
        np.arange(-0.62, -0.15, 0.008),
        np.array([0.0, 0.03, 0.05]),
    )
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    from_knee = points - np.array(AXES.knee)
    # nearer to the axis there are only the bones, which move by themselves
    points = points[np.hypot(from_knee[:, 0], from_knee[:, 1]) > 0.045]
    step = 1e-6
    slope = [
        (
            flexed(points + step * e, degrees, way_of(degrees))
            - flexed(points - step * e, degrees, way_of(degrees))
        )
        / (2 * step)
        for e in np.eye(3)
    ]
    determinant = np.linalg.det(np.stack(slope, -1))
    assert determinant.min() > 0.05
    assert 0.85 < np.median(determinant) < 1.1


def test_the_map_scales_with_the_person(rng):
    points, size = leg_points(rng), 1.12
    knee, ankle, patella = (
        (size * x, size * y, size * z) for x, y, z in (AXES.knee, AXES.ankle, AXES.patella)
    )
    larger = LegAxes(knee, ankle, patella, size)
    grown = transforms.rigid(np.eye(3), np.zeros(3))
    bones = {
        "femur": np.eye(4),
        "tibia": knee_turn(80),
        "patella": knee_turn(70),
        "foot": knee_turn(80),
    }
    expected = size * skinning.deform(points, SoftWeights.at(points, AXES), **bones)
    for bone in bones.values():
        bone[:3, 3] *= size
    result = skinning.deform(
        size * points,
        SoftWeights.at(size * points, larger),
        **{n: grown @ b for n, b in bones.items()},
    )
    np.testing.assert_allclose(result, expected, atol=1e-9)


def test_flexion_is_the_turn_about_the_outward_axis():
    for degrees in (-8.0, 0.0, 45.0, 110.0):
        assert np.degrees(skinning.flexion_of(knee_turn(degrees))) == pytest.approx(
            degrees, abs=1e-9
        )


BALL = trimesh.creation.icosphere(subdivisions=2, radius=0.03)
SHARE = TissueMobility([(np.asarray(BALL.vertices), np.asarray(BALL.faces))])


def test_a_bones_surface_takes_nothing_of_the_swing_and_what_is_far_from_it_all():
    """Also between the vertices of its long triangles."""
    places = trimesh.sample.sample_surface(BALL, 3000, seed=1)[0]
    np.testing.assert_array_equal(SHARE.at(places), 0)
    away = places * (1 + 0.001 / 0.03)
    np.testing.assert_array_equal(SHARE.at(away), 0)
    np.testing.assert_array_equal(SHARE.at(places * (1 + (FAR + 1e-3) / 0.03)), 1)


def test_between_them_it_rises_and_never_faster_than_the_farthest_swing_allows():
    heights = np.linspace(0, 0.04, 400)
    shares = SHARE.at(
        np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8]) * (0.03 + heights)[:, None]
    )
    slopes = np.diff(shares) / np.diff(heights)
    assert (slopes >= 0).all()
    assert shares[0] == 0
    assert shares[-1] == 1
    assert slopes.max() * skinning.FARTHEST_SWING == pytest.approx(0.5, rel=0.02)
    assert NEAR < heights[np.argmax(slopes)] < FAR
