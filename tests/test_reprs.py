"""Values that people meet while they work print as one short line with units."""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.deformation.models import ControlPointMotion, FieldMotion, RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import open_device
from legsim.reconstruction.fdk import FdkOptions

TIMES = np.arange(248) / 31
GRID = VolumeGrid((120, 110, 100), (0.00125, 0.00125, 0.0015), (0.01234567, -0.1234567, 1.234567))
SCAN = ConeBeamGeometry.circular(
    times=TIMES,
    angles=np.radians(-8.8 + 0.8 * np.arange(248)),
    source_isocenter=0.780,
    source_detector=1.198,
    shape_vu=(48, 62),
    pixel_pitch=6.16e-3,
    isocenter=(0.1, 0.5, -0.2),
)
POINTS = np.array([[0.0, 0.8, 0.0], [0.05, 0.5, 0.0], [0.0, 0.1, 0.0]])
TURNS = transforms.rotation_from_vector(np.radians(np.linspace(0, 3, 248))[:, None] * [0, 1.0, 0])


@pytest.mark.parametrize(
    ("value", "phrases"),
    [
        (
            SCAN,
            (
                "248 views over 197.6 deg of 62x48 pixels of 6.16 mm",
                "center 780, to detector 1198 mm",
            ),
        ),
        (Projections(SCAN, np.zeros((248, 48, 62))), ("248 views over 197.6 deg of 62x48 pixels",)),
        (GRID, ("100x110x120 voxels (x, y, z) of 1.25x1.25x1.5 mm", "-123.457, 1234.57) mm")),
        (Volume(GRID, np.zeros(GRID.shape_zyx)), ("100x110x120 voxels", "1/m")),
        (RigidMotion(TIMES, transforms.rigid(TURNS, np.zeros(3))), ("7.968 s", "up to 3 deg")),
        (
            ControlPointMotion(TIMES, POINTS, POINTS + 0.0123 * np.eye(3) * TIMES[:, None, None]),
            ("248 views over 7.968 s", "3 points", "98 mm"),
        ),
        (
            FieldMotion(
                TIMES[:2], GRID.coarse(0.05), np.zeros((2, *GRID.coarse(0.05).shape_zyx, 3))
            ),
            ("4x4x5 nodes", "50x50x50 mm apart"),
        ),
        (FdkOptions(), ("shepp-logan", "parker")),
        (open_device(), ("GiB", "units")),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_value_is_one_short_line_with_units(value: object, phrases: tuple[str, ...]) -> None:
    text = repr(value)
    assert len(text) < 120
    assert "\n" not in text
    assert text.startswith(f"{type(value).__name__}(")
    for phrase in phrases:
        assert phrase in text


def test_one_view_has_no_arc() -> None:
    assert "(1 view over 0 deg" in repr(SCAN[:1])
