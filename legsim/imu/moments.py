"""Dates and times of the day in the cells of a table, as seconds."""

import datetime
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from legsim.core.errors import file_error
from legsim.core.values import FloatArray

_CLOCK = re.compile(r"(?:(\d{1,3}):)?(\d{1,2}):(\d{1,2}(?:[.,]\d*)?)(?:Z|[+-]\d\d:?\d\d)?")
"""hours, minutes and seconds; minutes and seconds where there is one colon"""

_MILLISECONDS = re.compile(r"(\d{1,2}:\d{2}:\d{2}):(\d{3})$")

_MOST = 0.9
"""of a day or an hour: a clock that falls by more has begun anew"""


def seconds(
    path: Path, lines: Sequence[int], cells: Sequence[str], column: str | int
) -> FloatArray:
    """Seconds (n,) since 1970, or since midnight or the hour where cells have the time alone; NaN
    where a cell is empty.

    A time of the day that falls by almost a whole day is past midnight, and one of minutes and
    seconds that falls by almost an hour is in the next one.

    Raises:
        LegsimError: a cell is neither, with its line.
    """
    times = np.array([_moment(path, n, t, column) for n, t in zip(lines, cells, strict=True)])
    there = np.isfinite(times)
    clocks = [_CLOCK.fullmatch(_MILLISECONDS.sub(r"\1.\2", cell)) for cell in cells if cell]
    if clocks and all(clocks):
        period = 86400.0 if any(clock and clock[1] for clock in clocks) else 3600.0
        anew = np.diff(times[there], prepend=times[there][:1]) < -_MOST * period
        times[there] += period * np.cumsum(anew)
    return times


def _moment(path: Path, line: int, text: str, column: str | int) -> float:
    if not text:
        return np.nan
    # milliseconds behind a third colon
    text = _MILLISECONDS.sub(r"\1.\2", text)
    try:
        clock = _CLOCK.fullmatch(text)
        if clock is not None:
            hours, minutes, rest = (float((t or "0").replace(",", ".")) for t in clock.groups())
            if max(minutes, rest) >= 60:
                raise ValueError("no time of the day")
            return 3600 * hours + 60 * minutes + rest
        moment = datetime.datetime.fromisoformat(text.replace("/", "-").replace(",", "."))
        if moment.tzinfo is None:
            moment = moment.replace(tzinfo=datetime.UTC)
        return moment.timestamp()
    except ValueError:
        raise file_error(
            path,
            f"{text[:40]!r} in column {column!r} is no date and time",
            "write it as 2025-01-31T12:00:00.125, as 12:00:00.125 or as 00:00.125",
            place=f"line {line}",
        ) from None
