import numpy as np
import pytest

from legsim.config import MotionConfig
from legsim.core.errors import LegsimError
from legsim.kinematics import from_recording
from legsim.mocap import opensim, trc
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories
from legsim.run import motion as run_motion
from tools.experiments import recovery_errors as recovery_errors

SQUAT = "subject01/squat_30.trc"


@pytest.fixture(scope="module")
def squat() -> MarkerTrajectories:
    return trc.load(from_recording.find_recording(SQUAT))


@pytest.fixture(scope="module")
def solved() -> JointTrajectories:
    """Coordinates of a held squat."""
    return from_recording.solve_kinematics(SQUAT).trajectories


def saved(folder, motion: MarkerTrajectories, name="moved.trc") -> MotionConfig:
    trc.save(folder / name, motion)
    return MotionConfig(file=str(folder / name))


def short(motion: MarkerTrajectories, count: int = 240) -> MarkerTrajectories:
    return MarkerTrajectories(
        motion.times[:count], motion.marker_names, motion.positions_world[:count]
    )


def test_a_shipped_recording_becomes_a_bent_knee():
    recovered = from_recording.solve_kinematics(SQUAT)
    bend = -np.degrees(recovered.trajectories.coordinate("knee_angle_l"))
    assert 20 < bend.mean() < 40
    assert recovered.fit is not None
    assert recovered.fit.ik.rms < 5e-3
    assert recovered.fit.scaled_from == "squats.trc"
    assert any("RMS" in line for line in recovered.lines())
    assert {m["role"] for m in recovered.summary()["markers"]} >= {"sacrum", "epicondyle_lateral_l"}


def test_coordinates_are_taken_as_they_are(tmp_path):
    recovered = from_recording.solve_kinematics(SQUAT)
    opensim.save(tmp_path / "c.mot", recovered.trajectories)
    again = from_recording.solve_kinematics(str(tmp_path / "c.mot"))
    np.testing.assert_array_equal(again.trajectories.values, recovered.trajectories.values)
    assert again.fit is None


def test_flexion_positive_coordinates_are_turned_to_the_models_sign(tmp_path):
    recovered = from_recording.solve_kinematics(SQUAT)
    names = recovered.trajectories.coordinate_names
    flipped = recovered.trajectories.values.copy()
    flipped[:, [names.index("knee_angle_r"), names.index("knee_angle_l")]] *= -1
    opensim.save(
        tmp_path / "c.mot", JointTrajectories(recovered.trajectories.times, names, flipped)
    )
    again = from_recording.solve_kinematics(str(tmp_path / "c.mot"))
    np.testing.assert_array_equal(again.trajectories.values, recovered.trajectories.values)
    assert any("positive in flexion" in line for line in again.lines())


def test_filtering_coordinates_on_request_removes_what_is_fast(tmp_path):
    recovered = from_recording.solve_kinematics(SQUAT)
    shaken = (
        recovered.trajectories.values
        + 0.01 * np.sin(2 * np.pi * 25 * recovered.trajectories.times)[:, None]
    )
    opensim.save(
        tmp_path / "c.mot",
        JointTrajectories(
            recovered.trajectories.times, recovered.trajectories.coordinate_names, shaken
        ),
    )
    calm = run_motion.solve(MotionConfig(file=str(tmp_path / "c.mot")), filter_coordinates=True)
    assert np.abs(calm.trajectories.values - recovered.trajectories.values)[60:-60].max() < 1e-3


def test_a_real_mot_of_opensim_opens(shared_data):
    recovered = from_recording.solve_kinematics(
        str(shared_data / "mocap/squats_subject4/squats1_manual_scaling_ik.mot")
    )
    assert np.degrees(recovered.trajectories.coordinate("knee_angle_r").min()) < -90


@pytest.mark.parametrize("name", ["nowhere.trc", "subject99/squat_30.trc"])
def test_a_missing_file_is_named(name):
    with pytest.raises(LegsimError, match=r"no such motion file, here or among the shipped ones"):
        from_recording.solve_kinematics(name)


def test_what_is_no_trc_is_refused(tmp_path):
    (tmp_path / "a.trc").write_text("hello\n")
    with pytest.raises(LegsimError, match=r"a\.trc") as caught:
        from_recording.solve_kinematics(str(tmp_path / "a.trc"))
    assert "\n" not in str(caught.value)


def test_a_leg_of_a_kilometer_is_refused_with_its_unit(tmp_path, squat):
    config = saved(
        tmp_path, MarkerTrajectories(squat.times, squat.marker_names, 1000 * squat.positions_world)
    )
    with pytest.raises(LegsimError, match=r"moved\.trc.*unit"):
        run_motion.solve(config)


def test_a_role_without_a_marker_is_named(tmp_path, squat):
    kept = [k for k, name in enumerate(squat.marker_names) if name != "LKNE"]
    config = saved(
        tmp_path,
        MarkerTrajectories(
            squat.times, tuple(squat.marker_names[k] for k in kept), squat.positions_world[:, kept]
        ),
    )
    with pytest.raises(LegsimError, match=r"moved\.trc.*epicondyle_lateral_l"):
        run_motion.solve(config)


def test_a_trial_scaled_from_another_does_without_what_only_scaling_needs(tmp_path, squat):
    """One side's ankle alone: refused by itself, solved where another recording gives the
    lengths.
    """
    kept = [k for k, name in enumerate(squat.marker_names) if name != "RANK"]
    cut = short(squat)
    lacking = saved(
        tmp_path,
        MarkerTrajectories(
            cut.times, tuple(squat.marker_names[k] for k in kept), cut.positions_world[:, kept]
        ),
    )
    with pytest.raises(LegsimError, match=r"moved\.trc.*malleolus_lateral_r"):
        run_motion.solve(lacking)
    recovered = run_motion.solve(lacking.model_copy(update={"scaling_file": SQUAT}))
    assert recovered.fit is not None
    assert recovered.fit.scaled_from == "squat_30.trc"
    whole = run_motion.solve(
        saved(tmp_path, cut, "whole.trc").model_copy(update={"scaling_file": SQUAT})
    )
    np.testing.assert_array_equal(recovered.leg.scales.factors, whole.leg.scales.factors)
    np.testing.assert_allclose(
        recovered.trajectories.coordinate("knee_angle_l"),
        whole.trajectories.coordinate("knee_angle_l"),
        atol=0.02,
    )


def test_scaling_from_active_squats_finds_joint_centers_at_least_as_well():
    by_squats, by_itself = (
        errors_of("subject05/squat_60", file) for file in ("", "subject05/squat_60.trc")
    )
    assert max(by_squats.centers_mm) < 8.0
    assert np.linalg.norm(by_squats.centers_mm) < np.linalg.norm(by_itself.centers_mm)
    assert max(by_squats.knees_deg) < max(by_itself.knees_deg)


@pytest.mark.slow
def test_the_knees_of_the_held_squats_are_found():
    """As docs/biomechanics.md has it: one knee of 28 beyond 1 degree, which the place of one marker
    explains.
    """
    names = [f"subject{subject:02d}/squat_{bend}" for subject in range(1, 8) for bend in (30, 60)]
    found = [errors_of(name) for name in names]
    knees, centers = np.array([f.knees_deg for f in found]), np.array([f.centers_mm for f in found])
    assert (knees > 1).sum() <= 1
    assert np.sqrt(np.mean(knees**2)) < 0.55
    assert (np.sqrt(np.mean(centers**2, 0)) < (3.0, 4.0, 4.0)).all()


def errors_of(name: str, scaling_file: str = "") -> recovery_errors.Errors:
    found, _ = recovery_errors.recovered(name, scaling_file)
    return recovery_errors.errors(recovery_errors.truth_of(name), found.leg, found.trajectories)


def test_only_shipped_held_squats_are_scaled_from_the_squats_beside_them(tmp_path, squat):
    """A person's own squat_1.trc beside a squats.trc is taken as it is."""
    saved(tmp_path, short(squat), "squats.trc")
    recovered = run_motion.solve(saved(tmp_path, short(squat), "squat_1.trc"))
    assert recovered.fit is not None
    assert recovered.fit.scaled_from == "squat_1.trc"


def test_a_marker_that_is_never_seen_is_named(tmp_path, squat):
    positions = short(squat).positions_world.copy()
    positions[:, squat.marker_names.index("LKNE")] = np.nan
    config = saved(tmp_path, MarkerTrajectories(short(squat).times, squat.marker_names, positions))
    with pytest.raises(LegsimError, match=r"moved\.trc.*LKNE|moved\.trc.*epicondyle_lateral_l"):
        run_motion.solve(config)


def test_degrees_that_the_header_calls_radians_are_refused(tmp_path, solved):
    values = np.degrees(solved.values)
    opensim.save(
        tmp_path / "c.mot", JointTrajectories(solved.times, solved.coordinate_names, values)
    )
    with pytest.raises(
        LegsimError,
        match=(
            r"c\.mot \(coordinates\): hip_flexion_r is \d+ degrees at 0 s, .* write "
            r"inDegrees=yes"
        ),
    ):
        from_recording.solve_kinematics(str(tmp_path / "c.mot"))


def test_a_model_without_subtalar_and_toe_joints_is_read_with_them_at_zero(tmp_path, solved):
    kept = [
        k
        for k, name in enumerate(solved.coordinate_names)
        if not name.startswith(("subtalar", "mtp"))
    ]
    opensim.save(
        tmp_path / "c.mot",
        JointTrajectories(
            solved.times, tuple(solved.coordinate_names[k] for k in kept), solved.values[:, kept]
        ),
    )
    recovered = from_recording.solve_kinematics(str(tmp_path / "c.mot"))
    assert recovered.trajectories.coordinate_names == solved.coordinate_names
    np.testing.assert_array_equal(recovered.trajectories.values[:, kept], solved.values[:, kept])
    assert not np.delete(recovered.trajectories.values, kept, 1).any()
    assert any(
        "no subtalar_angle_r, mtp_angle_r, subtalar_angle_l, mtp_angle_l: taken as 0" in line
        for line in recovered.lines()
    )


def test_samples_left_out_of_coordinates_are_told(tmp_path, solved):
    kept = np.delete(np.arange(len(solved.times)), np.arange(100, 130))
    opensim.save(
        tmp_path / "c.mot",
        JointTrajectories(solved.times[kept], solved.coordinate_names, solved.values[kept]),
    )
    recovered = from_recording.solve_kinematics(str(tmp_path / "c.mot"))
    assert recovered.notes[1:] == (
        "0.258 s are missing after 0.825 s (elsewhere a sample every 0.00833 s): bridged by "
        "splines",
    )


def test_coordinates_that_are_not_a_legs_are_refused(tmp_path):
    opensim.save(
        tmp_path / "c.mot", JointTrajectories(np.arange(5.0), ("elbow",), np.zeros((5, 1)))
    )
    with pytest.raises(LegsimError, match=r"c\.mot: the motion has no coordinate pelvis_tilt"):
        from_recording.solve_kinematics(str(tmp_path / "c.mot"))
