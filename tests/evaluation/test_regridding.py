"""Regridding: a linear field is kept, places outside are unknown, and noise is averaged."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.evaluation import regridding
from legsim.evaluation.regions import Region
from legsim.geometry.volume import Volume, VolumeGrid


def linear(grid):
    x, y, z = grid.axes()
    return (20 + 100 * x + 50 * y[:, None] - 80 * z[:, None, None]).astype(np.float32)


def test_a_linear_field_is_the_same_on_any_grid():
    grid = VolumeGrid((20, 24, 28), (2e-3, 3e-3, 1e-3), (0.01, 0.02, 0.03))
    other = VolumeGrid((10, 30, 16), (1.7e-3, 2e-3, 1.1e-3), (0.012, 0.021, 0.031))
    found = regridding.onto(Volume(grid, linear(grid)), other)
    inside = found.known.copy()
    assert inside.all()
    np.testing.assert_allclose(found.volume.attenuation[3:-3], linear(other)[3:-3], rtol=1e-5)


def test_the_same_grid_is_left_as_it_is(rng):
    grid = VolumeGrid.cubic(8, 1e-3, (0, 0, 0))
    values = rng.uniform(size=grid.shape_zyx).astype(np.float32)
    found = regridding.onto(Volume(grid, values), grid)
    np.testing.assert_allclose(found.volume.attenuation, values, rtol=1e-6)
    assert found.known.all()


def test_places_outside_are_unknown_and_regions_are_clipped():
    grid = VolumeGrid.cubic(8, 1e-3, (0, 0, 0))
    moved = VolumeGrid.cubic(8, 1e-3, (0.003, 0, 0))
    found = regridding.onto(Volume(grid, np.ones((8, 8, 8), np.float32)), moved)
    np.testing.assert_array_equal(found.known[0, 0], [True] * 5 + [False] * 3)
    before = VolumeGrid.cubic(8, 1e-3, (-0.003, 0, 0))
    early = regridding.onto(Volume(grid, np.ones((8, 8, 8), np.float32)), before)
    np.testing.assert_array_equal(early.known[0, 0], [False] * 3 + [True] * 5)
    everything = Region("all", np.ones((8, 8, 8), bool))
    assert found.clipped(everything).mask.sum() == 5 * 64
    far = VolumeGrid.cubic(8, 1e-3, (0.006, 0, 0))
    with pytest.raises(LegsimError, match="covers 25 % of region 'all' only"):
        regridding.onto(Volume(grid, np.ones((8, 8, 8), np.float32)), far).clipped(everything)


def test_noise_of_finer_voxels_is_averaged(rng):
    fine, coarse = VolumeGrid.cubic(60, 1e-3, (0, 0, 0)), VolumeGrid.cubic(14, 4e-3, (0, 0, 0))
    noise = rng.normal(size=fine.shape_zyx).astype(np.float32)
    found = regridding.onto(Volume(fine, noise), coarse)
    assert found.volume.attenuation.std() < 0.1
