"""Marker files of the TRC format (Motion Analysis; the one OpenSim reads): text in, text out.

Facts of the format: OpenSim's documentation, "Marker (.trc) Files"; what is unusual but understood
is listed in docs/formats.md.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from legsim.core import files
from legsim.core.errors import file_error, printable
from legsim.core.values import LARGEST, FloatArray
from legsim.mocap._trc_times import SAME_RATE, TimeColumn, row_times, unit_of
from legsim.mocap.cells import number
from legsim.mocap.raw import RawMarkers
from legsim.mocap.trajectories import MarkerTrajectories

_EXPORT_AGAIN = "export the trial again as TRC"

_MARKS = ("\t", ";", ",")
"""between cells, in this order: semicolons where the comma is decimal"""

_AXES = re.compile(r"(\S+\s+){0,2}[xyz]\d*\b")
"""of the line below the names, whose first two cells some writers fill"""

_SLOWEST_HZ, _FASTEST_HZ = 2.0, 10_000.0
"""of a time column that is in seconds"""

_HEADER_KEYS = (
    "DataRate",
    "CameraRate",
    "NumFrames",
    "NumMarkers",
    "Units",
    "OrigDataRate",
    "OrigDataStartFrame",
    "OrigNumFrames",
)


@dataclass(frozen=True, slots=True)
class _Header:
    rate: str
    """as it stands there"""
    other_rates: dict[str, str]
    """of the camera and before resampling, by key, as they stand there"""
    rate_line: int
    frames: int | None
    units: str
    names: tuple[str, ...]
    """blank where a column has no name"""
    first_row: int
    """index of the first line after the header"""


@dataclass(frozen=True, slots=True)
class _Rows:
    lines: list[int]
    """line number of each row, counted from 1"""
    frames: list[int]
    time_texts: list[str]
    values: list[list[float]]
    unlabeled: int
    """rows that hold more columns than there are names"""


def load(path: Path | str, *, unit: str | None = None, up: str | None = None) -> MarkerTrajectories:
    """Reads markers as meters in world; a marker not seen (blank, NaN or exactly 0, 0, 0) is NaN.

    Args:
        unit: "m", "cm" or "mm" where the header is wrong.
        up: lab axis that points up ("y", "z", ...); judged from the markers by default, y being
            this format's habit.

    Raises:
        LegsimError: the file is not TRC, or it cannot be read without guessing.
    """
    return read(path).to_motion(unit=unit, up=up)


def read(path: Path | str) -> RawMarkers:
    """Reads markers in the file's own unit and axes, with notes about what was put right.

    Raises:
        LegsimError: as :func:`load`.
    """
    path = Path(path)
    lines = files.read(path, "TRC")
    header = _header(path, lines)
    rows = _rows(path, lines, header)
    stated = np.array(
        [
            _number(path, f"line {k}", text, "Time") if text else math.nan
            for k, text in zip(rows.lines, rows.time_texts, strict=True)
        ]
    )
    rate, rate_notes = _rate(path, header, stated)
    times, time_notes = row_times(
        path, rate, TimeColumn(rows.lines, rows.frames, rows.time_texts, stated)
    )
    kept = [k for k, name in enumerate(header.names) if name]
    positions = np.array(rows.values).reshape(len(times), len(header.names), 3)[:, kept]
    labels = tuple(header.names[k] for k in kept)
    return RawMarkers(
        str(path),
        times,
        labels,
        positions,
        header.units,
        "",
        "y",
        _notes(header, rows) + rate_notes + time_notes,
    )


def save(path: Path | str, motion: MarkerTrajectories) -> None:
    """Writes markers in meters along world's axes (y up), every number so that reading it back
    gives the same float64.

    A marker not seen is written NaN: a blank would shift the columns of readers that split at white
    space.

    Raises:
        LegsimError: there is no marker, a name cannot stand in the format, or the file cannot be
            written.
    """
    for name in motion.marker_names:
        if not name.strip() or name != name.strip() or re.search(r"[\t\r\n]", name):
            raise file_error(
                path,
                f"marker name {name!r} cannot be written",
                "rename the marker: no tabs, no blanks at its ends",
                place="line 4",
            )
    if not motion.marker_names or len(motion.times) == 0:
        raise file_error(
            path, "there is no marker or no sample to write", "save a motion that has both"
        )
    files.write_text(path, _text(printable(Path(path).name), motion))


def _text(name: str, motion: MarkerTrajectories) -> str:
    n, m = len(motion.times), len(motion.marker_names)
    rate = repr(float(motion.rate_hz)) if n > 1 else "1.0"
    axes = "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, m + 1))
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{name}",
        "\t".join(_HEADER_KEYS),
        "\t".join([rate, rate, str(n), str(m), "m", rate, "1", str(n)]),
        "Frame#\tTime\t" + "\t\t\t".join(motion.marker_names) + "\t\t",
        f"\t\t{axes}",
        "",
    ]
    table = motion.positions_world.reshape(n, 3 * m).tolist()
    for k, (time, row) in enumerate(zip(motion.times.tolist(), table, strict=True), start=1):
        lines.append(
            f"{k}\t{time!r}\t" + "\t".join("NaN" if math.isnan(x) else repr(x) for x in row)
        )
    return "\n".join(lines) + "\n"


def _header(path: Path, lines: list[str]) -> _Header:
    filled = [k for k, line in enumerate(lines) if line.strip(" \t,;")]
    starts = ("pathfiletype", "datarate", "", "frame#")
    for order, (start, what) in enumerate(
        zip(starts, ("PathFileType", "DataRate", "the numbers", "Frame#"), strict=True)
    ):
        if order >= len(filled):
            raise file_error(
                path,
                f"the file ends before the header line with {what}",
                _EXPORT_AGAIN,
                place=f"line {len(lines)}",
            )
        if not lines[filled[order]].strip(" \t,;\"'").lower().startswith(start):
            raise file_error(
                path,
                f"the header line should start with {what}",
                _EXPORT_AGAIN,
                place=f"line {filled[order] + 1}",
            )
    keys, numbers, names = (lines[k] for k in filled[1:4])
    cells = _header_numbers(keys, numbers)
    frames = cells.get("numframes", "")
    labels = _names(path, names, f"line {filled[3] + 1}")
    first = filled[3] + 1
    if len(filled) > 4 and _AXES.match(re.sub("[,;]", " ", lines[filled[4]]).strip().lower()):
        first = filled[4] + 1
    return _Header(
        cells.get("datarate", ""),
        {key: cells.get(key.lower(), "") for key in ("CameraRate", "OrigDataRate")},
        filled[2] + 1,
        int(frames) if frames.isdecimal() else None,
        cells.get("units", ""),
        labels,
        first,
    )


def _rate(path: Path, header: _Header, stated: FloatArray) -> tuple[float, tuple[str, ...]]:
    """Sampling rate in hertz: DataRate, or the time column's with a note where DataRate is none.

    Raises:
        LegsimError: neither says it, or the column is faster than the camera.
    """
    rate = _positive(header.rate)
    if math.isfinite(rate):
        return rate, ()
    if len(stated) == 1:
        return 1.0, (f"DataRate is {header.rate!r}: a single frame needs none",)
    steps = np.diff(stated)
    return _rate_of_times(path, header, float(np.median(steps)) if (steps > 0).all() else math.nan)


def _rate_of_times(path: Path, header: _Header, step: float) -> tuple[float, tuple[str, ...]]:
    """Sampling rate in hertz by a time column's usual step, beside the header's other rates."""
    others = {key: _positive(text) for key, text in header.other_rates.items()}
    for key, other in others.items():
        if unit_of(step, other)[0]:
            return other, (f"DataRate is {header.rate!r}: the rate is {key}, {other:g} Hz",)
    found = 1 / step
    others = {key: other for key, other in others.items() if math.isfinite(other)}
    said = " and ".join(f"{key} {other:g}" for key, other in others.items())
    fastest = min(_FASTEST_HZ, (1 + SAME_RATE) * max(others.values(), default=math.inf))
    if not _SLOWEST_HZ <= found <= fastest:
        faster = f", and the time column's {found:.4g} Hz are more than {said}"
        raise file_error(
            path,
            f"DataRate is {header.rate!r}, not a positive number"
            + (faster if others and found > _SLOWEST_HZ else ""),
            "write the sampling rate in hertz under DataRate",
            place=f"line {header.rate_line}",
        )
    note = f"DataRate is {header.rate!r}: the rate is the time column's, {found:.4g} Hz"
    if others and not any(abs(found / other - 1) < SAME_RATE for other in others.values()):
        note = f"warning: {note}, though {said} differ: see whether the times are in seconds"
    return found, (note,)


def _positive(text: str) -> float:
    """The rate that a header's cell states; NaN where it states none."""
    try:
        rate = float(text)
    except ValueError:
        return math.nan
    return rate if math.isfinite(rate) and rate > 0 else math.nan


def _header_numbers(keys: str, numbers: str) -> dict[str, str]:
    """Header key (lower case) to text.

    By tabs, semicolons or commas where both lines have them alike, by white space otherwise. Tabs
    that are doubled, as a widespread example has them, count as one.
    """
    for mark in _MARKS:
        names = [cell.strip().lower() for cell in keys.split(mark)]
        cells = [cell.strip() for cell in numbers.split(mark)]
        if len(names) >= 5 and len(cells) >= 5:
            whole = len(_filled(cells)) == len(_filled(names))
            if whole or len(_trimmed(cells)) > len(_trimmed(names)):
                names, cells = _filled(names), _filled(cells)
                if not whole and "units" in names and not any(map(str.isalpha, "".join(cells))):
                    cells.insert(names.index("units"), "")  # left blank
            return dict(zip(names, cells, strict=False))
    return {
        k.lower(): v
        for k, v in zip(
            re.split(r"[\s,]+", keys.strip()), re.split(r"[\s,]+", numbers.strip()), strict=False
        )
    }


def _filled(cells: list[str]) -> list[str]:
    return [cell for cell in cells if cell]


def _trimmed(cells: list[str]) -> list[str]:
    """Cells without the blank ones at both ends."""
    filled = [k for k, cell in enumerate(cells) if cell]
    return cells[filled[0] : filled[-1] + 1] if filled else []


def _names(path: Path, line: str, place: str) -> tuple[str, ...]:
    """Marker names in column order, blank where three columns have none."""
    mark = next(
        (m for m in _MARKS if len(c := _split(line, m)) > 1 and c[1].lower() == "time"), None
    )
    cells = _split(line, mark)[2:]
    filled = [k for k, cell in enumerate(cells) if cell]
    if not filled:
        raise file_error(
            path,
            "no marker is named, so that no column can be told from another",
            "label the markers and export again",
            place=place,
        )
    if all(k % 3 == 0 for k in filled):
        return tuple(cells[0 : filled[-1] + 1 : 3])
    return tuple(cells[k] for k in filled)


def _split(line: str, mark: str | None) -> list[str]:
    """Cells of a line, without an empty first one."""
    cells = [cell.strip() for cell in line.split(mark)]
    return cells[1:] if cells[0] == "" else cells


def _rows(path: Path, lines: list[str], header: _Header) -> _Rows:
    width = 3 * len(header.names)
    rows = _Rows([], [], [], [], 0)
    unlabeled = 0
    for k in range(header.first_row, len(lines)):
        line = lines[k]
        if not re.sub(r"[\s,;]", "", line):
            continue
        place = f"line {k + 1}"
        frame, time_text, cells = _cells(path, place, line, width)
        unlabeled += len(cells) > width
        rows.lines.append(k + 1)
        rows.frames.append(frame)
        rows.time_texts.append(time_text)
        rows.values.append(_coordinates(path, place, cells[:width], header.names))
    if not rows.lines:
        raise file_error(
            path, "there is no row of data", _EXPORT_AGAIN, place=f"line {header.first_row + 1}"
        )
    _check_end(path, lines, header, rows)
    return _Rows(rows.lines, rows.frames, rows.time_texts, rows.values, unlabeled)


def _cells(path: Path, place: str, line: str, width: int) -> tuple[int, str, list[str]]:
    """(frame, text of the time, cells of the coordinates without trailing blanks) of one row."""
    mark = next((m for m in _MARKS if m in line), None)
    cells = _split(line, mark)
    while cells and cells[-1] == "":
        cells.pop()
    if cells[0].lower().startswith("pathfiletype"):
        raise file_error(path, "another TRC file begins here", "split the file", place=place)
    if not re.fullmatch(r"[+-]?\d+(\.0*)?", cells[0]):
        raise file_error(
            path,
            f"frame number {cells[0]!r} is not a whole number",
            "check the row's first column",
            place=place,
        )
    values = cells[2:]
    if len(values) % 3:
        cure = "complete the row, or leave all three coordinates blank"
        raise file_error(
            path,
            f"the row holds {len(values)} coordinates, not a multiple of three (up to {width})",
            cure,
            place=place,
        )
    if mark is None and values and len(values) != width:
        cure = "separate the columns by tabs, so that blanks can be told"
        raise file_error(
            path,
            f"the row holds {len(values)} coordinates where {width} have names",
            cure,
            place=place,
        )
    return int(float(cells[0])), cells[1] if len(cells) > 1 else "", values


def _coordinates(path: Path, place: str, cells: list[str], names: tuple[str, ...]) -> list[float]:
    """The row's 3 m coordinates, NaN where not seen."""
    plain = _plain_numbers(cells)
    if plain is not None:
        return plain + [math.nan] * (3 * len(names) - len(plain))
    values = [
        _number(path, place, cell, names[k // 3]) if cell else math.nan
        for k, cell in enumerate(cells)
    ]
    for k in range(0, len(cells), 3):
        blank = sum(not cell for cell in cells[k : k + 3])
        if blank in (1, 2):
            problem = f"marker {names[k // 3]!r} has {3 - blank} of its 3 coordinates"
            raise file_error(
                path, problem, "complete the row, or leave all three blank", place=place
            )
    return values + [math.nan] * (3 * len(names) - len(values))


def _plain_numbers(cells: list[str]) -> list[float] | None:
    """The numbers of a row that needs no second look, many times as fast; None for any other."""
    try:
        values = list(map(float, cells))
    except ValueError:
        return None
    beyond = any(abs(value) > LARGEST for value in values)
    return None if beyond or any("_" in cell for cell in cells) else values


def _number(path: Path, place: str, text: str, name: str) -> float:
    value = number(text)
    if value is None:
        raise file_error(
            path,
            f"{text[:40]!r} of marker {name!r} is not a number",
            "write decimal points, and nothing where it is not seen",
            place=place,
        )
    return value


def _check_end(path: Path, lines: list[str], header: _Header, rows: _Rows) -> None:
    """Refuses a file cut off inside its last row, whose last number may have lost its last
    digits. A last row that has all its cells, also blank ones, is whole.
    """
    if not lines[-1].strip(" \t,;"):
        return
    whole = lines[-1][-1] in _MARKS and len(re.findall(r"[\t,;]", lines[-1])) > 3 * len(
        header.names
    )
    few = header.frames is not None and len(rows.lines) < header.frames
    marks = [len(re.findall(r"[\t,;]", lines[k - 1].rstrip(" \t,;"))) for k in rows.lines[-2:]]
    if few or (marks[-1] < marks[0] and not whole):
        of = f" of {header.frames}" if header.frames is not None else ""
        problem = f"the file breaks off in this row, number {len(rows.lines)}{of}"
        raise file_error(
            path,
            problem,
            "copy the file again, or delete its last row",
            place=f"line {rows.lines[-1]}",
        )


def _notes(header: _Header, rows: _Rows) -> tuple[str, ...]:
    notes = []
    if header.frames is not None and header.frames != len(rows.lines):
        notes.append(
            f"the header says {header.frames} frames; {len(rows.lines)} are there and read"
        )
    if rows.unlabeled:
        notes.append(
            f"{rows.unlabeled} rows hold columns beyond the named markers: unlabeled, ignored"
        )
    return tuple(notes)
