import re
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from legsim.core import transforms
from legsim.evaluation import scores
from legsim.evaluation.similarity import RegionScores, Scores
from legsim.kinematics.moving_leg import MovingLeg
from legsim.kinematics.skeleton import SegmentPoses
from legsim.report import scan_page


def result(method: str, ssim: float, *phantom: float) -> scores.MethodResult:
    return scores.MethodResult(
        method, Scores((RegionScores("leg", ssim, 0.1, 9.5, 10, *phantom),), None), 0.5, 1.0
    )


def test_quality_has_every_method_beside_the_published_value_of_its_condition():
    ssim, rmse, phantom, entropy = scan_page.quality(
        [result("rigid", 0.9, 0.7, 0.06), result("oracle", 0.95, 0.8, 0.05)], "30"
    )
    assert ssim.rows == (
        ("rigid", "0.900", "0.993 ± 0.003", "−0.093"),
        ("oracle", "0.950", "–", "–"),
    )
    assert rmse.rows[0] == ("rigid", "0.100", "0.015 ± 0.005", "+0.085")
    assert "Table 1, 30 degree squats" in ssim.note
    assert phantom.columns == ("method", "SSIM leg", "RMSE leg")
    assert phantom.rows == (("rigid", "0.700", "0.060"), ("oracle", "0.800", "0.050"))
    assert all("the range (minimum to maximum" in t.note for t in (ssim, rmse, phantom))
    assert entropy.rows == (("rigid", "9.500"), ("oracle", "9.500"))


def test_without_a_phantom_there_is_no_table_of_it():
    assert len(scan_page.quality([result("rigid", 0.9)], "30")) == 3


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


@pytest.mark.parametrize(
    ("bend", "condition"),
    [(30.0, "30"), (60.0, "60"), (5.0, "no held squat"), (100.0, "no held squat")],
)
def test_a_scan_is_set_beside_the_squat_that_it_shows(bend: float, condition: str):
    """By the bend within the views, whatever comes before and after them."""
    times = np.linspace(0, 10, 101)
    during = (times >= 4) & (times <= 6)
    turn = np.radians(np.where(during, bend, 45.0))
    eye = np.broadcast_to(np.eye(4), (len(times), 4, 4))
    shank = transforms.rigid(
        transforms.rotation_from_vector(np.outer(-turn, [0.0, 0.0, 1.0])), np.zeros(3)
    )
    poses = SegmentPoses(times, ("femur_l", "tibia_l"), np.stack([eye, shank], 1))

    class Person:
        trajectories = None
        leg = SimpleNamespace(segment_poses=lambda _: poses)

    person = cast(MovingLeg, Person())
    assert scan_page.condition_of(person, "left", np.linspace(4, 6, 20)) == condition
