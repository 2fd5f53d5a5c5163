"""Grids of voxels: where they lie, and what is none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from legsim.core.errors import LegsimError
from legsim.geometry.volume import Volume, VolumeGrid

GRID = VolumeGrid((3, 4, 5), (0.02, 0.03, 0.04), (0.1, 0.5, -0.1))


def test_grid_is_centered_and_steps_by_its_spacing():
    x, y, z = VolumeGrid((2, 3, 4), (0.1, 0.2, 0.3), (1, 2, 3)).axes()
    np.testing.assert_allclose(x, [0.85, 0.95, 1.05, 1.15])
    np.testing.assert_allclose(y, [1.8, 2.0, 2.2])
    np.testing.assert_allclose(z, [2.85, 3.15])


@given(
    counts=st.tuples(*[st.integers(2, 9)] * 3),
    starts=st.tuples(*[st.integers(0, 7)] * 3),
    lengths=st.tuples(*[st.integers(1, 9)] * 3),
)
def test_a_cropped_grid_keeps_its_voxels_in_place(counts, starts, lengths):
    grid = VolumeGrid(counts, (0.1, 0.2, 0.3), (1.0, -2.0, 0.5))
    box = tuple(
        slice(min(a, n - 1), min(a, n - 1) + k)
        for a, k, n in zip(starts, lengths, counts, strict=True)
    )
    cropped = grid.cropped(box)
    for axis, part, whole in zip(cropped.axes(), box[::-1], grid.axes(), strict=True):
        np.testing.assert_allclose(axis, whole[part], atol=1e-12)


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


def test_grids_and_volumes_print_as_one_short_line_with_units():
    grid = VolumeGrid((120, 110, 100), (1.25e-3, 1.25e-3, 1.5e-3), (0.01234567, -0.1, 1.234567))
    voxels = "100x110x120 voxels (x, y, z) of 1.25x1.25x1.5 mm"
    assert repr(grid) == f"VolumeGrid({voxels}, center (12.3457, -100, 1234.57) mm)"
    volume = Volume(grid, np.zeros(grid.shape_zyx))
    assert repr(volume) == f"Volume({voxels}, attenuation in 1/m)"
    assert max(len(repr(grid)), len(repr(volume))) < 120


def test_grids_are_alike_to_a_thousandth_of_a_voxel():
    grid = VolumeGrid((40, 50, 60), (1e-3, 2e-3, 0.5e-3), (0.1, 0.2, 0.3))

    def moved(voxels, stretch=0.0):
        center = (0.1 + voxels * 1e-3, 0.2, 0.3)
        return VolumeGrid(grid.shape_zyx, (1e-3 * (1 + stretch), 2e-3, 0.5e-3), center)

    assert grid.alike(moved(0.0009))
    assert not grid.alike(moved(0.0011))
    assert grid.alike(moved(0, 2e-5)), "half a thousandth at either end of 60 voxels"
    assert not grid.alike(moved(0, 5e-5))
    assert not grid.alike(VolumeGrid((40, 50, 61), grid.spacing_xyz, grid.center))
