"""Cubic B-splines: SimpleITK's values, and laws of interpolation."""

import numpy as np
import pytest
import SimpleITK as sitk

from legsim.evaluation import resampling
from legsim.geometry.volume import VolumeGrid
from tests.references import comparison

UNIT = VolumeGrid((21, 18, 25), (1e-3, 1e-3, 1e-3), (0.012, 0.0085, 0.010))
"""voxel (0, 0, 0) at the origin, 1 mm: an index is a point in mm"""


def whole(values: np.ndarray) -> tuple[slice, ...]:
    return tuple(slice(0, n) for n in values.shape)


def shift_by(*xyz: float) -> np.ndarray:
    return np.column_stack([np.zeros((3, 3)), xyz])


def by_simpleitk(values: np.ndarray, shift: np.ndarray) -> np.ndarray:
    transform = sitk.AffineTransform(3)
    transform.SetMatrix((np.eye(3) + shift[:, :3]).ravel().tolist())
    transform.SetTranslation(shift[:, 3].tolist())
    grid = VolumeGrid(
        values.shape, (1e-3,) * 3, tuple(0.5e-3 * (n - 1) for n in values.shape[::-1])
    )
    return comparison.resample(values, transform, grid)


@pytest.mark.parametrize("slab", [1, 5000, 1 << 28])
@pytest.mark.parametrize("size", [0.0, 0.3, 4.0])
def test_values_are_simpleitks(device, rng, slab, size, monkeypatch):
    monkeypatch.setattr(resampling, "_SLAB_BYTES", slab)
    values = rng.random((41, 18, 25), dtype=np.float32)
    shift = np.column_stack([rng.uniform(-0.01, 0.01, (3, 3)) * size, rng.uniform(-1, 1, 3) * size])
    found = resampling.resample(values, shift, whole(values), device)
    # voxels that lie on the very border may be taken for inside or outside
    wanted = by_simpleitk(values, shift)
    both = np.isfinite(found) & np.isfinite(wanted)
    assert np.count_nonzero(np.isfinite(found) != np.isfinite(wanted)) <= 2
    np.testing.assert_allclose(found[both], wanted[both], atol=3e-6)


@pytest.mark.parametrize("shape", [(1, 9, 9), (3, 3, 4), (13, 1, 5)])
def test_thin_volumes_are_mirrored_as_often_as_it_takes(device, rng, shape):
    values = rng.random(shape, dtype=np.float32)
    shift = shift_by(0.3, -0.2, 0.4)
    found = resampling.resample(values, shift, whole(values), device)
    wanted = by_simpleitk(values, shift)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(wanted))
    np.testing.assert_allclose(found, wanted, atol=3e-6)


def test_a_box_has_the_values_of_the_whole(device, rng):
    values = rng.random((60, 50, 55), dtype=np.float32)
    shift = np.column_stack([rng.uniform(-0.02, 0.02, (3, 3)), (1.2, -0.7, 2.1)])
    everything = resampling.resample(values, shift, whole(values), device)
    box = (slice(20, 43), slice(17, 18), slice(0, 30))
    found = resampling.resample(values, shift, box, device)
    # the inverse filter is cut off 12 voxels beyond the box instead of at the border: 3e-7
    np.testing.assert_allclose(found, everything[box], atol=2e-6)


def test_no_shift_gives_the_volume_back_and_whole_voxels_move_it(device, rng):
    values = rng.random((20, 21, 22), dtype=np.float32)
    found = resampling.resample(values, np.zeros((3, 4)), whole(values), device)
    np.testing.assert_allclose(found, values, atol=2e-6)
    moved = resampling.resample(values, shift_by(2, 0, -1), whole(values), device)
    np.testing.assert_allclose(moved[1:, :, :-2], values[:-1, :, 2:], atol=2e-6)
    assert np.isnan(moved[0]).all()
    assert np.isnan(moved[:, :, -2:]).all()


def test_a_cubic_is_kept_away_from_the_border(device):
    """Splines of degree 3 hold every polynomial of degree 3."""
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, 61),) * 3, indexing="ij")
    cubic = (x**3 - 2 * y**2 * z + y - 0.3).astype(np.float32)
    step = 1 / 30
    found = resampling.resample(cubic, shift_by(0.4, 0.2, -0.6), whole(cubic), device)
    x, y, z = x + 0.4 * step, y + 0.2 * step, z - 0.6 * step
    inner = (slice(15, -15),) * 3
    np.testing.assert_allclose(found[inner], (x**3 - 2 * y**2 * z + y - 0.3)[inner], atol=3e-6)
