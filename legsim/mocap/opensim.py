"""Joint coordinates in OpenSim's storage format (.mot, .sto): text in, text out.

Facts of the format: OpenSim's documentation, "Storage (.sto) Files" and "Motion (.mot) Files"; SIMM
motion files are older and in degrees without saying so.
"""

import math
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.mocap._stated_times import full_times, last_digit
from legsim.mocap.cells import number
from legsim.mocap.coordinates import RawCoordinates, is_of_leg, is_rotation
from legsim.mocap.trajectories import JointTrajectories, late_cure

_EXPORT_AGAIN = "write the file again from OpenSim"

_STATE = re.compile(r"(?:.*/)?([^/]+)/value")


_NO_COORDINATES = re.compile(
    r"speeds?|accelerations?|position ?errors?|controls?|pseudo ?\w*|"
    r"actuator ?(forces|speeds|powers)|(model)?forces|"
    r"inverse dynamics.*|static optimization|joint ?reactions?.*|induced ?accelerations?.*",
    re.I,
)
"""names, in the first line, of OpenSim's results that have the coordinates' names and other
values
"""


@dataclass(frozen=True, slots=True)
class _Header:
    degrees: bool | None
    rows: int | None
    columns: int | None
    end: int
    """index of the line with endheader"""


def load(path: Path | str, *, in_degrees: bool | None = None) -> JointTrajectories:
    """Reads joint coordinates as radians and meters, as the header says they are.

    Args:
        path: the file.
        in_degrees: overrides the header's inDegrees.

    Raises:
        LegsimError: the file is not storage, does not say its unit, or a row does not fit.
    """
    return read(path).to_motion(in_degrees=in_degrees)


def read(path: Path | str) -> RawCoordinates:
    """Reads joint coordinates in the file's own units, with notes about what was left out.

    Of a file of states (columns such as ``/jointset/knee_r/knee_angle_r/value``) the values are
    read under the coordinates' names. Columns that are no coordinate of the leg may be there twice
    or hold NaN: then they are left out.

    Raises:
        LegsimError: the file is not storage, or a row does not fit.
    """
    path = Path(path)
    lines = files.read(path, "storage")
    header = _header(path, lines)
    kind = lines[0].strip().removeprefix("name ").strip()
    if _NO_COORDINATES.fullmatch(kind):
        raise file_error(
            path,
            f"holds {kind!r} under the names of coordinates, not joint coordinates",
            "give the coordinates (…_Kinematics_q.sto, or the .mot of inverse kinematics)",
            place="line 1",
        )
    lines = _tabbed(lines, header.end)
    names, first_row = _column_names(path, lines, header)
    table, digit, row_notes = _table(path, lines, first_row, names, header)
    times = full_times(table[:, 0], digit)
    _check_times(path, times)
    kept, coordinates, column_notes = _coordinates(path, names, table)
    return RawCoordinates(
        str(path),
        times,
        coordinates,
        table[:, kept],
        header.degrees,
        f"line {header.end + 1}",
        (*row_notes, *column_notes),
    )


def save(path: Path | str, trajectories: JointTrajectories, *, in_degrees: bool = False) -> None:
    """Writes joint coordinates so that OpenSim opens them; in radians, reading them back gives the
    same float64.

    Raises:
        LegsimError: a coordinate name cannot stand in the format, a value is not finite, or the
            file cannot be written.
    """
    path = Path(path)
    for name in trajectories.coordinate_names:
        if not name or re.search(r"\s", name):
            raise file_error(
                path,
                f"coordinate name {name!r} cannot be written",
                "rename it without blanks",
                place="column names",
            )
    if not np.isfinite(trajectories.values).all():
        row, column = np.argwhere(~np.isfinite(trajectories.values))[0]
        problem = (
            f"{trajectories.coordinate_names[column]} is not a number at "
            f"{trajectories.times[row]:g} s"
        )
        raise file_error(
            path,
            problem,
            "OpenSim takes finite values only: fill or cut the gap",
            place=f"row {row + 1}",
        )
    values = np.array(trajectories.values)
    if in_degrees:
        rotations = [k for k, name in enumerate(trajectories.coordinate_names) if is_rotation(name)]
        values[:, rotations] = np.rad2deg(values[:, rotations])
    files.write_text(path, _text(trajectories, values, in_degrees))


def _text(trajectories: JointTrajectories, values: FloatArray, in_degrees: bool) -> str:
    header = (
        "Coordinates\nversion=1\n"
        f"nRows={len(values)}\nnColumns={1 + values.shape[1]}\n"
        f"inDegrees={'yes' if in_degrees else 'no'}\n\n"
        "Units are S.I. units (second, "
        f"meters{', degrees' if in_degrees else ', radians'})\n\nendheader\n"
    )
    rows = ["\t".join(("time", *trajectories.coordinate_names))]
    rows += [
        "\t".join(map(repr, row)) for row in np.column_stack([trajectories.times, values]).tolist()
    ]
    return header + "\n".join(rows) + "\n"


def _header(path: Path, lines: list[str]) -> _Header:
    end = next((k for k, line in enumerate(lines) if line.strip().lower() == "endheader"), None)
    if end is None:
        raise file_error(
            path,
            "no line says endheader",
            "check that this is a .mot or .sto file, or " + _EXPORT_AGAIN,
            place=f"line {len(lines)}",
        )
    said = {}
    for line in lines[:end]:
        match = re.fullmatch(r"\s*(\w+)\s*(?:=|\s)\s*(\S+)\s*", line)
        if match:
            said[match[1].lower()] = match[2]
    if said.get("datatype", "double").lower() != "double":
        problem = (
            f"holds DataType={said['datatype']} (orientations, vectors), not joint coordinates"
        )
        raise file_error(
            path, problem, "give the .mot that inverse kinematics made of it", place="header"
        )
    degrees = said.get("indegrees", "yes" if "datacolumns" in said else "")
    if degrees.lower() not in ("", "yes", "no", "y", "n", "true", "false"):
        raise file_error(
            path,
            f"inDegrees={degrees} is neither yes nor no",
            "write inDegrees=yes or inDegrees=no",
            place="header",
        )
    counts = [
        said.get(a, said.get(b, ""))
        for a, b in (("nrows", "datarows"), ("ncolumns", "datacolumns"))
    ]
    rows, columns = (int(count) if count.isdecimal() else None for count in counts)
    return _Header(degrees.lower()[0] in "yt" if degrees else None, rows, columns, end)


def _tabbed(lines: list[str], end: int) -> list[str]:
    """Lines whose table after ``end`` a spreadsheet has written with semicolons or commas, with
    tabs.
    """
    names = next((line for line in lines[end + 1 :] if line.strip()), "")
    mark = re.match(r"\s*time\s*([;,])", names, re.I)
    if mark is None:
        return lines
    below = [line.replace(mark[1], "\t") for line in lines[end + 1 :]]
    if mark[1] == ";":  # the usual reason for semicolons is decimal commas
        below = [line if line[:1].isalpha() else line.replace(",", ".") for line in below]
    return [*lines[: end + 1], *below]


def _column_names(path: Path, lines: list[str], header: _Header) -> tuple[list[str], int]:
    """(names of all columns, index of the first line of data)."""
    start = next((k for k in range(header.end + 1, len(lines)) if lines[k].strip()), None)
    if start is None:
        raise file_error(
            path, "no column names follow endheader", _EXPORT_AGAIN, place=f"line {header.end + 1}"
        )
    names = _split_names(lines, start)
    if names[0].lower() != "time":
        raise file_error(
            path,
            f"the first column is {names[0][:40]!r}, not time",
            _EXPORT_AGAIN,
            place=f"line {start + 1}",
        )
    if len(names) < 2:
        raise file_error(
            path, "there is no column beside time", _EXPORT_AGAIN, place=f"line {start + 1}"
        )
    return names, start + 1


def _split_names(lines: list[str], start: int) -> list[str]:
    """Column names in line ``start``: by white space, or by tabs where only so there are as many as
    numbers in the row below.
    """
    names = lines[start].split()
    row = next((line.split() for line in lines[start + 1 :] if line.strip()), [])
    by_tabs = [name.strip() for name in lines[start].split("\t") if name.strip()]
    return by_tabs if len(by_tabs) == len(row) != len(names) else names


def _table(
    path: Path, lines: list[str], first: int, names: list[str], header: _Header
) -> tuple[FloatArray, float, tuple[str, ...]]:
    """(rows, columns) of numbers, finite in time and in all coordinates of the leg, what the last
    digit of the times counts, and a note on a header that counts other rows or columns.
    """
    rows, places, times = [], [], []
    for k in range(first, len(lines)):
        cells = lines[k].split()
        if not cells:
            continue
        if len(cells) != len(names):
            problem = f"the row holds {len(cells)} numbers where {len(names)} columns have names"
            raise file_error(path, problem, _EXPORT_AGAIN, place=f"line {k + 1}")
        rows.append(
            [_number(path, k + 1, cell, name) for cell, name in zip(cells, names, strict=True)]
        )
        places.append(k + 1)
        times.append(cells[0])
    if not rows:
        raise file_error(path, "there is no row of data", _EXPORT_AGAIN, place=f"line {first + 1}")
    if lines[-1].strip() and header.rows is not None and len(rows) < header.rows:
        problem = f"the file breaks off in this row, number {len(rows)} of {header.rows}"
        raise file_error(
            path, problem, "copy the file again, or delete its last row", place=f"line {places[-1]}"
        )
    notes = [
        f"the header says {said} {what}; {there} are there and read"
        for said, there, what in (
            (header.rows, len(rows), "rows"),
            (header.columns, len(names), "columns"),
        )
        if said is not None and said != there
    ]
    return np.array(rows), last_digit(times), tuple(notes)


def _number(path: Path, line: int, text: str, name: str) -> float:
    """The number in a cell; NaN only in columns that are no coordinate of the leg."""
    value = number(text)
    if value is None or (math.isnan(value) and (name == "time" or _is_needed(name))):
        raise file_error(
            path,
            f"{text[:40]!r} is not a finite number",
            "repair the row, or " + _EXPORT_AGAIN,
            place=f"line {line}",
        )
    return value


def _is_needed(column: str) -> bool:
    """Whether a column is a coordinate of the leg, or its value in a file of states."""
    state = _STATE.fullmatch(column)
    return is_of_leg(state[1] if state else column)


def _check_times(path: Path, times: FloatArray) -> None:
    late = np.flatnonzero(np.diff(times) <= 0)
    if late.size:
        k = int(late[0])
        problem = f"time {times[k + 1]:g} does not come after {times[k]:g}"
        cure = late_cure(times, k + 1)
        raise file_error(path, problem, cure, place=f"row {k + 2} of the data")


def _coordinates(
    path: Path, names: list[str], table: FloatArray
) -> tuple[list[int], tuple[str, ...], tuple[str, ...]]:
    """(columns kept, their coordinate names, notes): of a file of states the values alone,
    otherwise all but time.
    """
    states = [(k, match[1]) for k, name in enumerate(names) if (match := _STATE.fullmatch(name))]
    columns = states or [(k, name) for k, name in enumerate(names)][1:]
    count = Counter(name for _, name in columns)
    doubles = [name for name in count if count[name] > 1]
    needed = [name for name in doubles if is_of_leg(name)]
    if needed:
        raise LegsimError(
            f"{path} (column names): {needed[0]} is there twice; keep one of the columns"
        )
    void = [name for k, name in columns if count[name] == 1 and np.isnan(table[:, k]).any()]
    kept = [(k, name) for k, name in columns if count[name] == 1 and name not in void]
    notes = [
        f"left out, being no coordinates of the leg {why}: {', '.join(left)}"
        for left, why in ((doubles, "and there twice"), (void, "and not numbers throughout"))
        if left
    ]
    if not kept:
        raise file_error(path, "no column is there once", _EXPORT_AGAIN, place="column names")
    return [k for k, _ in kept], tuple(name for _, name in kept), tuple(notes)
