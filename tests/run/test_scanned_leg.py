import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.kinematics.skeleton import SegmentPoses
from legsim.run.stages import ScanSetup

TIMES = np.arange(3) / 31
GEOMETRY = ConeBeamGeometry.circular(
    times=TIMES,
    angles=TIMES,
    source_isocenter=0.78,
    source_detector=1.198,
    shape_vu=(48, 62),
    pixel_pitch=6e-3,
)


def scanned(times: np.ndarray) -> ScanSetup:
    poses = SegmentPoses(times, ("tibia_l",), np.tile(np.eye(4), (len(times), 1, 1, 1)))
    return ScanSetup(None, None, (), poses, None, GEOMETRY)


def test_its_times_are_those_of_the_views():
    np.testing.assert_array_equal(scanned(TIMES).times, TIMES)


@pytest.mark.parametrize("times", [TIMES + 1e-3, TIMES[:2]])
def test_poses_at_other_times_are_refused(times):
    with pytest.raises(LegsimError, match="at the times of the geometry"):
        scanned(times)
