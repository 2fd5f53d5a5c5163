"""What `legsim.show` shows: a recording of a scan or a person, and nothing else."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.mocap.trajectories import JointTrajectories
from legsim.view.show import show
from tests.examples.recordings import read


@pytest.fixture
def person() -> MovingLeg:
    """Somebody who stands still."""
    times = np.arange(60) / 60
    still = JointTrajectories(times, COORDINATES, np.zeros((60, len(COORDINATES))))
    return MovingLeg("rest", LegModel.load(), still, fit=None)


def test_a_person_is_written_where_a_path_is_given(person, tmp_path):
    assert show(person, path=tmp_path / "recording.rrd") is None
    _, knee = read(tmp_path / "recording.rrd", "/angles/knee_angle_r", "Scalars:scalars")
    np.testing.assert_allclose(np.ravel(knee), np.zeros(60), atol=1e-12)


def test_volumes_without_a_scan_and_other_values_are_refused(person, tmp_path):
    grid = VolumeGrid.cubic(2, 0.01, (0.0, 0.0, 0.0))
    volume = Volume(grid, np.zeros(grid.shape_zyx, np.float32))
    with pytest.raises(LegsimError, match="volumes are shown with the scan"):
        show(person, volume, path=tmp_path / "r.rrd")
    with pytest.raises(LegsimError, match="not int"):
        show(3, path=tmp_path / "r.rrd")  # type: ignore[arg-type]
