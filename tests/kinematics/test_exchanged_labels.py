"""Heel and ankle under each other's label are named by what moves; labels in their places never."""

import numpy as np
import pytest

from legsim.kinematics import exchanged_labels, marker_sites
from legsim.kinematics.leg_model import LegModel
from legsim.mocap.labels import PAPER_ROLES
from legsim.mocap.trajectories import MarkerTrajectories

LEG = LegModel.load()
ROLES = (
    *PAPER_ROLES,
    *(f"{part}_{side}" for part in ("heel", "meta1", "meta5", "shank_1", "shank_2")
      for side in "rl"),
)  # fmt: skip
SITES = marker_sites.load().only(ROLES)


def steps(noise: float = 0.001) -> MarkerTrajectories:
    """Ankles and knees that move as in steps, 1 mm of noise."""
    times = np.arange(300) / 100
    values = np.tile(LEG.default_coordinates, (300, 1))
    for side, phase in (("r", 0.0), ("l", 2.0)):
        column = LEG.coordinate_names.index(f"ankle_angle_{side}")
        values[:, column] = 0.35 * np.sin(6 * times + phase)
        values[:, LEG.coordinate_names.index(f"knee_angle_{side}")] = -0.6 * (
            1 + np.cos(6 * times + phase)
        )
    positions = LEG.marker_positions(values, SITES)
    positions = positions + noise * np.random.default_rng(5).normal(size=positions.shape)
    return MarkerTrajectories(times, SITES.names, positions)


def said(motion: MarkerTrajectories) -> tuple[str, ...]:
    on = dict(zip(SITES.names, SITES.segments, strict=True))
    return exchanged_labels.notes(motion, on, {"heel_r": "RHEE"})


@pytest.mark.parametrize(
    ("one", "other"), [("heel_r", "malleolus_lateral_r"), ("malleolus_lateral_l", "heel_l")]
)
def test_two_labels_that_are_exchanged_are_named(one, other):
    motion = steps()
    positions = motion.positions_world.copy()
    rows = [SITES.names.index(one), SITES.names.index(other)]
    positions[:, rows] = positions[:, rows[::-1]]
    (note,) = said(MarkerTrajectories(motion.times, motion.marker_names, positions))
    assert note.startswith("warning: markers of one segment keep their distances better if")
    for name in (one, other):
        assert ("RHEE (on calcn_r)" if name == "heel_r" else f"{name} (on ") in note


def test_labels_in_their_places_are_not_doubted():
    assert said(steps()) == said(steps(noise=0.004)) == ()


def test_who_stands_tells_nothing():
    motion = steps()
    still = np.tile(motion.positions_world[:1], (300, 1, 1))
    assert said(MarkerTrajectories(motion.times, motion.marker_names, still)) == ()
