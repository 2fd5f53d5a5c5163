"""Surfaces of masks: closed, within half a voxel, and of the right volume."""

from itertools import product

import numpy as np
import pytest
from scipy.spatial import KDTree

from legsim.core import transforms
from legsim.phantom import _label_surfaces, surfaces
from legsim.phantom.meshes import Part
from legsim.phantom.raster import require_closed

VOXEL = 0.002


def ball(radius: float, center, spacing=(VOXEL, VOXEL, VOXEL)) -> tuple[np.ndarray, np.ndarray]:
    """(mask (k, j, i), world_from_index) of a ball of radius m about a point m."""
    counts = np.ceil((np.array(center) + radius) / spacing).astype(int) + 3
    i, j, k = (np.arange(n) * s - c for n, s, c in zip(counts, spacing, center, strict=True))
    far = k[:, None, None] ** 2 + j[None, :, None] ** 2 + i**2
    return far < radius**2, np.diag([*spacing, 1.0])


def of_mask(mask, world_from_index):
    return _label_surfaces.of_smoothed(_label_surfaces.smoothed(mask), world_from_index)


@pytest.mark.parametrize("voxels", [10.3, 12.6, 20])
@pytest.mark.parametrize("offset", [0.0, 0.37])
def test_a_ball_is_within_half_a_voxel_and_one_percent(voxels, offset):
    radius, center = voxels * VOXEL, np.full(3, (voxels + 3 + offset) * VOXEL)
    vertices, triangles = of_mask(*ball(radius, center))
    far = np.linalg.norm(vertices - center, axis=1) - radius
    assert np.abs(far).max() < 0.5 * VOXEL
    expected = 4 / 3 * np.pi * radius**3
    assert surfaces.volume(vertices, triangles) == pytest.approx(expected, rel=0.01)


def test_voxels_that_are_longer_one_way_bound_the_surface_along_that_way():
    spacing = (0.001, 0.001, 0.004)
    center = np.full(3, 0.03)
    vertices, _ = of_mask(*ball(0.02, center, spacing))
    outward = (vertices - center) / np.linalg.norm(vertices - center, axis=1)[:, None]
    far = np.linalg.norm(vertices - center, axis=1) - 0.02
    assert (np.abs(far) < 0.5 * np.abs(outward) @ spacing + 1e-9).all()


def test_any_mask_gives_a_closed_surface_with_its_voxels_on_their_sides(rng):
    for share in (0.1, 0.3, 0.5, 0.8):
        mask = rng.random((9, 10, 11)) < share
        vertices, triangles = of_mask(mask, np.eye(4))
        require_closed(Part("noise", "water", 0.0, vertices, triangles))
        assert surfaces.volume(vertices, triangles) > 0
        # each vertex lies between voxel centers of which some are inside and some outside
        low, high = (np.floor(vertices + 1e-4), np.ceil(vertices - 1e-4))
        padded = np.pad(mask, 1)
        corners = [
            padded[tuple(np.where(pick, high, low)[:, ::-1].astype(int).T + 1)]
            for pick in product((False, True), repeat=3)
        ]
        assert not np.all(corners, axis=0).any()
        assert np.any(corners, axis=0).all()


def test_a_mirrored_grid_still_faces_outward():
    mask, placed = ball(0.01, np.full(3, 0.016))
    mirrored = placed @ np.diag([1.0, 1, -1, 1])
    assert surfaces.volume(*of_mask(mask, mirrored)) > 0


@pytest.mark.parametrize("spacing", [(VOXEL,) * 3, (0.001, 0.002, 0.004)])
def test_distances_are_those_from_the_surface(spacing):
    center = np.full(3, 0.026)
    mask, placed = ball(0.02, center, spacing)
    vertices, triangles = of_mask(mask, placed)
    points = np.concatenate([vertices, vertices[triangles].mean(1)])
    k, j, i = np.nonzero(np.ones_like(mask))
    places = transforms.apply(placed, np.stack([i, j, k], -1).astype(float))
    true = 0.02 - np.linalg.norm(places - center, axis=1)
    step = max(spacing)
    rough = _label_surfaces.rough_distance(mask, np.array(spacing[::-1])).ravel()
    near = np.abs(true) < 0.006
    chosen = near.reshape(mask.shape)
    exact = _label_surfaces.exact_distance(mask, chosen, KDTree(points), placed)
    # the surface itself is up to half a voxel off
    assert np.abs(exact - true[near]).max() < 0.5 * step
    assert np.abs(rough[near] - exact).max() < 0.5 * step + 1e-6
    # and everywhere within a voxel, so that none that is near is taken for far
    assert np.abs(rough - true).max() < step


@pytest.mark.parametrize("filled", [True, False])
def test_a_mask_of_one_value_has_no_surface(filled):
    found = _label_surfaces.rough_distance(np.full((3, 4, 5), filled), np.full(3, VOXEL))
    assert (found == (np.inf if filled else -np.inf)).all()
