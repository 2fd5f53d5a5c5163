"""Tables of any program, by the names of their columns."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu.tables import SensorColumns, TableLayout, load
from tests.examples.sensors import still

SENSOR = SensorColumns("shank", ("ax", "ay", "az"), ("gx", "gy", "gz"))
NAMES = ("t", "ax", "ay", "az", "gx", "gy", "gz")


def write(path, rows, delimiter=",", names=NAMES):
    """A table with two lines of other text above it."""
    text = ["some logger 1.0", "", delimiter.join(names)]
    text += [delimiter.join(map(str, row)) for row in rows]
    path.write_text("\n".join(text) + "\n")
    return path


def rows_of(recording):
    """Rows of times in s, m/s^2 and rad/s."""
    return np.column_stack(
        [recording.times, recording.specific_force, recording.angular_velocity]
    ).tolist()


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_a_table_is_read_whatever_parts_its_columns(tmp_path, delimiter):
    one = still(count=20)
    path = write(tmp_path / "a.csv", rows_of(one), delimiter)
    (read,) = load(path, TableLayout((SENSOR,), time="t"))
    np.testing.assert_array_equal(read.times, one.times)
    np.testing.assert_array_equal(read.specific_force, one.specific_force)
    np.testing.assert_array_equal(read.angular_velocity, one.angular_velocity)


def test_decimal_commas_between_semicolons_are_numbers(tmp_path):
    one = still(count=20)
    rows = [[str(v).replace(".", ",") for v in row] for row in rows_of(one)]
    (read,) = load(write(tmp_path / "a.csv", rows, ";"), TableLayout((SENSOR,), time="t"))
    np.testing.assert_array_equal(read.specific_force, one.specific_force)


def test_units_and_clock_are_converted(tmp_path):
    one = still(count=20)
    rows = np.column_stack(
        [1e3 * one.times, one.specific_force / 9.80665, np.degrees(one.angular_velocity)]
    )
    layout = TableLayout((SENSOR,), "g", "deg/s", time="t", time_unit="ms")
    (read,) = load(write(tmp_path / "a.csv", rows.tolist()), layout)
    np.testing.assert_allclose(read.times, one.times, atol=1e-15)
    np.testing.assert_allclose(read.specific_force, one.specific_force, rtol=1e-14)
    np.testing.assert_allclose(read.angular_velocity, one.angular_velocity, rtol=1e-14)


def test_a_counter_and_a_rate_give_times(tmp_path):
    rows = rows_of(still(count=20))
    for k, row in enumerate(rows):
        row[0] = (250 + k + 2 * (k >= 10)) % 256
    layout = TableLayout((SENSOR,), rate_hz=50.0, counter="t")
    (read,) = load(write(tmp_path / "a.csv", rows), layout)
    np.testing.assert_allclose(np.diff(read.times), [0.02] * 9 + [0.06] + [0.02] * 9, atol=1e-12)
    assert "2 of 22 samples are missing" in read.notes[0]


def test_rows_without_numbers_are_lost_packets(tmp_path):
    rows = rows_of(still(count=20))
    rows[5][1:] = [""] * 6
    rows[6][4] = "NaN"
    (read,) = load(write(tmp_path / "a.csv", rows), TableLayout((SENSOR,), time="t"))
    assert len(read.times) == 18
    assert "2 of 20 samples are missing, the longest gap is 30 ms" in read.notes[0]


def broken(change):
    """Rows with something wrong in them."""
    rows = rows_of(still(count=20))
    change(rows)
    return rows


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r: r[3].__setitem__(0, r[2][0]), "a.csv: time 0.02 s is there twice .sample 3."),
        (lambda r: r[3].__setitem__(0, 0.0), "comes after 0.02 s .sample 3.; keep one sample"),
        (lambda r: r[3].__setitem__(2, "x7"), "line 7.: 'x7' in column 'ay' is not a number"),
        (lambda r: r.__setitem__(3, r[3][:4]), "line 7.: the row has 4 cells, the header 7"),
        (lambda r: [row.__setitem__(1, "") for row in r], "has numbers in 0 of 20 samples"),
        (lambda r: r.__delitem__(slice(1, None)), "holds no samples"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(tmp_path, change, said):
    with pytest.raises(LegsimError, match=said):
        load(write(tmp_path / "a.csv", broken(change)), TableLayout((SENSOR,), time="t"))


def test_missing_columns_are_named_beside_those_that_there_are(tmp_path):
    path = write(tmp_path / "a.csv", rows_of(still(count=20)), names=("t", "AX", *NAMES[2:]))
    with pytest.raises(LegsimError, match=r"line 3.: .* column 'ax'; the line has t, AX, ay"):
        load(path, TableLayout((SENSOR,), time="t"))


def test_a_layout_has_one_clock():
    with pytest.raises(LegsimError, match=r"give one of them"):
        TableLayout((SENSOR,))
    with pytest.raises(LegsimError, match=r"needs rate_hz"):
        TableLayout((SENSOR,), time="t", counter="n")
