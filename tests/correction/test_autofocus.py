"""Sharpness alone: it undoes a sway, and leaves alone who does not move."""

import numpy as np
import pytest

from legsim.correction.autofocus import Autofocus
from legsim.correction.image_criterion import COARSE
from legsim.correction.image_motion import FocusPlan, FocusRound
from legsim.correction.method import Scan
from legsim.deformation.models import RigidMotion
from legsim.imu.signals import ImuSignals
from tests.examples.knee_scan import STILL, VIEWS, left_px, motion_of, scanned
from tests.references.sway import Sway

pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")
QUICK = FocusPlan((FocusRound(COARSE, 25),))
NOTHING = ImuSignals(VIEWS, (), np.zeros((len(VIEWS), 0, 3)), np.zeros((len(VIEWS), 0, 3)))


def slow_sway() -> RigidMotion:
    """Of 0.06 and 0.1 Hz, which nine splines follow; a few millimeters."""
    waves = Sway.standing(4, position_mm=3.0, angle_deg=1.0)
    poses = waves.poses(0.35 * VIEWS)
    return RigidMotion.from_poses(VIEWS, poses)


def test_a_slow_sway_is_found_without_a_sensor() -> None:
    true = slow_sway()
    found = Autofocus(plan=QUICK)(Scan(scanned(true), NOTHING, ()))
    assert isinstance(found.motion, RigidMotion)
    before = left_px(RigidMotion.identity(VIEWS), true)
    assert left_px(found.motion, true) < 0.5 * before
    (note,) = found.notes
    assert "entropy of the gradient" in note
    assert "left as it is" not in note


def test_who_does_not_move_is_left_alone() -> None:
    """With noise of 2 % in the images."""
    images = scanned(motion_of(STILL), noise=0.05, seed=3)
    found = Autofocus(plan=QUICK)(Scan(images, NOTHING, ()))
    assert isinstance(found.motion, RigidMotion)
    np.testing.assert_array_equal(
        found.motion.moved_from_reference, RigidMotion.identity(VIEWS).moved_from_reference
    )
    assert "the data do not determine it, and the scan is left as it is" in found.notes[0]
