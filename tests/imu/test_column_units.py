"""What is said goes before what a table states, and this before what names hint."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu.column_units import check_gravity, check_names, force_scale, rate_scale
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
        [f"Gyro Shank {axis}" for axis in ("X", "Y", "Z", "RX", "RY", "RZ")],
        [f"gyr_1.{axis}" for axis in ("x", "y", "z", "roll", "pitch", "yaw")],
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


def test_a_device_called_gyro_is_a_gyroscope_where_nothing_else_says_what_its_axes_are():
    names = dict(enumerate(f"Gyro Shank {axis}" for axis in ("X", "Y", "Z", "A", "B", "C")))
    for rates in ([], [3, 4, 5]):
        with pytest.raises(LegsimError, match="column 0 is given as an acceleration"):
            check_names([0, 1, 2], rates, names)


@pytest.mark.parametrize("other", ["acc2_x", "acc_x_2", "acc_left_x", "acc_ax"])
def test_two_accelerometers_are_no_gyroscope(other):
    with pytest.raises(LegsimError, match="column 1 is given as an angular velocity"):
        check_names([0], [1], {0: "acc_x", 1: other})


@pytest.mark.parametrize(
    "name",
    ["FreeAcc_X", "Free Acc. x", "userAcceleration.x", "Acceleration without g x (m/s^2)", "Acc x (gravity removed)",
     "Acceleration x (without gravity)", "acc_x_no_gravity", "accelerationWithoutGravityX", "accNoGravity_x", "acc w/o gravity",
     "Shank_FreeAcceleration_X", "no_gravity_acc_x", "gravity-free accel x"],
)  # fmt: skip
def test_accelerations_that_are_called_free_of_gravity_are_refused(name):
    with pytest.raises(LegsimError, match="column 0 is an acceleration without gravity"):
        check_names([0, 1, 2], [3], {0: name})


@pytest.mark.parametrize(
    "name",
    ["Acc_X in free space, user 3", "bias-free accel x", "drift-free accel x", "noise_free_acc_x", "acc x no. g", "acc no 3 g",
     "acc_x with gravity", "acc_x no gravity compensation", "acc x (gravity not removed)"],
)  # fmt: skip
def test_accelerations_that_are_called_free_of_something_else_are_read(name):
    check_names([0], [1], {0: name, 1: "gyr"})


def test_linear_accelerations_are_specific_forces_where_they_hold_gravity(rng):
    """ROS calls specific force so, and Android what is left of it without gravity."""
    moving = rng.normal(scale=7.0, size=(2000, 3))
    assert np.median(np.linalg.norm(moving, axis=1)) > 9.8
    for name in ("linear_acceleration.x", "Linear Acceleration x (m/s^2)", "LinAcc"):
        check_gravity(["a"], {"a": name}, moving + np.array([0.0, 9.8, 0.0]))
        with pytest.raises(LegsimError, match=r"'a' is an acceleration without gravity: .*mean"):
            check_gravity(["a"], {"a": name}, moving)
    check_gravity(["a"], {"a": "acc_x"}, moving)
    check_gravity(["a"], {"a": "LinAcc"}, np.full((5, 3), np.nan))


@pytest.mark.parametrize("unit", [1.0, 9.80665, 9.80665e3])
@pytest.mark.parametrize("how", ["six positions", "turned over", "spun"])
def test_a_linear_acceleration_that_is_turned_about_holds_gravity_in_any_unit(rng, how, unit):
    """Its mean is nothing; a unit that is not m/s^2 is told later, by the magnitude."""
    turn = np.linspace(0, 40 * np.pi, 3000)
    up = {
        "six positions": np.repeat(np.concatenate([np.eye(3), -np.eye(3)]), 500, axis=0),
        "turned over": np.repeat([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], 1500, axis=0),
        "spun": np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1),
    }[how]
    moving = (np.arange(3000) % 10 < 4)[:, None] * rng.normal(scale=4.0, size=(3000, 3))
    check_gravity(["a"], {"a": "linear_acceleration.x"}, (9.80665 * up + moving) / unit)
