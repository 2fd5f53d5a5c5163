"""The report of a study: all there, each number the same in every form, and nothing that the study
has not.
"""

import csv
import html.parser
import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from legsim.report.page import Picture
from legsim.study import report
from legsim.study.results import StudyResults
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
        assert row["convention"] == ("" if score.noise is None else score.noise.convention)
        assert row["f_a"] == ("" if score.noise is None else str(score.noise.f_a))
        assert row["command"] == f"legsim run {score.folder}/config.toml --out OTHER"
        assert row["registration_translation_mm"] == (
            "" if (found := score.metrics.registration) is None else str(found.translation_mm)
        )
        for left in score.residuals:
            assert row[f"{left.structure}_mm"] == ("" if left.mm is None else str(left.mm))
            assert float(row[f"{left.structure}_pixels"]) == left.pixels


def test_every_draw_is_a_row_of_ladder_csv(made):
    rows = rows_of((made / "ladder.csv").read_text())
    for row, score in zip(rows, RESULTS.ladder, strict=True):
        assert (float(row["translation_mm"]), float(row["rotation_deg"])) == (
            score.translation_mm,
            score.rotation_deg,
        )
        assert row["f_g"] == ("" if score.noise.f_g is None else str(score.noise.f_g))


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


def test_the_reference_is_in_no_table_but_that_of_sharpness(made):
    rows = [
        row
        for row in Cells((made / "report.html").read_text()).rows
        if row[0] == "static" or "static" in row
    ]
    assert len(rows) == 3  # of three blocks


def test_every_noise_number_stands_under_its_convention(written_study):
    for section in written_study.content.sections:
        for table in section.tables:
            if table.name.startswith(("ladder", "noisy")):
                words = [table.caption, *(row[0] for row in table.rows)]
                assert any("SI" in word or "per-sample" in word for word in words), table.name


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


def test_too_few_scans_are_told():
    few = tuple(s for s in RESULTS.scores if s.subject == "subject01" and s.noise is None)
    content = report.content(StudyResults("s", "Two", few, (), ()))
    (section,) = [s for s in content.sections if s.title == "Are the differences more than chance?"]
    assert section.lines == (
        "Too few scans for a paired test: 2, where 6 are the fewest that can tell.",
    )


def test_every_posture_of_ones_own_is_tested_and_told():
    rng, scans = np.random.default_rng(3), [("standing", 7), ("stairs/up", 6), ("lunge", 2)]
    scores = [
        example_study.score(rng, f"p{k}", posture, method, loss)
        for posture, count in scans
        for k in range(count)
        for method, loss in (("uncorrected", 0.3), ("rigid", 0.03))
    ]
    page = report.content(replace(example_study.results(), scores=tuple(scores), ladder=()))
    assert [
        line.split(",")[2].split(":")[0].strip() for line in page.summary if "SSIM" in line
    ] == ["standing", "stairs/up", "lunge"]
    (section,) = [s for s in page.sections if s.title.startswith("Are the differences")]
    assert [t.name for t in section.tables] == [
        f"test_{m}_{p}" for p in ("standing", "stairs_up") for m in ("ssim", "rmse")
    ]
    assert "over standing and over stairs/up" in section.lines[0]
    assert (
        section.lines[1]
        == "Too few scans for a paired test: 2 of lunge, where 6 are the fewest that can tell."
    )


def test_nothing_at_all_is_an_empty_page_with_its_failures(tmp_path):
    content = report.write(tmp_path, StudyResults("s", "Nothing", (), (), (), ("all failed",)))
    assert content.sections == ()
    assert "all failed" in (tmp_path / "report.html").read_text()


def test_given_pictures_are_shown_where_they_belong():
    picture = Picture("Noise", example_study.picture(), "", "pictures/noise.png")
    content = report.content(StudyResults("s", "t", (), (), ()), (), (picture,))
    (section,) = [s for s in content.sections if s.title == "Images from noisy sensors"]
    assert section.figures == (picture,)


def test_what_sensors_need_is_told_for_each_convention(ladder_alone):
    lines = [line for line in ladder_alone.summary if "White noise" in line]
    assert ["SI convention" in lines[0], "per-sample convention" in lines[1]] == [True, True]
    assert "divided by about 8.1;" in lines[0]
    assert "no level of the ladder keeps errors within 1 mm and 1°" in lines[1]
