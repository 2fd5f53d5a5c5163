"""Files of sensors with a TOML about them."""

import numpy as np
import pytest

import legsim as ls
from legsim.core.errors import LegsimError
from legsim.imu.files import save_imu
from legsim.imu.signals import ImuSignals
from legsim.run import imu_files
from tests.examples.sensors import still
from tests.references.c3d import Channels, c3d_bytes


def write(folder, toml, one=None):
    """A table of one sensor in g and deg/s, and the TOML about it."""
    one = one or still(count=60)
    rows = np.column_stack([one.specific_force / 9.80665, np.degrees(one.angular_velocity)])
    lines = [",".join(map(repr, row)) for row in rows.tolist()]
    (folder / "raw.csv").write_text("\n".join(["ax,ay,az,gx,gy,gz", *lines]) + "\n")
    (folder / "shank.toml").write_text(toml)
    return folder / "shank.toml"


TABLE = """
file = "raw.csv"
rate_hz = 100
clock_offset_s = 2.5
acceleration_unit = "g"
angular_velocity_unit = "deg/s"

[[sensors]]
name = "shank_l"
segment = "tibia_l"
acceleration = ["ax", "ay", "az"]
angular_velocity = ["gx", "gy", "gz"]
"""


def test_a_segment_that_no_leg_has_is_refused_with_those_there_are(tmp_path):
    path = write(tmp_path, TABLE.replace("tibia_l", "shank_left"))
    with pytest.raises(LegsimError, match=r"is on 'shank_left', which no leg has.*tibia_l"):
        imu_files.load(path)


def test_a_table_is_read_through_its_toml(tmp_path):
    one = still(count=60)
    signals = ls.read_imu(write(tmp_path, TABLE, one))
    assert signals.sensor_names == ("shank_l",)
    np.testing.assert_allclose(signals.times, one.times - 2.5, atol=1e-14)
    np.testing.assert_allclose(signals.sensor("shank_l")[1], one.specific_force, rtol=1e-14)
    (sensor,) = imu_files.load(tmp_path / "shank.toml")
    assert sensor.worn.segment == "tibia_l"


def test_a_known_file_needs_no_toml_and_can_be_renamed_by_one(tmp_path):
    one = still(count=60)
    signals = ImuSignals(
        one.times, ("s1",), one.angular_velocity[:, None], one.specific_force[:, None]
    )
    save_imu(tmp_path / "imu.csv", signals)
    read = ls.read_imu(tmp_path / "imu.csv")
    np.testing.assert_array_equal(read.specific_force, signals.specific_force)
    (tmp_path / "a.toml").write_text('file = "imu.csv"\n[[sensors]]\nname = "shank_l"\n')
    assert ls.read_imu(tmp_path / "a.toml").sensor_names == ("shank_l",)


def test_lost_packets_are_a_warning(tmp_path):
    one = still(count=60)
    kept = np.delete(np.arange(60), [30, 31])
    save_imu(
        tmp_path / "imu.csv",
        ImuSignals(
            one.times[kept],
            ("s1",),
            one.angular_velocity[kept, None],
            one.specific_force[kept, None],
        ),
    )
    with pytest.warns(UserWarning, match=r"2 of 60 samples are missing"):
        ls.read_imu(tmp_path / "imu.csv")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('"g"', '"kg"'), "acceleration_unit"),
        (("rate_hz = 100", ""), "raw.csv: a table of sensors has times"),
        (('"ax"', '"AX"'), "raw.csv .line 1.: has no line with the column 'AX'"),
        (('"ax"', "0"), "acceleration.0.*: .*columns are counted from 1, not 0"),
        (('angular_velocity = ["gx", "gy", "gz"]', ""), "of every sensor, or of none"),
        (('name = "shank_l"', 'nam = "shank_l"'), "unknown key; valid here: name, recorded_as"),
    ],
)
def test_what_is_wrong_in_the_toml_is_named(tmp_path, change, said):
    with pytest.raises(LegsimError, match=said):
        ls.read_imu(write(tmp_path, TABLE.replace(*change)))


def test_an_unknown_sensor_is_named_beside_those_of_the_file(tmp_path):
    one = still(count=60)
    both = (one.angular_velocity, one.specific_force)
    save_imu(
        tmp_path / "imu.csv",
        ImuSignals(one.times, ("s1", "s2"), *(np.stack([v, v], 1) for v in both)),
    )
    (tmp_path / "a.toml").write_text('file = "imu.csv"\n[[sensors]]\nname = "shank_l"\n')
    with pytest.raises(LegsimError, match=r"no sensor 'shank_l'; name one of s1, s2"):
        ls.read_imu(tmp_path / "a.toml")


def test_known_biases_are_taken_off(tmp_path):
    one = still(count=60)
    more = (
        TABLE + "angular_velocity_bias_deg_per_s = [1.0, -2.0, 0.5]\n"
        "acceleration_bias_mg = [10.0, 0.0, -5.0]\n"
    )
    signals = ls.read_imu(write(tmp_path, more, one))
    rate, force = signals.sensor("shank_l")
    np.testing.assert_allclose(
        one.angular_velocity - rate, np.tile(np.radians([1.0, -2.0, 0.5]), (60, 1)), atol=1e-14
    )
    np.testing.assert_allclose(
        one.specific_force - force, np.tile([0.0980665, 0, -0.04903325], (60, 1)), atol=1e-14
    )


def test_a_toml_gives_counts_numbers_of_columns_and_a_second_file(tmp_path):
    one = still(count=60)
    path = tmp_path / "acc.csv"
    for name, values in (
        ("acc.csv", one.specific_force / 9.80665 * 2048),
        ("gyr.csv", np.degrees(one.angular_velocity) * 16.4),
    ):
        rows = np.column_stack([1e9 * one.times, values])
        path = tmp_path / name
        path.write_text("\n".join(",".join(map(repr, row)) for row in rows.tolist()) + "\n")
    toml = tmp_path / "shank.toml"
    toml.write_text(
        'file = "acc.csv"\nangular_velocity_file = "gyr.csv"\ntime = 1\ntime_unit = "ns"\n'
        "counts_per_g = 2048\ncounts_per_deg_per_s = 16.4\n[[sensors]]\n"
        'name = "shank_l"\nacceleration = [2, 3, 4]\nangular_velocity = [2, 3, 4]\n'
    )
    rate, force = ls.read_imu(toml).sensor("shank_l")
    np.testing.assert_allclose(force, one.specific_force, rtol=1e-12)
    np.testing.assert_allclose(rate, one.angular_velocity, rtol=1e-12)
    toml.write_text('file = "acc.csv"\ncounts_per_g = 2048\n')
    with pytest.raises(LegsimError, match=r"counts_per_g is given, but no columns"):
        imu_files.load(toml)


def test_two_sensors_of_one_recording_are_refused(tmp_path):
    """Both would have the readings of the first."""
    second = """
[[sensors]]
name = "thigh_l"
recorded_as = "shank_l"
acceleration = ["gx", "gy", "gz"]
angular_velocity = ["ax", "ay", "az"]
"""
    with pytest.raises(LegsimError, match="two sensors are that which is recorded as 'shank_l'"):
        ls.read_imu(write(tmp_path, TABLE + second))


@pytest.mark.parametrize("markers", [0, 1])
def test_sensors_in_a_c3d_share_its_clock_only_with_markers_beside_them(tmp_path, markers):
    one = still(count=60)
    both = np.concatenate([one.specific_force, one.angular_velocity], 1)
    labels = ["ax", "ay", "az", "gx", "gy", "gz"]
    units = ["m/s2"] * 3 + ["rad/s"] * 3
    channels = Channels(both, labels, units, [1.0] * 6, [0] * 6, rate=100.0)
    points = np.ones((60, markers, 3))
    (tmp_path / "a.c3d").write_bytes(c3d_bytes(points, ["M"] * markers, channels=channels))
    lines = TABLE.replace("raw.csv", "a.c3d").splitlines()
    lines = [line for line in lines if "rate_hz" not in line and "unit" not in line]
    (tmp_path / "a.toml").write_text("\n".join(li for li in lines if "offset" not in li))
    (sensor,) = imu_files.load(tmp_path / "a.toml")
    assert sensor.clock_stated == (markers > 0)


def test_rows_that_take_turns_need_their_texts_and_their_column(tmp_path):
    rows = 'acceleration_rows = "A"\nangular_velocity_rows = "G"\n'
    rates_alone = TABLE + rows.splitlines()[1]
    for toml in (TABLE + rows, rates_alone, TABLE.replace("rate_hz", 'rows_by = "k"\nrate_hz')):
        with pytest.raises(LegsimError, match="rows_by needs acceleration_rows"):
            imu_files.load(write(tmp_path, toml))
    toml = TABLE.replace("rate_hz", 'rows_by = "k"\nrate_hz') + rows
    with pytest.raises(LegsimError, match="no line with the column 'k'"):
        imu_files.load(write(tmp_path, toml))
