"""Instruments in turn: one counter, counters of their own, and rows alone."""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu import turns
from legsim.imu.recording import ImuRecording
from legsim.imu.table_layout import SensorColumns, TableLayout
from legsim.imu.tables import load
from tests.examples.sensors import still, swaying
from tests.imu.test_tables import NAMES, SENSOR, rows_of, write

PERIODS = [None, 256, 65536]


def table(count, kept, numbers, turn=1):
    """Lines and numbers of instruments that write ``turn`` rows each, of packets that are kept."""
    order = sorted(
        (k // turn, which, k) for which, own in enumerate(kept) for k in range(count) if own[k]
    )
    rows = [(line, which, numbers[which][k]) for line, (_, which, k) in enumerate(order)]
    return {
        name: tuple(np.array([(r[0], r[2]) for r in rows if r[1] == which], float).T)
        for which, name in enumerate("AG")
    }


@pytest.mark.parametrize("turn", [1, 7])
@pytest.mark.parametrize("begin", [0, 250, 65530])
@pytest.mark.parametrize("period", PERIODS)
def test_one_counter_puts_instruments_on_each_other(period, begin, turn):
    """Also where the first rows of one were lost, across a start at 0."""
    kept = np.ones((2, 600), bool)
    kept[1, :20], kept[0, 70:90], kept[1, 300] = False, False, False
    sent = begin + np.arange(600)
    sent = sent if period is None else sent % period
    first, notes = turns.first_packets(table(600, kept, [sent, sent], turn), period)
    assert first == {"A": 0, "G": 20}
    assert notes == ()
    kept[0, :33] = False
    first, _ = turns.first_packets(table(600, kept, [sent, sent], turn), None)
    assert first == {"A": 13, "G": 0}


@pytest.mark.parametrize("wraps", [False, True])
def test_counters_of_their_own_go_by_the_order_of_rows(wraps):
    kept = np.ones((2, 600), bool)
    kept[1, :20], kept[1, 300] = False, False
    sent = np.arange(600)
    numbers = [(100 + sent) % 256, (30 + sent) % 256] if wraps else [900 + sent, 30 + sent]
    first, (note,) = turns.first_packets(table(600, kept, numbers), 256 if wraps else None)
    assert first == {"A": 0, "G": 20}
    assert f"'A' and 'G' are {70 if wraps else 870} apart in the same place" in note


@pytest.mark.parametrize("begin", [0, 65500])
def test_blocks_of_one_counter_keep_its_numbers(begin):
    """Rows of one instrument below those of another."""
    sent = (begin + np.arange(600)) % 65536
    rows = {"A": (np.arange(600.0), 1.0 * sent), "G": (600 + np.arange(550.0), 1.0 * sent[50:])}
    first, notes = turns.first_packets(rows, 65536)
    assert first == {"A": 0, "G": 50}
    assert notes == ()


@pytest.mark.parametrize("begin", [600, 1000, 1500])
def test_blocks_with_counters_of_their_own_begin_together(begin):
    """Whatever their numbers, if few are in both blocks."""
    sent = np.arange(1000.0)
    first, (note,) = turns.first_packets({"A": (sent, sent), "G": (1000 + sent, begin + sent)})
    assert first == {"A": 0, "G": 0}
    assert f"'A' and 'G' are {begin} apart in the first rows of their blocks" in note


def test_blocks_with_counters_of_their_own_are_read_as_they_were_recorded(tmp_path):
    one, xyz = swaying(), ("x", "y", "z")
    rows = [["A", k, *f] for k, f in enumerate(one.specific_force.tolist())]
    rows += [["G", 1500 + k, *w] for k, w in enumerate(one.angular_velocity.tolist())]
    path = write(tmp_path / "a.csv", rows, names=("k", "n", *xyz))
    sensor = SensorColumns("shank", xyz, xyz, "A", "G")
    (read,) = load(path, TableLayout((sensor,), rate_hz=100.0, counter="n", rows_by="k"))
    np.testing.assert_array_equal(read.specific_force, one.specific_force)
    np.testing.assert_array_equal(read.angular_velocity, one.angular_velocity)
    assert "counters of their own" in read.notes[0]


def test_one_counter_of_instruments_in_turn_is_in_no_doubt(tmp_path):
    """It counts the rows of both, 200 of them per second."""
    one, xyz = swaying(), ("x", "y", "z")
    pairs = zip(one.specific_force.tolist(), one.angular_velocity.tolist(), strict=True)
    both = [row for f, w in pairs for row in (["A", *f], ["G", *w])]
    rows = [[kind, k, *values] for k, (kind, *values) in enumerate(both)]
    path = write(tmp_path / "a.csv", rows, names=("k", "n", *xyz))
    sensor = SensorColumns("shank", xyz, xyz, "A", "G")
    (read,) = load(path, TableLayout((sensor,), rate_hz=200.0, counter="n", rows_by="k"))
    assert not [note for note in read.notes if "grow by" in note or "In doubt" in note]


def test_rows_out_of_turn_are_described_by_place_and_size():
    kept = np.ones((2, 600), bool)
    both = {name: lines for name, (lines, _) in table(600, kept, [range(600)] * 2).items()}
    assert turns.out_of_turn(both, 100.0) == ()
    kept[0, [50, 51]], kept[1, [400, 500]] = False, False
    rows = table(600, kept, [range(600)] * 2)
    (note,) = turns.out_of_turn({name: lines for name, (lines, _) in rows.items()}, 100.0)
    assert "rows of 'A' and 'G' do not always take turns, from line 100 on" in note
    assert "up to 2 samples (20 ms) apart" in note
    blocks = {"A": np.arange(100.0), "G": 100 + np.arange(100.0)}
    assert turns.out_of_turn(blocks, 100.0) == ()


def in_turn(one: ImuRecording, other: ImuRecording) -> list[list[object]]:
    """Rows of a logger of two sensors that write a row per instrument, by time."""
    rows = [
        [t, name, kind, *xyz]
        for name, sensor in (("A", one), ("B", other))
        for kind, values in (("ACC", sensor.specific_force), ("GYR", sensor.angular_velocity))
        for t, xyz in zip(sensor.times.tolist(), values.tolist(), strict=True)
    ]
    return sorted(rows, key=lambda row: row[0])


def test_instruments_that_take_turns_in_a_table_are_told_apart_by_a_column(tmp_path):
    one, other = still(count=40), still(count=40, seed=1)
    rows = [[t, f"{name}/{kind}", *xyz] for t, name, kind, *xyz in in_turn(one, other)]
    rows.insert(7, [0.01, "A/BATTERY"])
    path = write(tmp_path / "a.csv", rows, names=("t", "what", "x", "y", "z"))
    xyz = ("x", "y", "z")
    sensors = tuple(SensorColumns(n, xyz, xyz, f"{n}/ACC", f"{n}/GYR") for n in ("A", "B"))
    first, second = load(path, TableLayout(sensors, time="t", rows_by="what"))
    for read, true in ((first, one), (second, other)):
        np.testing.assert_array_equal(read.times, true.times)
        np.testing.assert_array_equal(read.specific_force, true.specific_force)
        np.testing.assert_array_equal(read.angular_velocity, true.angular_velocity)
    by_number = replace(sensors[0], acceleration=(3, 4, 5), angular_velocity=(3, 4, 5))
    (again,) = load(path, TableLayout((by_number,), time=1, rows_by=2))
    np.testing.assert_array_equal(again.specific_force, one.specific_force)
    wrong = replace(sensors[0], acceleration_rows="A/acc")
    with pytest.raises(LegsimError, match="no row has 'A/acc' in column 'what'; give one of 'A/A"):
        load(path, TableLayout((wrong,), time="t", rows_by="what"))


def test_sensors_that_take_turns_in_a_table_are_told_apart_by_a_column(tmp_path):
    one, other = still(count=40), still(count=40, seed=1)
    rows = [[name, *row] for pair in zip(rows_of(one), rows_of(other), strict=True)
            for name, row in zip((7, 8), pair, strict=True)]  # fmt: skip
    path = write(tmp_path / "a.csv", rows, names=("id", *NAMES))
    sensors = tuple(replace(SENSOR, name=n, acceleration_rows=n, angular_velocity_rows=n)
                    for n in ("7", "8"))  # fmt: skip
    first, second = load(path, TableLayout(sensors, time="t", rows_by="id"))
    np.testing.assert_array_equal(first.specific_force, one.specific_force)
    np.testing.assert_array_equal(second.angular_velocity, other.angular_velocity)


def test_rows_alone_are_no_clock_of_instruments_with_unlike_numbers_of_them(tmp_path):
    """A gyroscope at half rate would be squeezed in time."""
    one, xyz = still(count=80), ("x", "y", "z")
    sensor = SensorColumns("shank", xyz, xyz, "A", "G")
    pairs = zip(one.specific_force.tolist(), one.angular_velocity.tolist(), strict=True)
    rows = [row for f, w in pairs for row in (["A", *f], ["G", *w])]
    fewer = [row for k, row in enumerate(rows) if k % 4 != 3]
    layout = TableLayout((sensor,), rate_hz=100.0, rows_by="k")
    (read,) = load(write(tmp_path / "a.csv", rows, names=("k", *xyz)), layout)
    np.testing.assert_allclose(read.angular_velocity, one.angular_velocity)
    with pytest.raises(LegsimError, match=r"rows \(80 of 'A', 40 of 'G'\), .* times \(time\) or"):
        load(write(tmp_path / "a.csv", fewer, names=("k", *xyz)), layout)
    files = [write(tmp_path / f"{k}.csv", [r[1:] for r in fewer if r[0] == k], names=xyz)
             for k in "AG"]  # fmt: skip
    layout = replace(layout, rows_by=None, sensors=(SensorColumns("shank", xyz, xyz),))
    with pytest.raises(LegsimError, match=r"unlike numbers of rows \(80 of .*A\.csv', 40 of"):
        load(files[0], layout, angular_velocity_file=files[1])


@pytest.mark.parametrize("begin", [0, 65500])
def test_a_packet_counter_puts_instruments_in_turn_on_each_other(tmp_path, begin):
    """Rows that one instrument lost at the start do not move it against the other."""
    one, xyz = swaying(), ("x", "y", "z")
    both = zip(one.specific_force.tolist(), one.angular_velocity.tolist(), strict=True)
    rows = [row for k, (f, w) in enumerate(both)
            for row in (["A", (begin + k) % 65536, *f], ["G", (begin + k) % 65536, *w])]  # fmt: skip
    lost = [row for k, row in enumerate(rows) if not (k < 40 and row[0] == "G")]
    path = write(tmp_path / "a.csv", lost, names=("k", "n", *xyz))
    sensor = SensorColumns("shank", xyz, xyz, "A", "G")
    (read,) = load(path, TableLayout((sensor,), rate_hz=100.0, counter="n", rows_by="k"))
    np.testing.assert_array_equal(read.times, one.times[20:])
    np.testing.assert_array_equal(read.specific_force, one.specific_force[20:])
    np.testing.assert_array_equal(read.angular_velocity, one.angular_velocity[20:])
    assert read.notes == ()


def test_rows_lost_from_both_instruments_are_in_doubt_without_a_counter(tmp_path):
    one, xyz = still(count=80), ("x", "y", "z")
    pairs = zip(one.specific_force.tolist(), one.angular_velocity.tolist(), strict=True)
    rows = [row for f, w in pairs for row in (["A", *f], ["G", *w])]
    layout = TableLayout((SensorColumns("shank", xyz, xyz, "A", "G"),), rate_hz=100.0, rows_by="k")
    assert load(write(tmp_path / "a.csv", rows, names=("k", *xyz)), layout)[0].notes == ()
    del rows[120], rows[41]  # an acceleration, and 40 samples before it an angular velocity
    (read,) = load(write(tmp_path / "a.csv", rows, names=("k", *xyz)), layout)
    assert read.notes[0].startswith("In doubt: a.csv: rows of 'A' and 'G' do not always take turns")
    assert "from line 45 on: rows were lost, or changed places" in read.notes[0]
    assert "up to 1 samples (10 ms) apart" in read.notes[0]
