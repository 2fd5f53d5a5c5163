"""Times that stand in a table beside the sampling rate that somebody states."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from legsim.core.errors import LegsimError
from legsim.imu import units
from legsim.imu.table_rows import RowsOf, number_in, read_rows

_LIKE_TIMES = re.compile(r"(?i)time|zeit|temps|tiempo|epoc|elapsed|^t$|^ts$|时间")

_UNITS_S = (1.0, 1e-3, 1e-4, 1e-6, 1e-7, 1e-9)
"""s per unit of times whose unit nothing states: ticks of 0.1 ms and 100 ns among them"""

_OFF = 0.02
"""of a rate, by which a stated one may be another: crystals are off by 0.01 %"""

_NEAR = 2.5
"""times a stated rate, within which one by times of a unit that nothing states is believed"""


def rate_doubts(
    path: Path, names: Sequence[str], only: RowsOf | None, rate_hz: float, count: float
) -> tuple[str, ...]:
    """Doubts a stated rate by columns of the table that look like times; nothing where each of them
    goes with it in some unit, or says nothing, as days, minutes and ticks of a processor do.

    Args:
        path: of the table.
        names: of its columns.
        only: the rows that are read.
        rate_hz: as stated.
        count: samples between the first and the last row, lost ones among them.
    """
    alike = [name for name in names if _LIKE_TIMES.search(name) and names.count(name) == 1]
    grown = [(name, found) for name in alike if (found := _growth(path, name, only)) is not None]
    return tuple(
        f"In doubt: by its column {name!r} the table has {said} samples per second, not "
        f"{rate_hz:g} (rate_hz): give the column of times (time), or correct the rate"
        for name, (span, off) in grown
        if (said := _other_rate(name, count / span, rate_hz, off))
    )


def _growth(path: Path, name: str, only: RowsOf | None) -> tuple[float, float] | None:
    """What a column grows by from the first to the last row, and share of it by which that is off;
    None where it does not only grow.

    Times that are rounded, or of delivery in bursts, are off by a step at their ends. The longest
    step is left out: it may be the only gap.
    """
    try:
        rows = read_rows(path, [name], only).rows
        times = np.array([number_in(path, line, cells[0], name) for line, cells in rows])
    except LegsimError:  # dates, or text
        return None
    steps = np.diff(times[np.isfinite(times)])
    span = float(steps.sum())
    if not ((steps >= 0).all() and span > 0):
        return None
    longest = np.sort(steps)[-2:]
    long = float(longest[0] or longest[-1])
    return span, (long + float(np.median(steps))) / span


def _other_rate(name: str, per_unit: float, rate_hz: float, off: float) -> str:
    """The rate by a column's growth per sample; empty where it is about the stated one, or where
    the column is in another unit than those of times here.
    """
    stated = units.of_name(name)
    seconds = None if stated is None else units.seconds_of(stated)
    rates = [per_unit / unit for unit in (_UNITS_S if seconds is None else [seconds])]
    nearest = min(rates, key=lambda rate: abs(np.log(rate / rate_hz)))
    unknown = stated is not None and seconds is None
    far = stated is None and abs(np.log(nearest / rate_hz)) > np.log(_NEAR)
    counts = abs(per_unit - 1) < _OFF  # a number per sample is no time
    alike = abs(nearest / rate_hz - 1) < _OFF + off
    return "" if unknown or far or counts or alike else f"{nearest:.4g}"
