"""The report of a study: all there, each number the same in every form, and nothing that the study
has not.
"""

import html.parser
from dataclasses import replace

import pytest
from PIL import Image

from legsim.study import report
from legsim.study.results import SensorScore, StudyResults
from tests.examples import study as example_study

RESULTS = example_study.results()


class Cells(html.parser.HTMLParser):
    """Texts of all cells of all rows of a page."""

    def __init__(self, text):
        super().__init__()
        self.rows, self.open = [], False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
            self.open = True

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self.open = False

    def handle_data(self, data):
        if self.open:
            self.rows[-1][-1] += data


@pytest.fixture
def made(written_study):
    return written_study.folder


@pytest.fixture(scope="module")
def ladder_alone():
    """Three exponents a sensor, which per-sample noise is too loud for."""
    few = tuple(s for s in RESULTS.ladder if {s.noise.f_a, s.noise.f_g} <= {0.0, 1.0, None})
    return report.content(replace(RESULTS, scores=(), costs=(), ladder=few))


def test_the_page_has_every_section(made):
    text = (made / "report.html").read_text()
    for title in (
        "Image quality",
        "What was left of the motion",
        "Are the differences more than chance?",
        "Pictures of one scan",
        "Sensor noise without images",
        "The noise ladder in numbers",
        "Images from noisy sensors",
        "Every scan and its folder",
        "What it took",
    ):
        assert f"<h2>{title}</h2>" in text
    assert "Seven subjects &amp; eight methods" in text
    assert "subject09 squat_30: no file" in text
    assert "legsim study paper.toml --out study" in text


def test_markdown_has_the_cells_of_the_page_in_order(made):
    rows = [row for row in Cells((made / "report.html").read_text()).rows if len(row) > 1]
    lines = [
        line
        for line in (made / "report.md").read_text().splitlines()
        if line.startswith("|") and "---" not in line
    ]
    lines = [line for line in lines if not line.startswith("| **")]
    assert len(lines) == len(rows) > 200
    for line, row in zip(lines, rows, strict=True):
        plain = line.replace("\\", "")
        numbers = [cell.strip() for cell in plain.split("|")[2:-1]]
        assert numbers == row[1:]
        assert row[0] in plain


def test_every_file_that_is_named_is_there(made, written_study):
    content = written_study.content
    for note in content.files:
        assert (made / note.name).exists() or note.name == "results.json"
    tables = {table.name for section in content.sections for table in section.tables}
    assert tables
    assert all((made / "tables" / f"{name}.csv").is_file() for name in tables)
    drawn = {
        figure
        for section in content.sections
        for figure in section.figures
        if figure.file != "pictures/slices.png"
    }
    assert len(drawn) == 5
    for figure in drawn:
        with Image.open(made / figure.file) as picture:
            assert picture.size == figure.size


def test_the_reference_is_in_no_table_but_those_of_the_phantom_and_of_sharpness(made):
    rows = [
        row
        for row in Cells((made / "report.html").read_text()).rows
        if row[0] == "static" or "static" in row
    ]
    assert len(rows) == 2 * 3  # of three blocks


def test_a_ladder_alone_has_no_image_quality(ladder_alone):
    assert [section.title for section in ladder_alone.sections] == [
        "Sensor noise without images",
        "The noise ladder in numbers",
    ]
    assert not any("SSIM" in line for line in ladder_alone.summary)
    assert "scores.csv" not in [note.name for note in ladder_alone.files]


def test_scans_alone_have_no_noise():
    clean = tuple(s for s in RESULTS.scores if s.noise is None)
    titles = [
        section.title
        for section in report.content(replace(RESULTS, scores=clean, ladder=())).sections
    ]
    assert not any("noise" in title.lower() or "noisy" in title.lower() for title in titles)


def test_one_scan_of_one_method_is_a_report(tmp_path):
    """No deviations, no tests, no "all": and still all forms."""
    one = tuple(
        s
        for s in RESULTS.scores
        if (s.subject, s.posture, s.method) == ("subject01", "squat_30", "rigid")
        and s.noise is None
    )
    content = report.write(tmp_path, StudyResults("s", "One", one, (), ()))
    assert [section.title for section in content.sections] == [
        "Image quality",
        "What was left of the motion",
        "Every scan and its folder",
    ]
    assert "nan" not in (tmp_path / "report.md").read_text()
    assert content.summary[0] == "1 scan of 1 subject, 1 method."


def test_nothing_at_all_is_an_empty_page_with_its_failures(tmp_path):
    content = report.write(tmp_path, StudyResults("s", "Nothing", (), (), (), ("all failed",)))
    assert content.sections == ()
    assert "all failed" in (tmp_path / "report.html").read_text()


def test_what_sensors_need_is_reported_for_each_convention(ladder_alone):
    lines = [line for line in ladder_alone.summary if "White noise" in line]
    assert ["SI convention" in lines[0], "per-sample convention" in lines[1]] == [True, True]
    assert "divided by about 8.1;" in lines[0]
    assert "no level of the ladder keeps errors within 1 mm and 1°" in lines[1]


def test_sensors_of_the_catalogue_have_a_section_and_a_file(tmp_path):
    scores = (SensorScore("subject01", "squat_30", "bmi160", "rest", 0, 12.5, 0.5),)
    made = report.write(tmp_path, StudyResults("s", "t", (), (), (), sensors=scores))
    assert [section.title for section in made.sections] == [
        "Sensors that one can buy, without images"
    ]
    header, row = (tmp_path / "sensors.csv").read_text().splitlines()
    assert header.startswith("subject,posture,sensor,calibration,repetition,translation_mm")
    assert row == "subject01,squat_30,bmi160,rest,0,12.5,0.5"
    assert "12.5" in (tmp_path / "report.md").read_text()


def test_runs_of_real_sensors_change_no_table_of_clean_or_noisy_ones():
    results = example_study.results()
    worse = [
        replace(score, sensor="bmi160", metrics=bad.metrics, seconds=1e3)
        for score, bad in zip(results.scores, reversed(results.scores), strict=True)
        if score.clean
    ]
    with_sensors = replace(results, scores=(*results.scores, *worse))

    def tables_of(content):
        found = {t.name: t for s in content.sections for t in s.tables}
        return {name: t for name, t in found.items() if not name.startswith("noisy_scans")}

    before, after = (report.content(one) for one in (results, with_sensors))
    own = tables_of(after)
    assert own.pop("aided_volumes")
    assert own == tables_of(before)
    assert after.summary == before.summary
