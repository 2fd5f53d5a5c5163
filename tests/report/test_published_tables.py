"""Ours, the published value and the difference, where it should stand."""

import pytest

from legsim.evaluation.scores import MeanAndDeviation, spread
from legsim.report import published_tables
from legsim.report.published_tables import Entry
from legsim.report.published_values import Score


def test_ours_the_published_value_and_the_difference_stand_together():
    entries = [
        Entry("30", "rigid", "leg", MeanAndDeviation(0.9876, 0.004, 7, 0.99), Score(0.993, 0.003)),
        Entry("30", "rigid", "shank", spread([0.9]), Score(0.993, 0.004)),
        Entry("60", "mine", "leg", spread([0.5]), None),
    ]
    table = published_tables.table("SSIM", "method", entries, note="n", name="ssim")
    assert table.columns == (
        "method",
        "leg",
        "published leg",
        "difference leg",
        "shank",
        "published shank",
        "difference shank",
    )
    assert table.rows == (
        ("30",),
        ("rigid", "0.988 ± 0.004", "0.993 ± 0.003", "−0.005", "0.900", "0.993 ± 0.004", "−0.093"),
        ("60",),
        ("mine", "0.500", "–", "–", "–", "–", "–"),
    )


def test_without_groups_no_row_heads_others():
    table = published_tables.table(
        "t", "method", [Entry("", "a", "leg", spread([1.0]), None)], note=""
    )
    assert table.columns == ("method", "leg"), "columns of nothing"
    assert table.rows == (("a", "1.000"),)


@pytest.mark.parametrize(
    ("ours", "published", "text"),
    [(0.5, 0.4, "+0.100"), (0.4, 0.5, "−0.100"), (0.5004, 0.5, "0.000"), (0.4996, 0.5, "0.000")],
)
def test_differences_are_signed_unless_they_round_to_nothing(ours, published, text):
    assert published_tables.difference(spread([ours]), Score(published, 0.1)) == text


def test_entries_of_quality_know_what_is_printed():
    ours = spread([0.9])
    assert published_tables.quality_entry("SSIM", "60", "rigid", "thigh", ours).published == Score(
        0.987, 0.006
    )
    assert published_tables.quality_entry("RMSE", "60", "rigid", "thigh", ours).published == Score(
        0.019, 0.006
    )
    assert (
        published_tables.quality_entry("SSIM", "standing", "rigid", "thigh", ours).published is None
    )


def test_the_note_names_the_source():
    published, own = (
        Entry("", "rigid", "leg", spread([0.9]), score) for score in (Score(0.993, 0.003), None)
    )
    tables = published_tables.quality_tables([published, own], [published], "Table 1", "Scaled so.")
    assert all(
        "equal. Scaled so. Published: Maier et al. 2021, Table 1; another phantom" in table.note
        for table in tables
    )
    assert all(
        "Published" not in table.note
        for table in published_tables.quality_tables([own], [own], "Table 1", "Scaled so.")
    )


def test_one_is_counted_without_an_s():
    assert [published_tables.counted(n, "scan") for n in (0, 1, 2)] == [
        "0 scans",
        "1 scan",
        "2 scans",
    ]
