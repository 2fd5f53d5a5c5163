"""Means over scans, paired tests against known ones, Holm's laws, and what the ladder asks of
sensors.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from legsim.evaluation.scores import spread
from legsim.study import statistics
from legsim.study.results import LadderScore, NoiseLevel, ScanScore
from legsim.study.statistics import LadderCell, of_region, of_registration, of_structure
from tests.examples import study as example_study

SSIM = of_region("ssim", "leg")


def score(subject: str, posture: str, method: str, ssim: float) -> ScanScore:
    made = example_study.score(np.random.default_rng(0), subject, posture, method, 0.1)
    regions = tuple(replace(region, ssim=ssim) for region in made.metrics.regions)
    return replace(made, metrics=replace(made.metrics, regions=regions))


def test_repetitions_of_a_scan_count_once():
    scores = [score("a", "squat_30", "rigid", s) for s in (0.8, 1.0)] + [
        score("b", "squat_30", "rigid", 0.5)
    ]
    assert statistics.per_scan(scores, SSIM) == {
        ("a", "squat_30"): pytest.approx(0.9),
        ("b", "squat_30"): 0.5,
    }
    found = statistics.over_scans(scores, SSIM)
    assert found is not None
    assert (found.count, found.mean) == (2, pytest.approx(0.7))


def test_numbers_that_a_score_has_not_are_left_out():
    made = example_study.score(np.random.default_rng(0), "a", "squat_30", "nonrigid-2d", 0.1)
    reference = example_study.score(np.random.default_rng(0), "a", "squat_30", "static", 0.0)
    assert statistics.per_scan([made], of_structure("mm", "femur")) == {}
    assert statistics.per_scan([made], of_structure("pixels", "femur")) != {}
    assert statistics.per_scan([made], of_region("ssim", "foot")) == {}
    assert statistics.per_scan([reference], of_registration("rotation_deg")) == {}


def test_all_pools_the_two_squats_alone():
    scores = [score("a", posture, "rigid", 0.9) for posture in ("squat_30", "standing", "squat_60")]
    found = statistics.blocks(scores)
    assert list(found) == ["30", "standing", "60", "all"]
    assert [s.posture for s in found["all"]] == ["squat_30", "squat_60"]


def test_one_posture_is_not_all():
    assert list(statistics.blocks([score("a", "squat_30", "rigid", 0.9)])) == ["30"]


def paired(differences: list[float]) -> statistics.PairedTest:
    scores = [score(f"s{k}", "squat_30", "first", 0.5 + d) for k, d in enumerate(differences)]
    scores += [score(f"s{k}", "squat_30", "second", 0.5) for k in range(len(differences))]
    (test,) = statistics.paired_tests(scores, SSIM)
    return test


def test_all_of_one_sign_is_one_half_to_the_power_of_n_twice():
    """The exact distribution: of 2^n sign patterns, two are as extreme."""
    test = paired([0.01 * k for k in range(1, 8)])
    assert (test.scans, test.p) == (7, pytest.approx(2 / 2**7))
    assert test.median_difference == pytest.approx(0.04)


def test_wilcoxon_on_darwins_maize():
    """Height differences of 15 pairs of plants; the exact p of these ranks (24 against 96) is known
    to be 0.0413.
    """
    differences = [6, 8, 14, 16, 23, 24, 28, 29, 41, -48, 49, 56, 60, -67, 75]
    assert paired([d / 200 for d in differences]).p == pytest.approx(0.041259765625)


def test_pairs_that_are_equal_do_not_count():
    differences = [0.01 * k for k in range(1, 8)]
    assert paired([*differences, 0.0, 0.0]).p == pytest.approx(2 / 2**7)
    assert paired([0.0] * 8).p == 1.0


def test_too_few_scans_have_no_p():
    assert paired([0.1] * 5).p is None
    assert paired([0.1] * 5).p_holm is None
    assert paired([0.1 + 0.01 * k for k in range(6)]).p == pytest.approx(2 / 2**6)


def test_only_scans_that_both_have_are_paired():
    scores = [score(f"s{k}", "squat_30", "first", 0.5 + 0.01 * k) for k in range(8)]
    scores += [score(f"s{k}", "squat_30", "second", 0.4) for k in range(2, 10)]
    (test,) = statistics.paired_tests(scores, SSIM)
    assert test.scans == 6


def test_tests_follow_scipy_and_holm():
    scores = [
        s
        for s in example_study.results().scores
        if s.noise is None and s.method in ("rigid", "oracle", "nonrigid-3d")
    ]
    found = statistics.paired_tests(scores, SSIM)
    assert [(t.first, t.second) for t in found] == [
        ("rigid", "nonrigid-3d"),
        ("rigid", "oracle"),
        ("nonrigid-3d", "oracle"),
    ]
    for test in found:
        first, second = (
            [SSIM(s) for s in scores if s.method == m] for m in (test.first, test.second)
        )
        assert test.p == pytest.approx(stats.wilcoxon(first, second, method="exact").pvalue)
    assert [t.p_holm for t in found] == pytest.approx(
        statistics.holm([t.p for t in found if t.p is not None])
    )


def test_holm_by_hand():
    assert statistics.holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert statistics.holm([]) == []


@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_holm_never_lowers_never_reorders_and_is_at_most_bonferroni(p_values):
    adjusted = np.array(statistics.holm(p_values))
    assert (adjusted >= p_values).all()
    assert (adjusted <= np.minimum(1, len(p_values) * np.array(p_values)) + 1e-15).all()
    assert (np.diff(adjusted[np.argsort(p_values, kind="stable")]) >= 0).all()


def test_cells_are_means_over_draws():
    level = NoiseLevel("SI", 1.0, None)
    draws = [LadderScore("a", "squat_30", level, k, mm, 0.1) for k, mm in enumerate((1.0, 3.0))]
    cells = statistics.ladder_cells(
        [*draws, LadderScore("a", "squat_30", NoiseLevel("per-sample", 1.0, None), 0, 9.0, 0.1)]
    )
    assert (cells[level].translation_mm.mean, cells[level].translation_mm.count) == (2.0, 2)


def cells_of(errors: dict[float, tuple[float, float]]) -> dict[NoiseLevel, LadderCell]:
    cells = {}
    for f, (mm, degrees) in errors.items():
        shift, turn = spread([mm]), spread([degrees])
        assert shift is not None
        assert turn is not None
        cells[NoiseLevel("SI", f, f)] = LadderCell(shift, turn)
    return cells


def test_errors_that_fall_with_the_noise_need_their_own_size():
    """An error of 13.7 mm that is proportional to the noise needs noise 13.7 times smaller."""
    cells = cells_of({f: (13.7 / 10**f, 0.011 / 10**f) for f in range(4)})
    assert statistics.needed_factor(cells, "SI") == pytest.approx(13.7)
    assert statistics.needed_factor(cells, "per-sample") is None


def test_the_larger_of_the_two_errors_decides():
    assert statistics.needed_factor(
        cells_of({0: (0.1, 20.0), 1: (0.01, 2.0), 2: (0.001, 0.2)}), "SI"
    ) == pytest.approx(20)


def test_quiet_sensors_need_nothing_and_loud_ones_are_not_helped():
    assert statistics.needed_factor(cells_of({0: (0.5, 0.5), 1: (0.05, 0.05)}), "SI") == 1
    assert statistics.needed_factor(cells_of({0: (100, 1), 1: (10, 0.1)}), "SI") is None
