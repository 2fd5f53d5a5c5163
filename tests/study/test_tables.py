"""Every table holds what it says, recomputed here from the scores."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.evaluation.registration import RegistrationError
from legsim.study import results as study_results
from legsim.study import statistics, tables
from legsim.study.results import LadderScore, NoiseLevel, SensorScore, StageCost
from tests.examples import study as example_study

CLEAN = tuple(s for s in example_study.results().scores if s.noise is None and s.method != "static")


def row_of(table, group, label):
    found, here = [], ""
    for row in table.rows:
        here = row[0] if len(row) == 1 else here
        if len(row) > 1 and here.startswith(group) and row[0] == label:
            found.append(row)
    (row,) = found
    return dict(zip(table.columns, row, strict=True))


@pytest.mark.parametrize(
    ("group", "postures"),
    [("30", ["squat_30"]), ("60", ["squat_60"]), ("all", ["squat_30", "squat_60"])],
)
def test_quality_is_the_mean_and_deviation_over_scans(group, postures):
    ssim, rmse = tables.quality(CLEAN)
    found = [s.metrics.of("thigh") for s in CLEAN if s.method == "rigid" and s.posture in postures]
    values = np.array([(m.ssim, m.rmse) for m in found])
    for column, table in enumerate((ssim, rmse)):
        mean, deviation = values[:, column].mean(), values[:, column].std(ddof=1)
        assert row_of(table, group, "rigid")["thigh"] == f"{mean:.3f} ± {deviation:.3f}"
    assert row_of(ssim, "60", "rigid")["published thigh"] == "0.987 ± 0.006"
    assert row_of(ssim, "30", "oracle")["published leg"] == "–"


def test_distances_from_the_phantom_have_a_row_for_the_motion_free_scan():
    every = [s for s in example_study.results().scores if s.noise is None]
    table = tables.to_phantom(every)
    assert table is not None
    for method in ("static", "nonrigid-2d"):
        found = [s.metrics.of("leg") for s in every if s.method == method]
        row = row_of(table, "all", method)
        for column, field in (("SSIM leg", "ssim_phantom"), ("RMSE leg", "rmse_phantom")):
            values = np.array([getattr(m, field) for m in found])
            assert row[column] == f"{values.mean():.3f} ± {values.std(ddof=1):.3f}"


def test_without_a_phantom_there_is_no_table_of_it():
    def blind(score):
        regions = tuple(
            replace(r, ssim_phantom=None, rmse_phantom=None) for r in score.metrics.regions
        )
        return replace(score, metrics=replace(score.metrics, regions=regions))

    assert tables.to_phantom([blind(s) for s in CLEAN]) is None


def test_every_table_of_image_quality_names_the_scaling():
    other = [replace(s, metrics=replace(s.metrics, scaling="extremes")) for s in CLEAN]
    found = statistics.paired_tests(CLEAN, statistics.of_region("ssim", "leg"))
    for scores, words in ((CLEAN, "one map, the range"), (other, "its own minimum and maximum")):
        shown = [*tables.quality(scores), *tables.every_scan(scores, "scans")]
        shown += [
            tables.to_phantom(scores),
            tables.tests("", found, "", study_results.protocol(scores)),
        ]
        assert all(words in table.note for table in shown if table is not None)


def test_a_method_that_is_compared_in_another_way_is_named():
    mixed = [
        replace(s, metrics=replace(s.metrics, registered="reconstructed"))
        if s.method != "rigid"
        else s
        for s in CLEAN
    ]
    usual, other = study_results.protocol(mixed).split(" rigid: ")
    assert "reconstructed where they lie" in usual
    assert "resampled" in other
    assert "resampled" not in usual


def test_a_method_that_failed_somewhere_says_how_many_scans_it_has():
    some = [s for s in CLEAN if not (s.method == "rigid" and s.subject == "subject03")]
    ssim, _ = tables.quality(some)
    assert row_of(ssim, "30 degree squats (7 scans)", "rigid (6 scans)")
    assert row_of(ssim, "all scans (14 scans)", "rigid (12 scans)")


def test_residuals_have_a_table_a_unit_and_no_empty_columns():
    mm, degrees, pixels, after = tables.residuals(CLEAN)
    assert mm.columns == ("method", "femur", "tibia", "patella", "skin")
    assert degrees.columns == ("method", "femur", "tibia", "patella")
    found = np.array(
        [s.residuals[0].mm for s in CLEAN if s.method == "oracle" and s.posture == "squat_60"],
        float,
    )
    assert row_of(mm, "60", "oracle")["femur"] == f"{found.mean():.2f} ± {found.std(ddof=1):.2f}"
    assert row_of(mm, "60", "nonrigid-2d")["femur"] == "–"
    assert row_of(pixels, "60", "nonrigid-2d")["femur"] != "–"
    assert after.name == "residuals_pixels_after_similarity"
    assert after.caption == "Motion that was not undone (pixels after similarity)"
    assert row_of(after, "60", "nonrigid-2d")["femur"] != "–"


def test_results_of_an_older_version_have_no_table_of_pixels_after_similarity():
    older = [
        replace(s, residuals=tuple(replace(r, pixels_after_similarity=None) for r in s.residuals))
        for s in CLEAN
    ]
    assert [t.name for t in tables.residuals(older)] == [
        f"residuals_{unit}" for unit in ("mm", "degrees", "pixels")
    ]


def test_sharpness_tells_entropy_and_seconds():
    table = tables.sharpness(CLEAN)
    assert table is not None
    entropy = np.array(
        [
            s.metrics.of("shank").gradient_entropy
            for s in CLEAN
            if s.method == "rigid" and s.posture == "squat_30"
        ]
    )
    assert (
        row_of(table, "30", "rigid")["gradient entropy shank"]
        == f"{entropy.mean():.3f} ± {entropy.std(ddof=1):.3f}"
    )
    seconds = np.array(
        [s.seconds for s in CLEAN if s.method == "rigid" and s.posture == "squat_30"]
    )
    assert (
        row_of(table, "30", "rigid")["seconds"]
        == f"{seconds.mean():.1f} ± {seconds.std(ddof=1):.1f}"
    )


def test_registration_tells_mean_largest_and_how_often():
    table = tables.registration(CLEAN)
    assert table is not None
    found = [s.metrics.registration for s in CLEAN if s.method == "uncorrected"]
    row = row_of(table, "all", "uncorrected")
    assert row["largest shift (mm)"] == f"{max(r.translation_mm for r in found):.2f}"
    assert row["largest rotation (deg)"] == f"{max(r.rotation_deg for r in found):.2f}"
    assert row["applied"] == f"{sum(r.applied for r in found)} of 14"


def test_the_registrations_own_error_is_reported():
    table = tables.registration(
        CLEAN, [RegistrationError(0.02, 0.01), RegistrationError(0.04, 0.03)]
    )
    assert table is not None
    assert "mean 0.03 mm and 0.02°, at most 0.04 mm and 0.03°, in 2 scans" in table.note
    silent = tables.registration(CLEAN)
    assert silent is not None
    assert "own error" not in silent.note


def test_without_registration_there_is_no_table():
    assert (
        tables.registration(
            [replace(s, metrics=replace(s.metrics, registration=None)) for s in CLEAN]
        )
        is None
    )


def test_a_matrix_of_tests_has_p_below_and_differences_above():
    found = statistics.paired_tests(CLEAN, statistics.of_region("ssim", "leg"))
    table = tables.tests("c", found, "n", "how")
    rows = {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}
    for test in found:
        assert test.p_holm is not None
        assert rows[test.second][test.first] == tables.p_text(test.p_holm)
        assert float(rows[test.first][test.second].replace("−", "-")) == pytest.approx(
            test.median_difference, abs=5e-5
        )
    assert all(rows[method][method] == "" for method in rows)


def test_too_few_scans_are_reported_in_their_cell():
    few = [s for s in CLEAN if s.subject in ("subject01", "subject02") or s.method != "rigid"]
    table = tables.tests(
        "c", statistics.paired_tests(few, statistics.of_region("ssim", "leg")), "n", "how"
    )
    rows = {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}
    assert rows["rigid"]["uncorrected"] == rows["uncorrected"]["rigid"] == "too few scans"
    assert rows["oracle"]["uncorrected"] != "too few scans"


def test_the_ladder_stands_beside_the_published_one():
    levels = [
        NoiseLevel("SI", None, 1.0),
        NoiseLevel("SI", 2.0, None),
        NoiseLevel("SI", 2.0, 0.0),
        NoiseLevel("SI", None, None),
    ]
    draws = [
        LadderScore("a", "b", level, k, mm, 0.0)
        for level in levels
        for k, mm in enumerate((0.5, 1.5))
    ]
    cells = statistics.ladder_cells(
        [*draws, LadderScore("a", "b", NoiseLevel("per-sample", 1.0, 1.0), 0, 883, 0.128)]
    )
    table = tables.ladder(cells, "SI")
    assert [row[0] for row in table.rows] == [
        "f_a = 2",
        "0",
        "no noise",
        "f_a = no noise",
        "1",
        "no noise",
    ]
    assert table.rows[1] == ("0", "1 ± 0.707", "1104", "9.1e-4", "0 ± 0", "1.36", "–")
    assert table.rows[5] == ("no noise", "1 ± 0.707", "0", "–", "0 ± 0", "0", "–")
    assert "Convention of the noise: SI" in table.note
    other = tables.ladder(cells, "per-sample")
    assert other.rows == (("f_a = 1",), ("1", "883", "883", "1", "0.128", "0.128", "1"))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0"),
        (8470.4, "8470"),
        (99.94, "99.9"),
        (0.9432, "0.943"),
        (0.01, "0.01"),
        (2e-5, "2.0e-5"),
        (1.4e-10, "1.4e-10"),
    ],
)
def test_sizes_keep_their_digits(value, text):
    assert tables.size(value) == text


def test_noisy_quality_has_the_clean_row_of_the_same_scans():
    scores = [s for s in example_study.results().scores if s.method == "rigid"]
    few = [s for s in scores if s.noise is None or s.subject in ("subject01", "subject02")]
    ssim, _ = tables.noisy_quality(few)
    clean = np.array(
        [
            s.metrics.of("leg").ssim
            for s in few
            if s.noise is None and s.subject in ("subject01", "subject02")
        ]
    )
    row = row_of(ssim, "rigid, noise read as per-sample", "no noise")
    assert row["leg"] == f"{clean.mean():.3f} ± {clean.std(ddof=1):.3f}"
    assert row["published leg"] == "0.991 ± 0.004"
    noisy = np.array(
        [s.metrics.of("leg").ssim for s in few if s.noise == NoiseLevel("per-sample", 4.0, 5.0)]
    )
    row = row_of(ssim, "rigid, noise read as per-sample", "f_a = 4, f_g = 5")
    assert row["leg"] == f"{noisy.mean():.3f} ± {noisy.std(ddof=1):.3f}"
    assert row["published leg"] == "0.926 ± 0.049"
    assert "Over 4 scans" in ssim.note


def test_noisy_scans_of_another_kind_stand_beside_nothing_printed():
    scores = [
        replace(s, posture="standing")
        for s in example_study.results().scores
        if s.method == "rigid" and s.posture == "squat_30"
    ]
    ssim, _ = tables.noisy_quality(scores)
    assert not any("paper" in column for column in ssim.columns)


def test_every_scan_is_linked_to_its_folder():
    ssim, rmse = tables.every_scan(CLEAN, "scans")
    assert len(ssim.rows) == 14
    for row, folder in zip(ssim.rows, ssim.links, strict=True):
        found = {s.method: s for s in CLEAN if s.folder == folder}
        assert row[-1] == folder
        assert row[0] == f"{found['rigid'].subject}, {found['rigid'].posture}"
        assert row[1:-1] == tuple(
            f"{found[method].metrics.of('leg').ssim:.4f}" for method in ssim.columns[1:-1]
        )
    assert (ssim.name, rmse.name) == ("scans_ssim", "scans_rmse")


def test_costs_are_listed_by_stage():
    table = tables.costs((StageCost("replay", 14, 2.5, 400.4), StageCost("fdk", 1, 8.04, None)))
    assert table.rows == (("replay", "14", "2.5", "400"), ("fdk", "1", "8.0", "–"))


def test_sensors_are_rows_below_their_calibration():
    draws = [
        SensorScore("a", "b", sensor, calibration, k, mm, mm / 10)
        for calibration in ("none", "rest")
        for sensor in ("bmi160", "mti300")
        for k, mm in enumerate((1.0, 3.0))
    ]
    table = tables.catalogued(draws)
    assert [row[0] for row in table.rows] == [
        *("not calibrated, exact start", "bmi160", "mti300"),
        *("rest before the scan", "bmi160", "mti300"),
    ]
    assert table.rows[1] == ("bmi160", "2 ± 1.41", "0.2 ± 0.141")
    assert tables.catalogued(draws[:1]).rows[1] == ("bmi160", "1", "0.1")


def test_levels_that_lack_scans_say_so():
    noisy = [s for s in example_study.results().scores if s.clean or s.noise is not None]
    whole, _ = tables.noisy_quality(noisy)
    assert not any(" of 14 scans" in row[0] for row in whole.rows)
    level = next(s.noise for s in noisy if s.noise is not None)
    fewer = [s for s in noisy if not (s.noise == level and s.subject == "subject01")]
    ssim, _ = tables.noisy_quality(fewer)
    assert [row[0] for row in ssim.rows if " of 14 scans" in row[0]] == [
        f"f_a = {level.f_a:g}, f_g = {level.f_g:g} (12 of 14 scans)"
    ]
