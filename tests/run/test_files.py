"""Files of a run give back what was written."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.deformation.files import load_motion, save_motion
from legsim.deformation.models import RigidMotion
from legsim.imu.signals import ImuSignals
from legsim.kinematics.skeleton import SegmentPoses
from legsim.mocap.trajectories import MarkerTrajectories
from legsim.run.files import (
    load_imu,
    load_rest,
    save_imu,
    save_marker_errors,
    save_poses,
    save_rest,
)


def test_imu_signals_survive_the_file_to_the_last_bit(tmp_path, rng):
    signals = ImuSignals(
        np.sort(rng.random(20)),
        ("shank_l", "thigh_l"),
        rng.normal(size=(20, 2, 3)),
        rng.normal(size=(20, 2, 3)),
    )
    save_imu(tmp_path / "imu.csv", signals)
    loaded = load_imu(tmp_path / "imu.csv")
    assert loaded.sensor_names == signals.sensor_names
    for name in ("times", "angular_velocity", "specific_force"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(signals, name))


def test_lost_samples_and_names_with_commas_survive_the_file(tmp_path, rng):
    rate, force = rng.normal(size=(2, 5, 2, 3))
    rate[2, 0], force[2, 0] = np.nan, np.nan
    rest = rng.normal(size=(2, 3))
    signals = ImuSignals(np.arange(5.0), ("a/b, c", "ü"), rate, force, rest_force=rest)
    save_imu(tmp_path / "imu.csv", signals)
    save_rest(tmp_path / "rest.csv", signals)
    loaded = load_imu(tmp_path / "imu.csv")
    assert loaded.sensor_names == signals.sensor_names
    np.testing.assert_array_equal(loaded.specific_force, force)
    np.testing.assert_array_equal(loaded.samples("a/b, c")[0], [0, 1, 3, 4])
    np.testing.assert_array_equal(load_rest(tmp_path / "rest.csv", ("ü", "a/b, c")), rest[::-1])
    with pytest.raises(LegsimError, match="lacks a sensor"):
        load_rest(tmp_path / "rest.csv", ("other",))


def test_imu_table_has_the_columns_that_were_promised(tmp_path):
    signals = ImuSignals(np.arange(2.0), ("s",), np.zeros((2, 1, 3)), np.ones((2, 1, 3)))
    save_imu(tmp_path / "imu.csv", signals)
    first, second, _ = (tmp_path / "imu.csv").read_text().splitlines()
    assert first == "time_s,s_ax_m_s2,s_ay_m_s2,s_az_m_s2,s_gx_rad_s,s_gy_rad_s,s_gz_rad_s"
    assert second == "0.0,1.0,1.0,1.0,0.0,0.0,0.0"


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


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda lines: [*lines[:2], lines[2] + ",1"], r"line 3\): holds 14 numbers instead of 13"),
        (lambda lines: [lines[0], lines[1].replace("0.0", "x", 1)], r"line 2\): could not convert"),
        (lambda lines: [lines[0]], "is not an IMU table"),
        (lambda lines: [lines[0].replace("_ax_", "_bx_", 1), lines[1]], "is not an IMU table"),
        (lambda lines: ['"', *lines], "is not an IMU table"),
    ],
)
def test_a_damaged_imu_table_is_named_by_line(tmp_path, change, problem):
    path = tmp_path / "imu.csv"
    times = np.arange(3.0)
    signals = np.zeros((2, 3, 2, 3))
    save_imu(path, ImuSignals(times, ("a", "b"), *signals))
    path.write_text("\n".join(change(path.read_text().splitlines())))
    with pytest.raises(LegsimError, match=problem):
        load_imu(path)
