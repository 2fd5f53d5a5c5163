"""A person's leg and markers found together with the poses: exact where the markers tell, calm where
they do not.
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from legsim.config import ImuConfig, MotionConfig
from legsim.core.values import FloatArray
from legsim.kinematics import (
    from_recording,
    inverse_kinematics,
    marker_sites,
    registration,
    scaling,
)
from legsim.kinematics._registration_model import PersonModel
from legsim.kinematics.ik_options import IkOptions
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.marker_sites import MarkerSites
from legsim.mocap.labels import PAPER_ROLES
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories
from legsim.run import motion as run_motion
from legsim.run import sensors as run_sensors

GENERIC = LegModel.load()
SITES = marker_sites.load()


def squats(n: int = 120, depth_deg: float = 95.0) -> FloatArray:
    """Coordinates (n, 20) of squats, sides differing."""
    phase = 0.5 - 0.5 * np.cos(np.linspace(0, 4 * np.pi, n))
    values = np.tile(GENERIC.default_coordinates, (n, 1))

    def put(name: str, degrees: FloatArray) -> None:
        values[:, COORDINATES.index(name)] = np.radians(degrees)

    put("pelvis_tilt", -30 * phase)
    put("pelvis_list", 2 * phase)
    for side, more in (("r", 0.0), ("l", 4.0)):
        put(f"hip_flexion_{side}", 5 + depth_deg * phase + more)
        put(f"hip_adduction_{side}", -8 - 5 * phase)
        put(f"hip_rotation_{side}", 4 * phase - more)
        put(f"knee_angle_{side}", -5 - depth_deg * phase - more)
        put(f"ankle_angle_{side}", 3 + 25 * phase)
    return values


def recording(leg: LegModel, values: FloatArray, sites: MarkerSites) -> MarkerTrajectories:
    where = leg.marker_positions(values, sites)
    return MarkerTrajectories(np.arange(len(values)) / 100, sites.names, where)


def moved(sites: MarkerSites, name: str, by_m: tuple[float, float, float]) -> MarkerSites:
    positions = sites.positions.copy()
    positions[sites.index(name)] += by_m
    return MarkerSites(sites.names, sites.segments, positions, sites.weights)


def test_the_jacobian_is_the_derivative_of_the_markers(rng: np.random.Generator):
    sites = SITES.only([*PAPER_ROLES, "heel_r", "meta1_l", "thigh_front_r"])
    model = PersonModel(GENERIC, sites)
    theta, h = 0.02 * rng.normal(size=model.size), 1e-6
    person = model(theta)
    values = squats(5)
    jacobian = model.jacobian(person, values)
    for parameter in range(model.size):
        ahead, behind = (model(theta + s * h * np.eye(model.size)[parameter]) for s in (1, -1))
        slope = (
            ahead.leg.marker_positions(values, ahead.sites)
            - behind.leg.marker_positions(values, behind.sites)
        ) / (2 * h)
        np.testing.assert_allclose(jacobian[..., parameter], slope, atol=1e-8)


def test_markers_that_sit_where_the_model_has_them_stay():
    """Somebody whose pelvis obeys the regression, measured without error."""
    scaled = scaling.fit(GENERIC, recording(GENERIC, squats(), SITES.only(PAPER_ROLES)), SITES)
    leg = LegModel.load(scaled.scales)
    motion = recording(leg, squats(), scaled.sites)
    found = registration.register(leg, motion, scaled.sites)
    np.testing.assert_allclose(found.sites.positions, scaled.sites.positions, atol=2e-3)
    assert found.leg.thigh_length("r") == pytest.approx(leg.thigh_length("r"), abs=1e-3)
    assert found.leg.shank_length("r") == pytest.approx(leg.shank_length("r"), abs=1e-3)
    assert found.rms_after < 2e-4
    assert found.notes() == ()


def knee_errors(found: FloatArray, true: FloatArray) -> FloatArray:
    """(2,) degrees RMS."""
    knees = [COORDINATES.index(f"knee_angle_{side}") for side in "rl"]
    return np.degrees(np.sqrt(((found - true)[:, knees] ** 2).mean(0)))


def test_a_rigid_squat_with_gait2392s_own_markers_is_found():
    """Its pelvis markers lie 4 cm further from the hips than the regression has them."""
    values, sites = squats(), SITES.only(PAPER_ROLES)
    motion = recording(GENERIC, values, sites)
    scaled = scaling.fit(GENERIC, motion, SITES)
    leg = LegModel.load(scaled.scales)
    before = inverse_kinematics.solve(leg, motion, scaled.sites)
    assert before.report.rms > 5e-3
    assert knee_errors(before.trajectories.values, values).min() > 3
    found = registration.register(leg, motion, scaled.sites)
    after = inverse_kinematics.solve(found.leg, motion, found.sites, found.config)
    assert after.report.rms < 0.5e-3
    assert knee_errors(after.trajectories.values, values).max() < 0.5
    # 4 cm from the regression, which is said
    assert found.hips_moved.min() > 0.02
    assert "moves the hip centers by" in found.notes()[0]
    # squats turn the hips forwards: that tells their centers in this plane, and not across it
    true = GENERIC.segment_poses(JointTrajectories(motion.times, COORDINATES, values))
    solved = found.leg.segment_poses(after.trajectories)
    for side in "rl":
        off = solved.of(f"femur_{side}")[:, :3, 3] - true.of(f"femur_{side}")[:, :3, 3]
        assert np.linalg.norm(off[:, :2], axis=1).max() < 3e-3


@pytest.mark.parametrize(
    ("name", "by_m"),
    [
        ("epicondyle_lateral_r", (0.0, 0.0, 0.012)),
        ("epicondyle_lateral_l", (0.0, 0.008, 0.0)),
        ("malleolus_lateral_r", (0.0, -0.008, 0.0)),
    ],
)
def test_a_marker_put_elsewhere_is_followed_in_a_squat(name, by_m):
    scaled = scaling.fit(GENERIC, recording(GENERIC, squats(), SITES.only(PAPER_ROLES)), SITES)
    leg = LegModel.load(scaled.scales)
    motion = recording(leg, squats(), moved(scaled.sites, name, by_m))
    found = registration.register(leg, motion, scaled.sites)
    solution = inverse_kinematics.solve(found.leg, motion, found.sites, found.config)
    assert solution.report.rms < 0.5e-3
    assert knee_errors(solution.trajectories.values, squats()).max() < 0.5


def test_a_standing_person_is_one_posture_and_keeps_the_lengths():
    values = np.tile(squats(1), (50, 1))
    sites = SITES.only(PAPER_ROLES)
    for side, out in (("r", 0.015), ("l", -0.015)):
        sites = moved(sites, f"epicondyle_lateral_{side}", (0.0, 0.0, out))
        sites = moved(sites, f"malleolus_lateral_{side}", (0.0, 0.0, -out))
    motion = recording(GENERIC, values, sites)
    scaled = scaling.fit(GENERIC, motion, SITES)
    leg = LegModel.load(scaled.scales)
    before = inverse_kinematics.solve(leg, motion, scaled.sites)
    found = registration.register(leg, motion, scaled.sites)
    after = inverse_kinematics.solve(found.leg, motion, found.sites, found.config)
    assert found.frames == 1
    assert after.report.rms < 1.5e-3 < before.report.rms
    assert not after.report.coordinate_at_limit.any()
    turned = [
        np.degrees(np.abs(s.trajectories.coordinate("hip_rotation_r")).max())
        for s in (before, after)
    ]
    assert turned[1] < 10 < turned[0]
    for side in "rl":
        assert found.leg.thigh_length(side) == pytest.approx(leg.thigh_length(side), rel=0.02)


@pytest.mark.parametrize("pelvis_too", [False, True])
def test_markers_hidden_in_turn_show_postures_by_those_that_two_frames_share(pelvis_too):
    """Each of knees and ankles for a quarter, with a marker of the pelvis, so that none is seen
    throughout.
    """
    pelvis = ("asis_r", "asis_l", "psis_r", "psis_l")
    limbs = [f"{role}_{side}" for role in ("epicondyle_lateral", "malleolus_lateral")
             for side in "rl"]  # fmt: skip
    sites = SITES.only([*pelvis, *limbs])
    motion = recording(GENERIC, squats(), sites)
    positions = np.array(motion.positions_world)
    for k, limb in enumerate(limbs):
        hidden = [limb, pelvis[k]] if pelvis_too else [limb]
        positions[30 * k : 30 * k + 30, [sites.index(name) for name in hidden]] = np.nan
    problem = inverse_kinematics.Problem(GENERIC, sites, IkOptions())
    whole = registration.postures(problem, motion.positions_world)
    found = registration.postures(problem, positions)
    assert len(found) > 0.5 * len(whole) > 10
    depth = np.degrees(squats()[found, COORDINATES.index("hip_flexion_r")])
    assert np.ptp(depth) > 85


def test_the_sum_has_its_minimum_where_registration_ends(rng: np.random.Generator):
    motion = recording(GENERIC, squats(), SITES.only(PAPER_ROLES))
    noisy = MarkerTrajectories(
        motion.times,
        motion.marker_names,
        motion.positions_world + 2e-3 * rng.normal(size=motion.positions_world.shape),
    )
    scaled = scaling.fit(GENERIC, noisy, SITES)
    leg = LegModel.load(scaled.scales)
    sites = scaled.sites
    chosen = registration.postures(
        inverse_kinematics.Problem(leg, sites, IkOptions()), noisy.positions_world
    )
    fit = registration._Fit(
        PersonModel(leg, sites), IkOptions(), noisy.positions_world[chosen], 3e-3, 3e-4, 8
    )
    fit.settle()
    assert 1e-3 < fit.error < 3e-3
    least = fit._total(fit.state, fit.theta)
    for _ in range(5):
        theta = fit.theta + 1e-3 * rng.normal(size=fit.theta.shape)
        _, problem = fit._at(theta)
        assert fit._total(fit._posed(problem, fit.state.values), theta) > least


def test_a_real_person_who_stands_is_followed(shared_data: Path):
    """Both knee markers sit some 2 cm further out than the model's: without registration the hips
    turn by 30 degrees and a knee is at its limit.
    """
    folder = shared_data / "cases" / "19_branch_jump"
    motion = MotionConfig(
        file=str(folder / "standing_11s.trc"), marker_map=str(folder / "seven.toml")
    )
    found = run_motion.solve(motion)
    assert found.fit is not None
    assert found.fit.ik.rms < 3e-3
    for side in "rl":
        rotation = np.degrees(found.trajectories.coordinate(f"hip_rotation_{side}"))
        assert np.abs(rotation).max() < 6
        assert np.ptp(rotation) < 5
    assert not found.fit.ik.coordinate_at_limit[[9, 16]].any()
    read = run_sensors.sense(found, ImuConfig())
    assert np.degrees(np.abs(read.angular_velocity).max()) < 20
    plain = run_motion.solve(motion.model_copy(update={"registration": False}))
    assert plain.fit is not None
    assert plain.fit.registration is None
    assert plain.fit.ik.rms > 7.5e-3


def test_registration_can_be_left_out():
    plain = from_recording.solve_kinematics("subject01/squat_30.trc", register=False)
    assert plain.fit is not None
    np.testing.assert_array_equal(plain.leg.scales.factors, plain.fit.scaling.scales.factors)
    names = plain.fit.sites.names
    np.testing.assert_array_equal(
        plain.fit.sites.positions, plain.fit.scaling.sites.only(names).positions
    )


def test_a_person_is_the_same_to_the_last_digit_on_any_number_of_threads():
    program = (
        "import hashlib; from legsim.kinematics.from_recording import solve_kinematics as solve; "
        "found = solve('subject06/squat_60.trc'); "
        "print(hashlib.sha256(found.trajectories.values.tobytes()).hexdigest())"
    )
    said = {
        subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, "OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "2")
    }
    assert len(said) == 1
