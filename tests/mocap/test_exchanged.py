"""Labels that change places on the way are found, movement is not."""

import numpy as np
import pytest

from legsim.mocap import cleaning
from legsim.mocap.exchanged import Exchange, find_exchanges
from legsim.mocap.labels import MarkerMap
from legsim.mocap.trajectories import MarkerTrajectories

TIMES = np.arange(200) / 100.0


def walking(speed: float = 0.0) -> np.ndarray:
    """(n, 4, 3) two legs that pass each other at 1 Hz, a knee and an ankle each."""
    stride = 0.3 * np.sin(2 * np.pi * TIMES)
    legs = [(stride, 0.15), (-stride, -0.15)]
    forward = speed * TIMES
    return np.stack(
        [
            np.stack([share * s + forward, np.full_like(s, height), np.full_like(s, side)], 1)
            for s, side in legs
            for share, height in ((0.5, 0.5), (1.0, 0.1))
        ],
        axis=1,
    )


@pytest.mark.parametrize("speed", [0.0, 1.5, 9.0])
def test_movement_exchanges_nothing(speed):
    assert find_exchanges(walking(speed), 0.01) == []


@pytest.mark.parametrize("gap", [0, 5])
def test_an_exchange_is_found_where_it_begins_and_where_it_ends(gap):
    positions = walking(1.5)
    positions[80:120, [1, 3]] = positions[80:120, [3, 1]]
    positions[80 - gap : 80] = np.nan
    assert find_exchanges(positions, 0.01) == [Exchange(80, 1, 3), Exchange(120, 1, 3)]


def test_cleaning_warns_of_it_with_the_labels_and_the_time():
    positions = walking()
    positions[150:, [1, 3]] = positions[150:, [3, 1]]
    motion = MarkerTrajectories(TIMES, ("RANK", "RHEE", "LANK", "LHEE"), positions)
    roles = ("malleolus_lateral_r", "heel_r", "malleolus_lateral_l", "heel_l")
    chosen = MarkerMap.one_to_one("m", roles, motion.marker_names)
    _, report = cleaning.clean(motion, chosen, required=())
    assert any("from 1.5 s on the labels RHEE and LHEE are exchanged" in n for n in report.notes)
