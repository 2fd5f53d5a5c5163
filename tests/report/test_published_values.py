"""The published numbers, spot-checked against the page and against each other."""

import pytest

from legsim.report import published_values
from legsim.report.published_values import PublishedDrift, Score


def test_cells_of_the_published_table():
    assert published_values.ssim("uncorrected", "thigh", "60") == Score(0.736, 0.118)
    assert published_values.rmse("marker-based", "leg", "30") == Score(0.021, 0.006)
    assert published_values.ssim("nonrigid-3d", "leg") == Score(0.993, 0.004)
    assert published_values.rmse("nonrigid-2d", "shank", "all") == Score(0.018, 0.006)


def test_what_the_study_does_not_have_is_none():
    assert published_values.ssim("oracle", "leg") is None
    assert published_values.rmse("rigid", "foot") is None


@pytest.mark.parametrize("condition", ["30", "60", "all"])
@pytest.mark.parametrize("region", published_values.REGIONS)
def test_every_correction_beats_no_correction(condition, region):
    before, error = (
        published_values.ssim("uncorrected", region, condition),
        published_values.rmse("uncorrected", region, condition),
    )
    for method in ("marker-based", "rigid", "nonrigid-2d", "nonrigid-3d"):
        assert published_values.ssim(method, region, condition).mean > before.mean
        assert published_values.rmse(method, region, condition).mean < error.mean


def test_cells_of_the_published_ladder():
    assert published_values.deviation(0, 0) == PublishedDrift(9461, 1.453)
    assert published_values.deviation(2, 3) == PublishedDrift(73, 1e-3)
    assert published_values.deviation(4, 5) == PublishedDrift(0.985, 2e-5)
    assert published_values.deviation(3, None) == PublishedDrift(9, 1e-5)
    assert published_values.deviation(None, 1) == PublishedDrift(80, 0.129)
    assert published_values.deviation(None, None) == PublishedDrift(0, 0)
    assert published_values.deviation(0.5, 1) is None
    assert published_values.deviation(0, 6) is None


def test_the_cells_below_1_mm_and_1_degree_are_the_bold_ones():
    """The text: with both sensors noisy, only where the noise is divided by 10^4 or 10^5."""
    noisy = published_values.EXPONENTS[:-1]
    low = {
        (a, g) for a in noisy for g in noisy if max(vars_of(published_values.deviation(a, g))) < 1
    }
    assert low == {(4, 4), (4, 5), (5, 4), (5, 5)}


def vars_of(cell: PublishedDrift) -> tuple[float, float]:
    return cell.translation_mm, cell.rotation_deg


@pytest.mark.parametrize("f_g", [3, 4, 5, None])
def test_a_quiet_gyroscope_turns_the_same_whatever_the_accelerometer(f_g):
    assert (
        len(
            {
                published_values.deviation(f_a, f_g).rotation_deg
                for f_a in published_values.EXPONENTS[:-1]
            }
        )
        == 1
    )


@pytest.mark.parametrize("region", published_values.REGIONS)
def test_no_noise_is_rigid_over_all_scans(region):
    assert published_values.noisy_ssim(None, None, region) == published_values.ssim(
        "rigid", region, "all"
    )
    assert published_values.noisy_rmse(None, None, region) == published_values.rmse(
        "rigid", region, "all"
    )


def test_cells_of_quality_under_noise():
    assert published_values.noisy_ssim(4, 5, "thigh") == Score(0.919, 0.054)
    assert published_values.noisy_rmse(5, 4, "thigh") == Score(0.021, 0.007)
    assert published_values.noisy_ssim(3, 3, "leg") is None
    assert published_values.noisy_rmse(4, 4, "foot") is None
