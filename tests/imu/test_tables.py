"""Tables of any program, by the names of their columns."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from legsim.core.errors import LegsimError
from legsim.imu.recording import ImuRecording
from legsim.imu.table_layout import SensorColumns, TableLayout
from legsim.imu.tables import load
from tests.examples.sensors import still, swaying

SENSOR = SensorColumns("shank", ("ax", "ay", "az"), ("gx", "gy", "gz"))
NAMES = ("t", "ax", "ay", "az", "gx", "gy", "gz")


def write(path, rows, delimiter=",", names=NAMES):
    """A table with two lines of other text above it."""
    text = ["some logger 1.0", "", delimiter.join(names)]
    text += [delimiter.join(map(str, row)) for row in rows]
    path.write_text("\n".join(text) + "\n", "utf-8")
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
        (
            lambda r: r[3].__setitem__(0, 0.0),
            "a.csv: time 0 s comes after 0.02 s .sample 3.; that row has",
        ),
        (lambda r: r[3].__setitem__(2, "x7"), "line 7.: 'x7' in column 'ay' is not a number"),
        (lambda r: r.__setitem__(3, r[3][:4]), "line 7.: the row has 4 cells, the header 7"),
        (lambda r: [row.__setitem__(1, "") for row in r], "has numbers in 0 of 20 samples"),
        (lambda r: r.__delitem__(slice(1, None)), "holds no samples"),
        (
            lambda r: (r.__delitem__(slice(2, None)), r[1].__setitem__(1, "")),
            "has 1 samples; at least 16",
        ),
    ],
)
def test_what_is_wrong_is_named_with_its_place(tmp_path, change, said):
    with pytest.raises(LegsimError, match=said):
        load(write(tmp_path / "a.csv", broken(change)), TableLayout((SENSOR,), time="t"))


def test_missing_columns_are_named_beside_those_that_there_are(tmp_path):
    path = write(tmp_path / "a.csv", rows_of(still(count=20)), names=("t", "AX", *NAMES[2:]))
    with pytest.raises(LegsimError, match=r"line 3.: .* column 'ax'; the line has t, AX, ay"):
        load(path, TableLayout((SENSOR,), time="t"))


def test_a_table_of_text_needs_a_clock(tmp_path):
    """Neither none nor an empty column."""
    path = write(tmp_path / "a.csv", [["", *row[1:]] for row in rows_of(still(count=20))])
    with pytest.raises(LegsimError, match=r"a.csv.*give one of them"):
        load(path, TableLayout((SENSOR,)))
    for clock in ({"time": "t"}, {"counter": "t", "rate_hz": 100.0}):
        with pytest.raises(LegsimError, match=r"a\.csv: column 't' is empty; name another"):
            load(path, TableLayout((SENSOR,), **clock))


def table_of(path, one, names, rows, below=()):
    """A table of a recording under other names."""
    text = [",".join(names), *(",".join(line) for line in below)]
    text += [",".join(map(str, row)) for row in rows]
    path.write_text("\n".join(text) + "\n", "utf-8")
    return path


FORCES, RATES = ("ax (g)", "ay (g)", "az (g)"), ("gx [dps]", "gy [dps]", "gz [dps]")


def test_units_that_the_table_states_are_taken(tmp_path):
    one = still(count=20)
    rows = np.column_stack(
        [1e3 * one.times, one.specific_force / 9.80665, np.degrees(one.angular_velocity)]
    ).tolist()
    sensor = SensorColumns("shank", FORCES, RATES)
    path = table_of(tmp_path / "a.csv", one, ("t (ms)", *FORCES, *RATES), rows)
    below = table_of(
        tmp_path / "b.csv", one, NAMES, rows, [("ms", "g", "g", "g", "deg/s", "deg/s", "deg/s")]
    )
    for found in (
        load(path, TableLayout((sensor,), time="t (ms)")),
        load(below, TableLayout((SENSOR,), time="t")),
    ):
        np.testing.assert_allclose(found[0].times, one.times, atol=1e-15)
        np.testing.assert_allclose(found[0].specific_force, one.specific_force, rtol=1e-14)
        np.testing.assert_allclose(found[0].angular_velocity, one.angular_velocity, rtol=1e-14)
    with pytest.raises(LegsimError, match=r"'gx \[dps\]' is stated to be in deg/s, but .*rad/s"):
        load(path, TableLayout((sensor,), None, "rad/s", time="t (ms)"))
    swapped = SensorColumns("shank", RATES, FORCES)
    with pytest.raises(LegsimError, match=r"of the acceleration are stated to be in deg/s"):
        load(path, TableLayout((swapped,), time="t (ms)"))


def test_counts_become_si_by_the_data_sheet(tmp_path):
    one = still(count=20)
    rows = np.column_stack(
        [
            one.times,
            one.specific_force / 9.80665 * 16384,
            np.degrees(one.angular_velocity) * 131.2,
        ]
    )
    layout = TableLayout((SENSOR,), time="t", counts_per_g=16384, counts_per_deg_per_s=131.2)
    (read,) = load(write(tmp_path / "a.csv", rows.tolist()), layout)
    np.testing.assert_allclose(read.specific_force, one.specific_force, rtol=1e-13)
    np.testing.assert_allclose(read.angular_velocity, one.angular_velocity, rtol=1e-13)


@pytest.mark.parametrize(("unit", "number", "setting"), [
    ("rpm", 4, "angular_velocity_unit"), ("cm/s²", 1, "acceleration_unit"), ("min", 0, "time_unit"),
])  # fmt: skip
def test_a_unit_that_is_not_read_is_asked_about(tmp_path, unit, number, setting):
    """No default stands in for it."""
    names = [f"{name} ({unit})" if k == number else name for k, name in enumerate(NAMES)]
    path = write(tmp_path / "a.csv", rows_of(still(count=20)), names=names)
    sensor = SensorColumns("shank", tuple(names[1:4]), tuple(names[4:]))
    with pytest.raises(LegsimError, match=f"stated to be in '{unit}'.*state {setting}"):
        load(path, TableLayout((sensor,), time=names[0]))
    given = {
        "acceleration_unit": "m/s2", "angular_velocity_unit": "rad/s", "time_unit": "s",
    }  # fmt: skip
    (read,) = load(path, TableLayout((sensor,), time=names[0], **given))
    assert len(read.times) == 20


def test_times_of_delivery_are_refused_with_the_rate(tmp_path):
    one = still(count=500)
    rows = rows_of(one)
    for k, row in enumerate(rows):
        row[0] = 0.05 * (k // 5) + 0.001 * (k % 5)
    path = write(tmp_path / "a.csv", rows)
    with pytest.raises(
        LegsimError, match=r"a.csv: .*in bursts: samples 1 ms .* rate_hz, about 100"
    ):
        load(path, TableLayout((SENSOR,), time="t"))
    (read,) = load(path, TableLayout((SENSOR,), rate_hz=100.0))
    np.testing.assert_allclose(read.times, one.times)


@pytest.mark.parametrize(
    "stamp", ["2025-03-01 23:59:59.{:03d}", "2025/03/01T23:59:59.{:03d}Z", "23:59:59,{:03d}"]
)
def test_dates_and_times_of_the_day_are_a_clock(tmp_path, stamp):
    one = still(count=20)
    rows = rows_of(one)
    for k, row in enumerate(rows):
        row[0] = stamp.format(10 * k)
    (read,) = load(write(tmp_path / "a.csv", rows, ";"), TableLayout((SENSOR,), time="t"))
    np.testing.assert_allclose(read.times - read.times[0], one.times, atol=1e-6)
    rows[3][0] = "yesterday"
    with pytest.raises(LegsimError, match=r"line 7.*'yesterday' in column 't' is no date and time"):
        load(write(tmp_path / "a.csv", rows, ";"), TableLayout((SENSOR,), time="t"))


def test_the_two_instruments_may_lie_in_two_tables(tmp_path):
    """Of one clock; equal times are kept to the bit, others meet on the faster one's."""
    one = swaying(seconds=4.0, rate_hz=100.0)
    force = np.column_stack([one.times, one.specific_force]).tolist()
    rate = np.column_stack([one.times, one.angular_velocity]).tolist()
    first = table_of(tmp_path / "a.csv", one, ("t", "x", "y", "z"), force)
    second = table_of(tmp_path / "g.csv", one, ("t", "x", "y", "z"), rate)
    layout = TableLayout((SensorColumns("shank", ("x", "y", "z"), ("x", "y", "z")),), time="t")
    (read,) = load(first, layout, angular_velocity_file=second)
    np.testing.assert_array_equal(read.specific_force, one.specific_force)
    np.testing.assert_array_equal(read.angular_velocity, one.angular_velocity)
    assert not read.notes
    table_of(tmp_path / "g.csv", one, ("t", "x", "y", "z"), rate[1::2])
    (read,) = load(first, layout, angular_velocity_file=second)
    inside = (one.times >= 0.01) & (one.times <= one.times[-1])
    np.testing.assert_array_equal(read.times, one.times[inside])
    np.testing.assert_allclose(read.angular_velocity, one.angular_velocity[inside], atol=1e-4)
    assert "on those of the faster" in read.notes[0]
    late = [[t + 100, *values] for t, *values in rate]
    table_of(tmp_path / "g.csv", one, ("t", "x", "y", "z"), late)
    with pytest.raises(LegsimError, match=r"hardly overlap in time: .*files of one recording"):
        load(first, layout, angular_velocity_file=second)


def test_rows_of_zeros_are_lost_packets(tmp_path):
    rows = rows_of(still(count=100))
    for row in rows[30:60]:
        row[1:] = [0.0] * 6
    (read,) = load(write(tmp_path / "a.csv", rows), TableLayout((SENSOR,), time="t"))
    assert len(read.times) == 70
    assert "30 of 100 samples are missing, the longest gap is 310 ms" in read.notes[0]


def test_sensors_in_rows_of_their_own_are_read(tmp_path):
    """Three sensors take turns."""
    names, rows = ["t"], []
    sensors = [still(count=50, seed=k) for k in range(3)]
    for k in range(3):
        names += [f"{column}{k}" for column in NAMES[1:]]
    for n in range(50):
        for k, one in enumerate(sensors):
            numbers = [*one.specific_force[n], *one.angular_velocity[n]]
            rows.append([one.times[n] + 0.001 * k, *[""] * 6 * k, *numbers, *[""] * 6 * (2 - k)])
    layout = TableLayout(
        tuple(
            SensorColumns(f"s{k}", (f"ax{k}", f"ay{k}", f"az{k}"), (f"gx{k}", f"gy{k}", f"gz{k}"))
            for k in range(3)
        ),
        time="t",
    )
    read = load(write(tmp_path / "a.csv", rows, names=names), layout)
    for k, one in enumerate(read):
        np.testing.assert_allclose(one.times, sensors[k].times + 0.001 * k)
        np.testing.assert_array_equal(one.specific_force, sensors[k].specific_force)
        assert one.notes == ()


def test_accelerations_and_angular_velocities_in_alternate_rows_are_read(tmp_path):
    one = swaying(seconds=3.0)
    rows = []
    for row in rows_of(one):
        rows += [[*row[:4], *[""] * 3], [row[0] + 0.002, *[""] * 3, *row[4:]]]
    (read,) = load(write(tmp_path / "a.csv", rows), TableLayout((SENSOR,), time="t"))
    assert len(read.times) == len(one.times) - 1
    for found, wanted, late in (
        (read.specific_force, one.specific_force, 0.0),
        (read.angular_velocity, one.angular_velocity, 0.002),
    ):
        by_hand = CubicSpline(one.times + late, wanted)(read.times)
        np.testing.assert_allclose(found, by_hand, atol=1e-6)


def test_a_sensor_beside_faster_channels_is_read(tmp_path):
    one = still(count=50)
    rows = []
    for row in rows_of(one):
        rows += [row, *([row[0] + 0.001 * k, *[""] * 6] for k in range(1, 10))]
    (read,) = load(write(tmp_path / "a.csv", rows), TableLayout((SENSOR,), time="t"))
    np.testing.assert_array_equal(read.specific_force, one.specific_force)


@pytest.mark.parametrize("cell", ["NA", "-", "#N/A", "-nan(ind)"])
def test_missing_numbers_are_lost_packets_in_any_spelling(tmp_path, cell):
    rows = rows_of(still(count=20))
    rows[5][4] = cell
    (read,) = load(write(tmp_path / "a.csv", rows), TableLayout((SENSOR,), time="t"))
    assert len(read.times) == 19


@pytest.mark.parametrize("every", [2, 3, 10])
def test_a_slower_accelerometer_in_rows_of_a_faster_gyroscope_is_read(tmp_path, every):
    one = swaying(seconds=6.0)
    rows = rows_of(one)
    for k, row in enumerate(rows):
        if k % every:
            row[1:4] = [""] * 3
    (read,) = load(write(tmp_path / "a.csv", rows), TableLayout((SENSOR,), time="t"))
    assert len(read.times) > len(one.times) - every
    shared = np.isin(one.times, read.times)
    np.testing.assert_allclose(read.angular_velocity, one.angular_velocity[shared], atol=1e-12)
    assert any("times of their own" in note for note in read.notes)


@pytest.mark.parametrize("number", ["", 0.0])
def test_columns_without_a_number_are_named(tmp_path, number):
    rows = rows_of(still(count=50))
    for row in rows[3:]:
        row[1:4] = [number] * 3
    with pytest.raises(LegsimError, match="numbers in 3 of 50 samples; check its columns"):
        load(write(tmp_path / "a.csv", rows), TableLayout((SENSOR,), time="t"))


def test_numbers_of_columns_that_the_line_above_calls_otherwise_are_refused(tmp_path):
    """Two sensors' columns, a row of sensors above that of quantities."""
    one = still(count=50)
    path = write(tmp_path / "a.csv", rows_of(one), names=["", *(f"acc_{x}" for x in "xyz"),
                                                          *(f"gyr_{x}" for x in "xyz")])  # fmt: skip
    path.write_text("sensor,l,l,l,l,l,l\n" + path.read_text())
    (read,) = load(path, TableLayout((SensorColumns("s", (2, 3, 4), (5, 6, 7)),), time=1))
    np.testing.assert_array_equal(read.specific_force, one.specific_force)
    with pytest.raises(LegsimError, match=r"a\.csv: column 5 is given as an accel.*'gyr_x'"):
        load(path, TableLayout((SensorColumns("s", (2, 4, 5), (3, 6, 7)),), time=1))


def test_units_at_the_end_of_names_are_taken_where_nothing_is_stated(tmp_path):
    """As a Blue Trident writes them; a stated unit goes before a name."""
    one = still(count=20)
    names = ("t_ms", "ax_g", "ay_g", "az_g", "gx_deg/s", "gy_deg/s", "gz_deg/s")
    rows = np.column_stack(
        [1e3 * one.times, one.specific_force / 9.80665, np.degrees(one.angular_velocity)]
    )
    path = write(tmp_path / "a.csv", rows.tolist(), names=names)
    sensor = SensorColumns("shank", names[1:4], names[4:])
    (read,) = load(path, TableLayout((sensor,), time="t_ms"))
    np.testing.assert_allclose(read.times, one.times, atol=1e-12)
    np.testing.assert_allclose(read.specific_force, one.specific_force, rtol=1e-12)
    np.testing.assert_allclose(read.angular_velocity, one.angular_velocity, rtol=1e-12)
    path = write(tmp_path / "b.csv", rows_of(one), names=names)
    (read,) = load(path, TableLayout((sensor,), "m/s2", "rad/s", time="t_ms", time_unit="s"))
    np.testing.assert_array_equal(read.specific_force, one.specific_force)


def test_packets_that_came_twice_count_once(tmp_path):
    one = still(count=40)
    rows = rows_of(one)
    rows.insert(10, rows[9])
    (read,) = load(write(tmp_path / "a.csv", rows), TableLayout((SENSOR,), time="t"))
    np.testing.assert_array_equal(read.times, one.times)
    assert read.notes == ("a.csv: 1 rows are there twice; one of each is taken.",)
    counted = [[9.0 + k, *row[1:]] for k, row in enumerate(rows_of(one))]
    counted.insert(10, counted[9])
    layout = TableLayout((SENSOR,), counter="t", rate_hz=100)
    (read,) = load(write(tmp_path / "b.csv", counted), layout)
    np.testing.assert_allclose(read.times, one.times, atol=1e-12)


def test_columns_that_would_be_both_quantities_row_by_row_are_refused(tmp_path):
    path = write(tmp_path / "a.csv", rows_of(still(count=40)))
    both = replace(SENSOR, angular_velocity=SENSOR.acceleration)
    with pytest.raises(LegsimError, match=r"that are accelerations and angular .* \(rows_by, with"):
        load(path, TableLayout((both,), time="t"))


def test_a_second_table_below_the_first_is_named(tmp_path):
    path = write(tmp_path / "a.csv", rows_of(still(count=40)))
    path.write_text(path.read_text() + "Gyroscope:\n0.1,0.2,0.3\n")
    with pytest.raises(LegsimError, match=r"line 44\): 'Gyroscope:' is no row of numbers: another"):
        load(path, TableLayout((SENSOR,), time="t"))


def test_a_column_may_be_meant_with_the_other_sign(tmp_path):
    """As phones that read gravity downwards, or axes that are left-handed."""
    one = still(count=40)
    path = write(tmp_path / "a.csv", rows_of(one))
    names = ("-ax", "ay", "-az"), ("gx", "-gy", "gz")
    for columns in (names, ((-2, 3, -4), (5, -6, 7))):
        (read,) = load(path, TableLayout((SensorColumns("shank", *columns),), time=1))
        np.testing.assert_array_equal(read.specific_force, one.specific_force * [-1, 1, -1])
        np.testing.assert_array_equal(read.angular_velocity, one.angular_velocity * [1, -1, 1])
    with pytest.raises(LegsimError, match="that are accelerations and angular velocities"):
        load(path, TableLayout((SensorColumns("shank", ("-ax", "ay", "az"), ("ax", "gy", "gz")),),
                               time="t"))  # fmt: skip
    with pytest.raises(LegsimError, match="has no column 0"):
        load(path, TableLayout((SensorColumns("shank", (0, 3, 4), (5, 6, 7)),), time="t"))


def test_a_column_of_the_table_may_begin_with_a_sign(tmp_path):
    """Its name is then its own, and beside it another is still meant with the other sign."""
    one = still(count=40)
    names = ("t", "-ax", "ay", "az", "gx", "gy", "gz")
    path = write(tmp_path / "a.csv", rows_of(one), names=names)
    sensor = SensorColumns("shank", ("-ax", "-ay", "az"), ("gx", "gy", "gz"))
    (read,) = load(path, TableLayout((sensor,), time="t"))
    np.testing.assert_array_equal(read.specific_force, one.specific_force * [1, -1, 1])


@pytest.mark.parametrize("columns", [("ax", "ay", "ax"), (2, 3, -2), ("ax", "-ay", "-ax")])
def test_a_column_that_is_twice_in_a_vector_is_refused(tmp_path, columns):
    path = write(tmp_path / "a.csv", rows_of(still(count=40)))
    with pytest.raises(LegsimError, match=r"a\.csv: .* has one column twice; give those of x, y"):
        load(path, TableLayout((SensorColumns("shank", columns, ("gx", "gy", "gz")),), time="t"))


def test_a_column_beyond_the_table_is_named(tmp_path):
    path = write(tmp_path / "a.csv", rows_of(still(count=40)))
    layout = TableLayout((SENSOR,), time="t", angular_velocity_time=9)
    with pytest.raises(LegsimError, match="column 9 is asked for, the header names 7; correct the"):
        load(path, layout)


def paired(every: int) -> tuple[ImuRecording, list[list[object]]]:
    """Rows of two instruments, each beside times of its own, of which the gyroscope is slower."""
    one = swaying(lean=0.3)
    slow = np.column_stack([one.times, one.angular_velocity])[::every].tolist()
    rest = [[""] * 4] * (len(one.times) - len(slow))
    fast = np.column_stack([one.times, one.specific_force]).tolist()
    return one, [[*a, *b] for a, b in zip(fast, slow + rest, strict=True)]


@pytest.mark.parametrize("every", [1, 2, 3])
def test_instruments_with_times_of_their_own_in_one_table_are_read(tmp_path, every):
    one, rows = paired(every)
    path = write(tmp_path / "a.csv", rows, names=("X[s]", *"xyz", "X[s]", *"abc"))
    layout = TableLayout((SensorColumns("shank", (2, 3, 4), (6, 7, 8)),), time=1)
    (read,) = load(path, replace(layout, angular_velocity_time=5))
    inside = one.times <= read.times[-1] + 1e-9
    np.testing.assert_allclose(read.times, one.times[inside])
    np.testing.assert_allclose(read.angular_velocity, one.angular_velocity[inside], atol=2e-3)
    if every < 3:
        (squeezed,) = load(path, layout)
        assert any("angular velocities end" in note for note in squeezed.notes) == (every > 1)
    else:
        with pytest.raises(LegsimError, match=r"400 of 1200 samples; .* and angular_velocity_time"):
            load(path, layout)
    with pytest.raises(LegsimError, match="angular_velocity_time is beside time"):
        replace(layout, time=None, rate_hz=100.0, angular_velocity_time=5)


def test_rows_of_events_between_samples_are_passed_over(tmp_path):
    """Their times are of their own: they are no samples that were lost, or are out of order."""
    one = still(count=40)
    rows = rows_of(one)
    rows.insert(10, [0.104, *[""] * 6])
    (read,) = load(write(tmp_path / "a.csv", rows), TableLayout((SENSOR,), time="t"))
    np.testing.assert_array_equal(read.times, one.times)
    assert read.notes == ()
