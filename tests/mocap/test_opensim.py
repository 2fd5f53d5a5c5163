"""OpenSim's storage files: exact round trips, degrees and radians, what OpenSim writes, damage
refused.
"""

import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from legsim.core.errors import LegsimError
from legsim.mocap import opensim as mocap_opensim
from legsim.mocap.coordinates import is_rotation
from legsim.mocap.trajectories import JointTrajectories

FIXTURES_ARE_SAFE = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
NAMES = ("pelvis_tilt", "pelvis_tx", "knee_angle_r", "knee_angle_r_beta")
TEXT = (
    "Coordinates\nversion=1\nnRows=2\nnColumns=5\ninDegrees=yes\n\nUnits are S.I. units (second, "
    "meters, Newtons, ...)\n"
    "If the header above contains a line with 'inDegrees', this tells (yes) or (no).\n\nendheader\n"
    "time\tpelvis_tilt\tpelvis_tx\tknee_angle_r\tknee_angle_r_beta\n"
    "      0.00000000\t      90.0\t 1.5\t -45 \t 0.25\n      0.01000000\t      90.0\t 1.5\t -45 "
    "\t 0.5\n"
)


@pytest.fixture
def write(tmp_path):
    """Writes a file and gives its path."""

    def _write(content: str):
        path = tmp_path / "motion.mot"
        path.write_text(content, newline="")
        return path

    return _write


@st.composite
def trajectories(draw):
    n, names = (
        draw(st.integers(1, 6)),
        draw(
            st.lists(
                st.from_regex(r"[a-z]{1,5}(_t[xyz])?", fullmatch=True),
                min_size=1,
                max_size=4,
                unique=True,
            )
        ),
    )
    times = np.cumsum(draw(st.lists(st.floats(1e-4, 10), min_size=n, max_size=n)))
    values = draw(st.lists(st.floats(-1e3, 1e3), min_size=n * len(names), max_size=n * len(names)))
    return JointTrajectories(times, tuple(names), np.reshape(values, (n, -1)))


@FIXTURES_ARE_SAFE
@given(motion=trajectories())
def test_what_is_saved_is_loaded_to_the_last_bit(tmp_path, motion):
    path = tmp_path / "motion.mot"
    mocap_opensim.save(path, motion)
    again = mocap_opensim.load(path)
    assert again.coordinate_names == motion.coordinate_names
    np.testing.assert_array_equal(again.times, motion.times)
    np.testing.assert_array_equal(again.values, motion.values)


@FIXTURES_ARE_SAFE
@given(motion=trajectories())
def test_degrees_in_the_file_are_the_same_motion(tmp_path, motion):
    path = tmp_path / "motion.mot"
    mocap_opensim.save(path, motion, in_degrees=True)
    np.testing.assert_allclose(mocap_opensim.load(path).values, motion.values, rtol=1e-14)


@FIXTURES_ARE_SAFE
@given(motion=trajectories(), where=st.floats(0, 1), junk=st.binary(max_size=4), cut=st.booleans())
def test_damage_gives_an_error_in_one_line_or_a_motion(tmp_path, motion, where, junk, cut):
    path = tmp_path / "motion.mot"
    mocap_opensim.save(path, motion)
    data = path.read_bytes()
    place = int(where * len(data))
    path.write_bytes(data[:place] + (b"" if cut else junk + data[place + len(junk) :]))
    problem = f"{path}: none"
    try:
        assert isinstance(mocap_opensim.load(path), JointTrajectories)
    except LegsimError as error:
        problem = str(error)
    assert problem.startswith(str(path))
    assert "\n" not in problem


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_only_rotations_are_in_degrees(write, end):
    found = mocap_opensim.load(write(TEXT.replace("\n", end)))
    assert found.coordinate_names == NAMES
    np.testing.assert_allclose(found.values[0], [np.pi / 2, 1.5, -np.pi / 4, 0.25], rtol=1e-15)
    np.testing.assert_array_equal(found.times, [0, 0.01])


def test_the_header_can_be_overridden(write):
    np.testing.assert_array_equal(
        mocap_opensim.load(write(TEXT), in_degrees=False).values[0], [90, 1.5, -45, 0.25]
    )
    radians = mocap_opensim.load(write(TEXT.replace("=yes", "=no")), in_degrees=True)
    np.testing.assert_allclose(radians.values[0], [np.pi / 2, 1.5, -np.pi / 4, 0.25])


@pytest.mark.parametrize("word", ["inDegrees=no", "INDEGREES = No", "inDegrees=false"])
def test_radians_stay(write, word):
    np.testing.assert_array_equal(
        mocap_opensim.load(write(TEXT.replace("inDegrees=yes", word))).values[0],
        [90, 1.5, -45, 0.25],
    )


@pytest.mark.parametrize("mark", [";", ",", " ; "])
def test_a_table_that_a_spreadsheet_has_written_is_read(write, mark):
    rows = [["time", "knee_angle_r"], ["0.00", "-10.5"], ["0.01", "-11.5"]]
    found = mocap_opensim.load(
        write("Coordinates\ninDegrees=yes\nendheader\n" + "\n".join(map(mark.join, rows)) + "\n")
    )
    np.testing.assert_allclose(np.degrees(found.values[:, 0]), [-10.5, -11.5])


def test_simm_motion_files_are_in_degrees(write):
    text = (
        "name squat\ndatacolumns 5\ndatarows 2\nrange 0 0.01\nendheader\n"
        + TEXT[TEXT.index("time\t") :]
    )
    np.testing.assert_allclose(mocap_opensim.load(write(text)).values[0, 0], np.pi / 2)


def test_of_states_the_values_are_read_under_their_coordinates_names(write):
    names = "time\t/jointset/knee_r/knee_angle_r/value\t/a/knee_angle_r/speed\t/forceset/soleus_r/force\thip/hip_flexion_r/value"
    text = TEXT.replace("inDegrees=yes", "inDegrees=no")
    found = mocap_opensim.load(
        write(text[: text.index("time\t")] + names + text[text.index("_beta\n") + 5 :])
    )
    assert found.coordinate_names == ("knee_angle_r", "hip_flexion_r")
    np.testing.assert_array_equal(found.values[0], [90, 0.25])


def test_the_header_is_what_opensim_asks_for(tmp_path):
    path = tmp_path / "motion.mot"
    mocap_opensim.save(path, JointTrajectories([0.0, 0.5], ("pelvis_tilt",), [[1.0], [2.0]]))
    lines = path.read_text().splitlines()
    assert lines[:5] == ["Coordinates", "version=1", "nRows=2", "nColumns=2", "inDegrees=no"]
    assert lines[lines.index("endheader") + 1 :] == ["time\tpelvis_tilt", "0.0\t1.0", "0.5\t2.0"]


@pytest.mark.parametrize(("change", "message"), [
    (lambda s: s.replace("endheader", "end"), "no line says endheader"),
    (lambda s: s.replace("inDegrees=yes\n", ""), "does not say whether angles are in degrees; write inDegrees=yes or inDegrees=no"),
    (lambda s: s.replace("=yes", "=maybe"), "inDegrees=maybe is neither yes nor no"),
    (lambda s: s.replace("time\t", "frame\t"), r"line 11\): the first column is 'frame', not time"),
    (lambda s: s[: s.index("time\t")], "no column names follow endheader"),
    (lambda s: s[: s.index("      0.00")], "there is no row of data"),
    (lambda s: s.replace("0.5\n", "x\n"), r"line 13\): 'x' is not a finite number"),
    (lambda s: s.replace("0.5\n", "nan\n"), r"line 13\): 'nan' is not a finite number"),
    (lambda s: s.replace("\t 0.5\n", "\n"), r"line 13\): the row holds 4 numbers where 5 columns have names"),
    (lambda s: s.replace("nRows=2", "nRows=9")[:-1], r"line 13\): the file breaks off in this row, number 2 of 9"),
    (lambda s: s.replace("0.01000000", "0.00000000"), r"row 2 of the data\): time 0 does not come after 0"),
    (lambda s: s.replace("pelvis_tx", "pelvis_tilt"), r"pelvis_tilt is there twice; keep one"),
    (lambda s: re.sub(r"(?m)^(time|      0.0\d0{6}).*$", r"\1", s), r"there is no column beside time"),
    (lambda s: "", "the file is empty"),
    (lambda s: "DataType=Quaternion\n" + s, (r"\(header\): holds DataType=Quaternion .*; give the .mot that inverse kinematics "
        r"made")),
])  # fmt: skip
def test_what_would_be_a_guess_is_refused_with_its_place(write, change, message):
    with pytest.raises(LegsimError, match=message):
        mocap_opensim.load(write(change(TEXT)))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("knee angle", 1.0, "cannot be written"),
        ("knee_angle_r", np.nan, "knee_angle_r is not a number at 0.5 s"),
    ],
)
def test_what_opensim_cannot_read_is_not_written(tmp_path, name, value, message):
    with pytest.raises(LegsimError, match=message):
        mocap_opensim.save(
            tmp_path / "m.mot", JointTrajectories([0.0, 0.5], (name,), [[1.0], [value]])
        )


@pytest.mark.parametrize(
    ("name", "rotates"),
    [
        ("pelvis_tx", False),
        ("pelvis_tilt", True),
        ("knee_angle_l_beta", False),
        ("mtp_angle_r", True),
    ],
)
def test_names_tell_rotations(name, rotates):
    assert is_rotation(name) == rotates


def test_a_motion_by_opensim_keeps_its_coupled_coordinate_equal_to_the_knee(shared_data):
    found = mocap_opensim.load(shared_data / "mocap/squats_subject4/squats1_manual_scaling_ik.mot")
    np.testing.assert_allclose(
        found.coordinate("knee_angle_r_beta"), found.coordinate("knee_angle_r"), atol=1e-8
    )
    assert found.coordinate("pelvis_ty")[0] == pytest.approx(0.95645564)
    assert np.rad2deg(found.coordinate("knee_angle_r").max()) > 90


@pytest.mark.peer
@pytest.mark.parametrize("in_degrees", [False, True])
def test_opensim_opens_ours(tmp_path, in_degrees):
    opensim = pytest.importorskip("opensim")
    path = tmp_path / "motion.mot"
    mocap_opensim.save(
        path,
        JointTrajectories([0.0, 0.5], NAMES, [[0.1, 1, -1, -1], [0.2, 1.5, -2, -2]]),
        in_degrees=in_degrees,
    )
    table = opensim.Storage(str(path))
    assert table.isInDegrees() == in_degrees
    assert (table.getSize(), table.getColumnLabels().getSize()) == (2, 5)
    values = table.getStateVector(1).getData()
    assert values.get(0) == pytest.approx(np.rad2deg(0.2) if in_degrees else 0.2, rel=1e-12)
    assert [values.get(1), values.get(3)] == [1.5, -2]


@pytest.mark.parametrize(("change", "note"), [
    (lambda s: s.replace("nRows=2", "nRows=9"), "the header says 9 rows; 2 are there and read"),
    (lambda s: s.replace("nRows=2", "nRows=1"), "the header says 1 rows; 2 are there and read"),
    (lambda s: s.replace("nColumns=5", "nColumns=7"), "the header says 7 columns; 5 are there and read"),
])  # fmt: skip
def test_a_header_that_counts_wrongly_is_noted_where_the_table_is_whole(write, change, note):
    raw = mocap_opensim.read(write(change(TEXT)))
    assert raw.notes == (note,)
    assert raw.values.shape == (2, 4)


def test_columns_that_are_no_coordinates_may_be_there_twice_or_hold_nan(write):
    text = TEXT.replace("_beta\n", "_beta\tforce_vx\tforce_vx\tarm_flex_r\tmass of it\n")
    raw = mocap_opensim.read(
        write(text.replace("0.25\n", "0.25 1 2 -nan(ind) 3\n").replace("0.5\n", "0.5 1 2 1 3\n"))
    )
    assert raw.names == (*NAMES, "mass of it")
    assert raw.notes[1:] == (
        "left out, being no coordinates of the leg and there twice: force_vx",
        "left out, being no coordinates of the leg and not numbers throughout: arm_flex_r",
    )


def test_even_times_of_few_digits_become_even(write):
    rows = "".join(f"{k / 60:.3f}\t1\t2\t3\t4\n" for k in range(120))
    text = TEXT[: TEXT.index("      0.00")].replace("nRows=2", "nRows=120") + rows
    np.testing.assert_allclose(np.diff(mocap_opensim.read(write(text)).times), 1 / 60, atol=1e-5)
    assert np.ptp(np.diff(mocap_opensim.read(write(text)).times)) < 1e-9


@pytest.mark.parametrize(
    "name",
    [
        *("Speeds", "Accelerations", "ActuatorForces", "Actuator Powers", "controls"),
        *("PositionErrors", "Inverse Dynamics Generalized Forces", "Static Optimization"),
    ],
)
def test_other_results_under_the_names_of_coordinates_are_refused(write, name):
    """Their numbers may be those of angles."""
    with pytest.raises(LegsimError, match=rf"line 1.*holds {name!r} under the names of coord"):
        mocap_opensim.read(write(TEXT.replace("Coordinates", name, 1)))


@pytest.mark.parametrize("name", ["Results", "normal_gait", "my speeds", "", "name walk.mot"])
def test_any_other_name_of_a_trial_is_read(write, name):
    assert len(mocap_opensim.read(write(TEXT.replace("Coordinates", name, 1))).times) == 2
