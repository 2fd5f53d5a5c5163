"""Joints of a measured scan: whole legs, and an ankle alone."""

import numpy as np
import pytest

from legsim.config.measured_scan import JointConfig
from legsim.core.errors import LegsimError
from legsim.run.measured_joints import on_sensors

SENSORS = ("thigh_l", "shank_l", "shank_r")
WORN = {"thigh_l": "femur_l", "shank_l": "tibia_l", "shank_r": "tibia_r"}


def joint(name: str, sensor: str, height: float) -> JointConfig:
    return JointConfig(name=name, sensor=sensor, position_mm=(0.0, height, 0.0))


LEG = (
    joint("ankle_l", "shank_l", -300.0),
    joint("knee_l", "shank_l", 120.0),
    joint("hip_l", "thigh_l", 250.0),
)


def heights(points) -> list[float]:
    return [float(1e3 * point.position_sensor[1]) for point in points]


def test_a_leg_is_in_order_and_the_knee_on_its_thigh_apart():
    found = on_sensors((*LEG, joint("knee_l", "thigh_l", -160.0)), SENSORS, WORN, "SCAN.toml")
    (leg,) = found.legs
    np.testing.assert_allclose(heights(leg), [250, 120, -300])
    assert found.ankles == ()
    np.testing.assert_allclose(found.knees["thigh_l"], [0, -0.16, 0])


def test_an_ankle_alone_is_of_a_foot_that_may_stand():
    """One sensor on a shank: hip and knee are nothing to it; the other leg may be whole."""
    alone = joint("ankle_r", "shank_r", -310.0)
    for given, legs in (((alone,), 0), ((alone, *LEG), 1)):
        found = on_sensors(given, SENSORS, WORN, "SCAN.toml")
        assert len(found.legs) == legs
        assert heights(found.ankles) == [-310]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (LEG[:2], r"hip_l is missing; a leg needs hip_l, knee_l, ankle_l, or its ankle_l alone"),
        ((*LEG, LEG[0]), "a joint is there twice"),
        ((LEG[0], LEG[0]), "a joint is there twice"),
        ((joint("ankle_l", "foot_l", 0.0),), "ankle_l is on 'foot_l', which has no start"),
        (
            (joint("ankle_l", "thigh_l", -500.0),),
            r"worn on femur_l; an ankle is a place on tibia_l: ",
        ),
        (
            (joint("ankle_r", "shank_l", -300.0),),
            r"worn on tibia_l; an ankle is a place on tibia_r: ",
        ),
    ],
)
def test_half_legs_and_doubles_are_refused(given, said: str):
    with pytest.raises(LegsimError, match=said):
        on_sensors(given, SENSORS, WORN, "SCAN.toml")


def test_a_sensor_whose_segment_is_not_said_may_carry_any_joint():
    found = on_sensors(LEG, SENSORS, {"thigh_l": "", "shank_l": ""}, "SCAN.toml")
    assert len(found.legs) == 1
