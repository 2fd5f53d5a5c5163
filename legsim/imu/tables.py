"""Sensors in a table of text: which columns are which, in which units, by which clock."""

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from legsim.core import files
from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import LARGEST, FloatArray
from legsim.imu import packets
from legsim.imu.recording import ImuRecording, check_plausible, gap_note

AccelerationUnit = Literal["m/s2", "g", "mg"]
AngularVelocityUnit = Literal["rad/s", "deg/s"]
Units = tuple[AccelerationUnit, AngularVelocityUnit]
TimeUnit = Literal["s", "ms", "us"]

_ACCELERATION = {"m/s2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY}
_ANGULAR_VELOCITY = {"rad/s": 1.0, "deg/s": math.pi / 180}
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}

_DELIMITERS = (",", ";", "\t", " ")

_HEADER_WITHIN = 200
"""lines among which the row of column names is searched"""


@dataclass(frozen=True, slots=True)
class SensorColumns:
    """Columns of one sensor."""

    name: str
    acceleration: tuple[str, str, str]
    """names of the columns of x, y, z"""
    angular_velocity: tuple[str, str, str]


@dataclass(frozen=True, slots=True)
class TableLayout:
    """What the columns of a table are."""

    sensors: tuple[SensorColumns, ...]
    acceleration_unit: AccelerationUnit = "m/s2"
    angular_velocity_unit: AngularVelocityUnit = "rad/s"
    time: str | None = None
    """column of times; None where rate_hz gives them"""
    time_unit: TimeUnit = "s"
    rate_hz: float | None = None
    counter: str | None = None
    """column of the packets' numbers; with rate_hz it gives times, and shows lost packets"""
    counter_period: int | None = None
    """count after which the counter starts at 0 again; None finds it"""

    def __post_init__(self) -> None:
        if (self.time is None) == (self.rate_hz is None):
            raise LegsimError(
                "a table of sensors has times by a column (time) or by a rate (rate_hz); give one "
                "of them"
            )
        if self.counter is not None and self.rate_hz is None:
            raise LegsimError("a packet counter needs rate_hz to become times; give it")

    def columns(self) -> tuple[str, ...]:
        """Names of all columns that are read."""
        of_clock = tuple(c for c in (self.time, self.counter) if c is not None)
        return of_clock + tuple(
            c for s in self.sensors for c in (*s.acceleration, *s.angular_velocity)
        )


def load(path: Path | str, layout: TableLayout) -> tuple[ImuRecording, ...]:
    """Reads the sensors of a table: comma, semicolon, tab or blanks between columns.

    Lines above the row of names are passed over. Rows in which a sensor has no numbers (lost
    packets) are left out and noted.

    Raises:
        LegsimError: missing columns, cells that are no numbers, times that do not increase, units
            that cannot be.
    """
    path = Path(path)
    table = read_columns(path, layout.columns())
    try:
        times, present = _times(table, layout)
    except LegsimError as error:
        raise file_error(path, str(error).partition(";")[0], _fix(error)) from error
    made = []
    for sensor in layout.sensors:
        force, rate = (
            np.stack([table[c][present] for c in columns], -1)
            for columns in (sensor.acceleration, sensor.angular_velocity)
        )
        units = layout.acceleration_unit, layout.angular_velocity_unit
        made.append(recording_of(path, sensor.name, times, *in_si(rate, force, units)))
    return tuple(made)


def in_si(rate: FloatArray, force: FloatArray, units: Units) -> tuple[FloatArray, FloatArray]:
    """Angular velocities in rad/s and specific forces in m/s^2, from stated units."""
    return _ANGULAR_VELOCITY[units[1]] * rate, _ACCELERATION[units[0]] * force


def recording_of(
    path: Path, name: str, times: FloatArray, rate: FloatArray, force: FloatArray
) -> ImuRecording:
    """Builds the checked recording of one sensor; samples that are NaN are left out and noted.

    Raises:
        LegsimError: times that do not increase, few samples, units that cannot be.
    """
    seen = np.asarray(np.isfinite(rate).all(-1) & np.isfinite(force).all(-1))
    if seen.sum() < 0.5 * len(seen):
        raise file_error(
            path,
            f"sensor {name!r} has numbers in {int(seen.sum())} of {len(seen)} samples",
            "check its columns, or export it again",
        )
    try:
        times = times[seen]
        made = ImuRecording(name, times, rate[seen], force[seen], gap_note(name, times))
        check_plausible(made)
    except LegsimError as error:
        raise file_error(path, str(error).partition("; ")[0], _fix(error)) from error
    return made


def read_columns(path: Path, wanted: Sequence[str]) -> dict[str, FloatArray]:
    """Reads the columns ``wanted`` (n,) of a table by their names; NaN where a cell is empty.

    Raises:
        LegsimError: as :func:`read_rows`; cells that are no numbers.
    """
    rows = [
        [_number(path, line, text, name) for text, name in zip(cells, wanted, strict=True)]
        for line, cells in read_rows(path, wanted)
    ]
    return dict(zip(wanted, np.array(rows).T, strict=True))


def read_rows(path: Path, wanted: Sequence[str]) -> list[tuple[int, list[str]]]:
    """Reads (line number, cells of the columns ``wanted``) of each row of a table.

    Columns are parted by comma, semicolon, tab or blanks; lines above their names are passed over.

    Raises:
        LegsimError: a file that cannot be read, missing columns, rows that break off.
    """
    lines = files.read(path, "table")
    found = next(
        (
            (k, delimiter)
            for k, line in enumerate(lines[:_HEADER_WITHIN])
            for delimiter in _DELIMITERS
            if set(wanted) <= set(cells_of(line, delimiter))
        ),
        None,
    )
    if found is None:
        raise _missing(path, lines, wanted)
    start, delimiter = found
    names = cells_of(lines[start], delimiter)
    doubled = [name for name in wanted if names.count(name) > 1]
    if doubled:
        raise file_error(
            path, f"column {doubled[0]!r} is there twice", "rename one", place=f"line {start + 1}"
        )
    at = [names.index(name) for name in wanted]
    rows = []
    for number, line in enumerate(lines[start + 1 :], start + 2):
        if not line.strip():
            continue
        cells = cells_of(line, delimiter)
        if len(cells) <= max(at):
            raise file_error(
                path,
                f"the row has {len(cells)} cells, the header {len(names)}",
                "complete the row, or delete it where the recording broke off",
                place=f"line {number}",
            )
        rows.append((number, [cells[k] for k in at]))
    if len(rows) < 2:
        raise file_error(path, "holds no samples below its names", "export it again")
    return rows


def cells_of(line: str, delimiter: str) -> list[str]:
    """Cells of a line, without blanks and quotes around them."""
    if delimiter == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]


def _missing(path: Path, lines: Sequence[str], wanted: Sequence[str]) -> LegsimError:
    best: set[str] = set()
    place, names = 0, [""]
    for k, line in enumerate(lines[:_HEADER_WITHIN]):
        for delimiter in _DELIMITERS:
            cells = cells_of(line, delimiter)
            if len(set(wanted) & set(cells)) > len(best):
                best, place, names = set(wanted) & set(cells), k, cells
    missing = ", ".join(repr(name) for name in wanted if name not in best)
    known = f"; the line has {', '.join(n for n in names if n)}" if best else ""
    return file_error(
        path,
        f"has no line with the column{'s' * (len(wanted) - len(best) > 1)} {missing}{known}",
        "correct the names of the columns",
        place=f"line {place + 1}" if best else f"first {_HEADER_WITHIN} lines",
    )


def _number(path: Path, line: int, text: str, column: str) -> float:
    if not text or re.fullmatch(r"(?i)[-+]?nan|n/a|null", text):
        return math.nan
    try:
        value = float(text.replace(",", "."))  # a decimal comma: commas between columns are gone
        if abs(value) > LARGEST or "_" in text:
            raise ValueError
        return value
    except ValueError:
        raise file_error(
            path,
            f"{text[:40]!r} in column {column!r} is not a number",
            "correct the cell, or leave it empty where the packet was lost",
            place=f"line {line}",
        ) from None


def _times(
    table: dict[str, FloatArray], layout: TableLayout
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Times (m,) s of the rows that have one, and which rows (n,) these are."""
    if layout.time is not None:
        times = _SECONDS[layout.time_unit] * table[layout.time]
        present = np.isfinite(times)
        _check_order(times[present])
        return times[present], present
    count = len(next(iter(table.values())))
    if layout.counter is None:
        return np.arange(count) / (layout.rate_hz or 1.0), np.ones(count, bool)
    present = np.isfinite(table[layout.counter])
    sent = packets.unwrapped(table[layout.counter][present], layout.counter_period)
    return sent / (layout.rate_hz or 1.0), present


def _check_order(times: FloatArray) -> None:
    late = np.flatnonzero(np.diff(times) <= 0)
    if late.size:
        k = late[0]
        kind = "is there twice" if times[k + 1] == times[k] else f"comes after {times[k]:g} s"
        raise LegsimError(
            f"time {times[k + 1]:g} s {kind} (sample {k + 1}); keep one sample a time, in order"
        )


def _fix(error: LegsimError) -> str:
    return str(error).partition("; ")[2] or "correct it there"
