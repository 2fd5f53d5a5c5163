"""The sections of a study's report hold what their titles say."""

from dataclasses import replace

import numpy as np

from legsim.report.page import Picture
from legsim.study import report
from legsim.study.results import StudyResults
from tests.examples import study as example_study

RESULTS = example_study.results()


def test_every_noise_number_stands_under_its_convention(written_study):
    for section in written_study.content.sections:
        for table in section.tables:
            if table.name.startswith(("ladder", "noisy")):
                words = [table.caption, *(row[0] for row in table.rows)]
                assert any("SI" in word or "per-sample" in word for word in words), table.name


def test_too_few_scans_are_reported():
    few = tuple(s for s in RESULTS.scores if s.subject == "subject01" and s.noise is None)
    content = report.content(StudyResults("s", "Two", few, (), ()))
    (section,) = [s for s in content.sections if s.title == "Are the differences more than chance?"]
    assert section.lines == (
        "Too few scans for a paired test: 2, where 6 are the fewest for a result.",
    )


def test_every_posture_of_ones_own_is_tested_and_reported():
    rng, scans = np.random.default_rng(3), [("standing", 7), ("stairs/up", 6), ("lunge", 2)]
    scores = [
        example_study.score(rng, f"p{k}", posture, method, loss)
        for posture, count in scans
        for k in range(count)
        for method, loss in (("uncorrected", 0.3), ("rigid", 0.03))
    ]
    page = report.content(replace(example_study.results(), scores=tuple(scores), ladder=()))
    assert [
        line.split(",")[2].split(":")[0].strip() for line in page.summary if "Mean SSIM" in line
    ] == ["standing", "stairs/up", "lunge"]
    (section,) = [s for s in page.sections if s.title.startswith("Are the differences")]
    assert [t.name for t in section.tables] == [
        f"test_{m}_{p}" for p in ("standing", "stairs_up") for m in ("ssim", "rmse")
    ]
    assert "over standing and over stairs/up" in section.lines[0]
    assert (
        section.lines[1]
        == "Too few scans for a paired test: 2 of lunge, where 6 are the fewest for a result."
    )


def test_given_pictures_are_shown_where_they_belong():
    picture = Picture("Noise", example_study.picture(), "", "pictures/noise.png")
    content = report.content(StudyResults("s", "t", (), (), ()), (), (picture,))
    (section,) = [s for s in content.sections if s.title == "Images from noisy sensors"]
    assert section.figures == (picture,)
