"""Every score and every draw of noise is a row, in full precision."""

import csv
import io

import pytest

from tests.examples import study as example_study

RESULTS = example_study.results()


@pytest.fixture
def made(written_study):
    return written_study.folder


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_every_score_and_region_is_a_row_of_scores_csv_in_full_precision(made):
    rows = rows_of((made / "scores.csv").read_text())
    expected = [(score, region) for score in RESULTS.scores for region in score.metrics.regions]
    for row, (score, region) in zip(rows, expected, strict=True):
        assert (row["subject"], row["posture"], row["method"], row["region"]) == (
            score.subject,
            score.posture,
            score.method,
            region.region,
        )
        assert (float(row["ssim"]), float(row["rmse"])) == (region.ssim, region.rmse)
        assert (row["scaling"], row["window"]) == ("reference", "uniform")
        assert float(row["ssim_phantom"]) == region.ssim_phantom
        assert row["convention"] == ("" if score.noise is None else score.noise.convention)
        assert row["f_a"] == ("" if score.noise is None else str(score.noise.f_a))
        assert row["command"] == f"legsim run {score.folder}/config.toml --out OTHER"
        assert row["registration_translation_mm"] == (
            "" if (found := score.metrics.registration) is None else str(found.translation_mm)
        )
        for left in score.residuals:
            assert row[f"{left.structure}_mm"] == ("" if left.mm is None else str(left.mm))
            assert float(row[f"{left.structure}_pixels"]) == left.pixels
            after = row[f"{left.structure}_pixels_after_similarity"]
            assert float(after) == left.pixels_after_similarity


def test_every_draw_is_a_row_of_ladder_csv(made):
    rows = rows_of((made / "ladder.csv").read_text())
    for row, score in zip(rows, RESULTS.ladder, strict=True):
        assert (float(row["translation_mm"]), float(row["rotation_deg"])) == (
            score.translation_mm,
            score.rotation_deg,
        )
        assert row["f_g"] == ("" if score.noise.f_g is None else str(score.noise.f_g))
