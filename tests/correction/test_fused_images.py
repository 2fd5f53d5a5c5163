"""One consumer sensor and sharpness: they undo a sway, and leave alone who does not move."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.correction import path_problem
from legsim.correction.fused import SensorPriors
from legsim.correction.fused_images import FusedImages
from legsim.correction.image_criterion import COARSE
from legsim.correction.image_motion import FocusPlan, FocusRound
from legsim.correction.method import Scan
from legsim.correction.rough_start import StartErrors, rough
from legsim.deformation.models import RigidMotion
from legsim.imu.catalogue import load_sensor
from legsim.imu.readout import read_out
from legsim.imu.signals import ImuSignals, SensorStart
from tests.examples.knee_scan import STILL, VIEWS, left_px, motion_of, scanned
from tests.references.sway import Sway

pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")
QUICK = FocusPlan((FocusRound(COARSE, 25),))
SAMPLES = np.arange(-60, 1020) / 120
SWAY = Sway.standing(4, position_mm=2.5, angle_deg=0.6)
BMI160 = load_sensor("bmi160").errors


def scan_of(sway: Sway, seed: int) -> Scan:
    """The leg with a sensor of all errors of its data sheet and a rough start."""
    rng = np.random.default_rng(seed)
    rate, force = sway.signals(SAMPLES)
    exact = ImuSignals(SAMPLES, ("shank_l",), rate[:, None], force[:, None])
    start = SensorStart(sway.poses(VIEWS[:1])[0], sway.velocities(VIEWS[:1])[0])
    read = read_out(exact, BMI160.without("low-pass"), rng)
    images = scanned(motion_of(sway), noise=0.05, seed=seed)
    return Scan(images, read, rough([start], StartErrors(), rng))


def test_a_consumer_sensor_and_sharpness_undo_a_sway() -> None:
    true = motion_of(SWAY)
    found = FusedImages("shank_l", SensorPriors(BMI160), plan=QUICK)(scan_of(SWAY, 1))
    assert isinstance(found.motion, RigidMotion)
    assert left_px(found.motion, true) < 0.6 * left_px(RigidMotion.identity(VIEWS), true)
    assert found.method == "fused"
    (note,) = found.notes
    assert "entropy of the gradient" in note


def test_who_does_not_move_is_left_alone() -> None:
    found = FusedImages("", SensorPriors(BMI160), plan=QUICK)(scan_of(STILL, 2))
    assert isinstance(found.motion, RigidMotion)
    np.testing.assert_array_equal(
        found.motion.moved_from_reference, RigidMotion.identity(VIEWS).moved_from_reference
    )
    assert "the data do not determine it, and the scan is left as it is" in found.notes[0]


def test_without_a_sensor_it_says_what_to_take() -> None:
    nothing = ImuSignals(VIEWS, (), np.zeros((len(VIEWS), 0, 3)), np.zeros((len(VIEWS), 0, 3)))
    with pytest.raises(LegsimError, match="take uncorrected or autofocus"):
        FusedImages()(Scan(scanned(motion_of(STILL)), nothing, ()))


def test_a_sensor_that_fits_no_path_leaves_the_scan_as_it_is(monkeypatch: pytest.MonkeyPatch):
    def far(*_: object) -> None:
        raise np.linalg.LinAlgError("not positive definite")

    monkeypatch.setattr(path_problem, "cho_factor", far)
    found = FusedImages("", SensorPriors(BMI160), plan=QUICK)(scan_of(STILL, 2))
    assert isinstance(found.motion, RigidMotion)
    assert found.notes[0].startswith("In doubt: fused: no path of the sensor fits")
