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

_MILLISECONDS = re.compile(r"(\d{1,2}:\d{1,2}:\d{1,2}):(\d{3})\b")

_HALF = re.compile(r"(.*\d)\s*([AaPp])\.?[Mm]\.?")
"""of a clock of twelve hours"""

_DATED = re.compile(r"(\d{1,4})([-/. ])(\d{1,2}|[A-Za-z]{3,9})\2(\d{1,4}),?[ T_]+(\d.*)")
"""year, month and day, or day and month in any order and the year; then the time"""

_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")

_MOST = 0.9
"""of a day or an hour: a clock that falls by more has begun anew"""


def seconds(
    path: Path, lines: Sequence[int], cells: Sequence[str], column: str | int
) -> FloatArray:
    """Seconds (n,) since 1970, or since midnight or the hour where cells have the time alone; NaN
    where a cell is empty.

    A time of the day that falls by almost a whole day is past midnight, and one of minutes and
    seconds that falls by almost an hour is in the next one. Where days and months may be either,
    the part that changes is the day.

    Raises:
        LegsimError: a cell is neither, or not as the others are, with its line.
    """
    # milliseconds behind a third colon
    plain = [_MILLISECONDS.sub(r"\1.\2", cell.strip()) for cell in cells]
    there = [cell for cell in plain if cell]
    halves = all(_HALF.fullmatch(cell) for cell in there)
    dated, day_first = bool(there) and _time_of_day(there[0], halves) is None, _day_first(there)
    times = np.full(len(plain), np.nan)
    for k, text in enumerate(plain):
        if not text:
            continue
        found = _dated(text, halves, day_first) if dated else _time_of_day(text, halves)
        if found is None:
            raise file_error(
                path,
                f"{text[:40]!r} in column {column!r} is no date and time",
                "write it as 2025-01-31T12:00:00.125, as 12:00:00.125 or as 00:00.125, and all "
                "cells alike",
                place=f"line {lines[k]}",
            )
        times[k] = found
    known = np.isfinite(times)
    if there and not dated:
        hours = any(clock and clock[1] for clock in map(_CLOCK.fullmatch, there)) or halves
        period = 86400.0 if hours else 3600.0
        anew = np.diff(times[known], prepend=times[known][:1]) < -_MOST * period
        times[known] += period * np.cumsum(anew)
    return times


def _time_of_day(text: str, halves: bool) -> float | None:
    """Seconds since midnight, or the hour; None for other text."""
    later = 0.0
    if halves:
        half = _HALF.fullmatch(text)
        if half is None:
            return None
        text, later = half[1], 43200.0 * (half[2] in "pP")
    clock = _CLOCK.fullmatch(text)
    if clock is None:
        return None
    hours, minutes, rest = (float((t or "0").replace(",", ".")) for t in clock.groups())
    if max(minutes, rest) >= 60 or (halves and not 1 <= hours <= 12):
        return None
    return 3600 * (hours % 12 if halves else hours) + 60 * minutes + rest + later


def _dated(text: str, halves: bool, day_first: bool) -> float | None:
    """Seconds since 1970 of a date and time; None for other text."""
    try:
        moment = datetime.datetime.fromisoformat(text.replace("/", "-").replace(",", "."))
        if moment.tzinfo is None:
            moment = moment.replace(tzinfo=datetime.UTC)
        return moment.timestamp()
    except ValueError:
        found = _DATED.fullmatch(text)
    clock = None if found is None else _time_of_day(found[5], halves)
    if found is None or clock is None:
        return None
    try:
        begin = datetime.datetime(*_date(found, day_first), tzinfo=datetime.UTC)
    except ValueError:
        return None
    return begin.timestamp() + clock


def _date(found: re.Match[str], day_first: bool) -> tuple[int, int, int]:
    """Year, month and day.

    Raises:
        ValueError: a month's name that is none.
    """
    first, second, last = found[1], found[3], found[4]
    if len(first) > 2:
        return int(first), _month(second), int(last)
    day, month = (first, second) if day_first or second.isalpha() else (second, first)
    return int(last) + 2000 * (len(last) == 2), _month(month), int(day)


def _month(text: str) -> int:
    return int(text) if text.isdigit() else 1 + _MONTHS.index(text[:3].lower())


def _day_first(cells: Sequence[str]) -> bool:
    """Whether dates whose year is last begin with the day: with points they do, else as numbers
    above 12, or what of the two changes, have it.
    """
    dates = [found for found in map(_DATED.fullmatch, cells) if found and found[3].isdigit()]
    if not dates or dates[0][2] == ".":
        return True
    first, second = ({int(found[k]) for found in dates} for k in (1, 3))
    if max(first) > 12 or max(second) > 12:
        return max(first) > 12
    return len(first) > len(second)
