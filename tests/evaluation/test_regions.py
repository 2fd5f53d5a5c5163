"""Regions of a leg: where they lie, and what is no region."""

import numpy as np
import pytest
from scipy import ndimage

from legsim.core.errors import LegsimError
from legsim.evaluation import regions as evaluation_regions
from legsim.evaluation.regions import Region, leg_regions
from legsim.geometry.volume import VolumeGrid
from tests.examples.blob import blob

GRID = VolumeGrid.cubic(48, 0.002, (0.1, 0.5, -0.2))


def regions(grid: VolumeGrid) -> tuple[Region, ...]:
    return leg_regions(
        blob(grid).attenuation > 2, grid, 0.5, evaluation_regions.cylinder(grid, 0.045)
    )


def test_shank_lies_below_the_knee_and_thigh_above():
    whole, shank, thigh = regions(GRID)
    y = GRID.axes()[1]
    assert not shank.mask[:, y >= 0.5].any()
    assert not thigh.mask[:, y < 0.5].any()
    assert (whole.mask == (shank.mask | thigh.mask)).all()
    assert not (whole.mask & ~evaluation_regions.cylinder(GRID, 0.045)).any()


def test_the_leg_is_what_is_marked_and_five_millimeters_of_air():
    marked = np.zeros(GRID.shape_zyx, bool)
    marked[20:25, 10:40, 20:28] = True
    seen = np.ones_like(marked)
    seen[:22] = False
    leg = leg_regions(marked, GRID, 0.5, seen)[0].mask
    away = 2e-3 * ndimage.distance_transform_edt(~marked)
    assert (leg[away < 0.004] == seen[away < 0.004]).all()
    assert not leg[away > 0.006].any()
    assert not leg[~seen].any()


def test_a_region_is_bool_and_cannot_be_written():
    region = Region("all", np.ones((3, 3, 3), bool))
    with pytest.raises(ValueError, match="read-only"):
        region.mask[0] = False
    with pytest.raises(
        LegsimError, match=r"region 'all' is float64 of shape \(3, 3\); expected bool"
    ):
        Region("all", np.ones((3, 3)))


def test_a_bounding_box_has_its_margin_and_ends_at_the_grid():
    mask = np.zeros((12, 12, 12), bool)
    mask[5, 6, 7:9] = True
    box = evaluation_regions.bounding_box(mask, (1, 2, 3))
    assert box == (slice(4, 7), slice(4, 9), slice(4, 12))
    assert evaluation_regions.bounding_box(mask, (0, 0, 20)) == (
        slice(5, 6),
        slice(6, 7),
        slice(0, 12),
    )


def test_a_box_within_another_holds_the_same_voxels(rng):
    values = rng.normal(size=(9, 8, 7))
    outer = (slice(2, 8), slice(1, 7), slice(3, 7))
    inner = (slice(3, 6), slice(2, 7), slice(4, 5))
    found = values[outer][evaluation_regions.within(inner, outer)]
    np.testing.assert_array_equal(found, values[inner])
