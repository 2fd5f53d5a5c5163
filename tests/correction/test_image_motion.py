"""From a scan and a model of its path to a correction: calibrated, and in the scan's own pixels."""

import numpy as np
import pytest

from legsim.correction import image_motion
from legsim.correction.image_criterion import COARSE, FINE
from legsim.correction.image_fit import SplinePath
from legsim.correction.image_motion import FocusPlan, FocusRound
from legsim.correction.method import Scan
from legsim.correction.path_measurements import StandingPrior
from legsim.opencl.device import Device
from tests.correction.test_autofocus import NOTHING, slow_sway
from tests.examples.knee_scan import KNEE, VIEWS, left_px, scanned

pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")


def test_calibration_goes_on_from_coarse_to_fine(device: Device) -> None:
    """From the true motion, which splines hold nearly: it stays near, and the note has both values."""
    true, model = slow_sway(), SplinePath(VIEWS, KNEE, 12)
    scan = Scan(scanned(true), NOTHING, ())
    plan = FocusPlan((FocusRound(COARSE, 20), FocusRound(FINE, 6, calibrated=True)))
    found = image_motion.followed(
        "any", scan, model, np.zeros(model.size), StandingPrior.at(KNEE, 4e-3), device, plan=plan
    )
    assert found.motion is not None
    assert left_px(found.motion, true) < 0.5 * left_px(slow_sway().identity(VIEWS), true)
    assert found.projections is scan.projections
    (note,) = found.notes
    before, after = (float(note.split(word)[0].split()[-1]) for word in (" without", " with the"))
    assert after < before
