"""Packets are counted across the wrap of their counter."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu.packets import found_period, sparse_note, unwrapped


@pytest.mark.parametrize("period", [256, 65536])
def test_any_losses_are_found_across_many_wraps(rng, period):
    sent = np.cumsum(rng.integers(1, period // 3, size=400))
    np.testing.assert_array_equal(unwrapped(sent % period, period), sent - sent[0])


def test_the_period_is_found():
    sent = np.arange(65500, 65600)
    np.testing.assert_array_equal(unwrapped(sent % 65536), np.arange(100))
    np.testing.assert_array_equal(unwrapped(np.arange(200, 300) % 256), np.arange(100))


@pytest.mark.parametrize(("period", "first"), [(200, 0), (180, 0), (129, 0), (255, 1), (100, 1)])
def test_a_period_that_is_no_power_of_two_is_found_by_its_wraps(rng, period, first):
    sent = np.arange(1000)
    np.testing.assert_array_equal(unwrapped(first + sent % period), sent)
    kept = np.sort(rng.choice(sent, 970, replace=False))
    np.testing.assert_array_equal(unwrapped(first + kept % period), kept - kept[0])


@pytest.mark.parametrize(
    ("counter", "said"),
    [
        ([1, 2, 2, 3], "packet 2 is there twice .samples 1 and 2."),
        ([1, 3, 2, 4], "packet 2 .sample 2. comes after packet 3"),
        ([1, 2.5], "no whole numbers"),
        ([70000, 1], "70000, beyond its period of 65536"),
    ],
)
def test_what_is_no_count_is_refused(counter, said):
    with pytest.raises(LegsimError, match=said):
        unwrapped(counter, 65536)


def test_a_period_is_that_of_numbers_that_start_again():
    assert found_period(np.arange(200.0)) is None
    assert found_period(np.arange(200.0, 300.0) % 256) == 256


def test_numbers_that_count_more_than_the_samples_are_noted():
    """Lost packets leave most numbers one apart; those of two sensors in turn are two apart."""
    sent = np.arange(300.0)
    assert sparse_note(np.delete(sent, slice(50, 150)), 100.0) == ()
    (note,) = sparse_note(2 * sent, 100.0)
    assert note.startswith("the packets' numbers grow by 2")
    assert sparse_note(2 * sent, 100.0, in_turn=2) == ()
    assert len(sparse_note(3 * sent, 100.0, in_turn=2)) == 1
    assert "grow by 2 from one sample to the next" in note
    assert "makes 50 samples" in note
