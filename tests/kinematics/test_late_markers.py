"""A marker that lags or leads is named with its lag; people whose skin slides are not accused."""

import numpy as np
import pytest

import legsim as ls
from legsim.core import resources
from legsim.kinematics import late_markers, marker_sites
from legsim.kinematics._ik_problem import Problem
from legsim.kinematics.ik_options import IkOptions, leg_priors
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.marker_sites import MarkerSites
from legsim.mocap import files
from legsim.mocap.labels import PAPER_ROLES
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories


def shifted(label: str, frames: int) -> MarkerTrajectories:
    """Shipped squats at 120 Hz, one marker late by some frames (early by negative ones)."""
    motion = files.load_markers(resources.motion_file("subject01/squats.trc"))
    positions = np.array(motion.positions_world[:900])
    k = motion.marker_names.index(label)
    late = np.clip(np.arange(len(positions)) - frames, 0, len(positions) - 1)
    positions[:, k] = positions[late, k]
    return MarkerTrajectories(motion.times[:900], motion.marker_names, positions)


def warnings_on(recording: MarkerTrajectories, folder) -> list[str]:
    files.save_recording(folder / "squats.trc", recording)
    person = ls.solve_kinematics(folder / "squats.trc")
    return [note for note in person.notes if "against the other markers" in note]


@pytest.mark.parametrize(("label", "frames"), [("RKNE", 4), ("SACR", -6), ("RASI", 8)])
def test_a_late_marker_is_named_with_its_lag(label: str, frames: int, tmp_path):
    (note,) = warnings_on(shifted(label, frames), tmp_path)
    way = "late" if frames > 0 else "early"
    assert note.startswith(f"warning: against the other markers {label} is {way} by about ")
    said = float(note.split(" ms (")[1].split()[0])
    assert said == pytest.approx(abs(frames), rel=0.3)  # the pattern is that of a small lag


def test_markers_of_one_clock_are_not_doubted(tmp_path):
    assert warnings_on(shifted("RKNE", 0), tmp_path) == []


def test_a_marker_that_sits_elsewhere_is_not_late_in_somebody_who_moves_on():
    """Evenly forward at 1.3 m/s; one marker is 2 cm ahead of its place on the model."""
    leg, n = LegModel.load(), 200
    sites = marker_sites.load().only((*PAPER_ROLES, "thigh_front_r", "shank_front_r"))
    values = np.tile(leg.default_coordinates, (n, 1))
    times, column = np.arange(n) / 100, leg.coordinate_names.index
    values[:, column("pelvis_tx")] = 1.3 * times
    values[:, column("knee_angle_r")] = -0.5 + 0.5 * np.cos(6 * times)
    places = sites.positions.copy()
    places[sites.index("shank_front_r"), 0] += 0.02
    worn = MarkerSites(sites.names, sites.segments, places, sites.weights)
    measured = MarkerTrajectories(times, sites.names, leg.marker_positions(values, worn))
    problem = Problem(leg, sites, IkOptions().settled(leg_priors()))
    solution = JointTrajectories(times, leg.coordinate_names, values)
    assert late_markers.find_late(problem, solution, measured) == ()
