"""The table of projection matrices (`projtable.txt`) of Siemens' scanners, CERA and CONRAD.

A first line "projtable.txt version 3", a date, comments after #, the count of views, then for each
view "@" and its number, a line of angles, and three lines of a 3x4 matrix from world mm to pixels.
The angles are not used: the matrix says it all.
"""

import re
from pathlib import Path

import numpy as np

from legsim.core.errors import file_error
from legsim.core.values import FloatArray
from legsim.geometry._file_parts import matrices_mm
from legsim.geometry.cone_beam import ConeBeamGeometry

_FIX = "expected a count, then per view @number, a line of angles and three lines of four numbers"


def is_table(text: str) -> bool:
    """Whether a text is such a table, by its first line or its views."""
    return text.lstrip("\ufeff \t\r\n").lower().startswith("projtable") or bool(
        re.search(r"^\s*@\s*\d+\s*$", text, re.MULTILINE)
    )


def matrices(path: Path, text: str) -> FloatArray:
    """(v, 3, 4) of a table's text.

    Raises:
        LegsimError: a view without three lines of four numbers, views that do not count up by one,
            or another count of them than announced.
    """
    lines = [(n, line.partition("#")[0].strip()) for n, line in enumerate(text.splitlines(), 1)]
    lines = [(n, line) for n, line in lines if line]
    starts = [k for k, (_, line) in enumerate(lines) if line.startswith("@")]
    if not starts:
        raise file_error(path, "holds no view (a line with @ and its number)", _FIX)
    announced = [int(line) for _, line in lines[: starts[0]] if line.isdecimal()]
    if announced and announced[-1] != len(starts):
        raise file_error(
            path, f"announces {announced[-1]} views, {len(starts)} are there", "write it again"
        )
    found, first = [], None
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
        number = lines[start][1][1:].strip()
        place = f"line {lines[start][0]}"
        if not number.isdecimal() or (first is not None and int(number) != first + len(found)):
            raise file_error(
                path, f"view {number!r} is out of order", "count views up by one", place=place
            )
        first = int(number) if first is None else first
        found.append(_matrix(path, [line for _, line in lines[start + 1 : end]], place))
    return np.array(found)


def _matrix(path: Path, lines: list[str], place: str) -> FloatArray:
    """(3, 4): the last three lines of a view, after one of angles."""
    try:
        rows = [[float(word) for word in re.split(r"[\s,;]+", line)] for line in lines]
    except ValueError:
        rows = []
    if len(rows) not in (3, 4) or any(len(row) != 4 for row in rows[-3:]):
        raise file_error(path, "its view has no 3x4 matrix", _FIX, place=place)
    return np.array(rows[-3:])


def text_of(geometry: ConeBeamGeometry) -> str:
    """A geometry as such a table; matrices have 1 as last number where that can be."""
    lines = [
        "projtable.txt version 3",
        "written by legsim",
        "",
        "# format: angle / entries of projection matrices",
        str(len(geometry)),
    ]
    for view, matrix in enumerate(matrices_mm(geometry), 1):
        last = matrix[2, 3]
        scaled = matrix / last if abs(last) > 1e-6 * np.abs(matrix[2]).max() else matrix
        rows = [" ".join(map(repr, row)) for row in scaled.tolist()]
        lines += [f"@{view}", "0.0 0.0", *rows, ""]
    return "\n".join(lines) + "\n"
