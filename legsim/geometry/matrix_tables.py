"""Numbers of any program as one row per view: text, .npy and MATLAB's .mat.

A row has 12 numbers (a 3x4 matrix row by row, or ASTRA's four vectors), 13 (a view number first) or
16 (a 4x4 matrix whose last row is 0 0 0 1). In text a view may also take three or four lines of
four. Anything else is refused: read as 12 numbers per view it would be other matrices.
"""

import re
from pathlib import Path

import numpy as np

from legsim.core import files
from legsim.core.errors import file_error
from legsim.core.values import FloatArray
from legsim.geometry import mat_file
from legsim.geometry._file_parts import BY_NUMBERS

SUFFIXES = (".txt", ".csv", ".ompl", ".npy", ".mat")

_FIX = "give 12 numbers per view (3x4, row by row), 13 with its number first, or 16 (4x4)"


def load(path: Path) -> FloatArray:
    """Reads (v, 12) numbers.

    Raises:
        LegsimError: another count of numbers per view, view numbers that do not count up by one,
            a fourth row other than 0 0 0 1, or no numbers at all.
    """
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return _of_array(path, _npy_values(path))
    if suffix == ".mat":
        return _of_array(path, mat_values(path), matlab=True)
    return _of_lines(path, _lines(path))


def text_of(rows: FloatArray, comment: str) -> str:
    """Rows (v, 12) as text, one view per line, each number by its shortest exact text."""
    lines = [" ".join(map(repr, row)) for row in rows.tolist()]
    return "\n".join([f"# {comment}", *lines, ""])


def _of_array(path: Path, values: FloatArray, matlab: bool = False) -> FloatArray:
    shape, stacked_last = values.shape, values.shape[:2] in ((3, 4), (4, 4))
    # MATLAB stacks along the last axis
    if values.ndim == 3 and stacked_last and (matlab or shape[1:] != (4, 4)):
        values = values.transpose(2, 0, 1)
    if values.ndim >= 2 and values.shape[-2:] in ((3, 4), (4, 4)):
        values = values.reshape(-1, values.shape[-2] * 4)
    if values.ndim == 1:
        values = values[None]
    if values.ndim != 2 or values.shape[1] not in (12, 13, 16) or not len(values):
        raise file_error(path, f"holds an array of shape {shape}", _FIX)
    return _twelve(path, values, [f"row {k}" for k in range(len(values))])


def _twelve(path: Path, values: FloatArray, places: list[str]) -> FloatArray:
    """(v, 12) of rows of 12, 13 or 16 numbers."""
    if values.shape[1] == 13:
        _check_numbering(path, values[:, 0], places)
        return values[:, 1:]
    if values.shape[1] == 16:
        off = np.flatnonzero(~(values[:, 12:] == (0, 0, 0, 1)).all(1))
        if len(off):
            row = " ".join(f"{x:g}" for x in values[off[0], 12:])
            raise file_error(
                path,
                f"16 numbers are a 4x4 matrix, but its last row is {row}",
                "expected 0 0 0 1, and the other rows to map world mm to pixels",
                place=places[int(off[0])],
            )
        return values[:, :12]
    return values


def _check_numbering(path: Path, numbers: FloatArray, places: list[str]) -> None:
    expected = numbers[0] + np.arange(len(numbers))
    wrong = np.flatnonzero(numbers != expected)
    if numbers[0] not in (0, 1):
        wrong = np.array([0])
    if len(wrong):
        raise file_error(
            path,
            f"of 13 numbers the first, {numbers[wrong[0]]:g}, is not this view's number",
            "expected views counted up by one from 0 or 1; sort the lines, or leave the numbers "
            "out",
            place=places[int(wrong[0])],
        )


def _of_lines(path: Path, lines: list[tuple[str, list[float]]]) -> FloatArray:
    counts = {len(numbers) for _, numbers in lines}
    places = [place for place, _ in lines]
    total = sum(len(numbers) for _, numbers in lines)
    if len(counts) == 1 and counts <= {12, 13, 16}:
        return _twelve(path, np.array([numbers for _, numbers in lines]), places)
    if counts == {4}:
        quads = np.array([numbers for _, numbers in lines])
        if len(quads) % 4 == 0 and (quads[3::4] == (0, 0, 0, 1)).all():
            return quads.reshape(-1, 16)[:, :12]
        if len(quads) % 3 == 0:
            return quads.reshape(-1, 12)
    if counts == {1, 4} and [len(numbers) for _, numbers in lines] == [1, 4, 4, 4] * (
        len(lines) // 4
    ):
        _check_numbering(path, np.array([n[0] for _, n in lines[::4]]), places[::4])
        return np.array([n for _, n in lines if len(n) == 4]).reshape(-1, 12)
    usual = max(counts, key=lambda c: sum(len(n) == c for _, n in lines)) if lines else 0
    place = next((p for p, n in lines if len(n) != usual), places[0] if lines else "")
    what = ", ".join(map(str, sorted(counts))) or "no"
    raise file_error(
        path,
        f"holds {total} numbers, in lines of {what}: no count of 3x4 matrices",
        _FIX,
        place=place,
    )


def _lines(path: Path) -> list[tuple[str, list[float]]]:
    """("line n", its numbers) of each line that has any.

    Numbers stand between blanks, commas, semicolons and brackets; # and % start a comment; within
    brackets a semicolon ends a row.
    """
    found = []
    for number, line in enumerate(path.read_text("utf-8-sig").splitlines(), 1):
        content = re.split(r"[#%]", line, maxsplit=1)[0].strip()
        rows = re.split(r"[;\]]", content) if re.search(r"[\[\]]", content) else [content]
        for row in rows:
            words = [word for word in re.split(r"[\s,;\[\](){}]+", row) if word]
            if words:
                found.append((f"line {number}", [_number(path, w, number) for w in words]))
    return found


def _number(path: Path, word: str, line: int) -> float:
    try:
        return float(word)
    except ValueError as error:
        raise file_error(
            path,
            f"{word!r} is not a number",
            "a file of matrices holds 12 numbers per view; of a scanner's description "
            f"{BY_NUMBERS}",
            place=f"line {line}",
        ) from error


def _npy_values(path: Path) -> FloatArray:
    fix = "write it with numpy.save of a (views, 3, 4) array"
    values = files.load_npy(path, fix)
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
        raise file_error(path, "is not an .npy file of real numbers", fix)
    return values.astype(float)


def mat_values(path: Path) -> FloatArray:
    """The one variable of a MATLAB file that holds numbers for each view.

    Raises:
        LegsimError: a file that is none or of version 7.3, or not exactly one such variable.
    """
    try:
        content = mat_file.arrays(path.read_bytes())
    except NotImplementedError as error:
        raise file_error(
            path, "is of MATLAB's version 7.3 (HDF5)", "write it by save(..., '-v7')"
        ) from error
    except (ValueError, MemoryError) as error:
        problem = f"is not a MATLAB file that can be read ({error})"
        raise file_error(path, problem, "write it by save(..., '-v7')") from error
    tables = {
        name: value
        for name, value in content.items()
        if value is not None
        and (
            value.shape[-1:] in ((12,), (13,), (16,))
            or {3, 4} <= {*value.shape}
            or value.shape[:2] == (4, 4)
        )
    }
    if len(tables) != 1:
        names = ", ".join(tables) or ", ".join(content)
        raise file_error(
            path,
            f"holds {len(tables)} variables with 12 numbers per view (variables: {names})",
            "save the views alone, as one (views, 12) or (3, 4, views) array",
        )
    return next(iter(tables.values())).astype(float)
