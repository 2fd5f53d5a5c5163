"""A static trial's mean pose as zero: angles counted from it, and a movement that stays as it is."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.kinematics import from_recording, osim_file, zero_pose
from legsim.kinematics.ik_options import CoordinateLock, IkOptions
from legsim.kinematics.leg_model import COORDINATES
from legsim.kinematics.osim_leg import OsimLeg
from legsim.mocap import opensim, trc
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories
from tests.examples import osim

TIMES = np.arange(60) / 60
SQUAT = "subject01/squat_30.trc"
PLACE = ("pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz")


@pytest.fixture(scope="module")
def person():
    return from_recording.solve_kinematics(SQUAT)


def still(folder, angle, name="static.mot"):
    """A file of coordinates that all have one value."""
    values = np.full((len(TIMES), len(COORDINATES)), angle)
    opensim.save(folder / name, JointTrajectories(TIMES, COORDINATES, values))
    return folder / name


def test_a_recording_from_its_own_mean_is_about_zero_and_stays_as_it_is(person):
    found = zero_pose.with_zero(person, SQUAT)
    assert found.trajectories is person.trajectories
    angles = found.from_zero()
    for name in COORDINATES:
        mean, change = angles.coordinate(name).mean(), np.ptp(angles.coordinate(name))
        if name in PLACE:
            assert np.array_equal(angles.coordinate(name), person.trajectories.coordinate(name))
        else:
            # solved without the second low-pass, which keeps a mean but for its ends
            assert np.degrees(abs(mean)) < 0.02
            assert change == pytest.approx(np.ptp(person.trajectories.coordinate(name)))
    assert "zero of the joint angles: the mean pose of squat_30.trc (2400 frames)" in found.notes
    row = found.summary()["coordinates"][COORDINATES.index("knee_angle_r")]
    assert row["zero"] == pytest.approx(row["mean"], abs=0.02)
    assert person.from_zero() is None
    assert "zero" not in person.summary()


def test_a_trial_is_solved_on_the_persons_leg_with_its_options():
    lock = CoordinateLock("subtalar_angle_r", 0.1)
    person = from_recording.solve_kinematics(SQUAT, ik=IkOptions(locked=(lock,)))
    found = zero_pose.with_zero(person, "subject01/squats.trc")
    value = dict(zip(COORDINATES, found.zero.values, strict=True))
    assert value["subtalar_angle_r"] == pytest.approx(0.1, abs=1e-12)
    assert -60 < np.degrees(value["knee_angle_r"]) < -20
    (note,) = [text for text in found.notes if "moves in squats.trc" in text]
    assert "give a trial of quiet standing" in note


def test_coordinates_are_counted_from_coordinates(tmp_path):
    person = from_recording.solve_kinematics(still(tmp_path, -0.3, "a.mot"))
    found = zero_pose.with_zero(person, still(tmp_path, -0.1)).from_zero()
    for name in COORDINATES:
        expected = -0.3 if name in PLACE else -0.2
        np.testing.assert_allclose(found.coordinate(name), expected, atol=1e-12)


def test_markers_are_no_zero_of_coordinates(tmp_path):
    person = from_recording.solve_kinematics(still(tmp_path, -0.3))
    with pytest.raises(LegsimError, match=r"squat_30\.trc: holds markers, but the recording joint"):
        zero_pose.with_zero(person, SQUAT)


@pytest.mark.parametrize("kind", ["markers", "coordinates"])
def test_a_model_of_the_user_has_a_zero_too(tmp_path, kind):
    model = osim.saved(tmp_path, osim.version_4(osim.two_legs(), markers=osim.MARKERS))
    leg = OsimLeg(osim_file.read(model))
    poses = [leg.posture(*np.radians(angles)) for angles in ((50, -70, 15), (5, -5, 0))]
    for name, pose in zip(("squat", "static"), poses, strict=True):
        values = np.tile(pose, (len(TIMES), 1))
        sites, _ = leg.marker_sites()
        places = leg.marker_positions(values, sites)
        trc.save(tmp_path / f"{name}.trc", MarkerTrajectories(TIMES, sites.names, places))
        opensim.save(
            tmp_path / f"{name}.mot", JointTrajectories(TIMES, leg.coordinate_names, values)
        )
    ending = "trc" if kind == "markers" else "mot"
    person = from_recording.solve_kinematics(tmp_path / f"squat.{ending}", model=model)
    found = zero_pose.with_zero(person, tmp_path / f"static.{ending}").from_zero()
    expected = dict(zip(leg.coordinate_names, poses[0] - poses[1], strict=True))
    for name in ("hip_a_r", "knee_angle_l"):
        # the weak prior toward the default moves angles by its share
        np.testing.assert_allclose(found.coordinate(name), expected[name], atol=1e-4)


def test_the_zero_has_the_knees_sign_of_the_movement(tmp_path):
    """Both trials count flexion positive; only the movement's knees bend enough to show it."""
    knees = [COORDINATES.index(f"knee_angle_{side}") for side in "rl"]
    for name, bend in (("move", 45 - 40 * np.cos(2 * np.pi * TIMES)), ("static", 8 + 0 * TIMES)):
        values = np.zeros((len(TIMES), len(COORDINATES)))
        values[:, knees] = np.radians(bend)[:, None]
        opensim.save(tmp_path / f"{name}.mot", JointTrajectories(TIMES, COORDINATES, values))
    person = from_recording.solve_kinematics(str(tmp_path / "move.mot"))
    found = zero_pose.with_zero(person, tmp_path / "static.mot")
    assert np.degrees(found.zero.values[knees]) == pytest.approx([-8, -8])
    assert np.degrees(found.from_zero().coordinate("knee_angle_r")[0]) == pytest.approx(3)
