"""Frames that repeat the frame before are found at any beat, and not in who stands still."""

import numpy as np
import pytest

from legsim.mocap.copies import find_copies

TIMES = np.arange(600) / 100


def walking(digit: float = 0.0) -> np.ndarray:
    """Seven markers (n, 21) m that swing by 0.2 m once a second, written to ``digit`` m."""
    phases = np.arange(21)
    noise = 1e-4 * np.random.default_rng(2).standard_normal((len(TIMES), 21))
    values = 0.2 * np.sin(2 * np.pi * TIMES[:, None] + phases) + noise
    return np.round(values / digit) * digit if digit else values


def copied(values: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """The values where ``kept`` (n,), else those of the last kept frame."""
    return values[np.maximum.accumulate(np.where(kept, np.arange(len(values)), 0))]


@pytest.mark.parametrize("digit", [0.0, 1e-4, 1e-3])
@pytest.mark.parametrize("beat", [2, 4, 5])
def test_every_copy_of_a_beat_is_found(digit: float, beat: int):
    kept = np.arange(len(TIMES)) % beat != beat - 1
    found = find_copies(copied(walking(digit), kept), 0.01)
    np.testing.assert_array_equal(found.frames, ~kept)
    (note,) = found.notes(TIMES)
    assert note.startswith(f"warning: {(~kept).sum()} of 600 frames repeat the frame before")
    assert f"of about {100 * (1 - 1 / beat):.2g} Hz was exported at 100 Hz" in note


def test_a_dropped_frame_is_bridged_and_a_long_pause_is_reported():
    kept = np.ones(len(TIMES), bool)
    kept[[100, 101, 250]] = False
    kept[300:360] = False
    found = find_copies(copied(walking(), kept), 0.01)
    assert np.flatnonzero(found.frames).tolist() == [100, 101, 250]
    one, other = found.notes(TIMES)
    assert one == "3 frames repeat the frame before exactly, the first at 1 s: left out and bridged"
    assert other.startswith("warning: nothing moves from 2.99 to 3.59 s: all 60 frames repeat one")


def test_markers_that_are_lost_on_the_way_do_not_hide_a_copy():
    kept = np.ones(len(TIMES), bool)
    kept[[100, 101]] = False
    values = copied(walking(), kept)
    values[:, :3], values[101, 3:6] = np.nan, np.nan
    assert np.flatnonzero(find_copies(values, 0.01).frames).tolist() == [100, 101]


@pytest.mark.parametrize("digit", [1e-4, 1e-3])
def test_who_stands_still_in_a_file_of_few_digits_repeats_nothing(digit: float):
    rng = np.random.default_rng(3)
    still = digit * (rng.uniform(0, 100, 21) + 0.05 * rng.standard_normal((600, 21)))
    written = np.round(still / digit) * digit
    assert (np.diff(written, axis=0) == 0).all(1).sum() > 20
    found = find_copies(written, 0.01)
    assert not found.frames.any()
    assert not found.notes(TIMES)
    assert not find_copies(np.ones((600, 21)), 0.01).notes(TIMES)


def test_one_marker_that_stands_while_others_move_is_no_copy():
    values = walking()
    values[100:110, 3:6] = values[99, 3:6]
    assert not find_copies(values, 0.01).notes(TIMES)
