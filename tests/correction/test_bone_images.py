"""Projections of a bone, their derivatives, and what of them counts."""

import numpy as np

from legsim.core import transforms
from legsim.correction.bone_images import BoneTemplate, EdgeFilter, bone_template
from legsim.correction.bone_regions import FEMUR, PATELLA, BoneRegions
from legsim.correction.bone_registration import about
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device

VIEWS = np.arange(12) / 2
GEOMETRY = ConeBeamGeometry.circular(
    times=VIEWS,
    angles=np.radians(15) * np.arange(len(VIEWS)),
    source_isocenter=0.78,
    source_detector=1.198,
    shape_vu=(60, 70),
    pixel_pitch=3.08e-3,
    isocenter=(0.0, 0.0, 0.0),
).moved(transforms.rigid(transforms.rotation_from_vector([0.12, 0.45, 0.08]), np.zeros(3)))
GRID = VolumeGrid((70, 80, 64), (1e-3,) * 3, (0.004, -0.003, 0.002))


def smooth_bone() -> BoneTemplate:
    """Two soft blobs; nothing is symmetric."""
    points = GRID.positions()
    values = np.zeros(len(points))
    for place, size, most in (([5, 8, -4], (8, 9, 6), 25.0), ([-8, -10, 6], (5, 6, 7), 18.0)):
        at = (points - 1e-3 * np.array(place)) / (1e-3 * np.array(size))
        values += most * np.exp(-0.5 * (at**2).sum(-1))
    return BoneTemplate(GRID, values.reshape(GRID.shape_zyx).astype(np.float32))


def motion() -> np.ndarray:
    turns = 0.05 * np.sin(VIEWS)[:, None] * [1.0, -0.5, 0.7]
    shifts = 3e-3 * np.cos(VIEWS)[:, None] * [0.4, 1.0, -0.6]
    return transforms.rigid(transforms.rotation_from_vector(turns), shifts)


def test_derivatives_are_those_of_the_images(device: Device):
    """Differences of volumes against moved ones, in the frequencies that count: a few percent.

    Over half a pixel, since the projector is linear between pixels.
    """
    bone, edges = smooth_bone(), EdgeFilter(margin=0.0)
    found = bone.derivatives(GEOMETRY, motion(), device)
    for k, step in enumerate([0.05] * 3 + [1e-3] * 3):
        twists = np.zeros((len(VIEWS), 6))
        twists[:, k] = step
        beside = [
            bone.images(GEOMETRY, motion() @ about(bone.middle, sign * twists), device)
            for sign in (1, -1)
        ]
        expected = edges((beside[0] - beside[1]) / (2 * step))
        off = edges(found[k]) - expected
        assert np.linalg.norm(off) < 0.06 * np.linalg.norm(expected)


def test_what_is_smooth_and_the_outer_rows_do_not_count():
    edges = EdgeFilter()
    rows, columns = np.mgrid[:60, :80]
    flat = 3.0 + 0.02 * columns[None] + 0.01 * rows[None]
    inside = edges(flat)[:, 15:-15, 15:-15]
    assert np.abs(inside).max() < 1e-4
    spot = np.zeros((1, 60, 80))
    spot[0, 1, 40] = 1
    assert np.abs(edges(spot)).max() < 0.04 * np.abs(edges(np.roll(spot, 29, 1))).max()


def test_a_bone_fades_out_and_ends_at_the_next():
    grid = VolumeGrid((20, 20, 20), (2e-3,) * 3, (0.0, 0.0, 0.0))
    labels = np.zeros(grid.shape_zyx, np.uint8)
    labels[5:12, 6:14, 6:14] = FEMUR
    labels[12:15, 6:14, 6:14] = PATELLA
    volume = Volume(grid, np.full(grid.shape_zyx, 45.0, np.float32))
    bone = bone_template(volume, BoneRegions(grid, labels), FEMUR, 20.0)
    assert bone is not None
    through = bone.attenuation[:, bone.attenuation.shape[1] // 2, bone.attenuation.shape[2] // 2]
    at = np.round((bone.grid.origin - grid.origin) / grid.spacing_xyz).astype(int)[2]
    np.testing.assert_allclose(through[7 - at : 10 - at], 25.0, rtol=1e-3)
    assert through[14 - at :].max(initial=0) < 1e-3
    assert 0 < through[4 - at] <= 25
    assert through[0] < 1e-2


def test_a_bone_that_was_not_found_is_none():
    grid = VolumeGrid((4, 4, 4), (2e-3,) * 3, (0.0, 0.0, 0.0))
    empty = BoneRegions(grid, np.zeros(grid.shape_zyx, np.uint8))
    assert bone_template(Volume(grid, np.ones((4, 4, 4), np.float32)), empty, FEMUR, 0.0) is None
