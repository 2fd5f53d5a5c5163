"""Rows of a table of text, of the columns that are asked for by name or by number."""

import csv
import math
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.imu import units
from legsim.mocap.cells import number as number_of

Column = str | int
"""its name, or its number from 1 on"""

_DELIMITERS = (",", ";", "\t", "|", " ")

_COMMENT = ("#", "//", "%")
"""what begins a line that is no row; before names it is passed over"""

_FEW = 12
"""texts of a column in an error"""

_HEADER_WITHIN = 200
"""lines among which the names, or the first numbers, are searched"""


@dataclass(frozen=True, slots=True)
class RowsOf:
    """Which rows are taken of a table whose instruments or sensors take turns."""

    column: Column
    text: str
    """what that column holds in them"""


@dataclass(frozen=True, slots=True)
class Rows:
    """Cells of the columns that were asked for."""

    rows: tuple[tuple[int, tuple[str, ...]], ...]
    """line number, and a cell per column"""
    units: tuple[str | None, ...]
    """unit that the file states per column, in its name or in the line below; None where none"""
    hints: tuple[str | None, ...]
    """unit at the end of a column's name, without brackets; None where none"""
    names: tuple[str, ...] = ()
    """of all columns of the table"""


_OTHERS = {
    "<": "XML",
    "{": "JSON",
    "[{": "JSON",
}
"""first characters of files that are no tables of text, and what they are"""


def table_lines(path: Path) -> list[str]:
    """Lines of a table.

    Raises:
        LegsimError: a file that cannot be read, or one of another kind.
    """
    lines = files.read(path, "table")
    first = lines[0].lstrip() if lines else ""
    for begin, kind in _OTHERS.items():
        if first.startswith(begin):
            raise file_error(
                path,
                f"is {kind}, not a table of text",
                "export the sensors' accelerations (with gravity) and angular velocities as text "
                "or CSV",
                place="line 1",
            )
    return lines


def read_rows(
    path: Path, wanted: Sequence[Column], only: RowsOf | None = None, *, fewest: int = 2
) -> Rows:
    """Reads the columns ``wanted`` (n,) of each row of a table.

    Columns are parted by comma, semicolon, tab, bar or blanks. Lines above their names are passed
    over, and so are a line of units below them, and comments. Where all columns are asked for by
    number, the first line with a number in each of them is the first row. All rows but those of
    ``only`` are passed over.

    Raises:
        LegsimError: a file that cannot be read, missing columns, rows that break off, fewer rows
            than ``fewest``.
    """
    lines = table_lines(path)
    asked = [*wanted, *([] if only is None else [only.column])]
    for column in asked:
        if isinstance(column, int) and column < 1:
            raise file_error(path, f"has no column {column}", "count columns from 1")
    start, table = _table(path, lines, wanted, only)
    stated = [units.in_name(title) for title in table.titles]
    key = None if only is None else _place(only.column, table.names)
    seen: set[str] = set()
    rows: list[tuple[int, tuple[str, ...]]] = []
    for number, cells in _cells(path, lines, start, table):
        if not rows and table.named and (below := _unit_line(cells, table.at)):
            stated = [unit or own for unit, own in zip(below, stated, strict=True)]
            continue
        if not rows and table.named and _says_calibrated(cells, table.at):
            continue
        if only is not None and key is not None:
            text = cells[key] if key < len(cells) else ""
            seen.add(text)
            if text != only.text:
                continue
        table.check(path, number, lines[number - 1], cells)
        rows.append((number, tuple(cells[k] for k in table.at)))
    if only is not None and not rows:
        raise _nobodys(path, only, seen)
    if len(rows) < fewest:
        raise file_error(path, "holds no samples below its names", "export it again")
    hints = tuple(units.hinted(title) for title in table.titles)
    return Rows(tuple(rows), tuple(stated), hints, tuple(table.names))


@dataclass(frozen=True, slots=True)
class _Table:
    """Where the columns are."""

    delimiter: str
    names: list[str]
    """of all columns; empty where they have none"""
    at: list[int]
    """index of each column that was asked for"""
    named: bool
    """whether one of them was asked for by name"""
    width: int
    """cells of each row between blanks; 0 where the first row says it"""
    in_turn: bool
    """whether rows are of several kinds"""

    @property
    def titles(self) -> list[str]:
        """Name of each column that was asked for, empty where it has none."""
        return [self.names[k] if k < len(self.names) else "" for k in self.at]

    def check(self, path: Path, number: int, line: str, cells: Sequence[str]) -> None:
        """Refuses a row that breaks off, has cells without names, or is no row.

        Raises:
            LegsimError: with its line.
        """
        place, among = f"line {number}", len(self.names)
        if len(cells) <= max(self.at):
            raise _broken_off(path, place, line, cells, self)
        if self.named and (more := _beyond(cells, among)):
            raise file_error(
                path,
                f"the row has {among + more} cells, the header {among}: names and numbers do not "
                "belong together",
                "give the numbers of the columns instead of names (the first is 1); decimal commas "
                "need another separator of columns",
                place=place,
            )
        if self.named and [cells[k] for k in self.at] == [self.names[k] for k in self.at]:
            raise file_error(
                path,
                "the names are there again: another recording begins",
                "split the file",
                place=place,
            )


def _table(
    path: Path, lines: Sequence[str], wanted: Sequence[Column], only: RowsOf | None
) -> tuple[int, _Table]:
    """Number of lines above the first row (or its units), and where the columns are."""
    named = [column for column in wanted if isinstance(column, str)]
    keys = [] if only is None or isinstance(only.column, int) else [only.column]
    # the second of several blocks has its names far below
    within = len(lines) if only else _HEADER_WITHIN
    start, delimiter, names = (
        _names(path, lines, [*named, *keys], within)
        if named or keys
        else _numbered(path, lines, wanted, within)
    )
    at = [_place(c, names) for c in wanted]
    width = len(names) if named or keys else 0
    return start, _Table(delimiter, names, at, bool(named), width, only is not None)


def _cells(
    path: Path, lines: Sequence[str], start: int, table: _Table
) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of each line below ``start`` that is neither empty nor a comment."""
    width = table.width
    for number, line in enumerate(lines[start:], start + 1):
        if not line.strip():
            continue
        cells = cells_of(line, table.delimiter)
        if line.lstrip().startswith(_COMMENT) and not _is_marked_row(cells, table.at):
            continue
        if table.delimiter == " ":
            width = width or len(cells)
            if len(cells) != width and not table.in_turn:
                cells = _between_single_blanks(path, number, line, width)
        yield number, cells


def _is_marked_row(cells: Sequence[str], at: Sequence[int]) -> bool:
    """Whether a line that begins as a comment is a row whose first cell is a label, as #12."""
    return (
        re.match(r"(#|//|%)(\s|$)", cells[0]) is None
        and len(cells) > max(at)
        and any(_is_value(cells[k]) for k in at)
        and all(not cells[k] or _is_value(cells[k]) for k in at)
    )


def _nobodys(path: Path, only: RowsOf, seen: Collection[str]) -> LegsimError:
    """The refusal of a table without rows of the kind; its column has the texts ``seen``."""
    texts = sorted(repr(text) for text in seen if text)
    if not texts:
        return file_error(
            path,
            f"column {only.column!r}, which says whose each row is, is empty or not there",
            "correct the column (rows_by)",
        )
    return file_error(
        path,
        f"no row has {only.text!r} in column {only.column!r}",
        f"give one of {', '.join(texts[:_FEW])}",
    )


def _broken_off(
    path: Path, place: str, line: str, cells: Sequence[str], table: _Table
) -> LegsimError:
    """The refusal of a row without all of the columns."""
    if re.search(r"[A-Za-z]", line) and not any(_is_value(cell) for cell in cells):
        return file_error(
            path,
            f"{line.strip()[:40]!r} is no row of numbers: another table begins there",
            "split the file, and give accelerations and angular velocities as file and "
            "angular_velocity_file",
            place=place,
        )
    last, among = max(table.at) + 1, len(table.names)
    if table.named and last > among:
        return file_error(
            path,
            f"column {last} is asked for, the header names {among}",
            "correct the number of the column (the first is 1)",
            place=place,
        )
    asked = f"the header {among}" if table.named else f"column {last} is asked for"
    return file_error(
        path,
        f"the row has {len(cells)} cells, {asked}",
        "complete the row, or delete it where the recording broke off",
        place=place,
    )


def _between_single_blanks(path: Path, number: int, line: str, count: int) -> list[str]:
    """Cells of a line with single blanks between them, some of which are empty.

    Raises:
        LegsimError: there are not as many as names: blanks do not say which cells are empty.
    """
    cells = line.split(" ")
    while len(cells) > count and not cells[-1]:
        cells.pop()
    if len(cells) != count:
        raise file_error(
            path,
            f"the row has {len(line.split())} cells, the header {count}",
            "complete the row, or export the table with commas or tabs: blanks hide empty cells",
            place=f"line {number}",
        )
    return cells


def _beyond(cells: Sequence[str], count: int) -> int:
    """Cells of a row beyond ``count`` up to the last that is not empty."""
    return max((k + 1 - count for k, cell in enumerate(cells) if cell and k >= count), default=0)


def _place(column: Column, names: Sequence[str]) -> int:
    """Index of a column."""
    return column - 1 if isinstance(column, int) else names.index(column)


def cells_of(line: str, delimiter: str) -> list[str]:
    """Cells of a line, without blanks and quotes around them."""
    if delimiter == " ":
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
    except csv.Error:  # a cell longer than any number or name
        return [line]


def number_in(path: Path, line: int, text: str, column: Column) -> float:
    """The number in a cell; NaN where it is empty.

    Raises:
        LegsimError: other text, or a number beyond any signal.
    """
    value = _number(text)
    if value is None:
        raise file_error(
            path,
            f"{text[:40]!r} in column {column!r} is not a number",
            "correct the cell, or leave it empty where the packet was lost",
            place=f"line {line}",
        )
    return value


def _number(text: str) -> float | None:
    # a decimal comma: commas between columns are gone
    return number_of(text.replace(",", ".")) if text else math.nan


def _names(
    path: Path, lines: Sequence[str], wanted: Sequence[str], within: int
) -> tuple[int, str, list[str]]:
    """Number of lines down to the names, delimiter, and all names."""
    for k, line in enumerate(lines[:within]):
        for delimiter in _DELIMITERS:
            # a name that is given with the mark of a comment before it, as %time, is meant so
            bare = _names_of(line, delimiter)
            names = bare if set(wanted) <= set(bare) else cells_of(line, delimiter)
            if set(wanted) <= set(names):
                doubled = [name for name in wanted if names.count(name) > 1]
                if doubled:
                    raise file_error(
                        path,
                        f"column {doubled[0]!r} is there twice",
                        "rename one, or give the numbers of the columns (the first is 1)",
                        place=f"line {k + 1}",
                    )
                return k + 1, delimiter, names
    raise _missing(path, lines, wanted)


def is_named(path: Path, column: str, others: Sequence[str]) -> bool:
    """Whether a line of a table has a column's name among the names ``others``."""
    wanted = {column, *others}
    return any(
        wanted <= set(cells)
        for line in table_lines(path)[:_HEADER_WITHIN]
        for delimiter in _DELIMITERS
        for cells in (cells_of(line, delimiter), _names_of(line, delimiter))
    )


def _names_of(line: str, delimiter: str) -> list[str]:
    """Names in a line, which may be a comment."""
    names = cells_of(line, delimiter)
    for mark in _COMMENT:
        if names and names[0].startswith(mark):
            names[0] = names[0].lstrip(mark).strip()
            return names[1:] if not names[0] and delimiter == " " else names
    return names


def _numbered(
    path: Path, lines: Sequence[str], wanted: Sequence[Column], within: int
) -> tuple[int, str, list[str]]:
    """Number of lines above the first numbers, delimiter, and the names in the line above."""
    last = max(int(column) for column in wanted)
    for k, line in enumerate(lines[:within]):
        for delimiter in _DELIMITERS:
            cells = cells_of(line, delimiter)
            asked = [cells[int(c) - 1] for c in wanted] if len(cells) >= last else [""]
            if all(_is_value(cell) for cell in asked):
                above = cells_of(lines[k - 1], delimiter) if k else []
                return k, delimiter, above if len(above) >= last else []
    raise file_error(
        path,
        f"has no line with numbers in columns {', '.join(map(str, wanted))}",
        "correct the numbers of the columns (the first is 1)",
        place=f"first {within} lines",
    )


def _is_value(cell: str) -> bool:
    """Whether a cell holds a number, a time of the day or a date."""
    return bool(cell) and (_number(cell) is not None or re.search(r"\d[-/:T]\d", cell) is not None)


def _unit_line(cells: Sequence[str], at: Sequence[int]) -> list[str | None]:
    """Units of the columns where a line holds nothing else for them; else nothing."""
    if len(cells) <= max(at):
        return []
    found = [units.known(cells[k]) or units.in_name(cells[k]) for k in at]
    numbers = any(cells[k] and _number(cells[k]) is not None for k in at)
    return found if any(found) and not numbers else []


def _says_calibrated(cells: Sequence[str], at: Sequence[int]) -> bool:
    """Whether a line says CAL of each column, as older exports of Shimmer do above the units."""
    return len(cells) > max(at) and all(cells[k].upper() in ("CAL", "CALIBRATED") for k in at)


def _missing(path: Path, lines: Sequence[str], wanted: Sequence[str]) -> LegsimError:
    best: set[str] = set()
    place, names = 0, [""]
    for k, line in enumerate(lines[:_HEADER_WITHIN]):
        for delimiter in _DELIMITERS:
            cells = _names_of(line, delimiter)
            if len(set(wanted) & set(cells)) > len(best):
                best, place, names = set(wanted) & set(cells), k, cells
    missing = ", ".join(repr(name) for name in wanted if name not in best)
    known = f"; the line has {', '.join(n for n in names if n)}" if best else ""
    other = "" if "".join(wanted).isascii() else ", or give their numbers where it is not in UTF-8"
    return file_error(
        path,
        f"has no line with the column{'s' * (len(wanted) - len(best) > 1)} {missing}{known}",
        f"correct the names of the columns{other}",
        place=f"line {place + 1}" if best else f"first {_HEADER_WITHIN} lines",
    )
