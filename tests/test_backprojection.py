"""The kernel against its plain float64 twin."""

import numpy as np
import pytest
from reference_backprojection import backproject as reference

from legsim import backprojection, transforms
from legsim.geometry import ConeBeamGeometry, VolumeGrid
from legsim.opencl import Device


def scan(rng: np.random.Generator, *, tilted: bool, views: int = 9) -> ConeBeamGeometry:
    geometry = ConeBeamGeometry.circular(
        times=np.arange(views) * 1.0,
        angles=np.linspace(0, 4, views),
        source_isocenter=0.5,
        source_detector=0.9,
        shape_vu=(40, 50),
        pixel_pitch=6e-3,
    )
    if not tilted:
        return geometry
    return geometry.moved(
        transforms.rigid(transforms.rotation_from_vector(rng.normal(0, 0.1, (views, 3))), rng.normal(0, 0.01, (views, 3)))
    )


GRIDS = {
    "inside": VolumeGrid((7, 9, 11), (0.006, 0.005, 0.004), (0.01, -0.02, 0.015)),
    "larger than what the detector sees": VolumeGrid((9, 33, 17), (0.03, 0.02, 0.03), (0.02, 0.01, 0.0)),
    "behind the source": VolumeGrid((25, 3, 25), (0.08, 0.05, 0.08), (0.0, 0.0, 0.0)),
    "one voxel": VolumeGrid((1, 1, 1), (0.01, 0.01, 0.01), (0.02, 0.03, 0.01)),
}


def far_from_sources(geometry: ConeBeamGeometry, grid: VolumeGrid) -> np.ndarray:
    """(z, y, x) bool: where rounding is not blown up by 1 / depth^2."""
    z, y, x = np.meshgrid(*grid.axes()[::-1], indexing="ij")
    _, depths = geometry.project(np.stack([x, y, z], -1).reshape(-1, 3))
    return (np.abs(depths).min(0) > 0.1).reshape(grid.shape_zyx)


@pytest.mark.parametrize("tilted", [False, True])
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_every_voxel_gets_what_the_plain_reference_says(device: Device, rng: np.random.Generator, grid: VolumeGrid, tilted: bool) -> None:
    geometry = scan(rng, tilted=tilted)
    images = rng.normal(size=(9, 40, 50)).astype(np.float32)
    expected = reference(images, geometry.matrices, grid)
    found = backprojection.backproject([(slice(0, 9), images)], geometry.matrices, grid, device)
    far = far_from_sources(geometry, grid)
    np.testing.assert_allclose(found[far], expected[far], atol=2e-4 * np.abs(expected[far]).max() + 1e-9)
    assert np.isfinite(found).all()


def test_slabs_and_batches_do_not_change_the_volume(device: Device, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    geometry, grid = scan(rng, tilted=True), GRIDS["inside"]
    images = rng.normal(size=(9, 40, 50)).astype(np.float32)
    whole = backprojection.backproject([(slice(0, 9), images)], geometry.matrices, grid, device)
    monkeypatch.setattr(backprojection, "_SLAB_BYTES", 2 * 4 * 9 * 11)
    batches = [(slice(0, 4), images[:4]), (slice(4, 9), images[4:])]
    seen: list[tuple[int, int]] = []
    slabs = backprojection.backproject(batches, geometry.matrices, grid, device, progress=lambda done, total: seen.append((done, total)))
    np.testing.assert_allclose(slabs, whole, rtol=1e-4, atol=1e-4 * np.abs(whole).max())
    assert seen == [(2, 7), (4, 7), (6, 7), (7, 7)]


def test_one_pixel_lands_on_its_ray(device: Device, rng: np.random.Generator) -> None:
    geometry = scan(rng, tilted=True)
    images = np.zeros((9, 40, 50), np.float32)
    images[3, 22, 31] = 1.0
    grid = VolumeGrid.cubic(41, 0.004, (0.0, 0.0, 0.0))
    volume = backprojection.backproject([(slice(0, 9), images)], geometry.matrices, grid, device)
    z, y, x = np.nonzero(volume)
    points = np.stack([axis[index] for axis, index in zip(grid.axes(), (x, y, z), strict=True)], -1)
    pixels, _ = geometry[3:4].project(points)
    assert len(points) > 50
    assert np.abs(pixels[0] - [31, 22]).max() < 1.001
