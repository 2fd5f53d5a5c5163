"""What a caller may get wrong ends in one line that says so, whichever method or function it is."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import legsim as ls
from legsim.core.errors import LegsimError
from legsim.correction.bead_scan import Beads, BeadScan
from legsim.correction.method import Scan
from legsim.correction.path_measurements import BeadShadows, FiducialShadows
from legsim.correction.rough_start import StartErrors
from legsim.evaluation.image_criteria import GradientEntropy
from legsim.evaluation.regions import Region
from legsim.imu.signals import ImuSignals
from tests.correction.test_fused import SWAY, VIEWS, scanned, shadows

PIXELS = np.zeros((len(VIEWS), 4, 2))
AXES = np.eye(4, 3)


@pytest.fixture(scope="module")
def without_sensors() -> Scan:
    scan = scanned(SWAY, 0)
    none = np.zeros((len(VIEWS), 0, 3))
    return replace(scan, signals=ImuSignals(VIEWS, (), none, none), starts=(), joints=())


@pytest.mark.parametrize(
    "method",
    [
        ls.Rigid(),
        ls.Standing(),
        ls.FusedBeads(shadows(SWAY, 0)),
        ls.FusedFiducials(FiducialShadows(PIXELS, AXES)),
        ls.FusedImages(),
    ],
    ids=lambda method: type(method).__name__,
)
def test_a_scan_without_sensors_is_refused(method: Callable, without_sensors: Scan):
    with pytest.raises(LegsimError, match="follows a sensor, and the scan has none"):
        method(without_sensors)


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: BeadShadows(PIXELS, -1.0), r"BeadShadows\.error_px is -1; it must be finite and"),
        (lambda: BeadShadows(PIXELS, 0.0), "must be finite and positive"),
        (lambda: BeadShadows(PIXELS[0]), r"BeadShadows\.pixels has shape"),
        (lambda: FiducialShadows(PIXELS, AXES[:3]), r"points_sensor has shape"),
        (lambda: BeadScan(scanned(SWAY, 0).projections, AXES, -1.0), r"BeadScan\.radius is -1"),
        (lambda: ls.SensorPriors(spread=0.0), r"SensorPriors\.spread is 0; .* positive"),
        (lambda: ls.SensorPriors(spread=-1.0), r"SensorPriors\.spread is -1"),
        (lambda: ls.SensorPriors(clock=-1.0), r"clock is -1; it must be finite and not negative"),
        (lambda: StartErrors(None), "StartErrors.tilt is None; expected a number"),  # type: ignore[arg-type]
        (lambda: Beads(0), r"Beads\.count is 0; it must be finite and positive"),
        (
            lambda: ls.FusedBeads(PIXELS)(scanned(SWAY, 0)),
            "are a BeadScan or BeadShadows.* not nda",
        ),  # type: ignore[arg-type]
        (lambda: ls.FusedFiducials(PIXELS)(scanned(SWAY, 0)), "are FiducialShadows.* not ndarray"),  # type: ignore[arg-type]
        (
            lambda: ls.MarkerBased(PIXELS)(scanned(SWAY, 0)),
            "are a BeadScan or BeadShadows.* not nda",
        ),  # type: ignore[arg-type]
        (lambda: ls.Autofocus(knots=3)(scanned(SWAY, 0)), "has 4 coefficients or more; knots is 3"),
        (lambda: ls.run_scan("config.toml", "out"), "what load_settings gives, not str"),  # type: ignore[arg-type]
        (lambda: ls.compare(scanned(SWAY, 0), {"rigid": ls.Rigid()}), "SimulatedScan, .* not Scan"),  # type: ignore[arg-type]
    ],
)
def test_wrong_values_are_refused_in_a_line(call: Callable[[], object], told: str):
    with pytest.raises(LegsimError, match=told) as error:
        call()
    assert "\n" not in str(error.value)


def test_lists_are_arrays():
    pixels = shadows(SWAY, 0).pixels
    np.testing.assert_array_equal(BeadShadows(pixels.tolist()).pixels, pixels)
    mask = np.ones((4, 5, 6), bool)
    assert Region("all", mask.tolist()).mask.sum() == GradientEntropy(mask.tolist()).mask.sum()
    one = ls.load_settings(preset="demo", overrides="scan.views=10")
    assert one == ls.load_settings(preset="demo", overrides=("scan.views=10",))
