"""A scan of what was reconstructed looks like the scan, and moves along the motion that it got."""

import numpy as np
import pytest

from legsim.correction.reprojection import reprojected
from legsim.deformation.models import RigidMotion
from legsim.opencl.device import Device
from tests.examples.knee_scan import GEOMETRY, VIEWS, motion_of, scanned
from tests.references.sway import Sway

pytestmark = pytest.mark.filterwarnings("ignore::legsim.reconstruction.weights.ShortScanWarning")
TRUE = motion_of(Sway.standing(4, position_mm=4.0, angle_deg=1.0))


def test_images_of_the_volume_along_the_true_motion_are_the_images(device: Device) -> None:
    images = scanned(TRUE)
    again = reprojected(images, TRUE.moved_from_reference, device)
    still = reprojected(images, RigidMotion.identity(VIEWS).moved_from_reference, device)
    middle = slice(30, 60)  # the cone's ends lose some
    off, blurred = (
        np.sqrt(np.mean((p.line_integrals - images.line_integrals)[:, middle] ** 2))
        for p in (again, still)
    )
    assert off < 0.04 * images.line_integrals.max()
    assert off < 0.8 * blurred
    assert again.geometry is images.geometry


def test_a_motion_shows_in_the_images(device: Device) -> None:
    """The centroid of each view moves as that of the moving leg does, to a tenth of a pixel."""
    images = scanned(TRUE)
    again = reprojected(images, TRUE.moved_from_reference, device)
    columns, rows = np.arange(GEOMETRY.shape_vu[1]), slice(30, 60)

    def centroid(values: np.ndarray) -> np.ndarray:
        return (values[:, rows] * columns).sum((1, 2)) / values[:, rows].sum((1, 2))

    off = centroid(again.line_integrals) - centroid(images.line_integrals)
    assert np.abs(off - off.mean()).max() < 0.1
