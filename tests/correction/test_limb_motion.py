"""A leg of rigid bones with tissue between them: what must hold whatever moves it."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.correction.bone_regions import FEMUR, PATELLA, TIBIA, BoneRegions
from legsim.correction.limb_motion import (
    Limb,
    articulated_motion,
    expected_patella,
    patella_motion,
    shares_at,
)
from legsim.deformation.models import RigidMotion
from legsim.geometry.volume import VolumeGrid
from legsim.kinematics import patella
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.skeleton import segment_index
from tests.examples import knee

TIMES = np.arange(5) / 31
NODES = knee.GRID.coarse(0.006)
BONES = BoneRegions(knee.GRID, knee.truth().astype(np.uint8))


def about(center: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Transforms (v, 4, 4) that turn by rotation vectors (v, 3) about a point."""
    there = transforms.translation(center)
    turned = transforms.rigid(transforms.rotation_from_vector(turn), np.zeros(3))
    return there @ turned @ transforms.inverse(there)


def squat(degrees: float) -> Limb:
    """The thigh sways, the knee bends by so much in the end."""
    rng = np.random.default_rng(4)
    sway = about(knee.JOINTS[0], 0.01 * np.cumsum(rng.normal(size=(5, 3)), 0))
    bend = about(knee.JOINTS[1], np.radians(degrees) * TIMES[:, None] / TIMES[-1] * [0, 0, -1.0])
    return Limb(knee.JOINTS, sway, sway @ bend, BONES)


def moved_world(limb: Limb, world: np.ndarray) -> Limb:
    """The same leg seen from another place; its voxels stay along the axes of the world."""
    joints = transforms.apply(world, limb.joints)
    return replace(limb, joints=joints, thigh=world @ limb.thigh, shank=world @ limb.shank)


def test_thigh_and_shank_that_move_alike_move_everything():
    one = squat(0.0).thigh
    limb = Limb(knee.JOINTS, one, one, BONES)
    motion = articulated_motion(TIMES, [limb], NODES)
    points = NODES.positions()[::7]
    np.testing.assert_allclose(
        motion.carry(points), RigidMotion.from_poses(TIMES, one).carry(points), atol=1e-12
    )


def test_any_frame_fixed_in_the_bone_gives_the_same_motion(rng):
    limb = squat(3.0)
    elsewhere = transforms.rigid(
        transforms.rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)
    )
    other = replace(limb, thigh=limb.thigh @ elsewhere, shank=limb.shank @ elsewhere)
    np.testing.assert_allclose(other.motions(), limb.motions(), atol=1e-12)


def test_the_frame_of_the_world_does_not_matter():
    """Where it lies, and which way it looks by a quarter of a turn: voxels then fall on voxels."""
    quarter = transforms.rigid(transforms.axis_rotation((0, 1, 0), np.pi / 2), [0.4, 0.1, -0.3])
    limb = squat(3.0)
    places = transforms.apply(quarter, np.array([knee.GRID.center]))[0]
    nz, ny, nx = knee.GRID.shape_zyx
    # a turn about y carries x to -z and z to x
    turned = BoneRegions(
        VolumeGrid((nx, ny, nz), knee.GRID.spacing_xyz, tuple(places.tolist())),
        np.ascontiguousarray(np.transpose(BONES.labels, (2, 1, 0))[::-1]),
    )
    other = replace(moved_world(limb, quarter), bones=turned)
    points = NODES.positions()[::11]
    there = transforms.apply(quarter, points)
    np.testing.assert_allclose(
        shares_at(there, [other], 0.006), shares_at(points, [limb], 0.006), atol=1e-9
    )
    np.testing.assert_allclose(
        other.motions(), quarter @ limb.motions() @ transforms.inverse(quarter), atol=1e-12
    )


def test_shares_sum_to_one_and_are_whole_at_bones():
    shares = shares_at(NODES.positions(), [squat(3.0)], 0.006)
    np.testing.assert_allclose(shares.sum(-1), 1, atol=1e-12)
    assert shares.min() >= 0
    for k, label in enumerate((FEMUR, TIBIA, PATELLA)):
        inside = shares_at(BONES.points(label), [squat(3.0)], 0.006)
        np.testing.assert_array_equal(inside[:, k], 1)


def test_shares_are_continuous(rng):
    """Along lines through bones, joint and tissue: a tenth of a millimeter changes little."""
    start, end = (np.array(NODES.center) + 0.06 * rng.uniform(-1, 1, (20, 1, 3)) for _ in range(2))
    lines = start + np.linspace(0, 1, 1200)[:, None] * (end - start)
    shares = np.stack([shares_at(line, [squat(3.0)], 0.006) for line in lines])
    step = np.linalg.norm(np.diff(lines, axis=1), axis=-1)
    # the nearest voxel of bone is known to a step, the change from bone to bone is 2 mm wide
    assert (np.abs(np.diff(shares, axis=1)).max(-1) / step).max() < 2 / 0.002


def test_bones_move_rigidly_to_a_micrometer_in_the_sampled_field():
    """In nodes 6 mm apart, where no other bone is nearer than a cell's diagonal."""
    limb = squat(3.0)
    field = articulated_motion(TIMES, [limb], NODES).on_grid(NODES)
    reach = np.sqrt(3) * 0.006
    for k, label in enumerate((FEMUR, TIBIA, PATELLA)):
        points = BONES.points(label)
        apart = np.delete(limb.bone_distances(points), k, -1).min(-1)
        free = points[apart > 2 * reach]
        assert len(free) > 300
        rigid = RigidMotion(TIMES, limb.motions()[:, k])
        np.testing.assert_allclose(field.carry(free), rigid.carry(free), atol=1e-6)


def test_space_does_not_fold_while_a_squat_is_held():
    """The bend of a held squat changes by one or two degrees; here by three."""
    field = articulated_motion(TIMES, [squat(3.0)], NODES).on_grid(NODES)
    cells = np.asarray(field.displacements[-1], float)
    slope = np.eye(3) + np.stack([np.gradient(cells, 0.006, axis=a) for a in (2, 1, 0)], -1)
    assert np.linalg.det(slope).min() > 0.5


def test_far_from_the_knee_tissue_goes_with_thigh_or_shank():
    up, down = knee.JOINTS[0] * 0.5, 0.5 * knee.JOINTS[2]
    sides = np.array([[0.05, 0, 0], [-0.05, 0, 0.02], [0, 0, -0.06]])
    shares = shares_at(np.concatenate([up + sides, down + sides]), [squat(3.0)], 0.006)
    assert (shares[:3, 0] > 0.99).all()
    assert (shares[3:, 1] > 0.99).all()


def test_without_bones_two_bodies_share_everything():
    limb = replace(squat(3.0), bones=None)
    assert limb.motions().shape == (5, 2, 4, 4)
    middle = shares_at(np.array([[0.03, 0.0, 0.04]]), [limb], 0.006)
    # at the height of the knee's center the shank's axis is the nearer one in front of it
    np.testing.assert_allclose(middle.sum(), 1)
    assert 0.3 < middle[0, 0] < 0.7


def test_each_of_two_legs_keeps_its_own_motion():
    left = squat(3.0)
    right = moved_world(replace(left, bones=None), transforms.translation([0, 0, 0.3]))
    still = replace(right, thigh=np.tile(np.eye(4), (5, 1, 1)), shank=np.tile(np.eye(4), (5, 1, 1)))
    motion = articulated_motion(TIMES, [left, still], NODES)
    assert motion.bodies.shape == (5, 5, 4, 4)
    shares = shares_at(np.array([[0.0, 0.2, 0.3], [0.0, -0.2, 0.3]]), [left, still], 0.006)
    assert (shares[:, 3:].sum(-1) > 0.99).all()


@pytest.mark.parametrize("side", ["l", "r"])
@pytest.mark.parametrize("start", [3.0, 40.0, 75.0])
def test_the_patella_moves_as_the_leg_model_moves_it(side, start):
    """The knee bends by 4 degrees more: the patella goes 4 mm, and is followed to 0.1 mm.

    What is left: the patella is not quite ahead, which turns the axis by 2 degrees.
    """
    leg = LegModel.load()
    values = np.tile(leg.default_coordinates, (5, 1))
    column = leg.coordinate_names.index(f"knee_angle_{side}")
    values[:, column] = -np.radians(start + np.linspace(0, 4, 5))
    found = leg.kinematics(values)
    femur, tibia, talus, patella = (
        transforms.rigid(found.rotations[:, k], found.origins[:, k])
        for k in (segment_index(f"{b}_{side}") for b in ("femur", "tibia", "talus", "patella"))
    )
    joints = np.stack([p[0, :3, 3] for p in (femur, tibia, talus)])
    thigh, shank, true = (p @ transforms.inverse(p[0]) for p in (femur, tibia, patella))
    middle = transforms.apply(patella[0], np.zeros((1, 3)))[0]
    points = middle + 0.02 * np.array([[0, 1, 0], [0, -1, 0], [0, 0, 1.0], [0.5, 0, 0]])
    follows = patella_motion(thigh, shank, joints, middle)
    went, missed = (
        np.linalg.norm(transforms.apply(m, points) - transforms.apply(true, points), axis=-1)
        for m in (thigh, follows)
    )
    assert went[-1].max() > 2e-3
    assert missed.max() < 2e-4


@pytest.mark.parametrize("side", ["r", "l"])
@pytest.mark.parametrize("start", [20.0, 75.0])
def test_the_patella_is_expected_where_the_leg_model_has_it(start: float, side: str):
    """To 0.5 mm, and sideways to half of what right and left differ by: a limb is of no side. A
    straight leg tells no forward.
    """
    leg = LegModel.load()
    values = np.tile(leg.default_coordinates, (2, 1))
    values[:, leg.coordinate_names.index(f"knee_angle_{side}")] = -np.radians([start, start + 10])
    found = leg.kinematics(values)
    femur, tibia, talus, true = (
        transforms.rigid(found.rotations[:, k], found.origins[:, k])
        for k in (segment_index(f"{b}_{side}") for b in ("femur", "tibia", "talus", "patella"))
    )
    limb = Limb(np.stack([p[0, :3, 3] for p in (femur, tibia, talus)]), femur, tibia)
    pose = expected_patella(limb)
    assert pose is not None
    middle = transforms.apply(true[0], patella.MIDDLE[None])[0]
    off = pose[:3, :3].T @ (pose[:3, 3] - middle)
    assert np.abs(off[:2]).max() < 0.5e-3
    assert abs(off[2]) < 3e-3
    assert pose[:3, 0] @ true[0, :3, 0] > 0.99
    straight = replace(limb, joints=np.array([[0, 0.4, 0], [0, 0, 0], [0, -0.4, 0]]), shank=femur)
    assert expected_patella(straight) is None


@pytest.mark.parametrize("bends", [(0.0, 10.0), (10.0, 0.0), (5.0, 20.0)])
def test_forward_is_told_by_how_the_knee_bends_not_by_how_it_stands(bends: tuple[float, float]):
    """A leg 7 degrees in varus: its shank is beside the thigh's axis all the time."""
    at = np.radians(np.linspace(bends[0], bends[1], 5))
    shank = about(np.zeros(3), (at - at[0])[:, None] * [0, 0, -1.0])
    down = transforms.axis_rotation((0, 0, 1), -at[0]) @ [0, -0.38, 0.38 * np.tan(np.radians(7))]
    limb = Limb(np.array([[0, 0.4, 0], [0, 0, 0], down]), np.tile(np.eye(4), (5, 1, 1)), shank)
    pose = expected_patella(limb)
    assert pose is not None
    assert abs(pose[2, 0]) < np.sin(np.radians(2))
    assert pose[0, 3] > 0.03
    assert expected_patella(replace(limb, shank=limb.thigh)) is None


def test_the_patella_carries_tissue_as_far_as_it_is_long():
    """All of it at the bone, none of the thigh's front beyond its length, in any size of person."""
    limb = squat(3.0)
    above = knee.PATELLA + np.array([[0.0, 0.02, 0.0], [0.0, 0.035, 0.0], [0.0, 0.09, 0.0]])
    shares = limb.carried_by_patella(above)
    assert shares[0] > 0.9
    assert 0.1 < shares[1] < shares[0]
    assert shares[2] == 0
    assert (replace(limb, bones=None).carried_by_patella(above) == 0).all()
    double = BoneRegions(
        VolumeGrid(knee.GRID.shape_zyx, (0.004, 0.004, 0.004), (0.02, 0.0, 0.0)), BONES.labels
    )
    large = replace(limb, joints=2 * limb.joints, bones=double)
    np.testing.assert_allclose(large.carried_by_patella(2 * above), shares, atol=1e-9)


def test_a_leg_without_length_is_refused():
    with pytest.raises(LegsimError, match=r"0 mm apart, .* no leg"):
        Limb(np.zeros((3, 3)), np.eye(4)[None], np.eye(4)[None])
    with pytest.raises(LegsimError, match=r"Limb\.shank"):
        Limb(knee.JOINTS, np.eye(4)[None], np.tile(np.eye(4), (2, 1, 1)))


def test_a_patella_follows_nothing_but_the_bend():
    """A leg that moves as one carries its patella along."""
    one = squat(0.0).thigh
    moved = one @ transforms.inverse(one[0])
    np.testing.assert_allclose(
        patella_motion(moved, moved, knee.JOINTS, knee.PATELLA), moved, atol=1e-12
    )


def test_a_patella_with_a_motion_of_its_own_follows_it(rng: np.random.Generator):
    """To rounding, whatever is fixed to it; femur and tibia do not notice."""
    own = about(knee.PATELLA, 0.02 * rng.normal(size=(5, 3)))
    own = transforms.translation(1e-3 * rng.normal(size=(5, 3))) @ own
    elsewhere = transforms.rigid(
        transforms.rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)
    )
    limb, follows = replace(squat(3.0), kneecap=own @ elsewhere), squat(3.0)
    true = RigidMotion(TIMES, own @ transforms.inverse(own[0]))
    np.testing.assert_allclose(limb.motions()[:, 2], true.moved_from_reference, atol=1e-12)
    np.testing.assert_array_equal(limb.motions()[:, :2], follows.motions()[:, :2])
    points = BONES.points(PATELLA)
    alone = points[limb.bone_distances(points)[:, :2].min(-1) > 0.012]
    assert len(alone) > 10
    carried = articulated_motion(TIMES, [limb], NODES).carry(alone)
    np.testing.assert_allclose(carried, true.carry(alone), atol=1e-9)


def test_a_patella_at_other_views_is_refused():
    with pytest.raises(LegsimError, match=r"Limb\.kneecap"):
        replace(squat(3.0), kneecap=np.tile(np.eye(4), (2, 1, 1)))
