"""Postures that whole turns do not change, and frames that take their neighbor's better one."""

import numpy as np
import pytest

from legsim.core.values import FloatArray
from legsim.kinematics import inverse_kinematics, marker_sites
from legsim.kinematics._ik_neighbors import settle, without_turns
from legsim.kinematics._ik_problem import Problem
from legsim.kinematics.ik_options import IkOptions
from legsim.kinematics.leg_model import COORDINATES, LegModel
from legsim.mocap.labels import PAPER_ROLES
from legsim.mocap.trajectories import MarkerTrajectories

LEG = LegModel.load()
SITES = marker_sites.load()
TILT, LIST, TURN = (COORDINATES.index(f"pelvis_{x}") for x in ("tilt", "list", "rotation"))


def walking(n: int = 200) -> FloatArray:
    """Values (n, 20) of somebody who bends the knees by up to 50 deg and turns by 300."""
    values = np.tile(LEG.default_coordinates, (n, 1))
    phase = np.linspace(0, 4 * np.pi, n)
    for side, sign in (("r", 1), ("l", -1)):
        bend = np.radians(30 + 20 * sign * np.sin(phase))
        values[:, COORDINATES.index(f"knee_angle_{side}")] = -bend
        values[:, COORDINATES.index(f"hip_flexion_{side}")] = 0.5 * bend
    values[:, TURN] = np.linspace(0, np.radians(300), n)
    values[:, TILT] = np.radians(10)
    return values


def test_whole_turns_and_the_other_way_to_write_a_posture_are_taken_out(rng):
    truth = walking()
    turned = truth.copy()
    for k in (TILT, LIST, TURN):
        turned[:, k] += 2 * np.pi * rng.integers(-3, 4, len(turned))
    other = rng.random(len(turned)) < 0.3
    turned[np.ix_(other, [TILT, LIST, TURN])] *= [1, -1, 1]
    turned[np.ix_(other, [TILT, LIST, TURN])] += np.pi
    places = LEG.marker_positions(turned, SITES)
    np.testing.assert_allclose(places, LEG.marker_positions(truth, SITES), atol=1e-9)
    np.testing.assert_allclose(without_turns(LEG, turned), truth, atol=1e-9)
    np.testing.assert_array_equal(without_turns(LEG, truth), truth)


def test_frames_that_are_astray_take_the_movement_of_their_neighbors():
    truth, sites = walking(), SITES.only(PAPER_ROLES)
    problem = Problem(LEG, sites, IkOptions())
    measured = LEG.marker_positions(truth, sites)
    weights = np.tile(sites.weights, (len(truth), 1))
    solved = inverse_kinematics.solve(
        LEG, MarkerTrajectories(np.arange(len(truth)) / 100, PAPER_ROLES, measured), sites
    ).trajectories.values
    values, frames = solved.copy(), np.arange(len(truth))
    values[80:110, COORDINATES.index("hip_rotation_r")] += np.radians(60)
    values[80:110, TILT] += np.radians(170)
    rows, converged = np.array([79, 80, 110]), np.zeros(len(truth), bool)
    settle(problem, values, frames, rows, measured, weights, converged)
    free = [k for k, name in enumerate(COORDINATES) if not name.startswith(("ankle", "sub", "mtp"))]
    np.testing.assert_allclose(values[:, free], solved[:, free], atol=1e-3)
    assert converged[80:110].all()


@pytest.mark.parametrize("role", ["asis_l", "thigh_1_r"])
def test_a_marker_that_comes_or_goes_makes_no_step(role: str):
    """Each sits 5 mm off, and one is out of view for three seconds."""
    rate, names = 100.0, (*PAPER_ROLES, "psis_r", "thigh_1_r", "thigh_1_l")
    truth, sites = walking(1000), SITES.only(names)
    off = np.random.default_rng(4).normal(0, 0.005, (len(names), 3))
    measured = LEG.marker_positions(truth, sites) + off
    hidden = measured.copy()
    hidden[300:600, names.index(role)] = np.nan
    strongest = []
    for positions in (measured, hidden):
        motion = MarkerTrajectories(np.arange(len(truth)) / rate, names, positions)
        found = inverse_kinematics.solve(LEG, motion, sites)
        place = LEG.segment_poses(found.trajectories).of("tibia_r")[:, :3, 3]
        strongest.append(np.linalg.norm(np.diff(place, 2, axis=0), axis=1).max() * rate**2)
    assert strongest[1] < strongest[0] + 2.0
