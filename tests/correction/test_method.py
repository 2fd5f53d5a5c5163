import re
from pathlib import Path

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.correction import method as correction_method
from legsim.correction.method import Correction, CorrectionMethod, Scan
from legsim.correction.rigid import Uncorrected, rigid_motion
from legsim.deformation.models import ControlPointMotion, RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.imu.signals import ImuSignals, SensorStart
from tests.references.sway import Sway

VIEWS = np.arange(40) / 31


def circular_scan() -> ConeBeamGeometry:
    angles = np.radians(5.0 * np.arange(len(VIEWS)))
    return ConeBeamGeometry.circular(
        times=VIEWS,
        angles=angles,
        source_isocenter=0.78,
        source_detector=1.198,
        shape_vu=(48, 62),
        pixel_pitch=6.16e-3,
        isocenter=(0.1, 0.5, -0.1),
    )


def scan() -> Scan:
    images = np.random.default_rng(0).random((len(VIEWS), 48, 62), np.float32)
    signals = ImuSignals(
        VIEWS, ("shank",), np.zeros((len(VIEWS), 1, 3)), np.zeros((len(VIEWS), 1, 3))
    )
    return Scan(
        Projections(circular_scan(), images), signals, (SensorStart(np.eye(4), np.zeros(3)),)
    )


def test_users_own_methods_fit_the_seam():
    def drop_half(scan: Scan, /) -> Correction:
        dimmed = Projections(scan.projections.geometry, scan.projections.line_integrals / 2)
        return Correction("mine", dimmed, None)

    method: CorrectionMethod = drop_half
    assert method(scan()).method == "mine"


def test_the_method_in_the_documents_is_whole():
    page = (Path(__file__).parents[2] / "docs/methods.md").read_text()
    (text,) = re.findall(r"```python\n(.*?)```", page.partition("## Your own")[2], re.S)
    written: dict[str, CorrectionMethod] = {}
    exec(text, written)
    found = correction_method.checked("mine", written["follow_last"])(scan())
    assert isinstance(found.motion, RigidMotion)
    assert found.method == "follow_last"


def test_a_users_method_that_works_is_left_alone():
    given = scan()
    assert correction_method.checked("mine", Uncorrected())(given).projections is given.projections


def _raises(scan: Scan, /) -> Correction:
    raise ValueError("first line\nsecond line")


def _says_nothing(scan: Scan, /) -> None:
    pass


def _crops(scan: Scan, /) -> Correction:
    whole = scan.projections
    return Correction("mine", Projections(whole.geometry[:10], whole.line_integrals[:10]), None)


def _counts(scan: Scan, /) -> Correction:
    return Correction("mine", scan.projections, np.zeros((len(scan.times), 4, 4)))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("method", "message"),
    [
        (
            _raises,
            r"method mine failed in .*test_method\.py, line \d+: ValueError: first line "
            r"second line; fix it",
        ),
        (
            _says_nothing,
            "method mine returned NoneType; return a legsim.correction.method.Correction",
        ),
        (
            _crops,
            r"method mine returned \(10, 48, 62\) \(views, rows, columns\) for a scan of \(40, "
            r"48, 62\)",
        ),
        (
            _counts,
            "method mine: a Correction's motion is None, a RigidMotion, .* not ndarray",
        ),
        (lambda: None, "method mine failed in .*: TypeError: .*takes 0 positional arguments"),
    ],
)
def test_troubles_of_a_users_method_are_reported_in_one_line(
    method: CorrectionMethod, message: str
):
    with pytest.raises(LegsimError, match=message) as caught:
        correction_method.checked("mine", method)(scan())
    assert "\n" not in str(caught.value)


def test_refuses_images_that_are_not_numbers_or_no_images():
    geometry, images = scan().projections.geometry, scan().projections.line_integrals.copy()
    images[3, 4, 5] = np.nan
    with pytest.raises(LegsimError, match="hold values that are not numbers"):
        Correction("mine", Projections(geometry, images), None)
    with pytest.raises(
        LegsimError, match=r"are a legsim\.geometry\.cone_beam\.Projections, not ndarray"
    ):
        Correction("mine", images, None)  # type: ignore[arg-type]


def test_refuses_unknown_order_and_sensor():
    with pytest.raises(LegsimError, match="known: pose, paper"):
        rigid_motion(VIEWS, Sway.standing(0).poses(VIEWS), order="left")  # type: ignore[arg-type]
    with pytest.raises(LegsimError, match="unknown sensor 'thigh'; known: shank"):
        scan().start("thigh")
    given = scan()
    with pytest.raises(LegsimError, match="0 starts for 1 sensors"):
        Scan(given.projections, given.signals, ())


def test_refuses_control_points_that_are_not_numbers():
    with pytest.raises(LegsimError, match="all coordinates finite"):
        ControlPointMotion(VIEWS, np.zeros((3, 3)), np.full((len(VIEWS), 3, 3), np.nan))


def test_refuses_motion_at_other_times():
    late = RigidMotion.identity(VIEWS + 0.01)
    with pytest.raises(LegsimError, match="at the projections' own times"):
        Correction("late", scan().projections, late)
