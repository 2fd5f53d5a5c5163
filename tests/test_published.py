"""The printed numbers, spot-checked against the page and against each other."""

import pytest

from legsim import published
from legsim.published import Score


def test_cells_of_the_printed_table():
    assert published.ssim("uncorrected", "thigh", "60") == Score(0.736, 0.118)
    assert published.rmse("marker-based", "leg", "30") == Score(0.021, 0.006)
    assert published.ssim("nonrigid-3d", "leg") == Score(0.993, 0.004)
    assert published.rmse("nonrigid-2d", "shank", "all") == Score(0.018, 0.006)


def test_what_the_study_does_not_have_is_none():
    assert published.ssim("oracle", "leg") is None
    assert published.rmse("rigid", "foot") is None


@pytest.mark.parametrize("condition", published.CONDITIONS)
@pytest.mark.parametrize("region", published.REGIONS)
def test_every_correction_beats_no_correction(condition, region):
    before, error = published.ssim("uncorrected", region, condition), published.rmse("uncorrected", region, condition)
    for method in published.METHODS[1:]:
        assert published.ssim(method, region, condition).mean > before.mean
        assert published.rmse(method, region, condition).mean < error.mean
