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


def rate_doubts(
    path: Path, names: Sequence[str], only: RowsOf | None, rate_hz: float, count: float
) -> tuple[str, ...]:
    """Doubts a stated rate by columns of the table that look like times; nothing where each of them
    goes with it in some unit, or says nothing.

    Args:
        path: of the table.
        names: of its columns.
        only: the rows that are read.
        rate_hz: as stated.
        count: samples between the first and the last row, lost ones among them.
    """
    alike = [name for name in names if _LIKE_TIMES.search(name) and names.count(name) == 1]
    spans = [(name, span) for name in alike if (span := _span(path, name, only)) is not None]
    return tuple(
        f"In doubt: by its column {name!r} the table has {said} samples per second, not "
        f"{rate_hz:g} (rate_hz): give the column of times (time), or correct the rate"
        for name, span in spans
        if (said := _other_rate(name, count / span, rate_hz))
    )


def _span(path: Path, name: str, only: RowsOf | None) -> float | None:
    """What a column grows by from the first to the last row; None where it does not only grow."""
    try:
        rows = read_rows(path, [name], only).rows
        times = np.array([number_in(path, line, cells[0], name) for line, cells in rows])
    except LegsimError:  # dates, or text
        return None
    times = times[np.isfinite(times)]
    grows = len(times) > 1 and bool((np.diff(times) >= 0).all() and times[-1] > times[0])
    return float(times[-1] - times[0]) if grows else None


def _other_rate(name: str, per_unit: float, rate_hz: float) -> str:
    """The rate by a column's growth per sample; empty where it is about the stated one."""
    stated = units.in_name(name) or units.hinted(name) or ""
    seconds = {str(unit): factor for unit, factor in units.SECONDS.items()}.get(stated)
    rates = [per_unit / unit for unit in ([seconds] if seconds else _UNITS_S)]
    nearest = min(rates, key=lambda rate: abs(np.log(rate / rate_hz)))
    counts = abs(per_unit - 1) < _OFF  # a number per sample is no time
    return "" if counts or abs(nearest / rate_hz - 1) < _OFF else f"{nearest:.4g}"
