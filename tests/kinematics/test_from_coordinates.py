"""Coordinates of a file become a person who moves: completed, checked, in the model's signs."""

import re

import numpy as np
import pytest

from legsim.config import MotionConfig
from legsim.core.errors import LegsimError
from legsim.kinematics import from_recording
from legsim.mocap import opensim
from legsim.mocap.trajectories import JointTrajectories
from legsim.run import motion as run_motion

SQUAT = "subject01/squat_30.trc"


@pytest.fixture(scope="module")
def solved() -> JointTrajectories:
    """Coordinates of a held squat."""
    return from_recording.solve_kinematics(SQUAT).trajectories


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


def test_knees_that_count_flexion_in_opposite_ways_are_refused(tmp_path, solved):
    """One of them would bend forwards, whichever way both are turned."""
    values = np.array(solved.values)
    values[:, solved.coordinate_names.index("knee_angle_r")] *= -1
    motion = JointTrajectories(solved.times, solved.coordinate_names, values)
    opensim.save(tmp_path / "c.mot", motion)
    with pytest.raises(LegsimError, match=r"knee_angle_r reaches .* and knee_angle_l -.*forwards"):
        from_recording.solve_kinematics(str(tmp_path / "c.mot"))


@pytest.mark.parametrize(("sign", "turned"), [(1, False), (-1, True)])
def test_bent_knees_tell_their_sign_beside_a_patella(tmp_path, solved, sign, turned):
    """A patella's coordinate decides for straight knees alone."""
    names = (*solved.coordinate_names, "knee_angle_r_beta")
    knees = [names.index("knee_angle_r"), names.index("knee_angle_l")]
    values = np.column_stack([solved.values, np.abs(solved.values[:, knees[0]])])
    values[:, knees] *= sign
    opensim.save(tmp_path / "c.mot", JointTrajectories(solved.times, names, values))
    again = from_recording.solve_kinematics(str(tmp_path / "c.mot"))
    np.testing.assert_array_equal(again.trajectories.values, solved.values)
    assert any("positive in flexion" in line for line in again.notes) == turned


def standing(folder, knee_deg: float, *, flat: bool = True, patella: bool = False) -> str:
    """A file of somebody who stands with both knees at an angle, on flat feet or without ankles."""
    times = np.arange(60) / 60
    ankle = -5.0 - knee_deg
    joints = {"hip_flexion": 5.0, "knee_angle": knee_deg}
    angles = {f"{joint}_{side}": angle for joint, angle in joints.items() for side in "rl"}
    angles["pelvis_tilt"] = 0.0
    if flat:
        angles |= {f"ankle_angle_{side}": ankle for side in "rl"}
    if patella:
        angles["knee_angle_r_beta"] = knee_deg
    sway = np.radians(0.5) * np.sin(times)
    values = np.stack([np.radians(angle) + sway for angle in angles.values()], 1)
    opensim.save(folder / "s.mot", JointTrajectories(times, tuple(angles), values))
    return str(folder / "s.mot")


@pytest.mark.parametrize("knee_deg", [-12.0, -3.0])
def test_straight_knees_in_gait2392s_sign_stay_so_beside_a_patella(tmp_path, knee_deg):
    """Legsim's own exported model has a patella's coordinate too."""
    found = from_recording.solve_kinematics(standing(tmp_path, knee_deg, patella=True))
    middle = np.degrees(np.median(found.trajectories.coordinate("knee_angle_r")))
    assert middle == pytest.approx(knee_deg, abs=0.5)
    assert not any("positive in flexion" in note for note in found.notes)


def test_a_patella_decides_the_sign_of_straight_knees(tmp_path):
    found = from_recording.solve_kinematics(standing(tmp_path, 3.0, patella=True))
    middle = np.degrees(np.median(found.trajectories.coordinate("knee_angle_r")))
    assert middle == pytest.approx(-3.0, abs=0.5)
    assert any("positive in flexion" in note for note in found.notes)


def test_flat_feet_tell_flexion_from_overextension(tmp_path):
    """Twelve degrees either way, as quiet standing has; knees decide with ankles and hips."""
    over = from_recording.solve_kinematics(standing(tmp_path, 12.0))
    assert np.degrees(over.trajectories.coordinate("knee_angle_r")).mean() > 11
    assert not any("flexion" in note for note in over.notes)
    path = standing(tmp_path, -12.0)
    bent = opensim.load(path)
    names = bent.coordinate_names
    values = np.array(bent.values)
    values[:, [names.index("knee_angle_r"), names.index("knee_angle_l")]] *= -1
    opensim.save(path, JointTrajectories(bent.times, names, values))
    found = from_recording.solve_kinematics(path)
    assert np.degrees(found.trajectories.coordinate("knee_angle_r")).mean() < -11
    assert any("positive in flexion" in note for note in found.notes)


def test_knees_that_may_be_overextended_or_of_the_other_sign_are_warned_of(tmp_path):
    found = from_recording.solve_kinematics(standing(tmp_path, 12.0, flat=False))
    assert np.degrees(found.trajectories.coordinate("knee_angle_r")).mean() > 11
    assert any(
        note.startswith("warning: both knees are overextended, by 12 deg") for note in found.notes
    )
    calm = from_recording.solve_kinematics(standing(tmp_path, 4.0, flat=False))
    assert not any("overextended" in note for note in calm.notes)


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


def test_samples_left_out_of_coordinates_are_reported(tmp_path, solved):
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


def test_one_sample_left_out_is_reported_and_a_varying_rate_is_no_gap(tmp_path, solved):
    def note(kept):
        motion = JointTrajectories(solved.times[kept], solved.coordinate_names, solved.values[kept])
        opensim.save(tmp_path / "c.mot", motion)
        return from_recording.solve_kinematics(str(tmp_path / "c.mot")).notes[1:]

    rows = np.arange(600)
    assert note(rows) == ()
    (one,) = note(np.delete(rows, 300))
    assert one.startswith("0.0167 s are missing after 2.49167 s")
    (two,) = note(np.delete(rows, [100, 300, 301]))
    assert "after 2.49167 s" in two
    assert "and 1 more gap:" in two
    varying = np.r_[rows[:300], rows[300::2]]
    assert note(varying) == ("the samples are 0.00833 to 0.0167 s apart, bridged by splines",)


def partial(folder, solved: JointTrajectories, names) -> str:
    """A file of some coordinates only."""
    columns = np.stack([solved.coordinate(name) for name in names], 1)
    opensim.save(folder / "c.mot", JointTrajectories(solved.times, tuple(names), columns))
    return str(folder / "c.mot")


def test_a_planar_motion_has_the_other_coordinates_at_their_defaults(tmp_path, solved):
    planar = [
        *("pelvis_tilt", "pelvis_tx"),
        *(f"{joint}_{side}" for joint in ("hip_flexion", "knee_angle") for side in "rl"),
    ]
    found = from_recording.solve_kinematics(partial(tmp_path, solved, planar))
    for name in planar:
        np.testing.assert_array_equal(
            found.trajectories.coordinate(name), solved.coordinate(name), err_msg=name
        )
    others = [name for name in solved.coordinate_names if name not in planar]
    defaults = dict(zip(found.leg.coordinate_names, found.leg.default_coordinates, strict=True))
    for name in others:
        assert (found.trajectories.coordinate(name) == defaults[name]).all()
    assert defaults["pelvis_ty"] > 0.9
    note = next(note for note in found.notes if note.startswith("the file has no pelvis_list"))
    assert all(name in note for name in others)
    assert f"pelvis_ty {defaults['pelvis_ty']:g} m" in note


@pytest.mark.parametrize("changes", [
    {"marker_map": "cast"}, {"up": "z"}, {"longest_gap": 1.0}, {"filter_hz": 3.0},
])  # fmt: skip
def test_what_is_said_of_markers_is_refused_for_coordinates(tmp_path, solved, changes):
    file = partial(tmp_path, solved, solved.coordinate_names)
    with pytest.raises(LegsimError, match=r"c\.mot: holds joint coordinates.*cannot apply; leave"):
        from_recording.solve_kinematics(file, **changes)


def test_the_units_of_coordinates_can_be_given(tmp_path, solved):
    values = np.array(solved.values)
    values[:, 3:6] *= 1000
    motion = JointTrajectories(solved.times, solved.coordinate_names, values)
    opensim.save(tmp_path / "c.mot", motion)
    config = MotionConfig(file=str(tmp_path / "c.mot"), unit="mm", angles="radians")
    found = run_motion.solve(config).trajectories
    np.testing.assert_allclose(found.values, solved.values, atol=1e-14)
    with pytest.raises(LegsimError, match=r"motion\.unit=mm"):
        run_motion.solve(config.model_copy(update={"unit": "file"}))


def test_coordinates_that_are_not_a_legs_are_refused(tmp_path):
    opensim.save(
        tmp_path / "c.mot", JointTrajectories(np.arange(5.0), ("elbow",), np.zeros((5, 1)))
    )
    with pytest.raises(
        LegsimError, match=r"c\.mot \(column names\): has no coordinate of the leg among elbow"
    ):
        from_recording.solve_kinematics(str(tmp_path / "c.mot"))


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("knee_angle_r", "knee_flex_r"),
        ("hip_flexion_l", "hip_flex_l"),
        ("ankle_angle_r", "ankle_dorsiflexion_r"),
        ("knee_angle_l", "LKneeAngles_X"),
        ("knee_angle_r", "RightKneeFlexion"),
        ("knee_angle_r", "r_knee"),
        ("knee_angle_r", "tib_fem_r"),
        ("hip_flexion_r", "hip_r_rx"),
        ("pelvis_tilt", "pelvis_rx"),
        ("pelvis_list", "pelvis_obliquity"),
        ("pelvis_tx", "pelvis_x"),
        ("pelvis_ty", "pelvis_height"),
    ],
)
def test_a_flexion_of_another_name_is_not_taken_for_a_stiff_joint(tmp_path, solved, name, other):
    names = tuple(other if k == name else k for k in solved.coordinate_names)
    opensim.save(tmp_path / "c.mot", JointTrajectories(solved.times, names, solved.values))
    with pytest.raises(LegsimError, match=f"has no {name}, but {other}.* by --model, or name"):
        from_recording.solve_kinematics(str(tmp_path / "c.mot"))


@pytest.mark.parametrize(("name", "other"), [
    ("pelvis_tx", "pelvis_obliquity"),
    ("pelvis_tilt", "pelvis_obliquity"),
    ("pelvis_list", "pelvis_translation_x"),
    ("knee_angle_r", "knee_r_tx"),
    ("knee_angle_r", "knee_contact_r_fx"),
    ("knee_angle_l", "knee_jrf_l"),
    ("knee_angle_r", "knee_cop_r"),
    ("knee_angle_l", "left_knee_RMS"),
    ("pelvis_tilt", "pelvis_marker_error"),
    ("hip_flexion_r", "hip_r_on_femur_in_ground_fx"),
])  # fmt: skip
def test_a_load_an_error_or_the_other_kind_is_not_offered_for_a_coordinate(
    tmp_path, solved, name, other
):
    names = tuple(other if k == name else k for k in solved.coordinate_names)
    opensim.save(tmp_path / "c.mot", JointTrajectories(solved.times, names, solved.values))
    notes = from_recording.solve_kinematics(str(tmp_path / "c.mot")).notes
    assert any(f"has no {name}: taken as" in note for note in notes)
    assert any(f"no coordinates of the leg: {other}" in note for note in notes)


@pytest.mark.parametrize(
    ("name", "turn"), [("pelvis_list", np.pi), ("pelvis_tilt", -np.pi), ("pelvis_tilt", 2.6)]
)
def test_who_hangs_head_down_is_refused(tmp_path, solved, name, turn):
    values = solved.values.copy()
    values[:, solved.coordinate_names.index(name)] += turn
    opensim.save(
        tmp_path / "c.mot", JointTrajectories(solved.times, solved.coordinate_names, values)
    )
    with pytest.raises(LegsimError, match=r"pose.: the pelvis is 0\.\d+ m below the feet.* y up"):
        from_recording.solve_kinematics(str(tmp_path / "c.mot"))


@pytest.mark.parametrize(("tilt", "flexion"), [(90, 70), (60, 90), (100, 90)])
def test_who_raises_the_legs_on_the_back_is_warned_of(tmp_path, solved, tilt, flexion):
    values = np.zeros_like(solved.values)
    values[:, solved.coordinate_names.index("pelvis_ty")] = 0.1
    values[:, solved.coordinate_names.index("pelvis_tilt")] = np.radians(tilt)
    for side in "rl":
        values[:, solved.coordinate_names.index(f"hip_flexion_{side}")] = np.radians(flexion)
    opensim.save(
        tmp_path / "c.mot", JointTrajectories(solved.times, solved.coordinate_names, values)
    )
    notes = from_recording.solve_kinematics(str(tmp_path / "c.mot")).notes
    assert any(re.search(r"the pelvis is \d+ cm below the feet, .* lies", note) for note in notes)


def test_who_lies_is_reported_and_who_stands_is_not(tmp_path, solved):
    values = solved.values.copy()
    for turn, said in ((0.0, False), (0.4, False), (np.pi / 2, True)):
        values[:, solved.coordinate_names.index("pelvis_tilt")] = turn
        opensim.save(
            tmp_path / "c.mot", JointTrajectories(solved.times, solved.coordinate_names, values)
        )
        notes = from_recording.solve_kinematics(str(tmp_path / "c.mot")).notes
        assert any("somebody lies or sits" in note for note in notes) == said


@pytest.mark.parametrize("other", ["knee_moment_r", "knee_angle_l_beta", "wrist_r", "hip_force_l"])
def test_a_column_that_is_no_such_angle_is_only_mentioned(tmp_path, solved, other):
    kept = [k for k, n in enumerate(solved.coordinate_names) if n != "ankle_angle_r"]
    names = (*(solved.coordinate_names[k] for k in kept), other)
    values = np.hstack([solved.values[:, kept], np.zeros((len(solved.times), 1))])
    opensim.save(tmp_path / "c.mot", JointTrajectories(solved.times, names, values))
    notes = from_recording.solve_kinematics(str(tmp_path / "c.mot")).notes
    assert any("has no ankle_angle_r: taken as 0" in note for note in notes)
