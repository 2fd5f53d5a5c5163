"""Joint coordinates from markers: exact recovery, the optimum's laws, limits, gaps, every
direction.
"""

import numpy as np
import pytest

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.kinematics import _ik_problem, _stance, inverse_kinematics, marker_sites
from legsim.kinematics.ik_options import (
    CoordinateLock,
    CoordinatePrior,
    CoordinateTask,
    IkOptions,
)
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.marker_sites import MarkerSites
from legsim.kinematics.skeleton import SegmentScales
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

LEG = LegModel.load(SegmentScales.uniform(1.05))
SEVEN = (
    "sacrum",
    *(
        f"{part}_{side}"
        for part in ("asis", "epicondyle_lateral", "malleolus_lateral")
        for side in "rl"
    ),
)
FULL = (
    *SEVEN,
    *(
        f"{part}_{side}"
        for part in ("thigh_front", "epicondyle_medial", "shank_front", "heel", "meta1", "meta5")
        for side in "rl"
    ),
)
NO_PRIOR = IkOptions(
    priors=tuple(CoordinatePrior(f"mtp_angle_{side}", 1e-6) for side in "rl"), flat_foot_weight=0.0
)


def sites(names):
    return marker_sites.load().only(names).scaled(LEG.scales)


def squats(n=200, *, yaw_deg=0.0, depth_deg=95.0):
    """Coordinates (n, 20) of smooth squats, sides differing."""
    phase = 0.5 - 0.5 * np.cos(np.linspace(0, 4 * np.pi, n))
    values = np.tile(LEG.default_coordinates, (n, 1))

    def put(name, degrees):
        values[:, COORDINATES.index(name)] = np.radians(degrees)

    put("pelvis_tilt", -30 * phase)
    put("pelvis_list", 2 * phase)
    put("pelvis_rotation", yaw_deg + 3 * phase)
    for side, more in (("r", 0), ("l", 4)):
        put(f"hip_flexion_{side}", 5 + depth_deg * phase + more)
        put(f"hip_adduction_{side}", -8 - 5 * phase)
        put(f"hip_rotation_{side}", 4 * phase - more)
        put(f"knee_angle_{side}", -5 - depth_deg * phase - more)
        put(f"ankle_angle_{side}", 3 + 25 * phase)
        put(f"subtalar_angle_{side}", 6 * phase)
    return values


def recording(values, used, noise=0.0, rng=None):
    positions = LEG.marker_positions(values, used)
    if rng is not None:
        positions = positions + noise * rng.normal(size=positions.shape)
    return MarkerTrajectories(np.arange(len(values)) / 100, used.names, positions)


def degrees_off(solution, values):
    return np.degrees(np.abs(solution.trajectories.values - values))


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 179.0, -120.0])
def test_a_noise_free_recording_is_recovered_whatever_way_the_subject_faces(yaw_deg):
    values = squats(yaw_deg=yaw_deg)
    solution = inverse_kinematics.solve(LEG, recording(values, sites(FULL)), sites(FULL), NO_PRIOR)
    off = degrees_off(solution, values)
    off[:, :3] = np.minimum(off[:, :3] % 360, 360 - off[:, :3] % 360)
    assert (
        np.delete(
            off, [COORDINATES.index("mtp_angle_r"), COORDINATES.index("mtp_angle_l")], axis=1
        ).max()
        < 1e-3
    )
    assert solution.report.rms < 1e-7
    assert len(solution.report.frames_unconverged) == 0


@pytest.mark.parametrize(
    ("rate_hz", "turns", "seconds"), [(25, 1, 2.0), (50, -1, 2.0), (25, 2, 2.0), (15, 1, 1.5)]
)
def test_somebody_who_turns_about_has_no_steps_in_the_angles(rate_hz, turns, seconds):
    times = np.arange(round((2 + seconds) * rate_hz)) / rate_hz
    values = squats(len(times))
    share = np.clip((times - 1) / seconds, 0, 1)
    yaw = 2 * np.pi * turns * share**3 * (10 - 15 * share + 6 * share**2)
    turned = transforms.axis_rotation([0, 1, 0], yaw)
    pelvis = LEG.segment_poses(JointTrajectories(times, COORDINATES, values)).of("pelvis")[
        :, :3, :3
    ]
    facing = LEG.pelvis_values(transforms.rigid(turned @ pelvis, np.zeros(3)))
    values[:, :3] = np.unwrap(facing[:, :3], axis=0)
    solution = inverse_kinematics.solve(LEG, recording(values, sites(FULL)), sites(FULL), NO_PRIOR)
    off = degrees_off(solution, values)
    assert (
        np.delete(
            off, [COORDINATES.index("mtp_angle_r"), COORDINATES.index("mtp_angle_l")], axis=1
        ).max()
        < 1e-3
    )


def test_seven_markers_give_the_knees_and_a_stated_share_of_the_rest():
    values = squats()
    solution = inverse_kinematics.solve(LEG, recording(values, sites(SEVEN)), sites(SEVEN))
    off = degrees_off(solution, values)
    for side in "rl":
        assert off[:, COORDINATES.index(f"knee_angle_{side}")].max() < 1.0
        share = dict(zip(COORDINATES, solution.report.coordinate_share, strict=True))
        assert share[f"knee_angle_{side}"] > 0.99
        assert 0.1 < share[f"hip_rotation_{side}"] < 1.0
        assert share[f"ankle_angle_{side}"] < 0.01
        assert solution.trajectories.coordinate(f"mtp_angle_{side}") == pytest.approx(0)


@pytest.mark.parametrize("knee_deg", [11.0, -140.0])
def test_knees_that_go_as_far_as_peoples_come_back(knee_deg):
    """Eleven degrees beyond straight, drawn back by a tenth of a degree; a heel at the buttock."""
    values = squats()
    for side in "rl":
        values[:, COORDINATES.index(f"knee_angle_{side}")] = np.radians(
            knee_deg + np.linspace(-1, 1, len(values))
        )
    solution = inverse_kinematics.solve(LEG, recording(values, sites(SEVEN)), sites(SEVEN))
    off = degrees_off(solution, values)
    for side in "rl":
        assert off[:, COORDINATES.index(f"knee_angle_{side}")].max() < 0.5
        assert not solution.report.coordinate_at_limit[COORDINATES.index(f"knee_angle_{side}")]


def test_a_foot_is_by_its_prior_in_frames_that_show_fewer_than_three_of_its_markers():
    values, used = squats(), sites(FULL)
    motion = recording(values, used)
    positions = motion.positions_world.copy()
    positions[20:50, used.names.index("heel_r")] = np.nan
    gaps = MarkerTrajectories(motion.times, used.names, positions)

    def by_prior(**options) -> dict[str, int]:
        report = inverse_kinematics.solve(LEG, gaps, used, IkOptions(**options)).report
        return {
            n: int(c) for n, c in zip(COORDINATES, report.coordinate_by_prior, strict=True) if c
        }

    # nobody puts markers on the toes of this model
    toes = {"mtp_angle_r": 200, "mtp_angle_l": 200}
    assert by_prior() == {"ankle_angle_r": 30, "subtalar_angle_r": 30, **toes}
    task, lock = CoordinateTask("ankle_angle_r", 1e-3), CoordinateLock("mtp_angle_l")
    expected = {"subtalar_angle_r": 30, "mtp_angle_r": 200}
    assert by_prior(tasks=(task,), locked=(lock,)) == expected


def test_ankle_and_subtalar_joint_stop_where_peoples_do():
    """Beyond the mean and two standard deviations (models/lower_body/README.md)."""
    ranges = dict(zip(COORDINATES, np.degrees(LEG.coordinate_ranges), strict=True))
    for side in "rl":
        for name, low, high in (
            ("ankle_angle", -56.2 - 2 * 6.1, 38.5 + 2 * 5.9),
            ("subtalar_angle", -20.7 - 2 * 5.0, 36.8 + 2 * 4.5),
        ):
            np.testing.assert_allclose(ranges[f"{name}_{side}"], (low, high), atol=2.5)


def test_feet_without_markers_stand_flat():
    solution = inverse_kinematics.solve(LEG, recording(squats(), sites(SEVEN)), sites(SEVEN))
    poses = LEG.segment_poses(solution.trajectories)
    for side in "rl":
        upright = poses.of(f"calcn_{side}")[:, :3, 1]
        assert np.degrees(np.arccos(upright[:, 1])).max() < 1.5


def test_the_gradient_vanishes_at_the_solution(rng):
    used = sites(FULL)
    motion = recording(squats(60), used, 0.01, rng)
    found = inverse_kinematics.solve(LEG, motion, used, NO_PRIOR).trajectories.values
    residuals = LEG.marker_positions(found, used) - motion.positions_world
    gradient = np.einsum(
        "m,nmi,nmic->nc", used.weights, residuals, LEG.marker_jacobians(found, used)
    )
    seen = [k for k, name in enumerate(COORDINATES) if not name.startswith("mtp")]
    inside = (found > LEG.coordinate_ranges[:, 0] + 1e-6) & (
        found < LEG.coordinate_ranges[:, 1] - 1e-6
    )
    assert np.abs(np.where(inside, gradient, 0)[:, seen]).max() < 1e-8


def test_the_curvature_is_the_derivative_of_the_gradient(rng):
    used = sites(FULL)
    problem = _ik_problem.Problem(LEG, used, IkOptions())
    values = squats(6) + 0.05 * rng.normal(size=(6, 20))
    measured = LEG.marker_positions(squats(6), used)
    weights, exact, h = np.tile(used.weights, (6, 1)), np.ones(6, bool), 1e-6
    curvature = problem.at(values, measured, weights, exact).curvature
    for c in range(20):
        step = h * np.eye(20)[c]
        ahead, behind = (problem.at(values + s, measured, weights, exact) for s in (step, -step))
        np.testing.assert_allclose(
            (ahead.cost - behind.cost) / (2 * h),
            problem.at(values, measured, weights, exact).gradient[:, c],
            atol=1e-8,
        )
        slope = (ahead.gradient - behind.gradient) / (2 * h)
        # the knee's own glide is left out of its second derivative
        glides = [
            k
            for k in range(20)
            if COORDINATES[k] == COORDINATES[c] and COORDINATES[c].startswith("knee")
        ]
        np.testing.assert_allclose(
            np.delete(curvature[:, c], glides, 1), np.delete(slope, glides, 1), atol=1e-7
        )


def test_the_second_derivatives_do_not_change_the_gauss_newton_scale(rng):
    used = sites(FULL)
    problem = _ik_problem.Problem(LEG, used, NO_PRIOR)
    values, weights = squats(5), np.tile(used.weights, (5, 1))
    state = problem.at(values, LEG.marker_positions(values, used) + 0.01, weights, np.ones(5, bool))
    jacobians = LEG.marker_jacobians(values, used)
    diagonal = np.einsum("m,nmic,nmic->nc", used.weights, jacobians, jacobians)
    np.testing.assert_allclose(
        np.delete(state.scale, [12, 19], 1), np.delete(diagonal, [12, 19], 1), rtol=1e-9, atol=1e-12
    )


def test_limits_hold_and_are_reported():
    values = squats()
    knee = COORDINATES.index("knee_angle_r")
    values[:, knee] = np.radians(30)
    solution = inverse_kinematics.solve(LEG, recording(values, sites(FULL)), sites(FULL), NO_PRIOR)
    assert solution.trajectories.values[:, knee].max() <= LEG.coordinate_ranges[knee, 1]
    assert solution.report.coordinate_at_limit[knee] == len(values)
    assert len(solution.report.frames_unconverged) == 0


def test_unseen_markers_are_ignored_and_empty_frames_bridged():
    values, used = squats(), sites(FULL)
    motion = recording(values, used)
    positions = motion.positions_world.copy()
    positions[40:80, used.index("thigh_front_r")] = np.nan
    positions[50:90, used.index("asis_r")] = positions[50:90, used.index("sacrum")] = np.nan
    positions[120:123] = np.nan
    solution = inverse_kinematics.solve(
        LEG, MarkerTrajectories(motion.times, used.names, positions), used, NO_PRIOR
    )
    off = np.delete(degrees_off(solution, values), [12, 19], 1)
    assert np.delete(off, [120, 121, 122], 0).max() < 1e-3
    assert off[120:123].max() < 1.0
    np.testing.assert_array_equal(solution.report.frames_unseen, [120, 121, 122])
    assert solution.report.marker_seen[used.index("asis_r")] == 200 - 40 - 3


def without(motion, name, first, last):
    """The recording with one marker hidden from ``first`` to ``last``."""
    positions = motion.positions_world.copy()
    positions[first:last, motion.marker_names.index(name)] = np.nan
    return MarkerTrajectories(motion.times, motion.marker_names, positions)


@pytest.mark.parametrize(
    ("marker", "first", "last"), [("asis_r", 100, 200), ("sacrum", 0, 100), ("asis_l", 30, 170)]
)
def test_a_walk_is_followed_where_two_markers_of_the_pelvis_are_left(marker, first, last):
    values = squats()
    values[:, COORDINATES.index("pelvis_tx")] += np.linspace(0, 3, len(values))
    whole = recording(values, sites(SEVEN))
    expected = inverse_kinematics.solve(LEG, whole, sites(SEVEN)).trajectories.values
    solution = inverse_kinematics.solve(LEG, without(whole, marker, first, last), sites(SEVEN))
    assert np.degrees(np.abs(solution.trajectories.values - expected)).max() < 3
    assert len(solution.report.frames_unconverged) == 0


def test_what_no_marker_in_sight_tells_goes_straight_across_the_gap():
    values = squats()
    solution = inverse_kinematics.solve(
        LEG, without(recording(values, sites(SEVEN)), "malleolus_lateral_r", 60, 150), sites(SEVEN)
    )
    for name in ("knee_angle_r", "ankle_angle_r"):
        found = solution.trajectories.coordinate(name)[59:151]
        np.testing.assert_allclose(found, np.linspace(found[0], found[-1], len(found)), atol=1e-12)
    assert degrees_off(solution, values)[:, COORDINATES.index("knee_angle_l")].max() < 1.0


def test_the_report_names_the_worst_frame(rng):
    used = sites(FULL)
    motion = recording(squats(), used, 0.001, rng)
    positions = motion.positions_world.copy()
    positions[77, used.index("heel_l")] += 0.05
    report = inverse_kinematics.solve(
        LEG, MarkerTrajectories(motion.times, used.names, positions), used
    ).report
    k = report.marker_names.index("heel_l")
    assert report.marker_worst_frame[k] == 77
    assert report.marker_worst[k] > 0.02
    assert 0.0005 < report.rms < 0.003


def test_the_shank_is_never_turned_about(rng):
    values, used = squats(depth_deg=110.0), sites(SEVEN)
    solution = inverse_kinematics.solve(LEG, recording(values, used, 0.005, rng), used)
    off = degrees_off(solution, values)
    for name in ("knee_angle", "hip_flexion", "hip_rotation"):
        for side in "rl":
            assert off[:, COORDINATES.index(f"{name}_{side}")].max() < 25


def test_calibrated_markers_go_where_the_recording_shows_them():
    true = sites(FULL)
    moved = true.positions.copy()
    k = true.index("thigh_front_r")
    moved[k] += (0.02, -0.03, 0.01)
    shown = MarkerSites(true.names, true.segments, moved, true.weights)
    found = inverse_kinematics.calibrate(
        LEG, recording(squats(), shown), true, ["thigh_front_r"], NO_PRIOR
    )
    np.testing.assert_allclose(found.positions, moved, atol=1e-6)


def test_markers_of_a_foot_go_where_it_stands_flat():
    """Not where it is on the average of a jump, whose feet hang."""
    true = sites(FULL)
    values = np.tile(LEG.default_coordinates, (240, 1))
    values[80:, COORDINATES.index("pelvis_ty")] += 0.25
    for side in "rl":
        values[80:, COORDINATES.index(f"ankle_angle_{side}")] = np.radians(-35)
    shown = recording(values, true)
    foot = [n for n, at in zip(true.names, true.segments, strict=True) if at.startswith("calcn")]
    found = inverse_kinematics.calibrate(LEG, shown, true, foot)
    rows = [true.index(name) for name in foot]
    np.testing.assert_allclose(found.positions[rows], true.positions[rows], atol=5e-3)


@pytest.mark.parametrize(("hidden", "flat"), [(1, True), (2, False)])
def test_a_foot_is_not_flat_in_swing_where_stance_hides_its_markers(hidden, flat):
    foot = ("heel_r", "meta1_r", "meta5_r")
    stance = np.arange(400) % 100 < 60
    places = np.full((400, 3, 3), 0.02)
    places[~stance, :, 1] += 0.08 + 0.01 * np.sin(np.flatnonzero(~stance))[:, None]
    places[stance, :hidden] = np.nan
    motion = MarkerTrajectories(np.arange(400) / 100, foot, places)
    found = _stance.flat_feet(motion, sites(foot))
    np.testing.assert_array_equal(found["calcn_r"], stance & flat)


def test_a_heel_that_rises_unseen_is_not_flat():
    foot = ("heel_r", "meta1_r", "meta5_r")
    places = np.full((100, 3, 3), 0.02)
    places[60:, 0] = np.nan
    found = _stance.flat_feet(MarkerTrajectories(np.arange(100) / 100, foot, places), sites(foot))
    np.testing.assert_array_equal(found["calcn_r"], np.arange(100) < 60)


LAID_DOWN = {
    "on the back": ([0, 0, 1], 90.0),
    "on the face": ([0, 0, 1], -90.0),
    "on the side": ([1, 0, 0], 90.0),
}


def laid(motion, how):
    axis, angle = LAID_DOWN[how]
    turn = transforms.axis_rotation(axis, np.radians(angle))
    return MarkerTrajectories(motion.times, motion.marker_names, motion.positions_world @ turn.T)


@pytest.mark.parametrize("how", LAID_DOWN)
def test_who_lies_has_the_ankles_that_the_markers_of_the_feet_show(how):
    """A foot is flat on the floor only under somebody who stands."""
    values = squats(60, depth_deg=40.0)
    used, lying = sites(FULL), laid(recording(values, sites(FULL)), how)
    loose = marker_sites.calibrated_roles() & set(FULL)
    placed = inverse_kinematics.calibrate(LEG, lying, used, loose)
    found = inverse_kinematics.solve(LEG, lying, placed).trajectories
    for side in "rl":
        name = f"ankle_angle_{side}"
        off = found.coordinate(name) - values[:, COORDINATES.index(name)]
        assert np.degrees(np.abs(off).max()) < 1


@pytest.mark.parametrize("how", LAID_DOWN)
def test_who_lies_without_markers_on_the_feet_has_neutral_ankles(how):
    values = squats(60, depth_deg=0.0)
    lying = laid(recording(values, sites(SEVEN)), how)
    found = inverse_kinematics.solve(LEG, lying, sites(SEVEN)).trajectories
    assert np.degrees(np.abs(found.coordinate("ankle_angle_r")).max()) < 1


def test_progress_ends_at_the_last_frame():
    steps = []
    inverse_kinematics.solve(
        LEG,
        recording(squats(600), sites(SEVEN)),
        sites(SEVEN),
        progress=lambda done, total: steps.append((done, total)),
    )
    assert steps[-1] == (600, 600)


@pytest.mark.parametrize(
    ("used", "message"),
    [
        (
            ("sacrum", "asis_r", "epicondyle_lateral_r", "epicondyle_lateral_l"),
            "no frame shows three markers of the pelvis",
        ),
        (("sacrum", "asis_r", "asis_l", "epicondyle_lateral_r"), "no marker sits on the left leg"),
    ],
)
def test_too_few_markers_are_refused(used, message):
    with pytest.raises(LegsimError, match=message):
        inverse_kinematics.solve(LEG, recording(squats(20), sites(used)), sites(used))


def test_an_unknown_coordinate_is_refused():
    with pytest.raises(
        LegsimError, match="unknown coordinate 'knee' for a prior; known: pelvis_tilt"
    ):
        inverse_kinematics.solve(
            LEG,
            recording(squats(20), sites(SEVEN)),
            sites(SEVEN),
            IkOptions(priors=(CoordinatePrior("knee", 1.0),)),
        )


def test_the_solution_carries_the_models_markers():
    values, used = squats(20), sites(FULL)
    solution = inverse_kinematics.solve(LEG, recording(values, used), used, NO_PRIOR)
    assert isinstance(solution.trajectories, JointTrajectories)
    np.testing.assert_allclose(
        solution.modelled.positions_world, recording(values, used).positions_world, atol=1e-6
    )
