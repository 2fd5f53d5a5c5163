"""What no leg does is said with its name and time, in the first and last frame too; what people do is
not.
"""

from dataclasses import replace

import numpy as np
import pytest

from legsim.core.values import FloatArray
from legsim.kinematics import from_recording, osim_file, plausibility
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.kinematics.osim_leg import OsimLeg
from legsim.kinematics.skeleton import SegmentScales, segment_index
from legsim.mocap.trajectories import JointTrajectories
from tests.examples import osim

LEG = LegModel.load()


def swaying(n: int = 300) -> FloatArray:
    values = np.tile(LEG.default_coordinates, (n, 1))
    values[:, COORDINATES.index("knee_angle_r")] = np.radians(-20 + 5 * np.sin(np.arange(n) / 30))
    return values


def objections(values: FloatArray, leg: LegModel = LEG) -> tuple[str, ...]:
    times = np.arange(len(values)) / 100
    return plausibility.objections(leg, JointTrajectories(times, COORDINATES, values))


def test_a_person_who_sways_is_plausible():
    assert objections(swaying()) == ()
    assert objections(swaying(1)) == ()


@pytest.mark.parametrize("name", ["subject01/squat_30.trc", "subject05/squats.trc"])
def test_the_shipped_recordings_are_plausible(name: str):
    found = from_recording.solve_kinematics(name)
    assert found.implausible == found.warnings == ()
    assert not any(line.startswith("warning") for line in found.lines())
    assert found.summary()["warnings"] == []


@pytest.mark.parametrize(("frame", "shown"), [(0, 0), (150, 149), (299, 298)])
def test_a_step_of_a_joint_is_named_wherever_it_is(frame: int, shown: int):
    values = swaying()
    values[frame, COORDINATES.index("hip_rotation_l")] += np.radians(40)
    assert any(
        f"hip_rotation_l steps at 4000 deg/s from frame {shown}" in o for o in objections(values)
    )


def test_a_step_of_the_whole_person_is_named():
    values = swaying()
    values[100:, COORDINATES.index("pelvis_tx")] += 0.5
    said = " ".join(objections(values))
    assert "pelvis_tx steps at 50 m/s from frame 99 (0.990 s)" in said
    assert "pelvis is accelerated by" in said


def of_model(tmp_path, knee: str) -> OsimLeg:
    """A user's model whose pelvis has its places before its turns, with a range of the knees."""
    pelvis, *legs = osim.two_legs()
    names = sorted(pelvis.coordinates, key=lambda name: name[-2] != "t")
    pelvis = replace(pelvis, coordinates={name: pelvis.coordinates[name] for name in names})
    text = osim.version_4([pelvis, *legs]).replace(
        "<range>-2.0 0.2</range>", f"<range>{knee}</range>"
    )
    return OsimLeg(osim_file.read(osim.saved(tmp_path, text)))


def test_a_users_order_of_coordinates_does_not_change_the_units(tmp_path):
    leg = of_model(tmp_path, "-2 0.2")
    assert leg.coordinate_names[:3] == ("pelvis_tx", "pelvis_ty", "pelvis_tz")
    values = np.tile(leg.default_coordinates, (300, 1))
    values[150:, 0] += 5
    values[200:, leg.coordinate_names.index("pelvis_tilt")] += 1
    motion = JointTrajectories(np.arange(300) / 100, leg.coordinate_names, values)
    said = " ".join(plausibility.objections(leg, motion))
    assert "pelvis_tx steps at 500 m/s" in said
    assert "pelvis_tilt steps at 5730 deg/s" in said


@pytest.mark.parametrize(("knee", "angle", "shown"), [
    ("-2 0", 0.0, False), ("0 2", 0.0, False), ("-2 0", -2.0, True), ("-2 0.2", 0.2, True),
])  # fmt: skip
def test_a_knee_that_stands_at_the_straight_end_of_a_users_model_is_plausible(
    tmp_path, knee, angle, shown
):
    leg = of_model(tmp_path, knee)
    values = np.tile(leg.default_coordinates, (100, 1))
    values[:, leg.coordinate_names.index("knee_angle_r")] = angle
    motion = JointTrajectories(np.arange(100) / 100, leg.coordinate_names, values)
    said = plausibility.beyond_limits(leg, motion)
    assert any(line.startswith("knee_angle_r is at its limit") for line in said) == shown


def test_legs_of_unlike_length_are_named():
    factors = np.ones((13, 3))
    factors[segment_index("femur_l")] = 1.08
    said = objections(swaying(), LegModel.load(SegmentScales(factors)))
    assert len(said) == 1
    assert "the thighs differ by 8 %" in said[0]


def test_a_lax_knee_is_plausible_and_one_that_no_person_has_is_not():
    values = swaying(100)
    column = COORDINATES.index("knee_angle_l")
    for degrees, said in (
        (11.0, ()),
        (17.0, ("knee_angle_l is overextended by more than 15 deg",)),
    ):
        values[:, column] = np.radians(degrees)
        moved = JointTrajectories(np.arange(100) / 100, COORDINATES, values)
        lines = plausibility.beyond_limits(LEG, moved)
        assert len(lines) == len(said)
        assert all(line.startswith(start) for line, start in zip(lines, said, strict=True))


@pytest.mark.parametrize(("sign", "shown"), [(1, False), (-1, True)])
def test_a_hip_that_no_person_has_is_named(sign: int, shown: bool):
    values = swaying()
    values[:, COORDINATES.index("hip_flexion_r")] = sign * np.radians(90)
    times = np.arange(len(values)) / 100
    lines = plausibility.beyond_limits(LEG, JointTrajectories(times, COORDINATES, values))
    assert any("hip_flexion_r is beyond what people's hips do" in line for line in lines) == shown


def test_a_knee_at_its_limit_is_implausible_and_printed():
    values = swaying()
    column = COORDINATES.index("knee_angle_l")
    values[:, column] = LEG.coordinate_ranges[column, 1]
    times = np.arange(len(values)) / 100
    moving = MovingLeg("a.mot", LEG, JointTrajectories(times, COORDINATES, values), None)
    assert moving.implausible == moving.warnings
    assert "knee_angle_l is at its limit of 20 deg in 100 % of the frames" in moving.warnings[0]
    assert any(line.startswith("warning: knee_angle_l is at its limit") for line in moving.lines())


def test_a_flexion_beyond_20_degrees_of_doubt_is_untold():
    names = ("pelvis_tilt", "hip_flexion_r", "hip_rotation_r", "knee_angle_l")
    assert plausibility.untold(names, np.radians([90.0, 19.0, 60.0, 12.0])) == []
    (said,) = plausibility.untold(names, np.radians([0.0, 43.0, 60.0, 12.0]))
    assert "hip_flexion_r (43 deg): too few of them" in said
