"""Labels at voxel centers against winding numbers in float64, exact ties, volumes, and agreement
with the projector's rule.
"""

import numpy as np
import pytest
import trimesh

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.geometry.volume import VolumeGrid
from legsim.phantom import voxelize
from legsim.phantom.meshes import Part, Phantom
from tests.references import voxelizer as reference_voxelizer


def part(
    name: str, mesh: trimesh.Trimesh, center=(0.0, 0.0, 0.0), attenuation: float = 1.0
) -> Part:
    return Part(name, "water", attenuation, mesh.vertices + np.asarray(center), mesh.faces)


def ball(name: str, radius: float, center=(0.0, 0.0, 0.0), subdivisions: int = 2) -> Part:
    return part(name, trimesh.creation.icosphere(subdivisions, radius=radius), center)


def test_overlapping_parts_on_an_uneven_grid_agree_with_winding_numbers(device):
    phantom = Phantom(
        (
            ball("a", 0.06),
            ball("b", 0.04, (0.03, 0.02, -0.01)),
            ball("c", 0.03, (-0.02, -0.03, 0.05)),
            ball("d", 0.01),
        )
    )
    grid = VolumeGrid((11, 9, 13), (0.0095, 0.0153, 0.0161), (0.0031, -0.0017, 0.0023))
    expected = reference_voxelizer.labels(phantom, grid)
    assert set(np.unique(expected)) == {0, 1, 2, 3, 4}
    np.testing.assert_array_equal(voxelize.labels(phantom, grid, device), expected)


def test_a_box_whose_faces_pass_through_voxel_centers_takes_each_center_once(device):
    """Two boxes share a face at voxel centers on each axis: no center is lost, none counted
    twice.
    """
    grid = VolumeGrid((8, 8, 8), (1.0, 1.0, 1.0), (3.5, 3.5, 3.5))
    for axis in range(3):
        bounds = np.array([[1.0, 1.0, 1.0], [6.0, 6.0, 6.0]])
        low, high = bounds.copy(), bounds.copy()
        low[1, axis] = high[0, axis] = 3.0
        halves = [
            part(name, trimesh.creation.box(bounds=b)) for name, b in (("low", low), ("high", high))
        ]
        for order in (halves, halves[::-1]):
            found = voxelize.labels(Phantom(tuple(order)), grid, device)
            assert (found != 0).sum() == 125
            assert sorted(np.bincount(found.ravel())[1:]) == [50, 75]


def test_volume_of_a_fine_ball(device):
    grid = VolumeGrid.cubic(64, 1e-3, (0.01, 0.02, -0.01))
    mesh = trimesh.creation.icosphere(4, radius=0.025)
    found = voxelize.labels(Phantom((part("ball", mesh, (0.0101, 0.0203, -0.0098)),)), grid, device)
    assert found.dtype == np.uint8
    assert found.sum() * 1e-9 == pytest.approx(mesh.volume, rel=2e-3)


def test_posed_vertices_move_the_labels(device):
    phantom, grid = Phantom((ball("a", 0.02),)), VolumeGrid.cubic(20, 0.004, (0, 0, 0))
    moved = transforms.apply(
        transforms.translation((0.008, -0.004, 0.012)), phantom.parts[0].vertices
    )
    still, shifted = (
        voxelize.labels(phantom, grid, device),
        voxelize.labels(phantom, grid, device, posed=[moved]),
    )
    np.testing.assert_array_equal(np.roll(still, (3, -1, 2), (0, 1, 2)), shifted)


def test_more_parts_than_a_byte_numbers(device):
    grid = VolumeGrid((1, 1, 300), (1.0, 1.0, 1.0), (149.5, 0.0, 0.0))
    boxes = tuple(
        part(f"box {k}", trimesh.creation.box(extents=(0.5, 0.5, 0.5)), (k, 0, 0))
        for k in range(300)
    )
    found = voxelize.labels(Phantom(boxes), grid, device)
    np.testing.assert_array_equal(found[0, 0], np.arange(1, 301))


def test_more_surfaces_along_a_column_than_fit_in_local_memory(device):
    boxes = tuple(
        part(f"box {k}", trimesh.creation.box(extents=(4, 4, 0.5)), (0, 0, k)) for k in range(60)
    )
    found = voxelize.labels(
        Phantom(boxes), VolumeGrid((60, 3, 3), (1.0, 1.0, 1.0), (0.0, 0.0, 29.5)), device
    )
    np.testing.assert_array_equal(found, np.arange(1, 61)[:, None, None] * np.ones((1, 3, 3)))


def test_true_volume_holds_the_attenuation_of_the_last_part(device):
    phantom = Phantom(
        (
            part("a", trimesh.creation.box(extents=(4, 4, 4)), attenuation=20.0),
            part("b", trimesh.creation.box(), (1, 1, 1), 50.0),
        )
    )
    volume = voxelize.attenuation(phantom, VolumeGrid.cubic(3, 1.0, (0.1, 0.1, 0.1)), device)
    assert (volume.attenuation == 20.0).sum() == 26
    assert volume.attenuation[2, 2, 2] == 50.0


def test_the_mean_of_many_points_is_the_share_that_a_voxel_has_of_a_part(device):
    """A box whose faces cut voxels at a quarter, in one direction each."""
    phantom = Phantom((part("a", trimesh.creation.box(bounds=[[0, 0, 0], [2.25, 2, 2]])),))
    grid = VolumeGrid((2, 2, 4), (1.0, 1.0, 1.0), (2.0, 1.0, 1.0))
    for points, last in ((1, 0.0), (2, 0.0), (4, 0.25)):
        shares = voxelize.attenuation(phantom, grid, device, points=points).attenuation
        shares = shares / phantom.parts[0].attenuation
        np.testing.assert_allclose(shares, np.broadcast_to([1, 1, last, 0], (2, 2, 4)), atol=1e-6)


def test_many_points_have_the_volume_of_a_ball_and_its_edge_in_between(device):
    mesh = trimesh.creation.icosphere(4, radius=0.02)
    phantom = Phantom((part("ball", mesh, attenuation=20.0),))
    grid = VolumeGrid.cubic(12, 4e-3, (0.001, 0.0005, 0))
    found = voxelize.attenuation(phantom, grid, device, points=4).attenuation
    assert found.sum() * 64e-9 / 20 == pytest.approx(mesh.volume, rel=2e-3)
    assert ((found > 0) & (found < 20)).any()


def test_an_open_surface_is_refused(device):
    mesh = trimesh.creation.box()
    with pytest.raises(LegsimError, match="'open' is not a closed"):
        voxelize.labels(
            Phantom((Part("open", "water", 1.0, mesh.vertices, mesh.faces[:-1]),)),
            VolumeGrid.cubic(3, 1.0, (0, 0, 0)),
            device,
        )
