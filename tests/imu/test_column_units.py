"""What is said goes before what a table states, and this before what names hint."""

import pytest

from legsim.core.errors import LegsimError
from legsim.imu.column_units import check_names, force_scale, rate_scale
from legsim.imu.table_layout import SensorColumns, TableLayout

LAYOUT = TableLayout((SensorColumns("s", ("x", "y", "z"), ("a", "b", "c")),), time="t")
NONE = dict.fromkeys("xyz")


def of(unit):
    return dict.fromkeys("xyz", unit)


def test_the_order_of_what_is_known():
    assert force_scale(LAYOUT, NONE, NONE) == rate_scale(LAYOUT, NONE, NONE) == 1.0
    assert force_scale(LAYOUT, NONE, of("g")) == 9.80665
    assert force_scale(LAYOUT, of("mg"), of("g")) == pytest.approx(9.80665e-3)
    in_counts = TableLayout(LAYOUT.sensors, time="t", counts_per_g=2048)
    assert force_scale(in_counts, of("mg"), of("g")) == 9.80665 / 2048
    # names that hint at several units, or at one of another quantity, hint at none
    assert force_scale(LAYOUT, NONE, {"x": "g", "y": "mg", "z": "g"}) == 1.0
    assert force_scale(LAYOUT, NONE, of("deg/s")) == 1.0


def test_contradictions_are_refused():
    in_g = TableLayout(LAYOUT.sensors, "g", time="t")
    for layout, stated, said in (
        (in_g, of("mg"), "stated to be in mg, but acceleration_unit is g"),
        (LAYOUT, of("furlongs"), "no unit that is read; state acceleration_unit"),
        (LAYOUT, {"x": "g", "y": "mg", "z": "g"}, "columns of one quantity are in g and mg"),
        (LAYOUT, of("rad/s"), "columns of the acceleration are stated to be in rad/s"),
    ):
        with pytest.raises(LegsimError, match=said):
            force_scale(layout, stated, NONE)


def test_names_of_the_other_quantity_are_refused():
    names = {1: "acc_x", 2: "gyr_y", "omega": "omega", 4: "accX from gyro", 5: ""}
    names[6] = "IM ACC Pitch1"
    check_names([1, 4, 5], [2, "omega", 4, 5, 6], names)
    with pytest.raises(LegsimError, match=r"column 2 is given as an acceleration.*'gyr_y'"):
        check_names([1, 2], [], names)
    with pytest.raises(LegsimError, match=r"column 1 is given as an angular velocity.*'acc_x'"):
        check_names([], [1], names)
    with pytest.raises(LegsimError, match=r"column 'omega' is given as an .*, and its name says"):
        check_names(["omega"], [], names)


@pytest.mark.parametrize(
    "called",
    [
        ("gyro1_ax", "gyro1_ay", "gyro1_az", "gyro1_wx", "gyro1_wy", "gyro1_wz"),
        ("ACC1_ax", "ACC1_ay", "ACC1_az", "ACC1_wx", "ACC1_wy", "ACC1_wz"),
        [f"Accelerometer 1 {axis}" for axis in ("X", "Y", "Z", "RX", "RY", "RZ")],
        ("rectangular x", "rectangular y", "rectangular z", "wx", "wy", "wz"),
        ("ax", "ay", "az", "wx acc. to sheet", "wy according to sheet", "wz acc to sheet"),
    ],
)
def test_the_axis_says_what_a_column_is_whatever_its_sensor_is_called(called):
    names = dict(enumerate(called))
    check_names([0, 1, 2], [3, 4, 5], names)
    # beside a sensor whose columns are exchanged
    names |= {6: "acc2", 7: "", 8: "", 9: "gyr2", 10: "", 11: ""}
    check_names([0, 1, 2, 6, 7, 8], [3, 4, 5, 9, 10, 11], names)
    with pytest.raises(LegsimError, match=r"column 9 is given as an acceleration.*'gyr2'"):
        check_names([0, 1, 2, 9, 10, 11], [3, 4, 5, 6, 7, 8], names)


@pytest.mark.parametrize("other", ["acc2_x", "acc_x_2", "acc_left_x", "acc_ax"])
def test_two_accelerometers_are_no_gyroscope(other):
    with pytest.raises(LegsimError, match="column 1 is given as an angular velocity"):
        check_names([0], [1], {0: "acc_x", 1: other})
