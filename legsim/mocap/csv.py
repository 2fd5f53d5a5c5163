"""Markers and joint coordinates as plain tables for spreadsheets and scripts: one row a sample,
name and unit in the header.

Markers: ``time_s, RASI_x_m, RASI_y_m, RASI_z_m, ...`` in world, empty where not seen. Coordinates:
``time_s, knee_angle_r_rad, pelvis_tx_m, ...``. Numbers have their shortest exact text, so that
reading a table back gives the same float64.
"""

import csv
import io
import math
import re
from pathlib import Path

import numpy as np

from legsim.core import files
from legsim.core.errors import file_error
from legsim.core.values import FloatArray
from legsim.mocap._stated_times import full_times, last_digit
from legsim.mocap.cells import number
from legsim.mocap.coordinates import RawCoordinates, is_translation
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories, written_twice

_AXES = ("_x_m", "_y_m", "_z_m")


def save_markers(path: Path | str, motion: MarkerTrajectories) -> None:
    """Writes a motion's markers.

    Raises:
        LegsimError: a name cannot stand in a header.
    """
    header = [f"{name}{axis}" for name in motion.marker_names for axis in _AXES]
    _save(Path(path), header, motion.times, motion.positions_world.reshape(len(motion.times), -1))


def save_coordinates(path: Path | str, trajectories: JointTrajectories) -> None:
    """Writes joint coordinates in radians and meters.

    Raises:
        LegsimError: a name cannot stand in a header.
    """
    header = [name + _unit(name) for name in trajectories.coordinate_names]
    _save(Path(path), header, trajectories.times, trajectories.values)


def load(path: Path | str) -> MarkerTrajectories | JointTrajectories:
    """Reads a table that :func:`save_markers` or :func:`save_coordinates` wrote.

    Raises:
        LegsimError: the header or a row is not of that form.
    """
    found = read(path)
    return found.to_motion() if isinstance(found, RawCoordinates) else found


def read(path: Path | str) -> MarkerTrajectories | RawCoordinates:
    """Reads markers, or joint coordinates as they are in the table.

    Raises:
        LegsimError: as :func:`load`.
    """
    path = Path(path)
    try:
        rows = [row for row in csv.reader(files.read(path, "CSV")) if row]
    except csv.Error as error:
        raise file_error(path, f"is not CSV ({error})", "export it again") from error
    header = rows[0]
    if header[0] != "time_s" or len(header) < 2:
        raise file_error(
            path,
            f"the header starts with {header[0]!r} and has {len(header)} columns",
            "start it with time_s and one more",
            place="line 1",
        )
    if len(rows) == 1:
        raise file_error(path, "has a header and no rows", "export it again")
    table = np.array(
        [_numbers(path, k, row, header) for k, row in enumerate(rows[1:], start=2)]
    ).reshape(-1, len(header))
    times = full_times(table[:, 0], last_digit(row[0] for row in rows[1:]))
    _check_times(path, times)
    return _value(path, header[1:], times, table[:, 1:])


def _check_times(path: Path, times: FloatArray) -> None:
    bad = np.flatnonzero(np.isnan(times))
    late = written_twice(times) if not bad.size else bad
    if late.size:
        raise file_error(
            path,
            f"the times must increase strictly: {times[late[0]]:.9g} s does not come after "
            f"{times[late[0] - 1]:.9g} s",
            "repair the table",
            place=f"row {late[0] + 1}",
        )


def _value(
    path: Path, header: list[str], times: FloatArray, table: FloatArray
) -> MarkerTrajectories | RawCoordinates:
    names = tuple(cell.removesuffix(_AXES[0]) for cell in header[::3])
    if header == [f"{name}{axis}" for name in names for axis in _AXES]:
        _check_unique(path, names)
        return MarkerTrajectories(times, names, table.reshape(len(times), len(names), 3))
    names = tuple(re.sub(r"_(rad|m)$", "", cell) for cell in header)
    wrong = [cell for cell, name in zip(header, names, strict=True) if cell != name + _unit(name)]
    if wrong and wrong[0].endswith("_m_s2"):
        problem = f"column {wrong[0]!r} is a sensor's"
        raise file_error(path, problem, "give it by --imu, beside a recording", place="line 1")
    if wrong:
        raise file_error(
            path,
            f"column {wrong[0]!r} is neither a marker's nor a coordinate's",
            "name columns like RASI_x_m, RASI_y_m, RASI_z_m, or like knee_angle_r_rad and "
            "pelvis_tx_m",
            place="line 1",
        )
    if not np.isfinite(table).all():
        raise file_error(
            path,
            "a coordinate is not a number",
            "fill the cell",
            place=f"row {np.argwhere(~np.isfinite(table))[0][0] + 1}",
        )
    _check_unique(path, names)
    return RawCoordinates(str(path), times, names, table, False, "column names")


def _check_unique(path: Path, names: tuple[str, ...]) -> None:
    doubles = [name for name in names if names.count(name) > 1]
    if doubles:
        raise file_error(
            path, f"{doubles[0]} is there twice", "keep one of its columns", place="line 1"
        )


def _unit(coordinate: str) -> str:
    return "_m" if is_translation(coordinate) else "_rad"


def _save(path: Path, header: list[str], times: FloatArray, table: FloatArray) -> None:
    wrong = [name for name in header if re.search(r"[\r\n\0]", name)]
    if wrong:
        raise file_error(
            path,
            f"the name {wrong[0]!r} cannot be written",
            "rename it to one line",
            place="line 1",
        )
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["time_s", *header])
    for row in np.column_stack([times, table]).tolist():
        writer.writerow(["" if math.isnan(x) else repr(x) for x in row])
    files.write_text(path, stream.getvalue())


def _numbers(path: Path, line: int, row: list[str], header: list[str]) -> list[float]:
    if len(row) != len(header):
        problem = f"the row holds {len(row)} cells where the header has {len(header)}"
        raise file_error(path, problem, "complete the row", place=f"line {line}")
    numbers = []
    for text in row:
        value = number(text) if text.strip() else math.nan
        if value is None:
            raise file_error(
                path,
                f"{text[:40]!r} is not a number",
                "write decimal points, and nothing where it is not seen",
                place=f"line {line}",
            )
        numbers.append(value)
    return numbers
