"""SSIM: slow references, scikit-image, laws, and where it knows nothing."""

from typing import get_args

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.evaluation import ssim
from legsim.evaluation.ssim import Window, ssim_map
from tests.references import comparison

WINDOWS = get_args(Window)


@pytest.fixture
def pair(rng) -> tuple[np.ndarray, np.ndarray]:
    """A volume of values about 0..1 and a noisy copy, whose slabs are cut."""
    fixed = rng.random((75, 20, 21), dtype=np.float32)
    return fixed + rng.normal(0, 0.1, fixed.shape).astype(np.float32), fixed


@pytest.mark.parametrize("window", WINDOWS)
def test_ssim_is_that_of_whole_windows_in_float64(device, pair, window):
    border = slice(ssim.reach(window), -ssim.reach(window))
    found = ssim_map(*pair, window=window, device=device)[border, border, border]
    np.testing.assert_allclose(found, comparison.plain_ssim(pair[0], pair[1], window), atol=2e-6)


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("slab", [1, 10_000, 1 << 25])
def test_ssim_in_slabs_is_scikit_images(device, pair, window, slab, monkeypatch):
    monkeypatch.setattr(ssim, "_SLAB_BYTES", slab)
    moving, fixed = (v.astype(np.float64) for v in pair)
    wanted = comparison.ssim(moving, fixed, window)
    np.testing.assert_allclose(ssim_map(*pair, window=window, device=device), wanted, atol=2e-6)


@pytest.mark.parametrize("window", WINDOWS)
def test_single_precision_is_enough_for_values_far_from_the_range(device, rng, window):
    """Noise of 0.01 on values of 3, where squares cancel: as near to float64 as scikit-image is."""
    fixed = 3 + rng.normal(0, 0.01, (20, 21, 22)).astype(np.float32)
    moving = fixed + rng.normal(0, 0.01, fixed.shape).astype(np.float32)
    wanted = comparison.ssim(moving.astype(np.float64), fixed.astype(np.float64), window)
    found = ssim_map(moving, fixed, window=window, device=device)
    # rounding of squares of 2.5, 6e-8 each, against the constant of 9e-4
    np.testing.assert_allclose(found, wanted, atol=3e-3)
    assert np.nanmean(found) == pytest.approx(np.nanmean(wanted), abs=1e-4)


@pytest.mark.parametrize("window", WINDOWS)
def test_equal_volumes_are_alike_and_the_order_of_two_does_not_matter(device, pair, window):
    moving, fixed = pair
    alike = ssim_map(fixed, fixed, window=window, device=device)
    assert np.nanmin(alike) == pytest.approx(1, abs=1e-6)
    there, back = (
        ssim_map(*each, window=window, device=device) for each in (pair, (fixed, moving))
    )
    np.testing.assert_allclose(there, back, atol=1e-6)


@pytest.mark.parametrize("window", WINDOWS)
def test_it_knows_nothing_where_its_window_holds_nan(device, rng, window):
    a, b = rng.random((2, 24, 24, 24), dtype=np.float32)
    holed = a.copy()
    holed[12, 12, 12] = np.nan
    whole, found = (ssim_map(each, b, window=window, device=device) for each in (a, holed))
    reach = ssim.reach(window)
    inside = np.zeros(a.shape, bool)
    inside[(slice(12 - reach, 13 + reach),) * 3] = True
    assert np.isnan(found[inside]).all()
    np.testing.assert_array_equal(found[~inside], whole[~inside])


@pytest.mark.parametrize("window", WINDOWS)
def test_a_grid_smaller_than_a_window_is_refused(device, window):
    size = 2 * ssim.reach(window)
    small = np.zeros((size, 20, 20), np.float32)
    with pytest.raises(LegsimError, match=rf"at least {size + 1} voxels along each axis"):
        ssim_map(small, small, window=window, device=device)
