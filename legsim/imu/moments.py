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

_MONTH_FIRST = re.compile(r"([A-Za-z]{3,9})[-/. ]+(\d{1,2}),?[-/. ]+(\d{4})(?=[, T_])")

_Parts = tuple[str, str, str]
"""of a date, as they are written"""

_LONG, _CLEAR = 7, 4
"""days of a recording beyond which an order is in doubt, unless others give it so many times them
"""

_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")

_MOST = 0.9
"""of a day or an hour: a clock that falls by more has begun anew"""


def seconds(
    path: Path, lines: Sequence[int], cells: Sequence[str], column: str | int
) -> FloatArray:
    """Seconds (n,) since 1970, or since midnight or the hour where cells have the time alone; NaN
    where a cell is empty.

    A time of the day that falls by almost a whole day is past midnight, and one of minutes and
    seconds that falls by almost an hour is in the next one. Where a date may be read in several
    orders, it is the one by which days go on.

    Raises:
        LegsimError: a cell is neither, or not as the others are, with its line; dates whose order
            is not clear.
    """
    # milliseconds behind a third colon, and a month's name before the day
    plain = [_MILLISECONDS.sub(r"\1.\2", cell.strip()) for cell in cells]
    plain = [_MONTH_FIRST.sub(r"\2-\1-\3", cell) for cell in plain]
    there = [cell for cell in plain if cell]
    halves = all(_HALF.fullmatch(cell) for cell in there)
    dated = bool(there) and _time_of_day(there[0], halves) is None
    order = _order(path, there, column) if dated else ""
    times = np.full(len(plain), np.nan)
    for k, text in enumerate(plain):
        if not text:
            continue
        found = _dated(text, halves, order) if dated else _time_of_day(text, halves)
        if found is None:
            raise file_error(
                path,
                f"{cells[k].strip()[:40]!r} in column {column!r} is no date and time",
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


def _dated(text: str, halves: bool, order: str) -> float | None:
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
        date = _date((found[1], found[3], found[4]), order)
        begin = datetime.datetime(*date, tzinfo=datetime.UTC)
    except ValueError:
        return None
    return begin.timestamp() + clock


def _date(parts: _Parts, order: str) -> tuple[int, int, int]:
    """Year, month and day.

    Raises:
        ValueError: a month's name that is none.
    """
    part = dict(zip("ymd" if len(parts[0]) > 2 else order, parts, strict=True))
    year = int(part["y"]) + 2000 * (len(part["y"]) == 2)
    return year, _month(part["m"]), int(part["d"])


def _month(text: str) -> int:
    return int(text) if text.isdigit() else 1 + _MONTHS.index(text[:3].lower())


def _order(path: Path, cells: Sequence[str], column: str | int) -> str:
    """Order of day (d), month (m) and year (y) of dates that do not begin with four digits: the one
    by which the column goes on from day to day.

    Raises:
        LegsimError: by several orders it would leap over days.
    """
    found = [f for f in map(_DATED.fullmatch, cells) if f and len(f[1]) < 3]
    dates = sorted({(f[1], f[3], f[4]) for f in found})
    if not dates:
        return "ymd"
    spans = {order: _span(dates, order) for order in _orders(dates, found[0][2])}
    first, *others = sorted(spans, key=lambda order: spans[order])
    wrong, days = spans[first]
    rivals = [order for order in others if spans[order][0] == wrong]
    if rivals and days > _LONG and spans[rivals[0]][1] < _CLEAR * days:
        raise file_error(
            path,
            f"dates such as {found[0][0][:40]!r} in column {column!r} may be of the order "
            f"{first!r} or {rivals[0]!r} (day, month, year), and leap over days by each",
            "write them as 2025-01-31T12:00:00.125",
        )
    return first


def _orders(dates: Sequence[_Parts], mark: str) -> list[str]:
    """Orders that dates may have, the usual one of their mark first."""
    named = any(month.isalpha() for _, month, _ in dates)
    orders = ["dmy"] if named or mark == "." else ["mdy", "dmy"]
    if all(len(last) < 3 for *_, last in dates):
        orders.insert(0 if mark == "-" and not named else len(orders), "ymd")
    return orders


def _span(dates: Sequence[_Parts], order: str) -> tuple[int, int]:
    """How many of the dates are none by this order, and the days from the first to the last."""
    days = []
    for parts in dates:
        try:
            days.append(datetime.date(*_date(parts, order)).toordinal())
        except ValueError:
            continue
    return len(dates) - len(days), max(days, default=0) - min(days, default=0)
