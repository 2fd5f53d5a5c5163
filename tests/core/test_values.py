import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.core.values import (
    LARGEST,
    frozen,
    in_millimeters,
    increasing_times,
    plain_numbers,
    to_nanometers,
    whole_counts,
    within,
)


def test_frozen_arrays_are_copied_once_and_cannot_be_written():
    source = np.arange(3.0)
    first = frozen("x", source, (3,))
    assert first is not source
    assert frozen("x", first, (None,)) is first
    with pytest.raises(ValueError, match="read-only"):
        first[0] = 1


def test_a_read_only_view_of_a_writable_array_is_copied():
    source = np.arange(3.0)
    view = source[:]
    view.flags.writeable = False
    assert frozen("x", view, (3,)) is not view


def test_an_array_over_foreign_memory_is_copied():
    stored = bytearray(np.arange(3.0).tobytes())
    view = np.frombuffer(stored)
    view.flags.writeable = False
    kept = frozen("x", view, (3,))
    stored[:] = bytes(len(stored))
    np.testing.assert_array_equal(kept, [0, 1, 2])


def test_wrong_shapes_are_named():
    with pytest.raises(LegsimError, match=r"x has shape \(3,\); expected \('any', 3\)"):
        frozen("x", np.zeros(3), (None, 3))


def test_times_must_increase():
    np.testing.assert_array_equal(increasing_times("t", [0, 1, 3]), [0, 1, 3])
    with pytest.raises(LegsimError, match=r"increase strictly.* sample 2 \(1 s\) comes 0 s after"):
        increasing_times("t", [0, 1, 1, 1])


@pytest.mark.parametrize("step", [-1.0, 1e-320, 1e-13])
def test_times_closer_than_any_clock_are_refused(step):
    """Rates would overflow."""
    with pytest.raises(LegsimError, match=r"sample 1 .* comes .* s after sample 0"):
        increasing_times("t", [0, step, 1])


@pytest.mark.parametrize("time", [np.nan, np.inf, -1e31])
def test_times_beyond_any_quantity_are_refused(time):
    with pytest.raises(LegsimError, match="not a number, or too large a one, at index 1"):
        increasing_times("t", [0, time, 1])


def test_numbers_are_within_up_to_the_largest():
    assert within(np.array([0, -LARGEST, 1e-320]))
    assert within(np.array([], int))
    for wrong in (np.nan, np.inf, -np.inf, 1.1 * LARGEST):
        assert not within(np.array([0, wrong]))


def test_plain_numbers_hide_nothing():
    masked = np.ma.masked_equal([1.0, 2.0, 3.0], 2.0)
    for bad in (masked, np.ones(2, complex), np.array(["1"]), np.array([None])):
        with pytest.raises(LegsimError, match=r"a is a masked array|a holds"):
            plain_numbers("a", bad)
    for good in (np.ma.array(np.ones(3)), np.ones(3, np.dtype(">f4")), [1, 2, 3], np.ones(3, bool)):
        assert plain_numbers("a", good).shape == (3,)


def test_counts_are_whole():
    assert whole_counts("n", np.array([3.0, 4.0])) == (3, 4)
    with pytest.raises(LegsimError, match="expected whole numbers"):
        whole_counts("n", (24.9, 24, 24))


def test_a_file_of_millimeters_holds_the_same_number(rng):
    """To the last bit, and within half a nanometer of the length."""
    meters = rng.uniform(-2, 2, 10_000)
    rounded = to_nanometers(meters)
    np.testing.assert_array_equal(1e-3 * in_millimeters(rounded), rounded)
    assert np.abs(rounded - meters).max() < 0.51e-9
