import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.deformation.models import ControlPointMotion, FieldMotion, RigidMotion
from legsim.geometry.volume import VolumeGrid
from tests.references.sway import Sway

TIMES = np.arange(5) / 2
GRID = VolumeGrid((3, 4, 5), (0.02, 0.03, 0.04), (0.1, 0.5, -0.1))


def rigid() -> RigidMotion:
    return RigidMotion.from_poses(TIMES, Sway.standing(1).poses(TIMES))


def test_all_kinds_of_motion_agree_where_everything_moves_as_one(rng: np.random.Generator):
    points = np.array(GRID.center) + rng.uniform(-0.02, 0.02, (20, 3))
    controls = np.array(GRID.center) + rng.normal(0, 0.2, (5, 3))
    expected = rigid().carry(points)
    followed = ControlPointMotion(TIMES, controls, rigid().carry(controls))
    np.testing.assert_allclose(followed.carry(points), expected, atol=1e-12)
    # rigid motion is linear in place, and so is a field between its nodes; float32 of some mm
    np.testing.assert_allclose(followed.on_grid(GRID).carry(points), expected, atol=1e-9)


def test_a_motion_on_its_own_nodes_is_itself_there():
    nodes = GRID.positions()
    for motion in (rigid(), rigid().on_grid(GRID)):
        on_nodes = motion.on_grid(GRID)
        np.testing.assert_allclose(on_nodes.carry(nodes), motion.carry(nodes), atol=1e-9)


def test_only_a_rigid_motion_keeps_every_line_straight():
    line = np.array(GRID.center) + np.linspace(-0.05, 0.05, 9)[:, None] * [1.0, 0.5, 0.2]
    points = np.array([[0.1, 0.7, -0.1], [0.12, 0.5, -0.1], [0.1, 0.3, -0.1]])
    bent = ControlPointMotion(TIMES, points, points + 0.02 * np.eye(3) * TIMES[:, None, None])
    for motion in (rigid(), bent, bent.on_grid(GRID)):
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


def test_a_field_is_linear_between_nodes_and_as_its_border_beyond():
    moved = np.zeros((1, *GRID.shape_zyx, 3), np.float32)
    moved[0, :, :, :, 0] = 0.01 * np.arange(5)
    motion = FieldMotion(np.zeros(1), GRID, moved)
    at = GRID.origin + np.array([[0.05, 0.03, 0.02], [1.0, 0, 0], [-1.0, 0, 0]])
    np.testing.assert_allclose((motion.carry(at)[0] - at)[:, 0], [0.025, 0.04, 0.0], atol=1e-8)


def test_nodes_are_in_the_order_of_the_arrays():
    nodes = GRID.positions().reshape(*GRID.shape_zyx, 3)
    np.testing.assert_allclose(nodes[2, 3, 4], GRID.origin + np.array([0.08, 0.09, 0.08]))
    np.testing.assert_allclose(nodes[0, 0, 1] - nodes[0, 0, 0], [0.02, 0, 0], atol=1e-15)


def test_nodes_cover_the_grid():
    nodes = GRID.coarse(0.03)
    for coarse, fine in zip(nodes.axes(), GRID.axes(), strict=True):
        assert coarse[0] <= fine[0]
        assert coarse[-1] >= fine[-1]
    with pytest.raises(LegsimError, match="positive spacing"):
        GRID.coarse(0.0)


def test_rigid_paths_are_the_matrices():
    points = np.eye(3)
    np.testing.assert_array_equal(
        rigid().carry(points)[3],
        transforms.apply(rigid().moved_from_reference[3], points),
    )
