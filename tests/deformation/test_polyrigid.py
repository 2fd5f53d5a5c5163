"""Laws of a blend of rigid motions: exact on bodies, free of the frame, without folds."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.deformation.models import RigidMotion
from legsim.deformation.polyrigid import PolyrigidMotion, blended
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import VolumeGrid
from legsim.reconstruction import fdk

TIMES = np.arange(4.0)
GRID = VolumeGrid((5, 6, 7), (0.02, 0.02, 0.02), (0.1, 0.4, -0.1))


def rigid(rng: np.random.Generator, *shape: int, angle: float = 0.5) -> np.ndarray:
    """Random transforms (*shape, 4, 4), of a few tenths of a radian and some centimeters."""
    vectors = angle * rng.normal(size=(*shape, 3))
    return transforms.rigid(
        transforms.rotation_from_vector(vectors), 0.05 * rng.normal(size=(*shape, 3))
    )


def shares(rng: np.random.Generator, count: int = 3) -> np.ndarray:
    drawn = rng.dirichlet(np.ones(count), GRID.shape_zyx)
    return np.moveaxis(drawn, -1, 0).astype(np.float32)


def moving(rng: np.random.Generator) -> PolyrigidMotion:
    return PolyrigidMotion(TIMES, rigid(rng, 4, 3), GRID, shares(rng))


def somewhere(rng: np.random.Generator, count: int = 50) -> np.ndarray:
    return np.array(GRID.center) + 0.04 * rng.normal(size=(count, 3))


def test_bodies_that_move_alike_carry_everything_rigidly(rng):
    one = rigid(rng, 4)
    motion = PolyrigidMotion(TIMES, np.stack([one] * 3, 1), GRID, shares(rng))
    points = somewhere(rng)
    np.testing.assert_allclose(
        motion.carry(points), RigidMotion(TIMES, one).carry(points), rtol=0, atol=1e-12
    )


def test_a_point_with_all_its_share_on_a_body_moves_with_it(rng):
    whole = np.zeros((3, *GRID.shape_zyx), np.float32)
    whole[1] = 1
    bodies = rigid(rng, 4, 3)
    points = somewhere(rng)
    np.testing.assert_array_equal(
        PolyrigidMotion(TIMES, bodies, GRID, whole).carry(points),
        RigidMotion(TIMES, bodies[:, 1]).carry(points),
    )


def test_the_blend_does_not_depend_on_the_frame(rng):
    """Neither on where world lies, nor on what the reference pose is called."""
    matrices, points = rigid(rng, 3), somewhere(rng)
    drawn = rng.dirichlet(np.ones(3), len(points))
    plain, other = blended(points, drawn, matrices), rigid(rng)
    back = transforms.apply(transforms.inverse(other), points)
    np.testing.assert_allclose(
        blended(points, drawn, other @ matrices), transforms.apply(other, plain), atol=1e-12
    )
    np.testing.assert_allclose(blended(back, drawn, matrices @ other), plain, atol=1e-12)


def test_half_of_a_turn_is_a_turn_by_half():
    """About an axis that does not pass through the origin; nothing shrinks."""
    center, axis = np.array([0.3, -0.2, 0.5]), np.array([0.0, 0.6, 0.8])

    def turned(angle: float) -> np.ndarray:
        about = transforms.translation(center)
        turn = transforms.rigid(transforms.axis_rotation(axis, angle), np.zeros(3))
        return about @ turn @ transforms.inverse(about)

    points = np.array([[0.0, 0, 0], [1.0, -1, 2]])
    both = np.stack([np.eye(4), turned(2.0)])
    np.testing.assert_allclose(
        blended(points, np.full((2, 2), 0.5), both),
        transforms.apply(turned(1.0), points),
        atol=1e-12,
    )


def test_space_is_continuous_and_does_not_fold_for_a_knee_that_bends_by_20_degrees(rng):
    """Shares that change over 8 cm along a leg, about the joint between two bodies."""
    grid = VolumeGrid((3, 21, 11), (0.01, 0.01, 0.01), (0.0, 0.0, 0.0))
    rises = np.clip(0.5 + grid.positions()[:, 1] / 0.08, 0, 1)
    rises = (rises * rises * (3 - 2 * rises)).reshape(grid.shape_zyx)
    bends = transforms.rigid(transforms.axis_rotation((0, 0, 1), -np.radians(20)), np.zeros(3))
    motion = PolyrigidMotion(
        [0.0, 1.0],
        np.stack([np.broadcast_to(np.eye(4), (2, 4, 4)), np.stack([np.eye(4), bends])], 1),
        grid,
        np.stack([rises, 1 - rises]),
    )
    points, step = np.array([0.04, 0.08, 0.008]) * rng.uniform(-1, 1, (500, 3)), 1e-4
    slope = np.stack(
        [
            (motion.carry(points + step * e) - motion.carry(points - step * e))[1] / (2 * step)
            for e in np.eye(3)
        ],
        -1,
    )
    assert np.linalg.det(slope).min() > 0.3
    assert np.linalg.norm(slope, 2, (-2, -1)).max() < 3


def test_samples_on_a_grid_say_the_same_at_its_nodes(rng):
    motion = moving(rng)
    nodes = GRID.positions()
    np.testing.assert_allclose(
        motion.on_grid(GRID).carry(nodes), motion.carry(nodes), rtol=0, atol=1e-7
    )


def test_shares_between_nodes_sum_to_one(rng):
    np.testing.assert_allclose(moving(rng).shares_at(somewhere(rng)).sum(-1), 1, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: 0.9 * s, "sum to 1"),
        (lambda s: np.stack([s[0] + s[1] + 1, s[2] - 1, 0 * s[0]]), "at least 0"),
        (lambda s: np.full_like(s, np.nan), "at least 0"),
        (lambda s: s[:, :2], "expected"),
    ],
)
def test_shares_that_are_none_are_refused(rng, change, message):
    with pytest.raises(LegsimError, match=message):
        PolyrigidMotion(TIMES, rigid(rng, 4, 3), GRID, change(shares(rng)))


def test_bodies_that_are_not_numbers_are_refused(rng):
    with pytest.raises(LegsimError, match="not a finite number"):
        PolyrigidMotion(TIMES, np.full((4, 3, 4, 4), np.nan), GRID, shares(rng))


@pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")
def test_the_back_projection_along_it_is_the_rigid_one_where_all_move_alike(device, rng):
    """To the rounding of displacements in single precision."""
    times = np.arange(40.0)
    geometry = ConeBeamGeometry.circular(
        times=times,
        angles=np.radians(5.0) * np.arange(40),
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(24, 31),
        pixel_pitch=0.012,
        isocenter=GRID.center,
    )
    images = Projections(geometry, rng.random((40, 24, 31), np.float32))
    one = transforms.rigid(
        transforms.rotation_from_vector(0.02 * rng.normal(size=(40, 3))),
        0.003 * rng.normal(size=(40, 3)),
    )
    volume = VolumeGrid((10, 12, 14), (0.01, 0.01, 0.01), GRID.center)
    along = PolyrigidMotion(times, np.stack([one] * 3, 1), GRID, shares(rng)).on_grid(
        volume.coarse(0.02)
    )
    followed, rigidly = (
        fdk.fdk(images, volume, motion=m, device=device).attenuation
        for m in (along, RigidMotion(times, one))
    )
    np.testing.assert_allclose(followed, rigidly, atol=1e-3 * np.abs(rigidly).max())
