"""What no leg does is said with its name and time, in the first and last frame too; what people do is
not.
"""

import numpy as np
import pytest

from legsim.core.values import FloatArray
from legsim.kinematics import from_recording, plausibility
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.kinematics.skeleton import SegmentScales, segment_index
from legsim.mocap.trajectories import JointTrajectories

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
