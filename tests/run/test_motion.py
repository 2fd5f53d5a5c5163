"""The recording of a run: known by its content, and solved as the settings say."""

from pathlib import Path

import numpy as np
import pytest

from legsim.config import MotionConfig, TremorConfig, load_settings
from legsim.core.errors import LegsimError
from legsim.kinematics.ik_options import (
    CoordinateLock,
    CoordinateTask,
    IkOptions,
    PriorStrengths,
)
from legsim.kinematics.leg_model import COORDINATES
from legsim.mocap import opensim
from legsim.mocap.trajectories import JointTrajectories
from legsim.run import motion
from tests.examples import osim, task_sets


def recording(path: Path, bend: float, seconds: int = 1) -> MotionConfig:
    """A file of a bent knee, and the settings that name it."""
    values = np.where([name.startswith("knee") for name in COORDINATES], bend, 0.0)
    count = 60 * seconds
    still = JointTrajectories(np.arange(count) / 60, COORDINATES, np.tile(values, (count, 1)))
    opensim.save(path, still)
    return MotionConfig(file=str(path))


def test_a_recording_is_known_by_its_content_whatever_its_name(tmp_path):
    first, other = (recording(tmp_path / f"{n}.mot", -0.5) for n in "ab")
    before = motion.fingerprint(first)
    (tmp_path / "b.mot").write_bytes((tmp_path / "a.mot").read_bytes())
    assert motion.fingerprint(other) == before
    assert motion.fingerprint(recording(tmp_path / "a.mot", -0.6)) != before


def test_settings_are_passed_on(tmp_path):
    plain = motion.solve(recording(tmp_path / "a.mot", -0.5))
    np.testing.assert_allclose(plain.trajectories.coordinate("knee_angle_l"), -0.5, atol=1e-12)
    assert plain.fit is None


def test_a_model_and_scales_are_passed_on_and_known_by_their_content(tmp_path):
    text = osim.version_4(osim.two_legs())
    model = osim.saved(tmp_path, text)
    scales = tmp_path / "s.xml"
    scale = "<Scale><scales>1 {} 1</scales><segment>femur_l</segment></Scale>"
    scales.write_text(f"<OpenSimDocument>{scale.format(1.2)}</OpenSimDocument>")
    settings = recording(tmp_path / "a.mot", -0.5).model_copy(
        update={"model": str(model), "scale_file": str(scales)}
    )
    assert motion.solve(settings).leg.thigh_length("l") == pytest.approx(1.2 * 0.41)
    before = motion.fingerprint(settings)
    scales.write_text(f"<OpenSimDocument>{scale.format(1.31)}</OpenSimDocument>")
    scaled = motion.fingerprint(settings)
    osim.saved(tmp_path, text.replace("-0.41", "-0.4155"))
    assert len({*before, *scaled, *motion.fingerprint(settings)}) == 5
    marked = settings.model_copy(update={"marker_set": str(scales)})
    assert len(motion.fingerprint(marked)) == len(motion.fingerprint(settings)) + 1


def test_a_tremor_moves_the_bones_and_is_reported(tmp_path):
    settings = recording(tmp_path / "a.mot", -0.5, seconds=4)
    still = motion.solve(settings)
    tremor = TremorConfig(acceleration_mg=2.0, seed=3)
    shaken, again, other = (
        motion.solve(settings.model_copy(update={"tremor": each}))
        for each in (tremor, tremor, tremor.model_copy(update={"seed": 4}))
    )
    assert np.ptp(still.trajectories.coordinate("knee_angle_l")) < 1e-9
    knee = np.degrees(shaken.trajectories.coordinate("knee_angle_l"))
    assert 1e-4 < knee.std() < 1e-2
    assert "a tremor of 2 mg at 8-12 Hz was added" in shaken.notes
    np.testing.assert_array_equal(again.trajectories.values, shaken.trajectories.values)
    assert not np.array_equal(other.trajectories.values, shaken.trajectories.values)


def test_a_model_whose_knees_cannot_move_over_its_feet_has_no_tremor(tmp_path):
    model = osim.saved(tmp_path, osim.version_4(osim.two_legs()))
    settings = recording(tmp_path / "a.mot", -0.5, seconds=4).model_copy(
        update={"model": str(model), "tremor": TremorConfig(acceleration_mg=2.0)}
    )
    with pytest.raises(LegsimError, match="leave the knees no way to move"):
        motion.solve(settings)


@pytest.mark.parametrize("count", [1, 5])
def test_a_recording_too_short_for_accelerations_is_named(tmp_path, count):
    still = np.zeros((count, len(COORDINATES)))
    file = tmp_path / "short.mot"
    opensim.save(file, JointTrajectories(np.arange(count) / 60, COORDINATES, still))
    with pytest.raises(LegsimError, match=rf"short\.mot: holds {count} samples? .* need 6; record"):
        motion.solve(MotionConfig(file=str(file)))


def test_settings_of_inverse_kinematics_are_in_si(tmp_path):
    (tmp_path / "c.toml").write_text(
        """
        [motion.ik]
        tasks_file = "t.xml"
        [motion.ik.marker_weights]
        heel_r = 10
        R.Knee.Med = 0
        "L.Knee.Med" = 0.5
        [motion.ik.tasks]
        knee_angle_r = { weight = 2, value_deg = -90 }
        mtp_angle_r = { weight = 3 }
        [motion.ik.locked]
        pelvis_tz = { value_mm = 20 }
        mtp_angle_l = {}
        [motion.ik.priors]
        flat_foot = 0
        """
    )
    settings = load_settings(
        tmp_path / "c.toml", overrides=("motion.ik.marker_weights.R.Heel=4",)
    ).motion
    assert motion.ik_options(settings.ik) == IkOptions(
        tasks_file="t.xml",
        marker_weights={"heel_r": 10, "R.Knee.Med": 0, "L.Knee.Med": 0.5, "R.Heel": 4},
        tasks=(
            CoordinateTask("knee_angle_r", 2.0, -np.pi / 2, "rad"),
            CoordinateTask("mtp_angle_r", 3.0),
        ),
        locked=(CoordinateLock("pelvis_tz", 0.02, "m"), CoordinateLock("mtp_angle_l")),
        strengths=PriorStrengths(flat_foot=0),
    )
    assert motion.ik_options(MotionConfig().ik) == IkOptions()


def test_locks_may_be_a_list():
    settings = load_settings(overrides=('motion.ik.locked=["mtp_angle_r", "mtp_angle_l"]',))
    locked = motion.ik_options(settings.motion.ik).locked
    assert locked == (CoordinateLock("mtp_angle_r"), CoordinateLock("mtp_angle_l"))
    one = load_settings(overrides=("motion.ik.locked=mtp_angle_r",))
    assert motion.ik_options(one.motion.ik).locked == locked[:1]


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("motion.ik.marker_weights.heel_r=-1", "weight of marker heel_r is -1"),
        ("motion.ik.marker_weights.heel_r=many", "valid number"),
        ("motion.ik.tasks.knee_angle_r={value_deg=3}", r"tasks.knee_angle_r.weight.*required"),
        ("motion.ik.tasks.knee_angle_r={weight=1, value_deg=3, value_mm=3}", "not both"),
        ("motion.ik.tasks.knee_angle_r={weight=1, value=3}", "unknown key; valid here: value_deg"),
        ("motion.ik.priors.toes=-1", "greater than or equal to 0"),
        ("motion.ik.prior.toes=1", "unknown key; valid here: tasks_file"),
    ],
)
def test_settings_of_inverse_kinematics_that_cannot_be_are_refused(override, said):
    with pytest.raises(LegsimError, match=said):
        motion.ik_options(load_settings(overrides=(override,)).motion.ik)


def test_a_recording_is_known_by_its_tasks_too(tmp_path):
    inner, setup = tmp_path / "inner.xml", tmp_path / "setup.xml"
    inner.write_text(task_sets.document(task_sets.task_set(task_sets.marker("RHEE", 1))))
    tool = '<InverseKinematicsTool><IKTaskSet file="inner.xml"/></InverseKinematicsTool>'
    setup.write_text(task_sets.document(tool))
    settings = MotionConfig(file="subject01/squat_60.trc", ik={"tasks_file": str(setup)})
    plain, before = motion.fingerprint(MotionConfig()), motion.fingerprint(settings)
    assert before[: len(plain)] == plain
    assert len(before) == len(plain) + 2
    inner.write_text(task_sets.document(task_sets.task_set(task_sets.marker("RHEE", 2.5))))
    assert motion.fingerprint(settings)[:-1] == before[:-1]
    assert motion.fingerprint(settings)[-1] != before[-1]


def test_a_zero_is_passed_on_and_known_by_its_content(tmp_path):
    settings = recording(tmp_path / "a.mot", -0.5)
    recording(tmp_path / "static.mot", -0.1)
    zeroed = settings.model_copy(update={"zero_file": str(tmp_path / "static.mot")})
    person = motion.solve(zeroed)
    np.testing.assert_array_equal(
        person.trajectories.values, motion.solve(settings).trajectories.values
    )
    np.testing.assert_allclose(person.from_zero().coordinate("knee_angle_r"), -0.4, atol=1e-12)
    before = motion.fingerprint(zeroed)
    assert len(before) == len(motion.fingerprint(settings)) + 1
    recording(tmp_path / "static.mot", -0.2)
    assert motion.fingerprint(zeroed) != before
