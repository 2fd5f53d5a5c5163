"""Joint coordinates in OpenSim's storage format (.mot, .sto): text in, text out.

Facts of the format: OpenSim's documentation, "Storage (.sto) Files" and "Motion (.mot) Files"; SIMM
motion files are older and in degrees without saying so.
"""

import math
import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.mocap.trajectories import JointTrajectories

_EXPORT_AGAIN = "write the file again from OpenSim"

_TRANSLATION = re.compile(r".*_t[xyz]")

_COUPLED = re.compile(r".*_beta")

_STATE = re.compile(r"(?:.*/)?([^/]+)/value")


@dataclass(frozen=True, slots=True)
class _Header:
    degrees: bool | None
    rows: int | None
    columns: int | None
    end: int
    """index of the line with endheader"""


def load(
    path: Path | str,
    *,
    in_degrees: bool | None = None,
    rotations: Collection[str] | None = None,
) -> JointTrajectories:
    """Reads joint coordinates as radians and meters.

    Of a file of states (columns such as ``/jointset/knee_r/knee_angle_r/value``) the values are
    read under the coordinates' names. In degrees are the rotations only: not the pelvis
    translations (``*_tx, *_ty, *_tz``), and not the coupled coordinates (``*_beta``), which OpenSim
    leaves in radians.

    Args:
        in_degrees: overrides the header's inDegrees.
        rotations: names of the coordinates that are in degrees in such a file; None tells by name.

    Raises:
        LegsimError: the file is not storage, does not say its unit, or a row does not fit.
    """
    path = Path(path)
    lines = files.read(path, "storage")
    header = _header(path, lines)
    names, first_row = _column_names(path, lines, header)
    table = _table(path, lines, first_row, len(names), header)
    _check_times(path, table[:, 0])
    kept, coordinates = _coordinates(path, names)
    values = table[:, kept]
    turned = [
        k
        for k, name in enumerate(coordinates)
        if (is_rotation(name) if rotations is None else name in rotations)
    ]
    degrees = header.degrees if in_degrees is None else in_degrees
    if degrees is None:
        cure = "write inDegrees=yes or inDegrees=no into the header (in Python: give in_degrees)"
        raise file_error(
            path,
            "the header does not say whether angles are in degrees",
            cure,
            place=f"line {header.end + 1}",
        )
    if degrees:
        values[:, turned] = np.deg2rad(values[:, turned])
    return JointTrajectories(table[:, 0], coordinates, values)


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


def is_rotation(coordinate: str) -> bool:
    """Whether OpenSim converts a coordinate of this name between degrees and radians."""
    return not (_TRANSLATION.fullmatch(coordinate) or _COUPLED.fullmatch(coordinate))


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


def _column_names(path: Path, lines: list[str], header: _Header) -> tuple[list[str], int]:
    """(names of all columns, index of the first line of data)."""
    start = next((k for k in range(header.end + 1, len(lines)) if lines[k].strip()), None)
    if start is None:
        raise file_error(
            path, "no column names follow endheader", _EXPORT_AGAIN, place=f"line {header.end + 1}"
        )
    names = lines[start].split()
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


def _table(path: Path, lines: list[str], first: int, columns: int, header: _Header) -> FloatArray:
    """(rows, columns) of numbers, all finite."""
    rows, places = [], []
    for k in range(first, len(lines)):
        cells = lines[k].split()
        if not cells:
            continue
        if len(cells) != columns:
            problem = f"the row holds {len(cells)} numbers where {columns} columns have names"
            raise file_error(path, problem, _EXPORT_AGAIN, place=f"line {k + 1}")
        rows.append([_number(path, k + 1, cell) for cell in cells])
        places.append(k + 1)
    if not rows:
        raise file_error(path, "there is no row of data", _EXPORT_AGAIN, place=f"line {first + 1}")
    if lines[-1].strip() and header.rows is not None and len(rows) < header.rows:
        problem = f"the file breaks off in this row, number {len(rows)} of {header.rows}"
        raise file_error(
            path, problem, "copy the file again, or delete its last row", place=f"line {places[-1]}"
        )
    return np.array(rows)


def _number(path: Path, line: int, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in text:
        raise file_error(
            path,
            f"{text[:40]!r} is not a finite number",
            "repair the row, or " + _EXPORT_AGAIN,
            place=f"line {line}",
        )
    return value


def _check_times(path: Path, times: FloatArray) -> None:
    late = np.flatnonzero(np.diff(times) <= 0)
    if late.size:
        k = int(late[0])
        problem = f"time {times[k + 1]:g} does not come after {times[k]:g}"
        raise file_error(path, problem, "delete the repeated row", place=f"row {k + 2} of the data")


def _coordinates(path: Path, names: list[str]) -> tuple[list[int], tuple[str, ...]]:
    """(columns kept, their coordinate names): of a file of states the values alone, otherwise all
    but time.
    """
    states = [(k, match[1]) for k, name in enumerate(names) if (match := _STATE.fullmatch(name))]
    kept = states or [(k, name) for k, name in enumerate(names)][1:]
    coordinates = tuple(name for _, name in kept)
    doubles = sorted({name for name in coordinates if coordinates.count(name) > 1})
    if doubles:
        raise LegsimError(
            f"{path} (column names): {doubles[0]} is there twice; keep one of the columns"
        )
    return [k for k, _ in kept], coordinates
