import re

import pytest

from legsim.evaluation import scores
from legsim.evaluation.similarity import RegionScores, Scores
from legsim.report import scan_page


def result(method: str, ssim: float) -> scores.MethodResult:
    return scores.MethodResult(
        method, Scores((RegionScores("leg", ssim, 0.1, 9.5, 10),), None), 0.5, 1.0
    )


def test_quality_has_every_method_beside_the_published_value_of_its_condition():
    ssim, rmse, entropy = scan_page.quality([result("rigid", 0.9), result("oracle", 0.95)], "30")
    assert ssim.rows == (
        ("rigid", "0.900", "0.993 ± 0.003", "−0.093"),
        ("oracle", "0.950", "–", "–"),
    )
    assert rmse.rows[0] == ("rigid", "0.100", "0.015 ± 0.005", "+0.085")
    assert "Table 1, 30 degree squats" in ssim.note
    assert entropy.rows == (("rigid", "9.500"), ("oracle", "9.500"))


@pytest.mark.parametrize(
    "heading",
    [
        "Image quality",
        "Motion",
        "SSIM",
        "published",
        "uncorrected",
        "rigid",
        "oracle",
        "not undone",
        "gradient entropy",
    ],
)
def test_the_report_of_a_run_tells(tiny_run, heading):
    assert heading in (tiny_run.folder / "report.html").read_text()


def test_the_report_needs_nothing_from_outside(tiny_run):
    page = (tiny_run.folder / "report.html").read_text()
    assert not re.search(r'(src|href)="(?!data:|#)[a-z]+:', page)
    assert page.count("data:image/png;base64,") >= 5


def test_the_pictures_lie_beside_the_report(tiny_run):
    names = {p.stem for p in (tiny_run.folder / "pictures").glob("*.png")}
    assert names >= {
        "slices",
        "overlay",
        "projections",
        "motion-errors",
        "imu",
        "joint-angles",
        "sway",
        "markers",
    }
