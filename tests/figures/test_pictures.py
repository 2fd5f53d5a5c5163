"""Slices and overlays have the right side on the left, in mm, in one grey window."""

import numpy as np
import pytest

from legsim import figures
from legsim.core.errors import LegsimError
from legsim.geometry.volume import NamedVolume, Volume, VolumeGrid
from legsim.scene.slices import SlicePlanes, VolumeSlices
from tests.examples import scene as example_scene


@pytest.fixture(scope="module")
def scan():
    return example_scene.scan_scene()


def test_slices_put_front_above_and_the_right_side_on_the_left():
    grid = VolumeGrid((20, 20, 20), (0.01, 0.01, 0.01), (0.0, 0.5, 0.0))
    values = np.zeros(grid.shape_zyx, np.float32)
    values[15:18, :, 15:18] = 20  # in front, to the subject's right
    values[9, 15:18, 2:5] = 20  # behind, high up, in the sagittal plane
    figure = figures.slices(
        [VolumeSlices.of(NamedVolume("a", Volume(grid, values)), SlicePlanes(0.45, 0.55, -0.005))],
        window_per_mm=(0, 0.02),
    )
    axial, _, sagittal = (ax.images[0] for ax in figure.axes[:3])
    row, column = np.argwhere(axial.get_array() > 0.01).mean(0)
    assert row > 12  # drawn with the origin below
    assert column < 8
    left, right, bottom, top = axial.get_extent()
    assert left > right
    assert bottom < top
    row, column = np.argwhere(sagittal.get_array() > 0.01).mean(0)
    assert row > 12
    assert column > 12  # the back on the right
    assert axial.get_clim() == sagittal.get_clim() == (0, 0.02)


def test_slices_are_in_mm_of_world(scan):
    figure = figures.slices(scan.slices)
    extent = figure.axes[0].images[0].get_extent()
    center = scan.slices[0].grid.center
    np.testing.assert_allclose((extent[0] + extent[1]) / 2, 1e3 * center[2])
    np.testing.assert_allclose((extent[2] + extent[3]) / 2, 1e3 * center[0])
    np.testing.assert_allclose(extent[3] - extent[2], 200)


def test_the_grey_window_is_that_of_the_first_volume(scan):
    figure = figures.slices(scan.slices)
    limits = {ax.images[0].get_clim() for ax in figure.axes[:9]}
    assert len(limits) == 1
    np.testing.assert_allclose(limits.pop(), (0.0, 1e-3 * scan.slices[0].white))


def test_equal_volumes_overlay_without_red_or_green(scan):
    reference = scan.slices[0]
    figure = figures.overlay(reference, [reference, scan.slices[1]])
    same, different = figure.axes[0].images[0].get_array(), figure.axes[1].images[0].get_array()
    np.testing.assert_array_equal(same[..., 0], same[..., 1])
    assert np.abs(different[..., 0] - different[..., 1]).max() > 0.3
    assert same[..., 2].max() == 0


def test_details_of_the_overlay_lie_on_bone_and_skin(scan):
    reference = scan.slices[0]
    figure = figures.overlay(reference, [reference], width_mm=30)
    _, bone, skin = figure.axes[:3]
    x, _, z = reference.grid.center
    assert abs(np.mean(bone.get_xlim()) - 1e3 * z) < 10
    assert abs(np.mean(bone.get_ylim()) - 1e3 * (x + 0.015)) < 10
    assert abs(np.mean(skin.get_ylim()) - 1e3 * (x + 0.065)) < 10


def test_overlays_need_one_grid(scan):
    other = VolumeSlices.of(NamedVolume("other", example_scene.leg_volume(np.zeros(3), 0.0)))
    with pytest.raises(LegsimError, match="'other' lies on another grid than 'motion-free'"):
        figures.overlay(scan.slices[0], [other])
