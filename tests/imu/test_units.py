"""How loggers spell their units."""

import pytest

from legsim.imu import units


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("m/s^2", "m/s2"),
        ("m/(s^2)", "m/s2"),
        ("m/s²", "m/s2"),
        ("m s^-2", "m/s2"),
        ("G", "g"),
        ("mg", "mg"),
        ("rad/s", "rad/s"),
        ("°/s", "deg/s"),
        ("dps", "deg/s"),
        ("Deg/Sec", "deg/s"),
        ("mdps", "mdeg/s"),
        ("msec", "ms"),
        ("µs", "us"),
        ("˚/s", "deg/s"),
        ("°·s⁻¹", "deg/s"),
        ("º/sec", "deg/s"),
        ("deg/sec.", "deg/s"),
        ("degrees per second", "deg/s"),
        ("millidegrees/s", "mdeg/s"),
        ("m·s⁻²", "m/s2"),
        ("meters per second squared", "m/s2"),
        ("metre per second per second", "m/s2"),
        ("g's", "g"),
        ("rpm", None),
        ("cm/s²", None),
        ("no_units", None),
        ("", None),
        ("m/s", None),
        ("a.u.", None),
    ],
)
def test_common_spellings_are_one_unit(text, unit):
    assert units.known(text) == unit


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        ("Acceleration x (m/s^2)", "m/s2"),
        ("Gyroscope y (rad/s)", "rad/s"),
        ("ACC.X 1[g]", "g"),
        ("Gyro X (m/(s^2))", "m/s2"),
        ("elapsed (s)", "s"),
        ("x-axis (g)", "g"),
        ("gx (rpm)", "rpm"),
        ("ax (cm/s²)", "cm/s²"),
        ("gx (deg)", "deg"),
        ("t (min)", "min"),
        ("ax (left)", None),
        ("ax (calibrated)", None),
        ("Time (13:00)", None),
        ("ax", None),
        ("g", None),
    ],
)
def test_a_unit_also_an_unknown_one_stands_in_the_brackets_of_a_name(column, unit):
    assert units.in_name(column) == unit


@pytest.mark.parametrize(
    "column", ["ax (with gravity)", "ax (left/right)", "ax (3 degrees of freedom)", "gx (radius)"]
)
def test_words_in_brackets_that_are_no_unit_are_passed_over(column):
    assert units.in_name(column) is None


@pytest.mark.parametrize(
    ("column", "unit"),
    [("ax (m/s^2 calibrated)", "m/s2"), ("t (elapsed seconds)", "s"), ("gx (deg/s, raw)", "deg/s")],
)
def test_a_unit_among_words_is_found(column, unit):
    assert units.in_name(column) == unit


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        ("ax_m/s/s", "m/s2"),
        ("acc_x_mss", "m/s2"),
        ("Gyro_X_deg_per_s", "deg/s"),
        ("gyr_y_dps", "deg/s"),
        ("shank_gz_rad_s", "rad/s"),
        ("Accel_X_g", "g"),
        ("Shank RT-Accel Sensor X,mG", "mg"),
        ("time,s", "s"),
        ("Time_ms", "ms"),
        ("unix_timestamp_microsec", "us"),
        ("Acc_X", None),
        ("gx", None),
        ("mx_microT", None),
    ],
)
def test_the_last_words_of_a_name_may_be_its_unit(column, unit):
    assert units.hinted(column) == unit


@pytest.mark.parametrize(
    ("name", "unit", "seconds"),
    [("time (ms)", "ms", 1e-3), ("t_us", "us", 1e-6), ("t_us (ns)", "ns", 1e-9),
     ("time (min)", "min", None), ("time", None, None), ("acc_g", "g", None)],
)  # fmt: skip
def test_a_name_says_its_unit_in_brackets_or_at_its_end(name, unit, seconds):
    assert units.of_name(name) == unit
    assert units.seconds_of(unit or "") == seconds
