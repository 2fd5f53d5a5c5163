"""Rigid registration finds a known motion, and misses it by a small part of a voxel."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.evaluation import registration, similarity
from legsim.evaluation.registration import Compared
from legsim.geometry.volume import Volume, VolumeGrid
from tests.examples.blob import GRID, blob, regions
from tests.references import comparison


def test_registration_undoes_a_rigid_motion():
    center = transforms.translation(GRID.center)
    turned = transforms.rigid(
        transforms.rotation_from_vector([0.02, -0.05, 0.03]), [0.003, -0.002, 0.001]
    )
    moved = blob(GRID, center @ turned @ transforms.inverse(center))
    loose = similarity.evaluate(moved, blob(GRID), regions(GRID), register=False)
    tight = similarity.evaluate(moved, blob(GRID), regions(GRID))
    assert tight.registration is not None
    assert tight.registration.applied
    assert tight.registration.translation_mm == pytest.approx(np.sqrt(14), abs=0.1)
    assert tight.registration.rotation_deg == pytest.approx(
        np.degrees(np.linalg.norm([0.02, 0.05, 0.03])), abs=0.2
    )
    assert tight.of("leg").rmse < 0.1 * loose.of("leg").rmse


def test_registration_never_makes_a_volume_worse(rng):
    reference = blob(GRID)
    noisy = Volume(
        GRID, reference.attenuation + rng.normal(0, 0.3, GRID.shape_zyx).astype(np.float32)
    )
    loose = similarity.evaluate(noisy, reference, regions(GRID), register=False)
    tight = similarity.evaluate(noisy, reference, regions(GRID))
    assert tight.of("leg").rmse <= loose.of("leg").rmse * 1.001


def test_the_registrations_own_error_is_a_small_part_of_a_voxel():
    error = registration.registration_error(blob(GRID), regions(GRID))
    assert 0 < error.translation_mm < 0.1 * 1e3 * GRID.spacing_xyz[0]
    assert 0 < error.rotation_deg < 0.2


def about_the_center(grid: VolumeGrid, turn: list[float], shift: list[float]) -> np.ndarray:
    center = transforms.translation(grid.center)
    rigid = transforms.rigid(transforms.rotation_from_vector(turn), shift)
    return center @ rigid @ transforms.inverse(center)


def given(moving: np.ndarray, grid: VolumeGrid = GRID) -> Compared:
    wide, box = registration.boxes(regions(grid)[0].mask, grid)
    assert wide == tuple(slice(0, n) for n in grid.shape_zyx)
    mask = regions(grid)[0].mask[box]
    return Compared(blob(grid).attenuation[box], mask, moving, grid, box)


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_it_climbs_as_high_as_simpleitk(rng, noise):
    motion = about_the_center(GRID, [0.01, -0.02, 0.015], [0.0006, -0.0009, 0.0004])
    moving = blob(GRID, motion).attenuation
    moving = moving + rng.normal(0, noise, moving.shape).astype(np.float32)
    found, _ = registration.rigid_transform(given(moving))
    theirs = comparison.register(blob(GRID).attenuation, moving, regions(GRID)[0].mask, GRID)
    corners = (
        np.array(GRID.center) + 0.03 * np.array(np.meshgrid(*([(-1, 1)] * 3))).reshape(3, -1).T
    )
    there = 1e-3 * np.array([theirs.TransformPoint(corner) for corner in 1e3 * corners])
    if noise == 0:
        missed = transforms.apply(found, corners) - transforms.apply(motion, corners)
        # a hundredth of a voxel of 2 mm, 3 cm from the center
        assert np.linalg.norm(missed, axis=1).max() < 2e-5
    # with noise the greatest correlation is elsewhere; other points than either search used
    pair, other = given(moving), transforms.best_rigid(corners, there)
    points = registration._points(pair, 200_000)
    fixed = registration._read(pair.fixed, pair.grid.cropped(pair.box), points)
    points, fixed = points[np.isfinite(fixed)], fixed[np.isfinite(fixed)]
    ours, simpleitks = (
        registration._correlation_at(matrix, pair, points, fixed) for matrix in (found, other)
    )
    assert ours > simpleitks - 1e-4


def test_scale_and_offset_of_the_values_change_nothing():
    motion = about_the_center(GRID, [0.01, -0.02, 0.015], [0.0006, -0.0009, 0.0004])
    moving = blob(GRID, motion).attenuation
    plain, _ = registration.rigid_transform(given(moving))
    other, _ = registration.rigid_transform(given(0.3 * moving + 5))
    # rounding of float32 may turn the search by a step of its smallest size
    np.testing.assert_allclose(other, plain, atol=1e-6)


def test_a_volume_without_any_likeness_is_left_where_it_is(rng):
    """The search ends, and what it found is not applied where it does not help."""
    strange = rng.random(GRID.shape_zyx, dtype=np.float32)
    found = similarity.evaluate(Volume(GRID, strange), blob(GRID), regions(GRID))
    assert found.registration is not None
    assert found.registration.applied == (
        found.registration.correlation_after > found.registration.correlation_before
    )
    assert np.isfinite(found.of("leg").ssim)


def test_a_volume_of_opposite_values_is_left_where_it_is():
    """Where the volumes differ in sign, no step towards a likeness is known."""
    shifted = blob(GRID, about_the_center(GRID, [0.0, 0.0, 0.0], [0.002, 0.0, 0.0]))
    matrix, stopped = registration.rigid_transform(given(-shifted.attenuation))
    np.testing.assert_array_equal(matrix, np.eye(4))
    assert stopped == "no further step raises the correlation after 0 steps"


def test_holes_outside_the_regions_do_not_matter():
    motion = about_the_center(GRID, [0.0, 0.01, 0.0], [0.0006, -0.0009, 0.0004])
    moving = blob(GRID, motion).attenuation.copy()
    plain, _ = registration.rigid_transform(given(moving))
    moving[0, 0], moving[:, :, 0] = np.nan, np.inf
    holed, _ = registration.rigid_transform(given(moving))
    np.testing.assert_allclose(holed, plain, atol=5e-5)
