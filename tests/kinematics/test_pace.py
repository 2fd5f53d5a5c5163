"""A rate that is wrong by a factor of four is named where somebody squats deep or walks; people's
own paces are passed.
"""

import numpy as np
import pytest

from legsim.kinematics import from_recording, pace
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.kinematics.skeleton import JOINT_CENTERS, JointCenters
from legsim.mocap.trajectories import JointTrajectories


def centers(times, hips_up, ahead=0.0) -> JointCenters:
    """Hips at a height (n,), ankles as far (n,) ahead of each other."""
    places = np.zeros((len(times), len(JOINT_CENTERS), 3))
    for k, name in enumerate(JOINT_CENTERS):
        joint, side = name.split("_")
        down = {"hip": 0.0, "knee": 0.5, "ankle": 1.0}[joint]
        places[:, k, 1] = hips_up + down * (0.1 - hips_up)
        places[:, k, 2] = 0.1 if side == "r" else -0.1
        places[:, k, 0] = ahead * (0.5 if side == "r" else -0.5) * down
    return JointCenters(times, places)


def squats(seconds: float) -> JointCenters:
    times = np.arange(0, 10, 0.01)
    return centers(times, 0.8 + 0.2 * np.cos(2 * np.pi * times / seconds))


def walk(length: float, per_second: float) -> JointCenters:
    times = np.arange(0, 20, 0.01)
    return centers(times, 0.9, length * np.sin(np.pi * per_second * times))


@pytest.mark.parametrize(("seconds", "falls"), [(10.0, 0), (3.0, 0), (1.2, 0), (0.6, 1)])
def test_hips_that_fall_faster_than_gravity_pulls_are_named(seconds, falls):
    found = pace.falling(squats(seconds))
    assert len(found) == falls
    assert all("see whether the recording's rate is lower" in line for line in found)


def test_hips_that_nobody_filtered_are_not_taken_for_a_fall(rng):
    times = np.arange(0, 10, 0.01)
    height = 0.8 + 0.2 * np.cos(2 * np.pi * times / 3) + rng.normal(0, 2e-3, len(times))
    assert pace.falling(centers(times, height)) == ()
    assert len(pace.falling(centers(times / 5, height))) == 1


def test_nothing_is_fitted_across_a_gap():
    """As where a clock jumps by years: even samples of all that time would fill any memory."""
    times = np.arange(0, 10, 0.01)
    height = 0.8 + 0.2 * np.cos(2 * np.pi * times / 0.6)
    slow = 0.8 + 0.2 * np.cos(2 * np.pi * times / 3)
    times[-300:] += 1e8
    assert len(pace.falling(centers(times, height))) == 1
    assert pace.falling(centers(times, slow)) == ()


def test_hips_of_runners_bounce_as_they_do():
    times = np.arange(0, 5, 0.01)
    bounce = 0.9 + 0.05 * np.cos(2 * np.pi * 3 * times)
    assert pace.falling(centers(times, bounce, 0.9 * np.sin(np.pi * 3 * times))) == ()
    assert len(pace.falling(centers(times, bounce))) == 1


@pytest.mark.parametrize(
    ("length", "per_second", "said"),
    [
        (0.65, 1.8, ""),
        (0.4, 1.0, ""),
        (1.6, 3.5, ""),
        (0.65, 7.2, "quick"),
        (0.65, 0.45, "slow"),
        (0.1, 7.2, ""),
    ],
)
def test_steps_too_quick_or_slow_for_their_length_are_named(length, per_second, said):
    found = pace.odd_steps(walk(length, per_second))
    assert len(found) == bool(said)
    assert all(f"far too {said} for their length" in line for line in found)


def test_small_legs_take_short_and_quick_steps():
    toddler = walk(0.31, 2.8)
    small = toddler.positions_world * [1, 0.45, 1]
    assert pace.odd_steps(JointCenters(toddler.times, small)) == ()
    (said,) = pace.odd_steps(JointCenters(toddler.times / 4, small))
    assert "far too quick" in said


@pytest.mark.parametrize("seconds", [1.5, 2.0, 3.0])
def test_lunges_are_no_walk(seconds):
    times = np.arange(0, 8 * seconds, 0.01)
    ahead = 0.85 * np.sin(np.pi * times / seconds)
    assert len(pace.odd_steps(centers(times, 0.9, ahead))) == 1
    assert pace.odd_steps(centers(times, 0.9 - 0.3 * np.abs(ahead), ahead)) == ()


def test_feet_on_cranks_do_not_walk():
    """Of 172.5 mm, at 100 turns a minute."""
    times = np.arange(0, 10, 0.01)
    turn, still = 2 * np.pi * 100 / 60 * times, centers(times, 0.9)
    places = still.positions_world.copy()
    for side, sign in (("r", 1), ("l", -1)):
        ankle = JOINT_CENTERS.index(f"ankle_{side}")
        places[:, ankle, 0] = sign * 0.1725 * np.cos(turn)
        places[:, ankle, 1] = 0.3 + sign * 0.1725 * np.sin(turn)
    assert pace.odd_steps(JointCenters(times, places)) == ()
    places[:, :, 1] = still.positions_world[:, :, 1]
    assert len(pace.odd_steps(JointCenters(times, places))) == 1


def test_who_places_one_foot_at_a_time_or_stands_does_not_walk():
    times = np.arange(0, 40, 0.01)
    turns = np.sign(np.sin(2 * np.pi * times**1.7 / 60))
    assert pace.odd_steps(centers(times, 0.9, 0.6 * turns)) == ()
    assert pace.odd_steps(squats(3.0)) == ()
    assert pace.odd_steps(centers([0.0], 0.9)) == pace.falling(centers([0.0], 0.9)) == ()


def test_squats_at_a_wrong_rate_are_implausible():
    person = from_recording.solve_kinematics("subject04/squats.trc", register=False)
    assert person.warnings == ()
    times = person.trajectories.times / 4
    hurried = MovingLeg(
        "a",
        LegModel.load(),
        JointTrajectories(times, COORDINATES, person.leg.values_of(person.trajectories)),
        None,
    )
    assert any("nobody falls faster" in line for line in hurried.implausible)
