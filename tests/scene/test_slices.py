"""Slices of a volume: which they are, how they are turned, and that the volume itself can go."""

import weakref

import numpy as np

from legsim.geometry.volume import NamedVolume, Volume, VolumeGrid
from legsim.scene.slices import SlicePlanes, VolumeSlices, axial, sagittal, white_level

GRID = VolumeGrid((9, 8, 7), (0.01, 0.01, 0.01), (0.3, 0.5, -0.2))


def test_a_cut_volume_has_the_slices_and_the_white_of_the_whole_one(rng):
    volume = Volume(GRID, rng.random(GRID.shape_zyx, dtype=np.float32))
    planes = SlicePlanes(0.47, 0.52, -0.21)
    cut = VolumeSlices.of(NamedVolume("rigid", volume), planes)
    np.testing.assert_array_equal(cut.shank, axial(volume, planes.shank_y))
    np.testing.assert_array_equal(cut.thigh, axial(volume, planes.thigh_y))
    np.testing.assert_array_equal(cut.sagittal, sagittal(volume, planes.sagittal_z))
    assert (cut.name, cut.grid, cut.white) == ("rigid", GRID, white_level(volume))


def test_a_cut_volume_does_not_hold_the_whole_one(rng):
    values = rng.random(GRID.shape_zyx, dtype=np.float32)
    held = weakref.ref(values)
    cut = VolumeSlices.of(NamedVolume("rigid", Volume(GRID, values)))
    del values
    assert held() is None
    assert cut.sagittal.shape == (8, 7)


def test_planes_lie_about_the_middle_of_the_grid():
    planes = VolumeSlices.of(
        NamedVolume("a", Volume(GRID, np.zeros(GRID.shape_zyx, np.float32)))
    ).planes
    np.testing.assert_allclose(
        (planes.shank_y, planes.thigh_y, planes.sagittal_z), (0.45, 0.55, -0.2)
    )


def test_white_is_a_percentile_and_hardly_another_one_in_a_large_volume(rng):
    grid = VolumeGrid((260, 128, 130), (0.001, 0.001, 0.001), (0.0, 0.0, 0.0))
    volume = Volume(grid, rng.random(grid.shape_zyx, dtype=np.float32))
    assert abs(white_level(volume) - 0.996) < 0.001


def test_slices_are_oriented_as_in_radiology():
    grid = VolumeGrid((5, 6, 7), (0.01, 0.01, 0.01), (0.3, 0.5, -0.2))
    values = np.zeros(grid.shape_zyx, np.float32)
    values[1, 4, 5] = 1  # left of the middle (low z), high up, in front
    volume = Volume(grid, values)
    _, y, z = grid.axes()
    row, column = np.argwhere(axial(volume, y[4] + 0.004))[0]
    assert (row, column) == (
        5,
        3,
    )  # with the origin below: front is above, low z (the left) on the right
    row, column = np.argwhere(sagittal(volume, z[1] - 0.004))[0]
    assert (row, column) == (4, 1)  # front on the left
