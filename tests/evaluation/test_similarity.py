import numpy as np
import pytest
import SimpleITK as sitk
from scipy.ndimage import gaussian_filter
from skimage.metrics import structural_similarity

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.evaluation import similarity
from legsim.evaluation.regions import Region
from legsim.geometry.volume import Volume, VolumeGrid
from tests.examples.blob import GRID, blob, regions


def test_a_volume_agrees_with_itself():
    metrics = similarity.evaluate(blob(GRID), blob(GRID), regions(GRID))
    assert metrics.registration is None
    assert all(m.ssim == pytest.approx(1) and m.rmse == 0 for m in metrics.regions)


def test_scale_and_offset_of_attenuation_do_not_matter():
    other = Volume(GRID, 3 * blob(GRID).attenuation + 7)
    metrics = similarity.evaluate(other, blob(GRID), regions(GRID), register=False)
    assert metrics.of("leg").rmse < 1e-6


def test_one_bright_voxel_does_not_set_the_scale():
    bright = blob(GRID).attenuation.copy()
    bright[24, 24, 24] *= 5
    metrics = similarity.evaluate(Volume(GRID, bright), blob(GRID), regions(GRID), register=False)
    assert metrics.of("leg").rmse < 0.03


def test_streaks_in_a_thousandth_of_the_voxels_do_not_set_the_scale(rng):
    streaked = blob(GRID).attenuation.copy()
    leg = np.flatnonzero(regions(GRID)[0].mask)
    streaked.flat[rng.choice(leg, len(leg) // 1000, replace=False)] -= 5
    metrics = similarity.evaluate(Volume(GRID, streaked), blob(GRID), regions(GRID), register=False)
    # the streaks themselves, of 5 in a range of about 20 to 40, and nothing elsewhere
    assert metrics.of("leg").rmse < 0.02


def test_metrics_are_the_same_digits_on_any_number_of_cores(rng):
    """So that scores of a machine, a cluster and a laptop can be compared as they are."""
    noisy = Volume(
        GRID, blob(GRID).attenuation + rng.normal(0, 0.3, GRID.shape_zyx).astype(np.float32)
    )
    cores = sitk.ProcessObject.GetGlobalDefaultNumberOfThreads()
    found = []
    try:
        for number in (1, 2, 5):
            sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(number)
            found.append(similarity.evaluate(noisy, blob(GRID), regions(GRID)))
    finally:
        sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(cores)
    assert found[0].registration is not None
    assert found[0] == found[1] == found[2]


def test_ssim_in_slabs_is_ssim_in_one_piece(rng):
    a, b = rng.random((2, 75, 20, 21), dtype=np.float32)
    whole = structural_similarity(a, b, data_range=1.0, win_size=7, full=True)[1][3:-3, 3:-3, 3:-3]
    np.testing.assert_allclose(similarity.ssim_map(a, b)[3:-3, 3:-3, 3:-3], whole, atol=1e-5)


def test_what_registration_brings_in_from_outside_counts_nowhere(rng):
    """A volume cut from a larger one, shifted by two voxels: where both know the body they agree,
    the rest is left out.
    """
    wide = gaussian_filter(rng.random((48, 52, 48), dtype=np.float32), 2.0)
    fixed, moving = wide[:, 2:-2], wide[:, :-4]
    everywhere = [Region("all", np.ones(GRID.shape_zyx, bool))]
    metrics = similarity.evaluate(Volume(GRID, moving), Volume(GRID, fixed), everywhere)
    assert metrics.registration is not None
    assert metrics.registration.translation_mm == pytest.approx(4, abs=0.1)
    assert 44 * 48**2 < metrics.of("all").voxels < 47 * 48**2
    assert metrics.of("all").ssim > 0.98
    assert metrics.of("all").rmse < 0.02


def test_ssim_knows_nothing_where_its_window_holds_nan(rng):
    a, b = rng.random((2, 20, 20, 20), dtype=np.float32)
    holed = a.copy()
    holed[10, 10, 10] = np.nan
    whole, found = similarity.ssim_map(a, b), similarity.ssim_map(holed, b)
    assert np.isnan(found[7:14, 7:14, 7:14]).all()
    away = np.ones_like(found, bool)
    away[7:14, 7:14, 7:14] = False
    np.testing.assert_allclose(found[away], whole[away], atol=1e-6)


def test_an_even_slope_has_the_entropy_of_its_voxels():
    """Every voxel has the same gradient: p = 1/n, whatever the slope."""
    slope = np.arange(12, dtype=np.float32)[None, :, None] * np.ones((10, 1, 14), np.float32)
    mask = np.ones(slope.shape, bool)
    assert similarity.gradient_entropy(7 * slope, mask) == pytest.approx(np.log(8 * 10 * 12))
    slope[5, 6, 7] = np.nan  # leaves out itself and its six neighbors
    assert similarity.gradient_entropy(slope, mask) == pytest.approx(np.log(8 * 10 * 12 - 7))


def test_a_step_keeps_its_edges_in_two_layers():
    step = np.zeros((10, 12, 14), np.float32)
    step[:, 6:] = 3
    assert similarity.gradient_entropy(step, np.ones(step.shape, bool)) == pytest.approx(
        np.log(2 * 8 * 12)
    )


def test_blur_and_noise_raise_gradient_entropy_and_scale_does_not(rng):
    sharp = blob(GRID).attenuation + 10 * (blob(GRID).attenuation > 5).astype(np.float32)
    leg = regions(GRID)[0].mask
    blurred = [
        similarity.gradient_entropy(gaussian_filter(sharp, sigma), leg)
        for sigma in (0, 0.7, 1.5, 3)
    ]
    assert np.all(np.diff(blurred) > 0.02)
    assert similarity.gradient_entropy(3 * sharp - 8, leg) == pytest.approx(blurred[0], abs=1e-4)
    noisy = sharp + rng.normal(0, 0.5, sharp.shape).astype(np.float32)
    assert similarity.gradient_entropy(noisy, leg) > blurred[0] + 0.02


def test_gradient_entropy_of_nothing_is_nothing():
    assert (
        similarity.gradient_entropy(np.ones((9, 9, 9), np.float32), np.ones((9, 9, 9), bool)) == 0
    )


@pytest.mark.parametrize(
    ("volume", "message"),
    [
        (
            Volume(VolumeGrid.cubic(48, 0.001, (0, 0, 0)), np.zeros((48, 48, 48), np.float32)),
            "different grids",
        ),
        (Volume(GRID, np.full((48, 48, 48), np.nan, np.float32)), "not numbers"),
        (Volume(GRID, np.zeros((48, 48, 48), np.float32)), "everywhere inside"),
    ],
)
def test_what_cannot_be_compared_is_refused(volume, message):
    with pytest.raises(LegsimError, match=message):
        similarity.evaluate(volume, blob(GRID), regions(GRID))


def test_an_empty_region_is_refused():
    with pytest.raises(LegsimError, match="holds no voxel"):
        similarity.evaluate(
            blob(GRID), blob(GRID), [Region("nothing", np.zeros((48, 48, 48), bool))]
        )


def test_voxels_far_from_the_regions_decide_nothing():
    grid = VolumeGrid.cubic(90, 0.002, GRID.center)
    center = transforms.translation(grid.center)
    moved = (
        center
        @ transforms.rigid(
            transforms.rotation_from_vector([0.02, -0.05, 0.03]), [0.003, -0.002, 0.001]
        )
        @ transforms.inverse(center)
    )
    wide, reference = blob(grid, moved), blob(grid)
    littered = wide.attenuation.copy()
    littered[:8], littered[..., -8:] = 1e4, -1e4
    shown = regions(grid)
    assert similarity.evaluate(Volume(grid, littered), reference, shown) == similarity.evaluate(
        wide, reference, shown
    )
