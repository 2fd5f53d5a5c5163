"""The report on aided sensors: means of draws first, shares of scans, and what was left alone."""

import csv
import io
from dataclasses import replace

import numpy as np

from legsim.study import aided_sections, csv_files, report, results
from legsim.study.results import AidedScore, ScanScore, StudyResults
from tests.examples import study as example_study

PX = {"uncorrected": 1.0, "dead-reckoning": 5e4, "beads-2": 0.08}


def aided() -> tuple[AidedScore, ...]:
    """Two sensors, two scans, two draws; beads are at 0.08 and 0.12 px in the second scan, twice
    as good without errors.
    """
    return tuple(
        AidedScore(
            subject,
            "squat_30",
            sensor,
            aid,
            draw,
            px * (1.0 if sensor == "bmi160" else 0.5) * (1 + 0.5 * draw * (subject == "b")),
            2 * px,
            px,
            0.1 * px,
            aid != "uncorrected",
        )
        for sensor in ("bmi160", "none")
        for subject in ("a", "b")
        for draw in (0, 1)
        for aid, px in PX.items()
    )


def of_sensors() -> tuple[ScanScore, ...]:
    rng = np.random.default_rng(1)
    return tuple(
        replace(example_study.score(rng, subject, "squat_30", method, loss), sensor=sensor)
        for sensor in ("none", "bmi160")
        for subject in ("a", "b")
        for method, loss in (("uncorrected", 0.1), ("fused-beads", 0.01))
    )


RESULTS = StudyResults("s", "Sensors", of_sensors(), (), (), aided=aided())


def test_a_row_per_sensor_and_aid_says_how_many_scans_stay_sharp():
    (section,) = aided_sections.of_motion(aided())
    table = section.tables[0]
    rows = {(table.rows[k - k % 4][0], row[0]): row for k, row in enumerate(table.rows)}
    beads = rows["bmi160", "beads-2"]
    # scan a: 0.08 twice; scan b: 0.08 and 0.12, whose mean is not above 0.1 but for rounding
    assert beads[1].startswith("0.09 ± ")
    assert beads[2:5] == ("0.08", "0.12", "2 of 2")
    assert rows["bmi160", "uncorrected"][-1] == "0 of 4"
    assert rows["no errors", "beads-2"][4] == "2 of 2"
    assert [t.name for t in section.tables] == ["aided", "aided_bmi160", "aided_none"]
    assert section.tables[1].rows[1] == ("b, squat_30", "1.25", "62500", "0.1")


def test_the_summary_names_what_stays_sharp():
    lines = aided_sections.headlines(aided())
    assert lines == [
        "beads-2 with bmi160: 2 of 2 scans within 0.1 px after similarity.",
        "beads-2 with no errors: 2 of 2 scans within 0.1 px after similarity.",
    ]


def test_volumes_of_sensors_have_their_own_table_and_are_no_clean_scores():
    page = report.content(RESULTS)
    titles = [section.title for section in page.sections]
    assert "Image quality" not in titles
    (section,) = [s for s in page.sections if s.title == "Sensors and what aids them, in images"]
    (table,) = section.tables
    assert [row[0] for row in table.rows] == [
        *("no errors (2 scans)", "uncorrected", "fused-beads"),
        *("bmi160 (2 scans)", "uncorrected", "fused-beads"),
    ]


def test_results_come_back_and_every_draw_is_a_row(tmp_path):
    results.save(tmp_path / "results.json", RESULTS)
    assert results.load(tmp_path / "results.json") == RESULTS
    rows = list(csv.DictReader(io.StringIO(csv_files.aided_csv(RESULTS.aided))))
    assert len(rows) == len(RESULTS.aided)
    assert float(rows[0]["px_after_similarity"]) == RESULTS.aided[0].px_after_similarity
    scores = list(csv.DictReader(io.StringIO(csv_files.scores_csv(RESULTS.scores))))
    assert {row["sensor"] for row in scores} == {"none", "bmi160"}


def test_the_page_says_how_the_sensors_started():
    for start, told in (("rough", "from a rough start"), ("truth", "from its true start")):
        (section,) = aided_sections.of_motion([replace(s, start=start) for s in aided()])
        assert told in section.lines[0]


def test_an_error_that_is_no_number_is_a_dash():
    nothing = [replace(s, mm=float("nan")) if s.aid == "beads-2" else s for s in aided()]
    (section,) = aided_sections.of_motion(nothing)
    (row,) = [r for r in section.tables[0].rows[:4] if r[0] == "beads-2"]
    assert row[6].startswith("–")
