"""Solutions of neighboring frames are one movement, and no other frame's posture fits better: laws,
on real recordings and on made ones whose frames have several minima.
"""

from pathlib import Path

import numpy as np
import pytest

from legsim.core.values import FloatArray
from legsim.kinematics import from_recording, inverse_kinematics, marker_sites
from legsim.kinematics._ik_newton import minimize
from legsim.kinematics._ik_problem import Problem
from legsim.kinematics.ik_options import IkOptions
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.kinematics.marker_sites import MarkerSites
from legsim.mocap.labels import PAPER_ROLES
from legsim.mocap.trajectories import MarkerTrajectories

LEG = LegModel.load()
SITES = marker_sites.load().only(PAPER_ROLES)

# recording, marker map, scaling trial; the first is a person whose frames have two minima each
REAL = (
    ("cases/19_branch_jump/standing_11s.trc", "cases/19_branch_jump/seven.toml", ""),
    ("cases/19_branch_jump/standing_20_frames.trc", "cases/19_branch_jump/seven.toml", ""),
    ("cases/19_branch_jump/standing_11s.trc", "auto", ""),
    ("mocap/standing_bmc/static_run.trc", "auto", ""),
    ("mocap/standing_biobuddy/anat_pose_ECH.c3d", "auto", ""),
    ("mocap/standing_c3dio/Capture0008_Standing.c3d", "auto", ""),
    ("mocap/squat_dart/squat.c3d", "auto", ""),
    ("mocap/squats_subject4/squats1.trc", "auto", ""),
    (
        "mocap/walk_opensim/subject01_walk1.trc",
        "auto",
        "mocap/walk_opensim/subject01_static.trc",
    ),
)


@pytest.mark.parametrize(("file", "marker_map", "scale_from"), REAL)
def test_real_recordings_are_one_movement(
    shared_data: Path, file: str, marker_map: str, scale_from: str
):
    found = from_recording.solve_kinematics(
        shared_data / file,
        marker_map=shared_data / marker_map if marker_map != "auto" else "auto",
        scale_from=shared_data / scale_from if scale_from else None,
        marker_noise=0.0,
    )
    assert found.fit is not None
    problem = Problem(found.leg, found.fit.sites, found.fit.options)
    assert len(found.fit.ik.frames_jumping) == 0
    _assert_laws(problem, found.fit.measured.positions_world, found.trajectories.values)


def _assert_laws(problem: Problem, measured: FloatArray, values: FloatArray) -> None:
    """Each frame's solution leads to its neighbors', and no other frame's posture leads to one that
    costs 1 % less.
    """
    seen = np.isfinite(measured).all(-1)
    weights, whole = seen * problem.sites.weights, seen.all(1)
    pairs = np.flatnonzero(whole[1:] & whole[:-1])
    for here, there in ((pairs, pairs + 1), (pairs + 1, pairs)):
        led, _, _ = minimize(problem, values[here], measured[there], weights[there])
        shown = [k for k, name in enumerate(COORDINATES) if not name.startswith("mtp")]
        off = np.abs(led.values - values[there])[:, shown].max(1)
        assert np.degrees(off.max()) < 0.3, f"frame {here[off.argmax()]}"
    some = np.flatnonzero(whole)
    some = some[np.unique(np.linspace(0, len(some) - 1, 40).astype(int))]
    plain = np.zeros(len(some), bool)
    cost = problem.at(values[some], measured[some], weights[some], plain).cost
    for other in some[::5]:
        starts = values[some].copy()
        starts[:, 6:] = values[other, 6:]
        led, _, _ = minimize(problem, starts, measured[some], weights[some])
        assert (led.cost > 0.99 * cost - 1e-15).all()


def _standing(n: int = 400) -> FloatArray:
    """Coordinates (n, 20) of somebody who sways on knees that are all but straight."""
    phase = np.linspace(0, 6 * np.pi, n)
    values = np.tile(LEG.default_coordinates, (n, 1))

    def put(name: str, degrees: FloatArray) -> None:
        values[:, COORDINATES.index(name)] = np.radians(degrees)

    put("pelvis_tilt", -8 + 0.5 * np.sin(phase))
    put("pelvis_list", 0.4 * np.sin(0.7 * phase))
    for side, shift in (("r", 0.0), ("l", 1.0)):
        put(f"hip_flexion_{side}", 8 + 0.8 * np.sin(phase + shift))
        put(f"hip_adduction_{side}", -3 + 0.5 * np.cos(0.7 * phase))
        put(f"hip_rotation_{side}", 2 * np.sin(0.5 * phase + shift))
        put(f"knee_angle_{side}", 3.5 + 0.5 * np.sin(phase + shift))
    return values


def _displaced(sites: MarkerSites) -> MarkerSites:
    """Knee markers 20 mm further out than the model thinks, ankle markers 20 mm further in."""
    positions = sites.positions.copy()
    for side, out in (("r", 1.0), ("l", -1.0)):
        positions[sites.index(f"epicondyle_lateral_{side}"), 2] += 0.02 * out
        positions[sites.index(f"malleolus_lateral_{side}"), 2] -= 0.02 * out
    return MarkerSites(sites.names, sites.segments, positions, sites.weights)


def _shown(values: FloatArray) -> MarkerTrajectories:
    where = LEG.marker_positions(values, _displaced(SITES))
    return MarkerTrajectories(np.arange(len(values)) / 100, SITES.names, where)


def _distinct(one: FloatArray, other: FloatArray) -> float:
    return float(np.degrees(np.abs(one - other)[:, 6:].max()))


def test_frames_with_two_minima_are_one_movement():
    motion = _shown(_standing())
    solution = inverse_kinematics.solve(LEG, motion, SITES)
    values = solution.trajectories.values
    problem = Problem(LEG, SITES, IkOptions())
    turned = values.copy()
    rotation = COORDINATES.index("hip_rotation_l")
    turned[:, rotation] *= -1
    turned[:, COORDINATES.index("knee_angle_l")] = np.radians(-7)
    weights = np.tile(SITES.weights, (len(values), 1))
    other, _, _ = minimize(problem, turned, motion.positions_world, weights)
    # most frames have another minimum, far away
    assert (np.degrees(np.abs(other.values - values)[:, rotation]) > 10).mean() > 0.8
    _assert_laws(problem, motion.positions_world, values)
    assert np.degrees(np.abs(np.diff(values[:, 6:], axis=0))).max() < 0.3


@pytest.mark.parametrize("strides", [(64, 8, 1), (50, 10, 1), (16, 4, 1)])
def test_the_movement_does_not_depend_on_the_order_in_which_frames_are_solved(strides):
    motion = _shown(_standing())
    expected = inverse_kinematics.solve(LEG, motion, SITES).trajectories.values
    found = inverse_kinematics.solve(LEG, motion, SITES, IkOptions(strides=strides))
    assert _distinct(found.trajectories.values, expected) < 0.05
    backwards = MarkerTrajectories(motion.times, SITES.names, motion.positions_world[::-1])
    found = inverse_kinematics.solve(LEG, backwards, SITES, IkOptions(strides=strides))
    assert _distinct(found.trajectories.values[::-1], expected) < 0.05


def test_a_jump_of_the_markers_themselves_is_followed():
    """Two stretches of one recording that do not belong together."""
    values = _standing()
    positions = _shown(values).positions_world.copy()
    bent = values.copy()
    for side in "rl":
        bent[:, COORDINATES.index(f"hip_flexion_{side}")] += 1.2
        bent[:, COORDINATES.index(f"knee_angle_{side}")] -= 1.8
    positions[200:] = _shown(bent).positions_world[200:]
    motion = MarkerTrajectories(np.arange(len(values)) / 100, SITES.names, positions)
    solution = inverse_kinematics.solve(LEG, motion, SITES)
    bend = np.degrees(solution.trajectories.coordinate("knee_angle_r"))
    assert (bend[:200] > -10).all()
    assert (bend[200:] < -90).all()
