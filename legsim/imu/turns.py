"""What order and numbers of rows say of instruments that take turns in a table."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from legsim.core.values import FloatArray
from legsim.imu import packets

Numbered = tuple[FloatArray, FloatArray]
"""lines (n,) of an instrument's rows, and the packets' numbers (n,) in them as sent"""


def first_packets(
    rows: Mapping[str, Numbered], period: int | None = None
) -> tuple[Mapping[str, float], tuple[str, ...]]:
    """Packets from the first one of the table to the first one of each instrument.

    One counter of all instruments has about the same number in rows that are beside each other; so
    an instrument whose first rows were lost begins later. Counters of their own are put on each
    other by the order of the rows, blocks of such by their first rows, which is noted.

    Args:
        rows: of each instrument, by what it is called in the table.
        period: count after which the counter starts at 0 again; None finds it.
    """
    names = list(rows)
    wraps_at = period or max((packets.found_period(counts) or 0) for _, counts in rows.values())
    counts = {name: _continued(rows[name][1], wraps_at) for name in names}
    lines = {name: rows[name][0] for name in names}
    against, within = names[0], 2 * _turn(list(lines.values())) + 1
    first, notes = {against: float(counts[against][0])}, []
    for name in names[1:]:
        one, other = ((lines[which], counts[which]) for which in (against, name))
        later, where = _later(one, other, wraps_at)
        off = later - wraps_at * np.rint(later / wraps_at) if wraps_at else later
        if where == "nowhere" or abs(off) > within:
            place = "same place" if where == "beside" else "first rows of their blocks"
            notes.append(
                f"In doubt: the packets' numbers of {against!r} and {name!r} are {abs(later):.0f} "
                f"apart in the {place} of the table: they are taken for counters of their own, "
                "and put on each other by the order of the rows"
            )
            off = 0.0
        first[name] = float(counts[name][0]) - later + off
    begin = min(first.values())
    return {name: count - begin for name, count in first.items()}, tuple(notes)


def _continued(counts: FloatArray, wraps_at: int) -> FloatArray:
    """Numbers (n,) without the starts at 0; they may repeat or be out of order."""
    if not wraps_at:
        return counts
    steps = np.diff(counts)
    return counts[0] + np.concatenate(
        [[0.0], np.cumsum(steps - wraps_at * np.rint(steps / wraps_at))]
    )


def _later(
    one: Numbered, other: Numbered, wraps_at: int
) -> tuple[float, Literal["beside", "range", "nowhere"]]:
    """By how much the numbers of the other are greater, and where both have a place in common:
    rows beside each other; a range of numbers, in blocks one below the other; nowhere.

    Numbers of blocks whose ranges mostly overlap are those of one counter; others are counted from
    the first row of each block.
    """
    (lines, counts), (others, numbers) = one, other
    beside = (others >= lines[0]) & (others <= lines[-1])
    if beside.any():
        apart = numbers - np.interp(others, lines, counts)
        return float(np.rint(np.median(apart[beside]))), "beside"
    anew = wraps_at * np.rint((counts.mean() - numbers.mean()) / wraps_at) if wraps_at else 0.0
    shared = min(counts.max(), numbers.max() + anew) - max(counts.min(), numbers.min() + anew)
    if shared > 0.5 * min(np.ptp(counts), np.ptp(numbers)):
        return -float(anew), "range"
    return float(numbers[0] - counts[0]), "nowhere"


def _turn(lines: Sequence[FloatArray]) -> int:
    """Rows that one instrument usually has before another one has its turn."""
    whose = _whose(lines)
    ends = np.flatnonzero(np.diff(whose, append=-1) != 0)
    return int(np.median(np.diff(ends, prepend=-1)))


def _whose(lines: Sequence[FloatArray]) -> np.ndarray:
    """Number of the instrument of each row of the table, in their order."""
    of = np.repeat(np.arange(len(lines)), [len(one) for one in lines])
    return of[np.argsort(np.concatenate(list(lines)), kind="stable")]


def out_of_turn(lines: Mapping[str, FloatArray], rate_hz: float) -> tuple[str, ...]:
    """Describes instruments, of as many rows each, that do not always take turns: by the order of
    rows alone they are apart where one lost a row; nothing where they do.

    Args:
        lines: (n,) of the rows of each instrument.
        rate_hz: rows of an instrument per second.
    """
    names = list(lines)
    whose, turn = _whose(list(lines.values())), _turn(list(lines.values()))
    at = np.sort(np.concatenate(list(lines.values())))
    worst, said = 0, ()
    for k, name in enumerate(names[1:], 1):
        ahead = np.cumsum((whose == 0).astype(int) - (whose == k))
        extent = np.maximum.accumulate(ahead) - np.minimum.accumulate(ahead) - turn
        if extent[-1] > worst:
            worst = int(extent[-1])
            said = (
                f"In doubt: rows of {names[0]!r} and {name!r} do not always take turns, from line "
                f"{at[np.argmax(extent > 0)]:.0f} on: rows were lost, or changed places, and by "
                f"rate_hz alone the two are up to {worst} samples ({1e3 * worst / rate_hz:.3g} ms) "
                "apart; give the column of times (time) or of the packets' numbers (counter)",
            )
    return said
