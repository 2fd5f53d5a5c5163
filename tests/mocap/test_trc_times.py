"""Times of TRC files: few digits, variable rates, rows and frames left out."""

from pathlib import Path

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.mocap._trc_times import TimeColumn, row_times

PATH = Path("trial.trc")


def found(times, *, rate: float, digits: int = 9, frames=None):
    """Times and notes of rows that state ``times`` with so many digits."""
    frames = list(range(1, len(times) + 1)) if frames is None else list(frames)
    texts = [f"{t:.{digits}f}" for t in times]
    column = TimeColumn(range(7, 7 + len(times)), frames, texts, np.array(list(map(float, texts))))
    return row_times(PATH, rate, column)


def variable(rate: float = 60.0) -> np.ndarray:
    """A camera that skips every second picture from the middle on."""
    return np.r_[np.arange(150), 150 + 2 * np.arange(150)] / rate


@pytest.mark.parametrize("digits", [3, 4, 9])
def test_a_variable_rate_is_the_same_however_many_digits_its_times_have(digits):
    times, notes = found(variable(), rate=60, digits=digits)
    np.testing.assert_allclose(times, variable(), atol=1e-9)
    assert notes == ("the rate varies between 30 and 60 Hz by the time column",)


def test_few_digits_of_another_rate_than_the_headers_are_kept():
    stated = np.round(np.cumsum(np.tile([0.021, 0.034], 50)), 3)
    times, _ = found(stated, rate=60, digits=3)
    np.testing.assert_array_equal(times, stated)


@pytest.mark.parametrize(("rate", "digits"), [(200, 2), (250, 2), (120, 2), (200, 1)])
def test_times_of_fewer_digits_than_the_rate_has_are_its_multiples(rate, digits):
    times, notes = found(np.arange(400) / rate, rate=rate, digits=digits)
    np.testing.assert_allclose(times, np.arange(400) / rate, atol=1e-9)
    assert notes == ()


@pytest.mark.parametrize("digits", [2, 3])
def test_few_digits_of_a_rate_near_the_headers_become_even(digits):
    times, _ = found(np.arange(3000) / 119.88, rate=120, digits=digits)
    np.testing.assert_allclose(np.diff(times), 1 / 119.88, rtol=1e-4)


def test_left_out_frames_are_reported_with_their_number_and_place():
    frames = np.delete(np.arange(1, 101), [10, 11, 12, 50])
    times, notes = found((frames - 1) / 100, rate=100, frames=frames)
    np.testing.assert_allclose(times, (frames - 1) / 100, atol=1e-9)
    assert notes == (
        "4 of 100 frames are left out in 2 places, first after frame 10 (0.09 s), most 3 after "
        "frame 10 (0.09 s)",
    )


def test_times_that_run_on_over_left_out_frames_are_reported():
    frames = np.delete(np.arange(1, 101), np.arange(40, 60))
    times, notes = found(np.arange(80) / 100, rate=100, frames=frames)
    np.testing.assert_allclose(times, np.arange(80) / 100, atol=1e-9)
    assert notes == (
        "20 of 100 frames are left out in 1 place, first after frame 40 (0.39 s), but the times "
        "run on as if none were missing; the times are taken (empty the time column to have the "
        "frame numbers taken)",
    )


def test_frame_numbers_that_return_are_reported():
    _, notes = found(np.arange(20) / 100, rate=100, frames=[*range(1, 11), *range(1, 11)])
    assert notes == ("frame numbers return from 10 to 1 at 0.1 s; the times are taken",)


def test_a_row_written_twice_is_refused_also_where_rounding_parts_the_two():
    times = np.insert(np.arange(20) / 100, 5, 0.05 - 1e-9)
    with pytest.raises(
        LegsimError, match=r"line 13\): time .* comes only 1e-09 s after .*; delete"
    ):
        found(times, rate=100, digits=10)
