"""CSV tables: exact round trips, told apart by their header, damage refused."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from legsim.core.errors import LegsimError
from legsim.mocap import csv
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories
from tests.mocap.test_opensim import trajectories
from tests.mocap.test_trc import motions

FIXTURES_ARE_SAFE = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@FIXTURES_ARE_SAFE
@given(motion=motions())
def test_markers_are_loaded_to_the_last_bit(tmp_path, motion):
    path = tmp_path / "markers.csv"
    csv.save_markers(path, motion)
    again = csv.load(path)
    assert isinstance(again, MarkerTrajectories)
    assert again.marker_names == motion.marker_names
    np.testing.assert_array_equal(again.times, motion.times)
    np.testing.assert_array_equal(again.positions_world, motion.positions_world)


@FIXTURES_ARE_SAFE
@given(motion=trajectories())
def test_coordinates_are_loaded_to_the_last_bit(tmp_path, motion):
    path = tmp_path / "coordinates.csv"
    csv.save_coordinates(path, motion)
    again = csv.load(path)
    assert isinstance(again, JointTrajectories)
    assert again.coordinate_names == motion.coordinate_names
    np.testing.assert_array_equal(again.values, motion.values)


def test_the_header_tells_names_and_units(tmp_path):
    path = tmp_path / "table.csv"
    csv.save_coordinates(path, JointTrajectories([0.0], ("knee_ty_r",), [[-0.4]]))
    assert path.read_text() == "time_s,knee_ty_r_m\n0.0,-0.4\n"
    csv.save_coordinates(
        path, JointTrajectories([0.0], ("pelvis_tx", "knee_angle_r"), [[1.0, 0.5]])
    )
    assert path.read_text() == "time_s,pelvis_tx_m,knee_angle_r_rad\n0.0,1.0,0.5\n"
    csv.save_markers(path, MarkerTrajectories([0.0], ("R,ASIS",), [[[1.0, np.nan, 0.5]]]))
    assert path.read_text() == 'time_s,"R,ASIS_x_m","R,ASIS_y_m","R,ASIS_z_m"\n0.0,1.0,,0.5\n'


@pytest.mark.parametrize(("text", "message"), [
    ("time,a_rad\n0,1\n", r"line 1\): the header starts with 'time' and has 2 columns"),
    ("time_s\n0\n", "has 1 columns"),
    ("time_s,a_deg\n0,1\n", r"line 1\): column 'a_deg' is neither a marker's nor a coordinate's"),
    ("time_s,a_rad\n0\n", r"line 2\): the row holds 1 cells where the header has 2"),
    ("time_s,a_rad\n0,one\n", r"line 2\): 'one' is not a number"),
    ("time_s,a_rad\n0,\n", r"row 1\): a coordinate is not a number"),
    ("time_s,a_rad\n0,1\n0,1\n", "must increase strictly: .* repair the table"),
    ("", "the file is empty"),
])  # fmt: skip
def test_what_is_no_such_table_is_refused(tmp_path, text, message):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(LegsimError, match=message):
        csv.load(path)


def test_a_name_of_two_lines_is_not_written(tmp_path):
    with pytest.raises(LegsimError, match="cannot be written"):
        csv.save_markers(
            tmp_path / "x.csv", MarkerTrajectories([0.0], ("a\nb",), np.ones((1, 1, 3)))
        )


@pytest.mark.parametrize("header", ["time_s,knee_angle_l_rad", "time_s,A_x_m,A_y_m,A_z_m"])
def test_a_header_without_rows_is_refused(tmp_path, header):
    (tmp_path / "x.csv").write_text(header + "\n")
    with pytest.raises(LegsimError, match=r"x\.csv: has a header and no rows"):
        csv.load(tmp_path / "x.csv")


def test_a_cell_longer_than_csv_allows_is_refused(tmp_path):
    (tmp_path / "x.csv").write_text("time_s,knee_angle_l_rad\n0," + 200000 * "1" + "\n")
    with pytest.raises(LegsimError, match=r"x\.csv: is not CSV"):
        csv.load(tmp_path / "x.csv")


@pytest.mark.parametrize("columns", ["knee_angle_r_rad", "A_x_m,A_y_m,A_z_m"])
def test_times_of_few_digits_become_even(tmp_path, columns):
    path = tmp_path / "table.csv"
    count = columns.count(",") + 1
    rows = "".join(f"{k / 120:.3f}{',0.5' * count}\n" for k in range(600))
    path.write_text(f"time_s,{columns}\n{rows}")
    np.testing.assert_allclose(np.diff(csv.read(path).times) * 120, 1, atol=1e-3)
