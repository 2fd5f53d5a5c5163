"""Rows that share a time: copies, instruments in turn, and rounded times."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.imu import same_times


def test_copies_are_one_and_other_rows_stay(rng):
    times, rows = np.arange(50) / 100, rng.normal(size=(50, 6))
    rows[7] = np.nan
    again = np.sort(np.r_[np.arange(50), [3, 3, 7, 40]])
    found, kept, (note,) = same_times.joined(times[again], rows[again])
    np.testing.assert_array_equal(found, times)
    np.testing.assert_array_equal(kept, rows)
    assert note == "4 rows are there twice; one of each is taken"
    assert same_times.joined(times, rows)[2] == ()


def test_instruments_that_write_a_row_each_share_a_time(rng):
    times, both = np.arange(50) / 100, rng.normal(size=(50, 6))
    rows = np.full((100, 6), np.nan)
    rows[::2, :3], rows[1::2, 3:] = both[:, :3], both[:, 3:]
    found, whole, notes = same_times.joined(np.repeat(times, 2), rows)
    np.testing.assert_array_equal(found, times)
    np.testing.assert_array_equal(whole, both)
    assert notes == ()


@pytest.mark.parametrize("rate_hz", [110.0, 130.0])
def test_rounded_times_are_spread_to_within_a_tick(rate_hz):
    exact, tick = np.arange(500) / rate_hz, 0.01
    rounded = np.floor(exact / tick) * tick
    found, (note,) = same_times.spread(rounded)
    assert (np.diff(found) > 0).all()
    assert np.abs(found - exact).max() < tick
    assert "samples share their time with the one before: spread evenly" in note
    np.testing.assert_array_equal(same_times.spread(exact)[0], exact)


def test_times_of_delivery_are_refused_with_the_rate():
    times = np.repeat(np.arange(0, 10, 0.05), 5)
    with pytest.raises(LegsimError, match=r"800 of 1000 samples share .* about 100\.4"):
        same_times.spread(times)


def test_one_row_too_many_leaves_the_other_ticks_joined(rng):
    """Instruments that write a row each, one of which wrote twice at a tick."""
    times, both = np.arange(50) / 100, rng.normal(size=(50, 6))
    rows = np.full((100, 6), np.nan)
    rows[::2, :3], rows[1::2, 3:] = both[:, :3], both[:, 3:]
    more = np.insert(rows, 42, np.r_[1.0, 2.0, 3.0, [np.nan] * 3], axis=0)
    ticks = np.insert(np.repeat(times, 2), 42, times[20])
    found, whole, _ = same_times.joined(ticks, more)
    np.testing.assert_array_equal(found, np.insert(times, 21, times[20]))
    np.testing.assert_array_equal(np.delete(whole, 21, 0), both)
    spread, (note,) = same_times.spread(found)
    assert note.startswith("1 samples share")
    np.testing.assert_allclose(spread[[20, 21, 22]], [0.2, 0.205, 0.21])


def test_instruments_in_turn_in_rounded_times_stay_whole(rng):
    exact, both = np.arange(200) / 110, rng.normal(size=(200, 6))
    rows = np.full((400, 6), np.nan)
    rows[::2, :3], rows[1::2, 3:] = both[:, :3], both[:, 3:]
    ticks = np.repeat(np.floor(exact / 0.01) * 0.01, 2)
    np.testing.assert_array_equal(same_times.joined(ticks, rows)[1], both)


@pytest.mark.parametrize("lag", [1, 2, 9])
def test_packets_that_come_again_some_rows_later_count_once(rng, lag):
    """As a radio logger writes every packet twice."""
    times, rows = np.arange(300) / 100, rng.normal(size=(300, 6))
    rows[9:12, 2] = np.nan
    written = sorted([(k, k) for k in range(300)] + [(k + lag + 0.5, k) for k in range(300)])
    order = np.array([k for _, k in written])
    found, kept, (note,) = same_times.without_repeats(times[order], rows[order])
    np.testing.assert_array_equal(found, times)
    np.testing.assert_array_equal(kept, rows)
    assert note.startswith("300 rows are there again")


def test_a_counter_that_starts_again_at_rest_repeats_no_packet():
    """Numbers come again, and readings of few digits too."""
    counts, rows = np.arange(1000.0) % 100, np.zeros((1000, 6))
    assert same_times.without_repeats(counts, rows)[2] == ()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t[np.r_[:50, 51, 50, 52:100, 101, 100, 102:200]], "2 samples are out of order"),
        (lambda t: t[np.r_[:50, 51, 50, 52:200]], "1 sample is out of order"),
        (lambda t: np.r_[t[:70], 0.1, t[71:]], "a wrong time: correct it"),
        (lambda t: np.r_[t, t[:80]], "begins anew there: split the file"),
        (lambda t: np.r_[t[:100], t[100:] - 0.125], "set back, or .* give rate_hz"),
    ],
)
def test_times_that_go_back_are_refused_with_what_helps(change, said):
    with pytest.raises(LegsimError, match=rf"comes after .* \(sample \d+\); .*{said}"):
        same_times.check_order(change(np.arange(200) / 100))


@pytest.mark.parametrize(("bits", "unit"), [(16, 1e-3), (32, 1e-6), (32, 1e-3)])
def test_a_clock_that_starts_at_0_again_goes_on(bits, unit):
    counts = 2**bits - 1000 + 10 * np.arange(300)
    found, (note,) = same_times.going_on(unit * (counts % 2**bits), unit)
    np.testing.assert_allclose(np.diff(found), 10 * unit, rtol=1e-6)
    assert note == f"its times start at 0 again 1 times, after {bits} bits, and go on"
    for other in (unit * counts, unit * (counts % 50_000)):
        assert same_times.going_on(other, unit)[1] == ()


def test_packets_may_be_lost_where_a_clock_starts_at_0_again():
    counts = 2**16 - 1000 + 10 * np.r_[:60, 115:300]
    found, notes = same_times.going_on(1e-3 * (counts % 2**16), 1e-3)
    np.testing.assert_allclose(np.diff(found), 1e-3 * np.diff(counts), rtol=1e-6)
    assert len(notes) == 1
    counts = 2**16 - 1000 + 10 * np.r_[:60, 210:400]  # 1.5 s
    assert same_times.going_on(1e-3 * (counts % 2**16), 1e-3)[1] == ()
    counts = 2**16 - 1000 + 10 * np.r_[:60, 1160:1400]  # of 65 ms, a good part of the period
    assert same_times.going_on(1e-6 * (counts % 2**16), 1e-6)[1] == ()
