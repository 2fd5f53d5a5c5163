import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.deformation import models
from legsim.deformation.models import ControlPointMotion, FieldMotion, RigidMotion
from legsim.geometry import volume
from legsim.geometry.volume import VolumeGrid
from tests.references.sway import Sway

TIMES = np.arange(5) / 2
GRID = VolumeGrid((3, 4, 5), (0.02, 0.03, 0.04), (0.1, 0.5, -0.1))


def rigid() -> RigidMotion:
    return RigidMotion.from_poses(TIMES, Sway.standing(1).poses(TIMES))


def test_all_kinds_of_motion_agree_where_everything_moves_as_one(rng: np.random.Generator):
    points = np.array(GRID.center) + rng.uniform(-0.02, 0.02, (20, 3))
    controls = np.array(GRID.center) + rng.normal(0, 0.2, (5, 3))
    expected = models.carried(points, rigid())
    followed = ControlPointMotion(TIMES, controls, models.carried(controls, rigid()))
    np.testing.assert_allclose(models.carried(points, followed), expected, atol=1e-12)
    # rigid motion is linear in place, and so is a field between its nodes; float32 of some mm
    np.testing.assert_allclose(
        models.carried(points, models.sampled(followed, GRID)), expected, atol=1e-9
    )


def test_the_rigid_part_of_a_rigid_motion_is_itself_and_of_a_bend_its_least_squares(
    rng: np.random.Generator,
):
    points = rng.normal(size=(8, 3))
    true = rigid().moved_from_reference
    np.testing.assert_array_equal(models.rigid_part(rigid(), points), true)
    followed = ControlPointMotion(TIMES, points[:5], models.carried(points[:5], rigid()))
    np.testing.assert_allclose(models.rigid_part(followed, points), true, atol=1e-12)
    bent = ControlPointMotion(TIMES, points[:5], points[:5] + rng.normal(0, 0.1, (5, 5, 3)))
    goal, part = models.carried(points, bent), models.rigid_part(bent, points)

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
    np.testing.assert_allclose(
        (models.carried(at, motion)[0] - at)[:, 0], [0.025, 0.04, 0.0], atol=1e-8
    )


def test_nodes_are_in_the_order_of_the_arrays():
    nodes = volume.node_positions(GRID).reshape(*GRID.shape_zyx, 3)
    np.testing.assert_allclose(nodes[2, 3, 4], GRID.origin + np.array([0.08, 0.09, 0.08]))
    np.testing.assert_allclose(nodes[0, 0, 1] - nodes[0, 0, 0], [0.02, 0, 0], atol=1e-15)


def test_nodes_cover_the_grid():
    nodes = volume.nodes_over(GRID, 0.03)
    for coarse, fine in zip(nodes.axes(), GRID.axes(), strict=True):
        assert coarse[0] <= fine[0]
        assert coarse[-1] >= fine[-1]
    with pytest.raises(LegsimError, match="positive spacing"):
        volume.nodes_over(GRID, 0.0)


def test_rigid_paths_are_the_matrices():
    points = np.eye(3)
    np.testing.assert_array_equal(
        models.carried(points, rigid())[3],
        transforms.apply(rigid().moved_from_reference[3], points),
    )
