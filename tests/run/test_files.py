"""Files of a run give back what was written."""

import numpy as np

from legsim.deformation.files import load_motion, save_motion
from legsim.deformation.models import RigidMotion
from legsim.kinematics.skeleton import SegmentPoses
from legsim.mocap.trajectories import MarkerTrajectories
from legsim.run.files import save_marker_errors, save_poses


def test_poses_and_motion_survive_the_file(tmp_path, rng):
    poses = SegmentPoses(np.arange(3.0), ("a", "b"), rng.normal(size=(3, 2, 4, 4)))
    save_poses(tmp_path / "p.npz", poses)
    np.testing.assert_array_equal(
        np.load(tmp_path / "p.npz")["world_from_segment"], poses.world_from_segment
    )
    motion = RigidMotion(np.arange(3.0), rng.normal(size=(3, 4, 4)))
    save_motion(tmp_path / "m.npz", motion)
    loaded = load_motion(tmp_path / "m.npz")
    assert isinstance(loaded, RigidMotion)
    np.testing.assert_array_equal(loaded.moved_from_reference, motion.moved_from_reference)


def test_marker_errors_are_opensims_columns_and_a_column_per_marker(tmp_path):
    """3 and 4 mm in the first frame; in the second one marker is not seen."""
    measured = np.zeros((2, 2, 3))
    modelled = np.array([[[3e-3, 0, 0], [0, 4e-3, 0]], [[0, 0, 2e-3], [0, 0, 0]]])
    measured[1, 1] = np.nan
    times, names = np.array([0.0, 0.5]), ("a", "b")
    save_marker_errors(
        tmp_path / "e.sto",
        MarkerTrajectories(times, names, measured),
        MarkerTrajectories(times, names, modelled),
    )
    lines = (tmp_path / "e.sto").read_text().splitlines()
    columns = lines[lines.index("endheader") + 1].split("\t")
    assert columns == [
        "time",
        "total_squared_error",
        "marker_error_RMS",
        "marker_error_max",
        "a",
        "b",
    ]
    rows = np.array([[float(v) for v in line.split("\t")] for line in lines[-2:]])
    np.testing.assert_allclose(rows[0], (0, 25e-6, np.sqrt(12.5e-6), 4e-3, 3e-3, 4e-3))
    np.testing.assert_allclose(rows[1], (0.5, 4e-6, 2e-3, 2e-3, 2e-3, np.nan))
