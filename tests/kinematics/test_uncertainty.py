"""Standard deviations of the coordinates: as large as errors are, and larger where markers lack."""

import re

import numpy as np
import pytest

from legsim.kinematics import from_recording
from legsim.kinematics.leg_model import COORDINATES
from tools.experiments import recovery_errors


@pytest.mark.parametrize("name", ["subject02/squat_60", "subject05/squat_30", "subject03/squats"])
def test_the_knees_errors_are_of_the_stated_size(name: str):
    found, _ = recovery_errors.recovered(name)
    errors = recovery_errors.errors(
        recovery_errors.truth_of(name), found.leg, found.trajectories
    ).knees_deg
    stated = [found.standard_deviations()[COORDINATES.index(f"knee_angle_{side}")] for side in "rl"]
    assert (np.array(errors) < 2 * np.array(stated)).all()
    assert max(stated) < 3.0


def test_what_seven_markers_do_not_show_is_uncertain():
    bent, straight = (
        from_recording.solve_kinematics(f"subject01/{trial}.trc").standard_deviations()
        for trial in ("squat_60", "squats")
    )
    rotation, knee, ankle = (
        COORDINATES.index(f"{name}_r") for name in ("hip_rotation", "knee_angle", "ankle_angle")
    )
    assert bent[rotation] < 3 < straight[rotation]
    # feet that stood while the person was registered tell the rotation as well as the bend
    assert max(bent[knee], bent[rotation]) < bent[ankle]


def test_without_registration_the_knee_is_less_certain():
    with_it, without = (
        from_recording.solve_kinematics("subject01/squat_60.trc", register=choice)
        for choice in (True, False)
    )
    knee = COORDINATES.index("knee_angle_r")
    assert 2 * with_it.standard_deviations()[knee] < without.standard_deviations()[knee]
    row = with_it.summary()["coordinates"][knee]
    assert row["standard_deviation"] == with_it.standard_deviations()[knee]
    assert any(line.startswith("least known") for line in with_it.lines())
    assert any(re.match(r"lengths .* from \d+ postures?, by an", s) for s in with_it.lines())
