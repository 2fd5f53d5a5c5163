"""Joints in radians among degrees are doubted; stiff, held and healthy ones are not."""

import numpy as np
import pytest

from legsim.mocap import mixed_units
from legsim.mocap.trajectories import JointTrajectories
from tests.mocap.test_coordinates import NAMES, TIMES, in_degrees, raw, squat


def read(*in_radians: str) -> list[str]:
    """Doubts on a squat in degrees with some columns in radians."""
    values = in_degrees(squat())
    for name in in_radians:
        values[:, NAMES.index(name)] = np.radians(values[:, NAMES.index(name)])
    motion, notes = raw(values, degrees=True).to_plausible_motion()
    assert list(notes) == mixed_units.doubts(motion)
    return list(notes)


@pytest.mark.parametrize("name", ["knee_angle_r", "knee_angle_l", "hip_flexion_l"])
def test_one_joint_in_radians_is_doubted_by_the_other_side(name: str):
    (note,) = read(name)
    other = name[:-1] + ("l" if name.endswith("r") else "r")
    assert note.startswith(f"warning: {name} moves by ")
    assert f"{other} by " in note
    assert note.endswith("convert that column, unless the joint is stiff")


def test_both_knees_in_radians_are_doubted_by_the_hips():
    notes = read("knee_angle_r", "knee_angle_l")
    assert [note.split()[1] for note in notes] == ["knee_angle_r", "knee_angle_l"]
    assert all("hip_flexion_" in note for note in notes)


def test_degrees_throughout_and_radians_throughout_say_nothing():
    assert read() == []
    motion, notes = raw(squat()).to_plausible_motion()
    assert (mixed_units.doubts(motion), notes) == ([], ())


@pytest.mark.parametrize("degrees", [0.0, 0.3, 8.0])
def test_a_stiff_knee_is_no_doubt(degrees: float):
    """Held exactly, by an orthosis, or bent by a few degrees."""
    values, k = squat(), NAMES.index("knee_angle_r")
    values[:, k] *= np.radians(degrees) / np.ptp(values[:, k])
    assert mixed_units.doubts(JointTrajectories(TIMES, NAMES, values)) == []
