"""Rows of a table that share one time: packets that came twice, instruments that share a clock's
tick, and times that are rounded to more than the step between samples.
"""

import numpy as np
from numpy.typing import NDArray

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray

_ROUNDED = 1 / 3
"""largest share of samples that share a time with the one before where rounding is to blame"""


_CLOSE = 0.5
"""of the usual step, by which sorted times are apart where they are not of one even clock"""

_ACROSS, _LOST_S, _SHARE = 10.0, 1.0, 0.1
"""usual steps at most, across which a clock starts at 0 again; or s, as long as these are a small
share of its period: packets may be lost there"""

_REACH = 64
"""rows within which a packet may come again"""


def without_repeats(
    ticks: FloatArray, rows: FloatArray
) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Ticks (m,) and rows (m, k) without those that a logger wrote again some rows later, with a
    note on these.

    Only where ticks go back: a row is one of before where its tick and all its cells are. A counter
    that starts at 0 again soon has the same numbers anew, and is searched less far.
    """
    if not (np.diff(ticks) < 0).any():
        return ticks, rows, ()
    cells = np.column_stack([ticks, rows])
    cells = np.where(np.isnan(cells), np.inf, cells)
    order = np.lexsort(cells.T)
    reach = min(_REACH, int(len(np.unique(ticks)) / 4))
    same = (cells[order[1:]] == cells[order[:-1]]).all(-1) & (np.diff(order) <= reach)
    again = np.zeros(len(ticks), bool)
    again[order[1:][same]] = True
    if not again.any():
        return ticks, rows, ()
    note = f"{again.sum()} rows are there again, some rows later; the first of each is taken"
    return ticks[~again], rows[~again], (note,)


def going_on(times: FloatArray, unit: float) -> tuple[FloatArray, tuple[str, ...]]:
    """Times (n,) s of a clock of 16 or 32 bits that counts units of so many seconds, without its
    starts at 0, with a note on these.
    """
    steps = np.diff(times)
    back = np.flatnonzero(steps < 0)
    if not back.size or not (steps > 0).any():
        return times, ()
    usual = float(np.median(steps[steps > 0]))
    for bits in (16, 32):
        period = unit * 2.0**bits
        across = period + steps[back]
        most = max(_ACROSS * usual, min(_LOST_S, _SHARE * period))
        if ((across > 0) & (across < most)).all():
            anew = np.zeros(len(times))
            anew[back + 1] = period
            note = f"its times start at 0 again {back.size} times, after {bits} bits, and go on"
            return times + np.cumsum(anew), (note,)
    return times, ()


def check_order(times: FloatArray) -> None:
    """Refuses times (n,) s that go back.

    Raises:
        LegsimError: with the first place, and with what helps: sorting where the sorted times are
            even, else a rate.
    """
    back = np.flatnonzero(np.diff(times) < 0)
    if not back.size:
        return
    k = int(back[0])
    said = f"time {times[k + 1]:.13g} s comes after {times[k]:.13g} s (sample {k + 1})"
    steps = np.diff(np.sort(times))
    usual = float(np.median(steps))
    if back.size == 1 and _begins_anew(times, k):
        fix = "the clock begins anew there: split the file into its recordings"
    elif usual > 0 and (steps < _CLOSE * usual).mean() < 0.5 * back.size / len(steps):
        out = "1 sample is" if back.size == 1 else f"{back.size} samples are"
        fix = f"{out} out of order: sort the rows by their times"
    elif (np.diff(np.delete(times, back + 1)) >= 0).all():
        fix = "that row has a wrong time: correct it, or delete the row"
    else:
        fix = (
            "the clock was set back, or the times are those of delivery: leave the column of times "
            "out and give rate_hz, if no sample is lost"
        )
    raise LegsimError(f"{said}; {fix}")


def _begins_anew(times: FloatArray, last: int) -> bool:
    """Whether what follows the sample ``last`` begins about where the times (n,) s begin."""
    far = float(times[last] - times[last + 1]) > 0.5 * float(times[last] - times[0]) > 0
    # the row behind a single wrong time goes on where the rows before it were
    return far and last + 2 < len(times) and bool(times[last + 2] < times[last])


def joined(ticks: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Ticks (m,) and rows (m, k) without copies, with a note on these.

    Neighbors of one tick that are the same in all cells are one row, and so are those of which each
    has what the others lack, as where every instrument writes its own. Rows of one tick that have
    the same cells stay apart.

    Args:
        ticks: (n,) times or numbers of packets.
        rows: (n, k), NaN where a cell is empty.
    """
    if not (np.diff(ticks) == 0).any():
        return ticks, rows, ()
    same = ((rows[1:] == rows[:-1]) | (np.isnan(rows[1:]) & np.isnan(rows[:-1]))).all(-1)
    twice = np.concatenate([[False], same & (np.diff(ticks) == 0)])
    ticks, rows = ticks[~twice], rows[~twice]
    notes = (f"{twice.sum()} rows are there twice; one of each is taken",) if twice.any() else ()
    first = _begins(ticks, np.isfinite(rows))
    there = np.add.reduceat(np.isfinite(rows).astype(int), first)
    filled = np.add.reduceat(np.nan_to_num(rows), first)
    return ticks[first], np.where(there == 1, filled, np.nan), notes


def _begins(ticks: FloatArray, known: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Index of the first of the rows (n, k) that are joined to one each."""
    first = _first(ticks)
    begins = np.zeros(len(ticks), bool)
    begins[first] = True
    crowded = (np.add.reduceat(known.astype(int), first) > 1).any(-1)
    ends = np.append(first[1:], len(ticks))
    for begin, end in zip(first[crowded], ends[crowded], strict=True):
        taken = known[begin].copy()
        for k in range(begin + 1, end):
            begins[k] = (taken & known[k]).any()
            taken = known[k] | (taken & ~begins[k])
    return np.flatnonzero(begins)


def spread(times: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Times (n,) s that all differ, with a note: samples of one time evenly up to the next one.

    Raises:
        LegsimError: more than a third share their time with the sample before: they came in
            packets.
    """
    first, count = _first(times), len(times)
    shared = count - len(first)
    if not shared:
        return times, ()
    usual = float(times[-1] - times[0]) / (count - 1)
    if shared > _ROUNDED * count:
        rate = f", about {1 / usual:.4g}" if usual > 0 else ""
        raise LegsimError(
            f"{shared} of {count} samples share their time with the one before: the times are "
            "those of delivery, or rounded; leave the column of times out, and give rate_hz" + rate
        )
    counts = np.diff(first, append=count)
    of = np.repeat(np.arange(len(first)), counts)
    # the tick that samples share lasts up to the next one, or as long as they usually take
    room = np.minimum(np.diff(times[first], append=np.inf), counts * usual)
    note = f"{shared} samples share their time with the one before: spread evenly up to the next"
    return times + (np.arange(count) - first[of]) * (room / counts)[of], (note,)


def _first(ticks: FloatArray) -> np.ndarray:
    """Index of the first row of each tick."""
    return np.flatnonzero(np.concatenate([[True], np.diff(ticks) != 0]))
