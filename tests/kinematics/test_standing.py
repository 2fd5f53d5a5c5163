"""Who stands over the own feet, on the floor, as tall as an adult, is passed; a tilted vertical,
another origin and another unit are named.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from legsim.core.values import FloatArray
from legsim.kinematics import from_recording, standing
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.skeleton import JointCenters, SegmentScales
from legsim.mocap import trc
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

LEG = LegModel.load()


def posed(frames: int = 100, **degrees: float) -> tuple[FloatArray, JointCenters]:
    """The pelvis' axes and the joint centers of somebody who holds a posture, leaning forwards by
    5 degrees unless ``pelvis_tilt`` and ``ankle_angle`` say otherwise.
    """
    values = np.tile(LEG.default_coordinates, (frames, 1))
    for name, angle in {"pelvis_tilt": -5.0, **degrees}.items():
        values[:, COORDINATES.index(name)] = np.radians(angle)
    poses = LEG.segment_poses(JointTrajectories(np.arange(frames) / 100, COORDINATES, values))
    return poses.of("pelvis")[:, :3, :3], LEG.joint_centers(poses)


def tilted(pelvis: FloatArray, centers: JointCenters, turn: FloatArray):
    return turn @ pelvis, JointCenters(centers.times, centers.positions_world @ turn.T)


def about(axis: str, degrees: float) -> FloatArray:
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


@pytest.mark.parametrize("heading", [0.0, 70.0, 180.0])
@pytest.mark.parametrize("axis", ["x", "z"])
@pytest.mark.parametrize("degrees", [-15.0, 15.0])
def test_a_tilted_vertical_is_named_whichever_way_somebody_faces(heading, axis, degrees):
    upright = tilted(*posed(), about("y", heading))
    assert standing.leaning(*upright) == ()
    (said,) = standing.leaning(*tilted(*upright, about(axis, degrees)))
    assert "would fall over" in said


def test_the_way_that_somebody_leans_is_said():
    (back,) = standing.leaning(*tilted(*posed(), about("z", 15.0)))
    (aside,) = standing.leaning(*tilted(*posed(), about("x", 15.0)))
    assert "cm behind" in back
    assert "cm right of" in aside


@pytest.mark.parametrize(
    "posture",
    [
        {"hip_flexion_r": 25.0},
        {"hip_flexion_r": 24.0, "hip_flexion_l": -2.0},
        {"hip_adduction_r": 6.0, "hip_adduction_l": -16.0},
    ],
    ids=["holds one leg forwards", "stands in a step over the rear foot", "shifts the weight"],
)
def test_who_stands_over_one_of_two_feet_does_not_fall(posture):
    assert standing.leaning(*posed(**posture)) == ()


def test_a_tilted_vertical_is_named_where_the_feet_stand_apart():
    apart = posed(hip_adduction_r=-7.0, hip_adduction_l=-7.0)
    assert standing.leaning(*apart) == ()
    for degrees in (-15.0, 15.0):
        assert len(standing.leaning(*tilted(*apart, about("x", degrees)))) == 1


@pytest.mark.parametrize(
    "posture",
    [
        {"knee_angle_r": -30.0, "knee_angle_l": -30.0},
        {"hip_flexion_r": 60.0, "hip_flexion_l": 60.0, "pelvis_tilt": -60.0},
        {"hip_flexion_r": 40.0, "hip_flexion_l": -20.0},
        {"pelvis_tilt": -90.0},
    ],
    ids=["squats", "bends forwards", "stands astride", "lies"],
)
def test_who_stands_otherwise_is_not_judged(posture):
    assert standing.leaning(*tilted(*posed(**posture), about("z", 15.0))) == ()


def test_who_moves_or_stands_for_a_moment_is_not_judged():
    pelvis, centers = tilted(*posed(), about("z", 15.0))
    moving = centers.positions_world + np.linspace(0, 0.5, 100)[:, None, None] * [1, 0, 0]
    assert standing.leaning(pelvis, JointCenters(centers.times, moving)) == ()
    moving[:30] = moving[0]
    assert standing.leaning(pelvis, JointCenters(centers.times, moving)) == ()
    assert len(standing.leaning(pelvis[:1], JointCenters([0.0], centers.positions_world[:1]))) == 1


@pytest.mark.parametrize(("up", "said"), [(0.0, ""), (0.5, ""), (1.0, "above"), (-1.0, "below")])
def test_feet_far_from_the_zero_are_named(up, said):
    _, centers = posed()
    lifted = centers.positions_world + np.array([0, up, 0])
    found = standing.off_the_floor(JointCenters(centers.times, lifted))
    assert len(found) == bool(said)
    assert all(f"m {said} the laboratory's zero" in line for line in found)


def test_the_legs_of_a_small_child_are_named():
    assert standing.small(LEG) == ()
    (said,) = standing.small(LegModel.load(SegmentScales.uniform(0.5)))
    assert "times too short: see whether the unit" in said


def test_a_recording_whose_vertical_is_tilted_is_warned_of(tmp_path):
    """Through the solution, whose priors want a flat floor."""
    squats = trc.load(from_recording.find_recording("subject01/squats.trc"))
    still = squats.positions_world[:120]
    for degrees in (0.0, 15.0):
        turned = MarkerTrajectories(
            squats.times[:120], squats.marker_names, still @ about("z", degrees).T
        )
        trc.save(tmp_path / "a.trc", turned)
        person = from_recording.solve_kinematics(tmp_path / "a.trc", register=False)
        assert any("would fall over" in line for line in person.warnings) == (degrees > 0)
        assert not any("would fall over" in line for line in person.implausible)
