"""Held samples are found by what noise, the file's digits and other markers allow; a person who
stands still loses none.
"""

import numpy as np
import pytest

from legsim.mocap.held import find_held
from tests.mocap.test_cleaning import RATE, recording

KNEE = 4


def rounded(positions, millimeters: float) -> np.ndarray:
    digit = 1e-3 * millimeters
    return np.round(positions / digit) * digit


def frozen(positions, first: int, last: int) -> np.ndarray:
    held = positions.copy()
    held[first : last + 1, KNEE] = held[first - 1, KNEE]
    return held


@pytest.mark.parametrize("millimeters", [0.01, 0.1, 1.0])
@pytest.mark.parametrize("noise", [0.0, 0.0002])
def test_a_marker_frozen_during_motion_is_found_at_any_resolution(millimeters, noise):
    positions = frozen(rounded(recording(noise=noise).positions_world, millimeters), 300, 479)
    held = find_held(positions, 1 / RATE)
    assert held[300:480, KNEE].all()
    held[270:490, KNEE] = False  # rounding repeats the value for a while before and after
    assert not held.any()


def test_a_marker_frozen_for_good_is_found():
    positions = frozen(recording().positions_world, 400, len(recording().times) - 1)
    assert find_held(positions, 1 / RATE)[400:, KNEE].all()


def test_a_marker_frozen_while_the_person_stands_is_found_by_its_missing_noise(rng):
    positions = rounded(1 + 0.0002 * rng.standard_normal((1200, 7, 3)), 0.01)
    held = find_held(frozen(positions, 500, 679), 1 / RATE)
    assert held[500:680, KNEE].all()
    assert held.sum() == 180


@pytest.mark.parametrize("millimeters", [0.01, 0.1, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("noise", [0.0, 0.00005, 0.0002])
def test_a_person_who_stands_very_still_loses_no_marker(millimeters, noise, rng):
    times = np.arange(1200) / RATE
    sway = 0.002 * np.sin(2 * np.pi * 0.2 * times[:, None, None] + np.arange(7)[:, None])
    still = 1 + sway * np.array([1, 0.1, 0.5]) + noise * rng.standard_normal((1200, 7, 3))
    assert not find_held(rounded(still, millimeters), 1 / RATE).any()


@pytest.mark.parametrize("millimeters", [0.01, 0.1, 1.0, 2.0])
def test_a_foot_that_rests_while_the_body_moves_is_kept(millimeters):
    """Computed without noise: between two steps a foot repeats its place for a second."""
    positions = recording(noise=0).positions_world.copy()
    times = np.arange(len(positions)) / RATE
    swing = np.clip(times - 2.0, 0, 1)
    step = 0.3 * (swing - np.sin(2 * np.pi * swing) / (2 * np.pi))
    positions[:, 5] = [0.0, 0.08, 0.15]
    positions[:, 5, 0] += step
    assert not find_held(rounded(positions, millimeters), 1 / RATE).any()


def test_nothing_is_reported_where_all_markers_stand():
    moving = recording(noise=0).positions_world
    slowest = 1 + int(np.linalg.norm(np.diff(moving[200:-200, 0], axis=0), axis=1).argmin()) + 200
    positions = np.insert(moving, slowest, np.repeat(moving[slowest][None], 120, axis=0), axis=0)
    assert not find_held(positions, 1 / RATE).any()


def test_frames_copied_while_somebody_moves_on_are_found_by_the_jump_at_their_end():
    positions = recording().positions_world.copy()
    positions[300:480] = positions[299]
    held = find_held(positions, 1 / RATE)
    jumping = np.linalg.norm(positions[480] - positions[479], axis=1) > 0.01
    assert jumping.sum() > 3
    assert held[300:480, jumping].all()
    assert not np.delete(held, np.s_[300:480], axis=0).any()


def test_a_point_that_never_moves_is_kept():
    positions = recording().positions_world.copy()
    positions[:, KNEE] = positions[0, KNEE]
    assert not find_held(positions, 1 / RATE).any()
