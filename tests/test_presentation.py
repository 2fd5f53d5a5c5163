import re

import pytest

from legsim import presentation
from legsim.evaluation import Metrics, RegionMetrics


def result(method: str, ssim: float) -> presentation.MethodResult:
    return presentation.MethodResult(method, Metrics((RegionMetrics("leg", ssim, 0.1, 9.5, 10),), None), 0.5, 1.0)


def test_scores_hold_every_region_of_every_method():
    scores = presentation.scores([result("rigid", 0.9), result("oracle", 0.95)])
    assert [(s.method, s.region, s.ssim, s.entropy) for s in scores] == [("rigid", "leg", 0.9, 9.5), ("oracle", "leg", 0.95, 9.5)]


@pytest.mark.parametrize(
    "heading", ["Image quality", "Motion", "SSIM", "printed", "uncorrected", "rigid", "oracle", "not undone", "gradient entropy"]
)
def test_the_report_of_a_run_tells(tiny_run, heading):
    assert heading in (tiny_run.folder / "report.html").read_text()


def test_the_report_needs_nothing_from_outside(tiny_run):
    page = (tiny_run.folder / "report.html").read_text()
    assert not re.search(r'(src|href)="(?!data:|#)[a-z]+:', page)
    assert page.count("data:image/png;base64,") >= 5


def test_the_pictures_lie_beside_the_report(tiny_run):
    names = {p.stem for p in (tiny_run.folder / "pictures").glob("*.png")}
    assert names >= {"slices", "overlay", "projections", "motion-errors", "imu", "joint-angles", "sway", "markers"}
