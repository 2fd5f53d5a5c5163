"""What a moving person reports of the fit."""

import re

import numpy as np
import pytest

from legsim.config import MotionConfig
from legsim.kinematics import from_recording
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.mocap import trc
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories
from legsim.run import motion as run_motion

SQUAT = "subject01/squat_30.trc"


def saved(folder, motion: MarkerTrajectories, name="moved.trc") -> MotionConfig:
    trc.save(folder / name, motion)
    return MotionConfig(file=str(folder / name))


@pytest.fixture(scope="module")
def squat() -> MarkerTrajectories:
    return trc.load(from_recording.find_recording(SQUAT))


def test_a_poor_fit_and_what_was_not_seen_are_warned_of(tmp_path, squat):
    """A knee's marker that trembles in one place for good, and an ankle's that is never seen
    again.
    """
    positions = np.array(squat.positions_world)
    knee, ankle = (squat.marker_names.index(name) for name in ("RKNE", "RANK"))
    half = len(squat.times) // 2
    positions[half:, ankle] = np.nan
    positions[half:, :, 0] += np.linspace(0, 0.6, len(positions) - half)[:, None]
    tremble = 1e-5 * np.random.default_rng(2).standard_normal((len(positions) - half, 3))
    positions[half:, knee] = positions[half - 1, knee] + tremble
    moving = run_motion.solve(
        saved(tmp_path, MarkerTrajectories(squat.times, squat.marker_names, positions))
    )
    lines = moving.lines()
    (poor,) = [line for line in moving.implausible if "no good fit" in line]
    assert re.search(r"epicondyle_lateral_r within \d+ mm, .* frame \d+ \(\d+\.\d+ s\)", poor)
    assert f"warning: {poor}" in lines
    assert any(
        "not seen for longer than can be bridged" in line and "malleolus_lateral_r" in line
        for line in lines
    )
    assert not any(
        "no good fit" in line or "not seen" in line
        for line in from_recording.solve_kinematics(SQUAT).lines()
    )


@pytest.mark.parametrize(("swing", "said"), [(0.0, False), (0.1, True)])
def test_coordinates_without_the_height_of_the_pelvis_tell_of_no_floor(swing, said):
    """As joint angles with a pelvis_ty of 0; where it moves, somebody measured it."""
    values = np.tile(LegModel.load().default_coordinates, (50, 1))
    values[:, COORDINATES.index("pelvis_ty")] = swing * np.sin(np.linspace(0, 6, 50))
    motion = JointTrajectories(np.arange(50) / 50, COORDINATES, values)
    warnings = MovingLeg("a", LegModel.load(), motion, None).warnings
    assert any("below the laboratory's zero" in line for line in warnings) == said


def test_joints_of_the_foot_that_priors_decide_are_reported_with_their_share():
    person = from_recording.solve_kinematics(SQUAT)
    (line,) = [text for text in person.lines() if text.startswith("decided by the prior")]
    assert "ankle_angle_r, subtalar_angle_r, mtp_angle_r, ankle_angle_l" in line
    assert line.endswith("in 100 % of the frames")
    frames = {c["name"]: c["frames_decided_by_prior"] for c in person.summary()["coordinates"]}
    assert frames["subtalar_angle_l"] == len(person.trajectories.times)
    assert frames["knee_angle_l"] == 0
