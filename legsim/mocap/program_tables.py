"""Tables of markers that capture programs export beside C3D and TRC: CSV of Motive and of Nexus,
and TSV of Qualisys Track Manager.

- Motive (OptiTrack): a line of keys and values, ``Format Version, 1.23, ..., Length Units, ...``;
  rows of kinds, names and quantities above ``Frame, Time (Seconds), X, Y, Z, ...``; y is usually
  up.
- Nexus (Vicon): a section ``Trajectories`` with its rate, a row of names, ``Frame, Sub Frame, X, Y,
  Z, ...`` and a row of units; z is usually up.
- Qualisys: lines of a key and its values, ``NO_OF_FRAMES`` to ``MARKER_NAMES``, then rows with or
  without frame and time; in mm, z is usually up.

A marker that is not seen is blank, or 0, 0, 0.
"""

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from legsim.core import files
from legsim.core.errors import file_error
from legsim.core.values import FloatArray
from legsim.mocap.cells import number
from legsim.mocap.raw import RawMarkers
from legsim.mocap.trajectories import written_twice

_AGAIN = "export it again, or as C3D"

_TIME_DIGIT = 1.5e-6
"""s of Motive's last digit, and a half for its rounding"""


_HEADER = 50
"""lines among which Qualisys' keys and values are"""

_SLOWEST, _FASTEST = 0.01, 1e6
"""Hz of cameras"""


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """The rows of numbers of a file."""

    path: Path
    cells: list[list[str]]
    """of the numbers' rows"""
    first: int
    """line of the first, counted from 1"""

    def column(self, k: int) -> FloatArray:
        """(n,) numbers of a column, NaN where a cell is blank.

        Raises:
            LegsimError: a cell holds something else.
        """
        return np.array([self._number(n, k) for n in range(len(self.cells))], float)

    def _number(self, row: int, k: int) -> float:
        cells = self.cells[row]
        text = cells[k].strip() if k < len(cells) else ""
        value = number(text) if text else math.nan
        if value is None:
            raise file_error(
                self.path,
                f"{text[:40]!r} is not a number",
                _AGAIN,
                place=f"line {self.first + row}",
            )
        return value

    def markers(
        self,
        times: FloatArray,
        frames: FloatArray,
        named: Sequence[tuple[str, int]],
        *,
        unit: str,
        usual_up: str,
    ) -> RawMarkers:
        """The markers whose names and first columns are ``named``.

        Raises:
            LegsimError: no marker, half a marker, or times or frames that do not go on.
        """
        if not named:
            raise file_error(self.path, "holds no marker", _AGAIN)
        late = written_twice(times)
        if late.size or not np.isfinite(times).all():
            row = int(late[0]) if late.size else int(np.argmin(np.isfinite(times)))
            raise file_error(
                self.path,
                "has no time after that of the row before",
                _AGAIN,
                place=f"line {self.first + row}",
            )
        columns = [[self.column(start + axis) for axis in range(3)] for _, start in named]
        positions = np.moveaxis(np.array(columns), -1, 0)
        half = np.isnan(positions).any(-1) & ~np.isnan(positions).all(-1)
        if half.any():
            row, marker = np.argwhere(half)[0]
            raise file_error(
                self.path,
                f"marker {named[marker][0]!r} has one or two coordinates of three",
                _AGAIN,
                place=f"line {self.first + row}",
            )
        left_out = int(np.nansum(np.diff(frames) - 1)) if len(frames) > 1 else 0
        notes = (f"{left_out} frames are left out",) if left_out else ()
        labels = tuple(name for name, _ in named)
        return RawMarkers(str(self.path), times, labels, positions, unit, "", usual_up, notes)


def read_motive(path: Path | str) -> RawMarkers:
    """Reads the markers of Motive's CSV; bones, rigid bodies and where these expect their markers
    are left out.

    Raises:
        LegsimError: the table has no markers, or cannot be read without guessing.
    """
    path = Path(path)
    rows = _cells(path, ",")
    said = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    space = said.get("Coordinate Space", "Global")
    if space != "Global":
        problem = f"holds positions in the space {space!r}"
        raise file_error(path, problem, "export it in the space Global", place="line 1")
    top = _find(path, rows, lambda row: row[:1] == ["Frame"], "Frame, Time (Seconds), X, ...")
    above = [row for row in rows[1:top] if any(row)]
    if len(above) < 3:
        problem = "lacks the rows of kinds, names and quantities above its columns"
        raise file_error(path, problem, _AGAIN, place=f"line {top + 1}")
    kinds, names, quantities = above[0], above[1], above[-1]
    width = min(map(len, (kinds, names, quantities, rows[top])))
    named = [
        (names[k], k)
        for k in range(2, width - 2)
        if (kinds[k], quantities[k]) == ("Marker", "Position") and rows[top][k : k + 3] == [*"XYZ"]
    ]
    if not named:
        there = ", ".join(dict.fromkeys(kind for kind in kinds[2:] if kind)) or "nothing"
        cure = "tick Markers where it is exported, or export C3D"
        raise file_error(path, f"holds {there} and no markers", cure)
    table = _table(path, rows, top + 1)
    rate = _rate(path, said.get("Export Frame Rate") or said.get("Capture Frame Rate", ""), 1)
    stated = table.column(1)
    # six decimals of multiples of 1 / rate: these
    frames = np.round(stated * rate)
    even = bool((np.abs(frames / rate - stated) < _TIME_DIGIT).all())
    times = frames / rate if even else stated
    unit = said.get("Length Units", "")
    return table.markers(times, frames, named, unit=unit, usual_up="y")


def read_nexus(path: Path | str) -> RawMarkers:
    """Reads the trajectories of Nexus' CSV; devices, joints and model outputs are left out.

    Raises:
        LegsimError: there are none, or they cannot be read without guessing.
    """
    path = Path(path)
    rows = _cells(path, ",")
    start = _find(path, rows, lambda row: row[:1] == ["Trajectories"], "Trajectories")
    end = next((k for k in range(start + 1, len(rows)) if not any(rows[k])), len(rows))
    if end < start + 6:
        problem = "ends before the trajectories' numbers"
        raise file_error(path, problem, _AGAIN, place=f"line {end}")
    rate = _rate(path, rows[start + 1][0], start + 2)
    names, axes, units = rows[start + 2 : start + 5]
    if axes[:2] != ["Frame", "Sub Frame"]:
        problem = f"the columns begin with {', '.join(axes[:2])}, not with Frame, Sub Frame"
        raise file_error(path, problem, _AGAIN, place=f"line {start + 4}")
    named = [(name, k) for k, name in enumerate(names) if name and axes[k : k + 3] == [*"XYZ"]]
    stated = {units[k] for _, first in named for k in range(first, min(first + 3, len(units)))}
    if len(stated) > 1:
        problem = f"states several units of length: {', '.join(sorted(stated))}"
        raise file_error(path, problem, _AGAIN, place=f"line {start + 5}")
    table = _table(path, rows[:end], start + 5)
    frames = table.column(0)
    times = (frames - 1) / rate
    return table.markers(times, frames, named, unit="".join(stated), usual_up="z")


def read_qualisys(path: Path | str) -> RawMarkers:
    """Reads the markers of a TSV of Qualisys Track Manager.

    Raises:
        LegsimError: it holds no markers (3D), or cannot be read without guessing.
    """
    path = Path(path)
    rows = _cells(path, "\t")
    said = dict(row[:2] for row in rows[:_HEADER] if len(row) > 1)
    if said.get("DATA_INCLUDED", "3D") != "3D":
        problem = f"holds {said['DATA_INCLUDED']}, no markers"
        raise file_error(path, problem, "export 3D data", place="DATA_INCLUDED")
    last = _find(path, rows, lambda row: row[:1] == ["MARKER_NAMES"], "MARKER_NAMES")
    names = [name for name in rows[last][1:] if name]
    start = next((k for k in range(last + 1, len(rows)) if _is_numbers(rows[k])), len(rows))
    table = _table(path, rows, start)
    before = _columns_before(table.cells, 3 * len(names))
    if before not in (0, 2):
        problem = f"has {before + 3 * len(names)} columns for {len(names)} markers"
        cure = "export it with frame and time, or without both"
        raise file_error(path, problem, cure, place=f"line {start + 1}")
    rate = _rate(path, said.get("FREQUENCY", ""), 4)
    frames = table.column(0) if before else np.arange(1.0, len(table.cells) + 1)
    times = (frames - 1) / rate
    named = [(name, before + 3 * k) for k, name in enumerate(names)]
    return table.markers(times, frames, named, unit="mm", usual_up="z")


def _cells(path: Path, mark: str) -> list[list[str]]:
    """The cells of all lines, without blanks around them. Between tabs quotes are text, which
    somebody may have typed into a description; those around a whole cell are a spreadsheet's.
    """
    quoting = csv.QUOTE_NONE if mark == "\t" else csv.QUOTE_MINIMAL
    try:
        rows = list(csv.reader(files.read(path, "CSV"), delimiter=mark, quoting=quoting))
    except csv.Error as error:
        raise file_error(path, f"is no table ({error})", _AGAIN) from error
    around = ' "' if mark == "\t" else " "
    return [[cell.strip().strip(around) for cell in row] for row in rows]


def _find(path: Path, rows: list[list[str]], wanted: Callable[[list[str]], bool], what: str) -> int:
    """Index of the first row that is ``wanted``."""
    for k, row in enumerate(rows):
        if wanted(row):
            return k
    raise file_error(path, f"has no line {what}", _AGAIN)


def _table(path: Path, rows: list[list[str]], start: int) -> _Table:
    """The rows of numbers from index ``start``; blank ones at the end are left out."""
    end = len(rows)
    while end > start and not any(rows[end - 1]):
        end -= 1
    if end == start:
        raise file_error(path, "holds no rows of numbers", _AGAIN, place=f"line {start + 1}")
    return _Table(path, rows[start:end], start + 1)


def _rate(path: Path, text: str, line: int) -> float:
    value = number(text) if text else None
    if value is None or not _SLOWEST < value < _FASTEST:
        problem = f"states no rate of a camera in Hz, but {text!r}"
        raise file_error(path, problem, _AGAIN, place=f"line {line}")
    return value


def _columns_before(rows: list[list[str]], of_markers: int) -> int:
    """Columns before those of the markers. An empty last column is that of a closing tab, or of a
    marker that is never seen.
    """
    width = max(map(len, rows))
    ends = [row[-3:] for row in rows if len(row) == width]
    if any(end[-1] for end in ends):
        return width - of_markers
    unseen = not any(map(any, ends)) and width - of_markers in (0, 2)
    return width - of_markers - (not unseen)


def _is_numbers(row: list[str]) -> bool:
    """Whether a row holds numbers alone, or cells of a frame in which no marker is seen."""
    return len(row) > 1 and all(not cell or number(cell) is not None for cell in row)
