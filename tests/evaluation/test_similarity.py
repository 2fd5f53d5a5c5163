import weakref
from typing import get_args

import numpy as np
import pytest
import SimpleITK as sitk
from scipy.ndimage import gaussian_filter

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.evaluation import similarity
from legsim.evaluation.regions import Box, Region
from legsim.evaluation.scaling import Scaling
from legsim.evaluation.similarity import RegionScores
from legsim.geometry.volume import Volume, VolumeGrid
from tests.examples.blob import GRID, blob, regions
from tests.references import comparison


def test_a_volume_agrees_with_itself():
    metrics = similarity.evaluate(blob(GRID), blob(GRID), regions(GRID))
    assert metrics.registration is None
    assert all(m.ssim == pytest.approx(1) and m.rmse == 0 for m in metrics.regions)


def test_a_prepared_reference_scores_each_volume_as_if_it_were_the_first(rng):
    first, second, true = (noisy(rng) for _ in range(3))
    moved = Volume(GRID, np.roll(second.attenuation, 1, 2))
    prepared = similarity.prepare(blob(GRID), regions(GRID), phantom=true)
    found = [prepared.scores(volume) for volume in (first, moved, first)]
    alone = [
        similarity.evaluate(volume, blob(GRID), regions(GRID), phantom=true)
        for volume in (first, moved)
    ]
    assert found == [*alone, alone[0]]


def test_a_prepared_reference_keeps_no_whole_volume():
    reference, true = blob(GRID), blob(GRID)
    gone = weakref.ref(reference.attenuation), weakref.ref(true.attenuation)
    prepared = similarity.prepare(reference, regions(GRID)[1:], phantom=true)
    assert prepared.fixed.size < reference.attenuation.size
    assert prepared.fixed.base is None
    assert prepared.true is not None
    assert prepared.true.base is None
    del reference, true
    assert [kept() for kept in gone] == [None, None]


def scores(volume: Volume, reference: Volume, scaling: Scaling, **options) -> RegionScores:
    found = similarity.evaluate(
        volume, reference, regions(GRID), register=False, scaling=scaling, **options
    )
    assert found.scaling == scaling
    return found.of("leg")


def noisy(rng: np.random.Generator) -> Volume:
    added = rng.normal(0, 0.5, GRID.shape_zyx).astype(np.float32)
    return Volume(GRID, blob(GRID).attenuation + added)


@pytest.mark.parametrize("scaling", get_args(Scaling))
def test_one_affine_map_of_all_volumes_changes_nothing(rng, scaling):
    """Another unit or zero of attenuation is no other image."""
    volume, reference, true = noisy(rng), blob(GRID), noisy(rng)
    other = [Volume(GRID, 3 * v.attenuation + 7) for v in (volume, reference, true)]
    before = scores(volume, reference, scaling, phantom=true)
    after = scores(other[0], other[1], scaling, phantom=other[2])
    for field in ("ssim", "rmse", "ssim_phantom", "rmse_phantom", "gradient_entropy"):
        assert getattr(after, field) == pytest.approx(getattr(before, field), abs=2e-6)


@pytest.mark.parametrize("scaling", ["percentiles", "extremes"])
def test_a_map_of_one_volume_alone_counts_only_by_the_references_range(scaling):
    other = Volume(GRID, 3 * blob(GRID).attenuation + 7)
    assert scores(other, blob(GRID), scaling).rmse < 1e-6
    assert scores(other, blob(GRID), "reference").rmse > 0.5


def test_rmse_is_a_share_of_the_range():
    """A difference of 2 everywhere, by hand."""
    reference = blob(GRID).attenuation
    raised = Volume(GRID, reference + 2)
    inside = reference[regions(GRID)[0].mask]
    for scaling, values in (("reference", reference), ("reference-leg", inside)):
        expected = 2 / float(values.max() - values.min())
        assert scores(raised, blob(GRID), scaling).rmse == pytest.approx(expected, rel=1e-4)


def test_one_bright_voxel_sets_the_scale_of_its_own_extremes_alone():
    bright = blob(GRID).attenuation.copy()
    bright[24, 24, 24] *= 5
    found = {s: scores(Volume(GRID, bright), blob(GRID), s).rmse for s in get_args(Scaling)}
    assert max(found[s] for s in found if s != "extremes") < 0.03
    assert found["extremes"] > 0.1


def test_streaks_in_a_thousandth_of_the_voxels_do_not_set_the_scale(rng):
    streaked = blob(GRID).attenuation.copy()
    leg = np.flatnonzero(regions(GRID)[0].mask)
    streaked.flat[rng.choice(leg, len(leg) // 1000, replace=False)] -= 5
    for scaling in ("reference", "percentiles"):
        # the streaks themselves, of 5 in a range of about 20 to 40, and nothing elsewhere
        assert scores(Volume(GRID, streaked), blob(GRID), scaling).rmse < 0.02


def test_the_phantom_is_a_second_reference(rng):
    volume, reference, true = noisy(rng), blob(GRID), noisy(rng)
    found = scores(volume, reference, "reference", phantom=true)
    alone = scores(volume, reference, "reference")
    assert (alone.ssim_phantom, alone.rmse_phantom) == (None, None)
    assert (found.ssim, found.rmse) == (alone.ssim, alone.rmse)
    # two noises of 0.5, in the range of the motion-free volume
    values = reference.attenuation
    expected = 0.5 * np.sqrt(2) / float(values.max() - values.min())
    assert found.rmse_phantom == pytest.approx(expected, rel=0.02)
    itself = scores(true, reference, "reference", phantom=true)
    assert itself.ssim_phantom == pytest.approx(1, abs=1e-6)
    assert itself.rmse_phantom == 0


@pytest.mark.parametrize("window", ["uniform", "gaussian"])
def test_scores_are_those_of_simpleitk_and_scikit_image(rng, window):
    """Registration, resampling and SSIM by the libraries, in whole volumes."""
    center = transforms.translation(GRID.center)
    turn = transforms.rotation_from_vector([0.01, -0.02, 0.015])
    turned = transforms.rigid(turn, [0.0006, -0.0009, 0.0004])
    moved = blob(GRID, center @ turned @ transforms.inverse(center)).attenuation
    moved = moved + rng.normal(0, 0.2, moved.shape).astype(np.float32)
    fixed, leg = blob(GRID).attenuation, regions(GRID)[0].mask
    low, high = float(fixed.min()), float(fixed.max())
    a, b = (((v - low) / (high - low)).astype(np.float32) for v in (moved, fixed))
    registered = comparison.resample(a, comparison.register(b, a, leg, GRID), GRID)
    ssim = comparison.ssim(registered, b, window)[leg]
    rmse = np.sqrt(np.nanmean((registered - b)[leg].astype(float) ** 2))
    found = similarity.evaluate(Volume(GRID, moved), blob(GRID), regions(GRID), window=window)
    assert found.of("leg").rmse == pytest.approx(rmse, abs=1e-4)
    assert found.of("leg").ssim == pytest.approx(np.nanmean(ssim, dtype=float), abs=1e-4)
    assert found.window == window


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


@pytest.mark.parametrize("scaling", ["reference", "extremes"])
def test_a_volume_made_anew_where_it_lies_agrees_as_if_it_had_not_moved(rng, scaling):
    grain = transforms.translation([0.4 * GRID.spacing_xyz[0], 0.0, 0.0])
    noise = rng.normal(0, 0.05, GRID.shape_zyx).astype(np.float32)
    made_at = []

    def volume(at: np.ndarray, box: Box) -> Volume:
        """What the scan shows where ``at`` carries the voxels: the same noise, not smoothed."""
        made_at.append(at)
        seen = blob(GRID, transforms.inverse(at) @ grain).attenuation + noise
        return Volume(GRID.cropped(box), seen[box])

    whole = (slice(0, 48), slice(0, 48), slice(0, 48))
    reference = Volume(GRID, blob(GRID).attenuation + noise)
    prepared = similarity.prepare(reference, regions(GRID), scaling=scaling)
    moved = Volume(GRID, volume(np.eye(4), whole).attenuation)
    resampled = prepared.scores(moved)
    again = prepared.scores(moved, reconstructed_at=volume)
    np.testing.assert_allclose(made_at[-1], grain, atol=3e-4)  # noise holds it back
    assert again.registration is not None
    assert again.registration.reconstructed
    assert again.registration.applied
    assert resampled.of("leg").ssim < again.of("leg").ssim
    assert again.of("leg").rmse < 0.2 * resampled.of("leg").rmse
    assert "reconstructed where they lie" in again.protocol


def test_what_lies_where_it_should_is_not_made_anew():
    def never(at: np.ndarray, box: Box) -> Volume:
        raise AssertionError("nothing moved")

    still = Volume(GRID, blob(GRID).attenuation * np.float32(0.99))
    prepared = similarity.prepare(blob(GRID), regions(GRID))
    found = prepared.scores(still, reconstructed_at=never)
    assert found.registration is not None
    assert not found.registration.reconstructed
    assert not found.registration.applied


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"scaling": "bogus"}, "unknown scaling 'bogus'; choose one of reference, "),
        ({"window": "bogus"}, "unknown window 'bogus'; choose one of uniform, gaussian"),
        ({"regions": ()}, "no region to compare volumes in"),
    ],
)
def test_what_is_no_comparison_is_refused(options: dict, told: str):
    given = {"regions": regions(GRID), **options}
    with pytest.raises(LegsimError, match=told):
        similarity.evaluate(blob(GRID), blob(GRID), **given)
