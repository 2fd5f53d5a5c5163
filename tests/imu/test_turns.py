"""Instruments in turn: one counter, counters of their own, and rows alone."""

import numpy as np
import pytest

from legsim.imu import turns

PERIODS = [None, 256, 65536]


def table(count, kept, numbers, turn=1):
    """Lines and numbers of instruments that write ``turn`` rows each, of packets that are kept."""
    order = sorted(
        (k // turn, which, k) for which, own in enumerate(kept) for k in range(count) if own[k]
    )
    rows = [(line, which, numbers[which][k]) for line, (_, which, k) in enumerate(order)]
    return {
        name: tuple(np.array([(r[0], r[2]) for r in rows if r[1] == which], float).T)
        for which, name in enumerate("AG")
    }


@pytest.mark.parametrize("turn", [1, 7])
@pytest.mark.parametrize("begin", [0, 250, 65530])
@pytest.mark.parametrize("period", PERIODS)
def test_one_counter_puts_instruments_on_each_other(period, begin, turn):
    """Also where the first rows of one were lost, across a start at 0."""
    kept = np.ones((2, 600), bool)
    kept[1, :20], kept[0, 70:90], kept[1, 300] = False, False, False
    sent = begin + np.arange(600)
    sent = sent if period is None else sent % period
    first, notes = turns.first_packets(table(600, kept, [sent, sent], turn), period)
    assert first == {"A": 0, "G": 20}
    assert notes == ()
    kept[0, :33] = False
    first, _ = turns.first_packets(table(600, kept, [sent, sent], turn), None)
    assert first == {"A": 13, "G": 0}


@pytest.mark.parametrize("wraps", [False, True])
def test_counters_of_their_own_go_by_the_order_of_rows(wraps):
    kept = np.ones((2, 600), bool)
    kept[1, :20], kept[1, 300] = False, False
    sent = np.arange(600)
    numbers = [(100 + sent) % 256, (30 + sent) % 256] if wraps else [900 + sent, 30 + sent]
    first, (note,) = turns.first_packets(table(600, kept, numbers), 256 if wraps else None)
    assert first == {"A": 0, "G": 20}
    assert f"'A' and 'G' are {70 if wraps else 870} apart in the same place" in note


@pytest.mark.parametrize("begin", [0, 65500])
def test_blocks_of_one_counter_keep_its_numbers(begin):
    """Rows of one instrument below those of another."""
    sent = (begin + np.arange(600)) % 65536
    rows = {"A": (np.arange(600.0), 1.0 * sent), "G": (600 + np.arange(550.0), 1.0 * sent[50:])}
    first, notes = turns.first_packets(rows, 65536)
    assert first == {"A": 0, "G": 50}
    assert notes == ()


def test_rows_out_of_turn_are_described_by_place_and_size():
    kept = np.ones((2, 600), bool)
    both = {name: lines for name, (lines, _) in table(600, kept, [range(600)] * 2).items()}
    assert turns.out_of_turn(both, 100.0) == ()
    kept[0, [50, 51]], kept[1, [400, 500]] = False, False
    rows = table(600, kept, [range(600)] * 2)
    (note,) = turns.out_of_turn({name: lines for name, (lines, _) in rows.items()}, 100.0)
    assert "rows of 'A' and 'G' do not always take turns, from line 100 on" in note
    assert "up to 2 samples (20 ms) apart" in note
    blocks = {"A": np.arange(100.0), "G": 100 + np.arange(100.0)}
    assert turns.out_of_turn(blocks, 100.0) == ()
