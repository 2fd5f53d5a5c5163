"""The recordings in motions/: they are what their README says, physically possible, and like the
sway of people.
"""

import itertools
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import welch

from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import JOINT_CENTERS
from legsim.mocap import trajectories, trc
from tools.virtual_subjects import make as make_motions
from tools.virtual_subjects import plan as posture_plan
from tools.virtual_subjects import report as posture_report
from tools.virtual_subjects.body import SOLE_BELOW_CALCN, Body
from tools.virtual_subjects.controller import ControllerParams, DelayedFeedback, filtered_noise
from tools.virtual_subjects.simulation import simulate
from tools.virtual_subjects.statistics import (
    Sway,
    Truth,
    angular_velocity,
    bridged,
    count_squats,
    knee_flexion_deg,
    load_truth,
    sway,
)
from tools.virtual_subjects.subjects import SUBJECTS

ROOT = Path(__file__).parents[2]
MOTIONS = ROOT / "motions"
NAMES = [subject.name for subject in SUBJECTS]
HOLDS = {"squat_30": 30.0, "squat_60": 60.0}
TRIALS = [*HOLDS, "squats"]
each_recording = pytest.mark.parametrize(
    "name", [f"{subject}/{trial}" for subject in NAMES for trial in TRIALS]
)
each_hold = pytest.mark.parametrize(
    "name", [f"{subject}/{trial}" for subject in NAMES for trial in HOLDS]
)


@cache
def recording(name: str) -> trajectories.MarkerTrajectories:
    return trc.load(MOTIONS / f"{name}.trc")


@cache
def truth(name: str) -> Truth:
    return load_truth(str(MOTIONS / f"{name}_truth.npz"))


@cache
def measured(name: str) -> Sway:
    return sway(recording(name), truth(name))


# ---- the files are what they say
# ---------------------------------------------------------------------------------------------


@each_recording
def test_twenty_seconds_at_120_hz_of_seven_markers(name: str) -> None:
    motion = recording(name)
    assert motion.positions_world.shape == (2400, 7, 3)
    assert motion.rate_hz == pytest.approx(120.0, abs=1e-9)
    assert motion.marker_names == ("SACR", "RASI", "LASI", "RKNE", "LKNE", "RANK", "LANK")
    assert np.abs(motion.positions_world[np.isfinite(motion.positions_world)]).max() < 2.0


@each_recording
def test_labelled_synthetic(name: str) -> None:
    assert "synthetic" in (MOTIONS / f"{name}.trc").read_text().splitlines()[0]
    with np.load(MOTIONS / f"{name}_truth.npz") as stored:
        assert str(stored["note"]).startswith("synthetic")


@each_recording
def test_a_few_short_drop_outs(name: str) -> None:
    gone = np.isnan(recording(name).positions_world).any(-1)
    assert 0 < gone.sum() < 400
    starts = np.diff(gone.astype(int), axis=0) == 1
    assert starts.sum() <= 10
    assert not gone[:10].any()
    assert not gone[-10:].any()


def test_everything_stays_small() -> None:
    assert sum(path.stat().st_size for path in MOTIONS.rglob("*") if path.is_file()) < 12e6


def test_readme_holds_the_table_that_the_files_give() -> None:
    text = (MOTIONS / "README.md").read_text("utf-8")
    for row in (
        *posture_report.sway_table(MOTIONS),
        *posture_report.squat_table(MOTIONS),
        *posture_report.sensor_table(MOTIONS),
    ):
        assert row in text


def test_people_differ() -> None:
    for attribute, spread in (("height", 0.3), ("mass", 35.0), ("stance_width", 0.1)):
        values = [getattr(subject, attribute) for subject in SUBJECTS]
        assert np.ptp(values) > spread
        assert len(set(values)) == 7
    assert np.ptp([subject.thigh[1] / subject.shank[1] for subject in SUBJECTS]) > 0.01


# ---- the truth is physically possible
# ----------------------------------------------------------------------------------------


def heading(foot: np.ndarray) -> np.ndarray:
    """Turn (n,) rad of a foot (n, 4, 4) about the vertical."""
    return np.arctan2(-foot[:, 2, 0], foot[:, 0, 0])


@each_recording
def test_feet_stay_flat_on_the_floor(name: str) -> None:
    poses = truth(name).leg.segment_poses(truth(name).trajectories)
    subject = SUBJECTS[NAMES.index(name.split("/")[0])]
    for side in "rl":
        foot = poses.of(f"calcn_{side}")
        corners = np.array(
            [[-0.03, 0, 0.03], [-0.03, 0, -0.03], [0.2, 0, 0.04], [0.2, 0, -0.04]]
        ) - [
            0,
            SOLE_BELOW_CALCN * subject.foot[1],
            0,
        ]
        sole = np.einsum("nij,pj->npi", foot[:, :3, :3], corners) + foot[:, None, :3, 3]
        assert np.abs(sole[..., 1]).max() < 1e-4
        assert np.ptp(foot[:, :3, 3], axis=0).max() < 1e-5
        # a sole's skin shears, a foot does not pivot: by this angle a toe moves 4 mm
        turned = heading(foot)
        assert 0.2 < np.degrees(np.ptp(turned)) < 1.2


@each_recording
def test_joint_centers_are_those_of_the_leg_model(name: str) -> None:
    leg = truth(name).leg
    centers = leg.joint_centers(leg.segment_poses(truth(name).trajectories))
    assert centers.names == JOINT_CENTERS
    np.testing.assert_allclose(truth(name).joint_centers, centers.positions_world, atol=1e-5)


@each_recording
def test_feet_would_have_stayed_without_the_weld(name: str) -> None:
    with np.load(MOTIONS / f"{name}_truth.npz") as stored:
        hind, fore, inner, outer = stored["pressure_range_m"].T
        assert stored["friction"] < 0.5
    assert (hind > -0.03).all()
    assert (fore < 0.23).all()
    assert (inner > -0.04).all()
    assert (outer < 0.045).all()


@each_hold
def test_knees_are_bent_as_asked(name: str) -> None:
    np.testing.assert_allclose(measured(name).knee_flexion_deg, HOLDS[name.split("/")[1]], atol=2.0)


@each_hold
def test_joints_move_together_as_a_closed_chain(name: str) -> None:
    """Both feet on the floor leave six ways to move the pelvis and one way to turn each foot, and
    these decide all twelve joints of the legs.
    """
    found = truth(name).trajectories
    poses = truth(name).leg.segment_poses(found)
    joints = (
        "hip_flexion",
        "hip_adduction",
        "hip_rotation",
        "knee_angle",
        "ankle_angle",
        "subtalar_angle",
    )
    legs = np.stack([found.coordinate(f"{joint}_{side}") for joint in joints for side in "rl"], -1)
    pelvis = np.stack(
        [found.coordinate(c) for c in found.coordinate_names if c.startswith("pelvis")], -1
    )
    feet = np.stack([heading(poses.of(f"calcn_{side}")) for side in "rl"], -1)
    free = np.concatenate([pelvis, feet], -1)
    legs, free = legs - legs.mean(0), free - free.mean(0)
    assert (np.degrees(legs.std(0)) > 0.02).all()
    assert (np.degrees(legs.std(0)) < 1.5).all()
    # linear for so small a sway
    left = legs - free @ np.linalg.lstsq(free, legs, rcond=None)[0]
    assert (left.std(0) < 0.03 * legs.std(0).max()).all()


# ---- the sway is like people's
# -----------------------------------------------------------------------------------------------


@each_hold
def test_sway_lies_in_the_measured_ranges(name: str) -> None:
    found = measured(name)
    assert found.pelvis_std_mm.min() > 0.2
    assert found.pelvis_std_mm.max() < 3.5
    assert 2.0 < found.pelvis_speed_mm_s < 9.0
    assert found.marker_acceleration_mg.min() > 0.5
    assert found.marker_acceleration_mg.max() < 5.0
    assert found.shank_rate_deg_s.min() > 0.15
    assert found.shank_rate_deg_s.max() < 1.0


@pytest.mark.parametrize("subject", NAMES)
def test_a_deeper_squat_sways_more(subject: str) -> None:
    high, low = (measured(f"{subject}/{trial}") for trial in HOLDS)
    assert low.pelvis_speed_mm_s > high.pelvis_speed_mm_s
    assert low.marker_acceleration_mg.max() > high.marker_acceleration_mg.max()
    assert (low.shank_rate_deg_s > high.shank_rate_deg_s).all()


def test_a_deeper_squat_sways_wider_on_average() -> None:
    high, low = (
        np.mean([np.linalg.norm(measured(f"{s}/{trial}").pelvis_std_mm) for s in NAMES])
        for trial in HOLDS
    )
    assert low > 1.1 * high


@each_hold
def test_power_falls_with_frequency_without_a_limit_cycle(name: str) -> None:
    motion = recording(name)
    pelvis = 1e3 * bridged(motion)[:, :3].mean(1)
    frequency, power = welch(pelvis, 120.0, nperseg=1200, detrend="linear", axis=0)  # pyright: ignore[reportCallIssue]

    def band(low: float, high: float) -> np.ndarray:
        return np.asarray(power)[(frequency >= low) & (frequency < high)].mean(0)

    horizontal = [0, 2]
    steps = [band(0.1, 0.5), band(0.5, 1.2), band(1.2, 2.5), band(2.5, 5.0)]
    for coarse, fine in itertools.pairwise(steps):
        assert (coarse > 1.5 * fine)[horizontal].all()
    velocity = (power * frequency[:, None] ** 2)[1:]
    # a limit cycle would put most of the velocity into one bin of 0.1 Hz; a resonance may have a
    # good part
    assert (velocity[:50].max(0) / velocity[:50].sum(0)).max() < 0.5


@each_hold
def test_no_drift_out_of_the_scan(name: str) -> None:
    pelvis = bridged(recording(name))[:, :3].mean(1)
    assert np.linalg.norm(pelvis[-600:].mean(0) - pelvis[:600].mean(0)) < 8e-3
    assert np.ptp(pelvis, axis=0).max() < 0.02


@each_recording
def test_markers_follow_the_bones_but_for_skin_and_cameras(name: str) -> None:
    with np.load(MOTIONS / f"{name}_truth.npz") as stored:
        sites = MarkerSites(
            stored["marker_names"],
            tuple(stored["marker_segments"]),
            stored["marker_places_m"],
            np.ones(7),
        )
    values = truth(name).leg.values_of(truth(name).trajectories)
    error = recording(name).positions_world - truth(name).leg.marker_positions(values, sites)
    size = 1e3 * np.linalg.norm(error, axis=-1)
    assert np.nanmax(size) < 12.0
    # cameras: what changes from frame to frame and is too quick for a body
    jitter = 1e3 * np.nanstd(np.diff(error, 3, axis=0), axis=0) / np.sqrt(20)
    assert 0.035 < jitter.mean() < 0.05
    if not name.endswith("squats"):
        assert np.nanmax(np.nanstd(size, axis=0)) < 0.5


# ---- active squats
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("subject", NAMES)
def test_five_smooth_squats_from_stance_to_about_90_deg(subject: str) -> None:
    flexion = knee_flexion_deg(truth(f"{subject}/squats"))
    assert count_squats(flexion) == 5
    assert flexion[:60].max() < 12
    assert flexion.min() > 0
    assert 75 < flexion.max() < 105
    rate = np.gradient(flexion, 1 / 120)
    jerk = np.gradient(np.gradient(rate, 1 / 120), 1 / 120)
    assert np.abs(rate).max() < 180
    # minimum jerk: peak 60 amplitudes / duration^3, here 85 deg in 1.3 s
    assert np.abs(jerk).max() < 2 * 60 * 85 / 1.3**3


# ---- the machinery
# --------------------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(posture_plan, "DURATION", 0.1)
    body = Body(SUBJECTS[1])
    plan = posture_plan.hold(body, 30.0, np.random.default_rng(1))
    short = posture_plan.Plan(
        *(
            values[:60]
            for values in (plan.q, plan.v, plan.a, plan.torques, plan.mass_center, plan.push)
        )
    )
    monkeypatch.setattr("tools.virtual_subjects.simulation.WARM_UP", 0.0)
    first, again = (
        simulate(body, short, ControllerParams(), np.random.default_rng(3)) for _ in range(2)
    )
    assert np.array_equal(first.q, again.q)
    # with nothing but its own weight on it the floor carries the body
    weight = first.foot_force[:, :, 1].sum(1).mean()
    assert weight == pytest.approx(SUBJECTS[1].mass * 9.80665, rel=0.02)


def test_planned_torques_hold_the_posture_without_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(posture_plan, "DURATION", 0.5)
    monkeypatch.setattr(posture_plan, "WARM_UP", 0.0)
    monkeypatch.setattr("tools.virtual_subjects.simulation.WARM_UP", 0.0)
    body = Body(SUBJECTS[4])
    monkeypatch.setattr(posture_plan, "POSITION_SENSE", (0.0, 0.0))
    plan = posture_plan.hold(body, 60.0, np.random.default_rng(1))
    calm = ControllerParams(
        sensory_deg=0.0,
        motor_variation=0.0,
        motor_floor=0.0,
        unrest_floor=0.0,
        unrest_variation=0.0,
    )
    held = simulate(body, plan, calm, np.random.default_rng(0))
    assert np.abs(held.q - plan.q[0]).max() < 1e-6


def test_feet_turn_as_their_jacobian_says_and_a_planned_posture_leaves_them_unturned(
    rng: np.random.Generator,
) -> None:
    body = Body(SUBJECTS[2])
    posture = body.posture(np.radians(40.0))
    body.kinematics(posture)
    turned, jacobian = body.twists()
    np.testing.assert_allclose(turned, 0, atol=1e-9)
    step = 1e-4 * rng.standard_normal(body.size)
    body.kinematics(posture + step)
    # to second order in the step
    np.testing.assert_allclose(body.twists()[0], jacobian @ step, atol=1e-6)
    assert np.abs(jacobian @ step).max() > 1e-5


def test_a_sole_turns_back_by_its_stiffness(monkeypatch: pytest.MonkeyPatch) -> None:
    """The floor's moment on a foot about the vertical is a spring's and a damper's."""
    monkeypatch.setattr(posture_plan, "DURATION", 2.0)
    monkeypatch.setattr(posture_plan, "WARM_UP", 0.0)
    monkeypatch.setattr("tools.virtual_subjects.simulation.WARM_UP", 0.0)
    body, params = Body(SUBJECTS[0]), ControllerParams(unrest_floor=0.3)
    plan = posture_plan.hold(body, 30.0, np.random.default_rng(1))
    held = simulate(body, plan, params, np.random.default_rng(0))
    turns = []
    for row in held.q:
        body.kinematics(row)
        turns.append(body.twists()[0])
    turn, moment = np.array(turns), held.foot_force[:, :, 4]
    rate = np.gradient(turn, 1 / posture_plan.RATE, axis=0)
    stiffness = params.sole_stiffness * SUBJECTS[0].mass / 75.0
    expected = -stiffness * (turn + params.damping_time * rate)
    # the rate between two samples of the recording is not that of the last step before one
    assert np.std(moment - expected) < 0.1 * np.std(expected)


def test_feedback_answers_after_its_delay() -> None:
    params = ControllerParams()
    channel = DelayedFeedback(params, 1e-3)
    torque = np.array([channel(0.01, 0.0, 600.0, 1.0) for _ in range(2000)])
    assert np.flatnonzero(torque)[0] == pytest.approx(97, abs=2)
    assert torque[-1] == pytest.approx(-0.01 * 600.0 * params.proportional, rel=1e-3)


def test_noise_has_unit_variance_and_its_correlation_time(rng: np.random.Generator) -> None:
    noise = filtered_noise(rng, 200_000, 0.01, 0.5)
    assert noise.std() == pytest.approx(1.0, abs=0.05)
    # two equal poles: r(t) = (1 + t/T) exp(-t/T)
    assert np.mean(noise[50:] * noise[:-50]) == pytest.approx(2 * np.exp(-1), abs=0.06)


def test_angular_velocity_of_a_steady_turn() -> None:
    angle = 0.3 * np.arange(50) / 120
    turn = np.zeros((50, 3, 3))
    turn[:, 0, 0], turn[:, 0, 2], turn[:, 1, 1], turn[:, 2, 0], turn[:, 2, 2] = (
        np.cos(angle),
        np.sin(angle),
        1,
        -np.sin(angle),
        np.cos(angle),
    )
    np.testing.assert_allclose(
        angular_velocity(turn, 1 / 120)[1:-1], np.broadcast_to([0, 0.3, 0], (48, 3)), atol=1e-6
    )


@pytest.mark.slow
def test_the_tool_rebuilds_a_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(make_motions, "MOTIONS", tmp_path)
    make_motions.make(SUBJECTS[0], 1, ("squat_30",))
    rebuilt = trc.load(tmp_path / "subject01" / "squat_30.trc")
    kept = recording("subject01/squat_30")
    # another machine's rounding may show in the last digit, 0.01 mm
    np.testing.assert_allclose(rebuilt.positions_world, kept.positions_world, atol=1.1e-5)
