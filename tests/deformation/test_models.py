import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.deformation import models
from legsim.deformation.models import ControlPointMotion, FieldMotion, RigidMotion
from legsim.geometry.volume import VolumeGrid
from tests.references.sway import Sway

GRID = VolumeGrid((2, 3, 4), (0.1, 0.1, 0.1), (0, 0, 0))


def test_values_are_copied_and_read_only():
    moved = np.zeros((2, 3, 3))
    motion = ControlPointMotion(np.arange(2.0), np.zeros((3, 3)), moved)
    moved[:] = 5
    assert (motion.moved == 0).all()
    with pytest.raises(ValueError, match="read-only"):
        motion.moved[0, 0, 0] = 1


def test_a_field_has_a_vector_a_node_and_view():
    assert (
        FieldMotion(np.arange(5.0), GRID, np.zeros((5, 2, 3, 4, 3))).displacements.dtype
        == np.float32
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: ControlPointMotion(np.arange(2.0), np.zeros((0, 3)), np.zeros((2, 0, 3))),
            "at least one control point",
        ),
        (
            lambda: ControlPointMotion(
                np.arange(2.0), np.zeros((3, 3)), np.full((2, 3, 3), np.nan)
            ),
            "all coordinates finite",
        ),
        (
            lambda: ControlPointMotion(np.arange(2.0), np.zeros((3, 3)), np.zeros((3, 3, 3))),
            r"expected \(2, 3, 3\)",
        ),
        (
            lambda: ControlPointMotion([1.0, 0.0], np.zeros((3, 3)), np.zeros((2, 3, 3))),
            "must increase",
        ),
        (
            lambda: FieldMotion(np.arange(2.0), GRID, np.zeros((2, 4, 3, 2, 3))),
            r"expected \(2, 2, 3, 4, 3\)",
        ),
        (
            lambda: FieldMotion(np.arange(1.0), GRID, np.full((1, 2, 3, 4, 3), np.inf)),
            "not a finite number",
        ),
    ],
)
def test_impossible_motions_are_refused(make, message):
    with pytest.raises(LegsimError, match=message):
        make()


TIMES = np.arange(5) / 2
NODES = VolumeGrid((3, 4, 5), (0.02, 0.03, 0.04), (0.1, 0.5, -0.1))


def rigid() -> RigidMotion:
    return RigidMotion.from_poses(TIMES, Sway.standing(1).poses(TIMES))


def test_all_kinds_of_motion_agree_where_everything_moves_as_one(rng: np.random.Generator):
    points = np.array(NODES.center) + rng.uniform(-0.02, 0.02, (20, 3))
    controls = np.array(NODES.center) + rng.normal(0, 0.2, (5, 3))
    expected = rigid().carry(points)
    followed = ControlPointMotion(TIMES, controls, rigid().carry(controls))
    np.testing.assert_allclose(followed.carry(points), expected, atol=1e-12)
    # rigid motion is linear in place, and so is a field between its nodes; float32 of some mm
    np.testing.assert_allclose(followed.on_grid(NODES).carry(points), expected, atol=1e-9)


def test_a_motion_on_its_own_nodes_is_itself_there():
    nodes = NODES.positions()
    for motion in (rigid(), rigid().on_grid(NODES)):
        on_nodes = motion.on_grid(NODES)
        np.testing.assert_allclose(on_nodes.carry(nodes), motion.carry(nodes), atol=1e-9)


def test_only_a_rigid_motion_keeps_every_line_straight():
    line = np.array(NODES.center) + np.linspace(-0.05, 0.05, 9)[:, None] * [1.0, 0.5, 0.2]
    points = np.array([[0.1, 0.7, -0.1], [0.12, 0.5, -0.1], [0.1, 0.3, -0.1]])
    bent = ControlPointMotion(TIMES, points, points + 0.02 * np.eye(3) * TIMES[:, None, None])
    for motion in (rigid(), bent, bent.on_grid(NODES)):
        leaves = np.abs(np.diff(motion.carry(line), 2, axis=1)).max()
        assert motion.straight == bool(leaves < 1e-12)


def test_the_rigid_part_of_a_rigid_motion_is_itself_and_of_a_bend_its_least_squares(
    rng: np.random.Generator,
):
    points = rng.normal(size=(8, 3))
    true = rigid().moved_from_reference
    np.testing.assert_array_equal(rigid().rigid_part(points), true)
    followed = ControlPointMotion(TIMES, points[:5], rigid().carry(points[:5]))
    np.testing.assert_allclose(followed.rigid_part(points), true, atol=1e-12)
    bent = ControlPointMotion(TIMES, points[:5], points[:5] + rng.normal(0, 0.1, (5, 5, 3)))
    goal, part = bent.carry(points), bent.rigid_part(points)

    def misfit(tried: np.ndarray) -> float:
        return float(((transforms.apply(tried, points) - goal) ** 2).sum())

    least = misfit(part)
    for _ in range(20):
        nearby = transforms.rigid(
            transforms.rotation_from_vector(rng.normal(0, 1e-2, 3)), rng.normal(0, 1e-2, 3)
        )
        assert misfit(nearby @ part) > least


def test_a_motion_placed_elsewhere_carries_from_there_what_it_carried_before(rng):
    points = np.array(NODES.center) + rng.uniform(-0.02, 0.02, (20, 3))
    controls = np.array(NODES.center) + rng.normal(0, 0.2, (4, 3))
    line = np.array(NODES.center) + np.outer([-0.2, 0.0, 0.3], [0.0, 1.0, 0.0])
    turn = transforms.rotation_from_vector([0.01, -0.02, 0.005])
    at = transforms.rigid(turn, [0.003, -0.002, 0.001])
    elsewhere = transforms.apply(at, points)

    def bent(resting: np.ndarray) -> ControlPointMotion:
        return ControlPointMotion(
            TIMES, resting, resting + rng.normal(0, 0.003, (5, *resting.shape))
        )

    for motion in (rigid(), bent(controls)):
        np.testing.assert_allclose(
            motion.placed(at, NODES).carry(points), motion.carry(elsewhere), atol=1e-12
        )
    assert isinstance(bent(controls).placed(at, NODES), ControlPointMotion)
    # samples 2 to 4 cm apart of a motion that bends over 20 cm; a lost turn leaves 0.4 mm
    for motion in (bent(line), bent(controls).on_grid(NODES)):
        away = motion.placed(at, NODES).carry(points) - motion.carry(elsewhere)
        assert np.abs(away).max() < 2e-4
    resting = models.placed(None, TIMES, at, NODES)
    np.testing.assert_allclose(resting.carry(points)[2], elsewhere, atol=1e-12)


def test_a_field_is_linear_between_nodes_and_as_its_border_beyond():
    moved = np.zeros((1, *NODES.shape_zyx, 3), np.float32)
    moved[0, :, :, :, 0] = 0.01 * np.arange(5)
    motion = FieldMotion(np.zeros(1), NODES, moved)
    at = NODES.origin + np.array([[0.05, 0.03, 0.02], [1.0, 0, 0], [-1.0, 0, 0]])
    np.testing.assert_allclose((motion.carry(at)[0] - at)[:, 0], [0.025, 0.04, 0.0], atol=1e-8)


def test_rigid_paths_are_the_matrices():
    points = np.eye(3)
    np.testing.assert_array_equal(
        rigid().carry(points)[3],
        transforms.apply(rigid().moved_from_reference[3], points),
    )


def test_motions_print_as_one_short_line_with_units():
    times = np.arange(249) / 31
    turns = transforms.rotation_from_vector(np.radians(times)[:, None] * [0, 0.5, 0])
    rigid = RigidMotion(times, transforms.rigid(turns, np.zeros(3)))
    points = np.eye(3)
    followed = ControlPointMotion(times, points, points + 0.01 * times[:, None, None] * np.eye(3))
    field = FieldMotion(times, GRID, np.zeros((249, *GRID.shape_zyx, 3)))
    assert repr(rigid) == "RigidMotion(249 views over 8 s, turned by up to 4 deg)"
    assert repr(followed) == "ControlPointMotion(249 views over 8 s, 3 points moved by up to 80 mm)"
    assert repr(field) == (
        "FieldMotion(249 views over 8 s, 4x3x2 nodes (x, y, z) 100x100x100 mm apart)"
    )
    assert max(len(repr(motion)) for motion in (rigid, followed, field)) < 120
