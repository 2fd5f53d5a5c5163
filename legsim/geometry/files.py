"""Geometry files in millimeters: legsim's JSON, RTK's XML and plain 3x4 matrices."""

import json
import re
import tokenize
from pathlib import Path

import numpy as np

from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.geometry import rtk_xml
from legsim.geometry._file_parts import (
    NEEDS_DETECTOR,
    count_of,
    geometry_of,
    is_number,
    matrices_mm,
    numbers_of,
)
from legsim.geometry.cone_beam import ConeBeamGeometry

SUFFIXES = (".json", ".xml", ".txt", ".npy")


def load_geometry(
    path: Path | str,
    *,
    columns: int | None = None,
    rows: int | None = None,
    pixel_mm: float | None = None,
    view_rate_hz: float = 31.0,
) -> ConeBeamGeometry:
    """Reads a geometry from .json (legsim), .xml (RTK), .txt or .npy.

    .txt and .npy hold one 3x4 matrix per view, world mm to pixels.

    Args:
        columns, rows: pixels of the detector, for files that do not say; RTK's XML then has its
            detector centered.
        pixel_mm: pixel pitch, for files that do not say; RTK's XML is in mm on the detector and
            cannot be read without it.
        view_rate_hz: views per second, for files without times.

    Raises:
        LegsimError: the file is missing, of another kind or malformed, or what it leaves open was
            not given.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise file_error(
            path,
            f"unknown kind of geometry {path.suffix!r}",
            f"name it with one of {', '.join(SUFFIXES)}",
        )
    if (columns is None) != (rows is None):
        raise LegsimError("a detector needs both columns and rows; give the other one too")
    shape_vu = None if columns is None or rows is None else (rows, columns)
    try:
        if path.suffix.lower() == ".json":
            return _load_json(path)
        if path.suffix.lower() == ".xml":
            return rtk_xml.load(path, shape_vu, pixel_mm, view_rate_hz)
        return _load_matrices(path, shape_vu, pixel_mm, view_rate_hz)
    except OSError as error:
        raise file_error(
            path, f"cannot be read ({error.strerror or error})", "check the path"
        ) from error
    except UnicodeDecodeError as error:
        raise file_error(path, "is not text", "check that it is a geometry") from error


def save_geometry(path: Path | str, geometry: ConeBeamGeometry) -> None:
    """Writes a geometry; the suffix says which kind, as in :func:`load_geometry`.

    The file appears whole or not at all.

    Raises:
        LegsimError: an unknown suffix, a file that cannot be written, or views that RTK cannot
            express (skewed, mirrored, not square).
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise file_error(
            path,
            f"unknown kind of geometry {path.suffix!r}",
            f"name it with one of {', '.join(SUFFIXES)}",
        )
    if suffix == ".npy":
        with files.whole(path) as partial:
            np.save(partial, matrices_mm(geometry))
    else:
        text = (
            _json_text(geometry)
            if suffix == ".json"
            else rtk_xml.text_of(path, geometry)
            if suffix == ".xml"
            else _plain_text(geometry)
        )
        files.write_text(path, text)


def _json_text(geometry: ConeBeamGeometry) -> str:
    rows, columns = geometry.shape_vu
    head = {
        "unit": "mm",
        "columns": columns,
        "rows": rows,
        "pixel_mm": geometry.pixel_pitch * 1e3,
        "times_s": geometry.times.tolist(),
    }
    lines = ",\n".join(
        json.dumps(matrix) for matrix in matrices_mm(geometry).reshape(-1, 12).tolist()
    )
    return json.dumps(head)[:-1] + ', "matrices": [\n' + lines + "\n]}\n"


def _load_json(path: Path) -> ConeBeamGeometry:
    try:
        content = json.loads(path.read_text("utf-8-sig"))
    except json.JSONDecodeError as error:
        raise file_error(
            path,
            f"is not JSON ({error.msg})",
            "correct it there",
            place=f"line {error.lineno}, column {error.colno}",
        ) from error
    except RecursionError as error:
        raise file_error(
            path, "nests lists too deeply", "give one flat list of 12 numbers per view"
        ) from error
    if not isinstance(content, dict):
        raise file_error(
            path,
            "holds no object",
            'expected {"unit": "mm", "columns": ..., "rows": ..., "times_s": [...], "matrices": '
            "[...]}",
        )
    missing = [
        key for key in ("unit", "columns", "rows", "times_s", "matrices") if key not in content
    ]
    if missing:
        raise file_error(
            path,
            f"lacks {', '.join(missing)}",
            'expected the keys "unit", "columns", "rows", "times_s", "matrices"',
        )
    if content["unit"] != "mm":
        raise file_error(
            path, f"the unit is {content['unit']!r}", 'only "mm" is known', place="unit"
        )
    shape_vu = (count_of(path, content, "rows"), count_of(path, content, "columns"))
    pixel_mm = content.get("pixel_mm")
    if pixel_mm is not None and not (is_number(pixel_mm) and pixel_mm > 0):
        raise file_error(
            path,
            f"{pixel_mm!r} is not a positive number",
            "give the pixel pitch in mm or leave it out",
            place="pixel_mm",
        )
    times = numbers_of(path, content["times_s"], "times_s")
    matrices = content["matrices"]
    if not isinstance(matrices, list) or not matrices:
        raise file_error(
            path,
            "is not a list of matrices",
            "give one list of 12 numbers per view",
            place="matrices",
        )
    rows = [numbers_of(path, matrix, f"matrices[{k}]", 12) for k, matrix in enumerate(matrices)]
    if len(rows) != len(times):
        raise file_error(
            path,
            f"there are {len(rows)} matrices but {len(times)} times",
            "give one of each per view",
            place="times_s",
        )
    return geometry_of(path, times, np.reshape(rows, (-1, 3, 4)), shape_vu, pixel_mm)


def _plain_text(geometry: ConeBeamGeometry) -> str:
    lines = [
        " ".join(repr(x) for x in matrix)
        for matrix in matrices_mm(geometry).reshape(-1, 12).tolist()
    ]
    return (
        "# one 3x4 matrix per view, row by row: world mm to (column, row) pixels\n"
        + "\n".join(lines)
        + "\n"
    )


def _load_matrices(
    path: Path, shape_vu: tuple[int, int] | None, pixel_mm: float | None, view_rate_hz: float
) -> ConeBeamGeometry:
    values = _npy_values(path) if path.suffix.lower() == ".npy" else _text_values(path)
    if values.size == 0 or values.size % 12:
        raise file_error(
            path,
            f"holds {values.size} numbers, which is no whole count of 3x4 matrices",
            "give 12 numbers per view",
        )
    if shape_vu is None:
        raise file_error(path, "does not say how large the detector is", NEEDS_DETECTOR)
    matrices = values.reshape(-1, 3, 4)
    if not np.isfinite(matrices).all():
        view = int(np.flatnonzero(~np.isfinite(matrices).all(axis=(1, 2)))[0])
        raise file_error(
            path, "holds numbers that are not finite", "correct them there", place=f"matrix {view}"
        )
    return geometry_of(path, np.arange(len(matrices)) / view_rate_hz, matrices, shape_vu, pixel_mm)


_UNREADABLE = (
    *(ValueError, EOFError, TypeError, SyntaxError, OverflowError),
    tokenize.TokenError,
)
"""what numpy raises for a damaged header"""


def _npy_values(path: Path) -> FloatArray:
    fix = "write it with numpy.save of a (views, 3, 4) array"
    try:
        values = np.load(path, allow_pickle=False)
    except _UNREADABLE as error:
        raise file_error(path, "is not an .npy file of numbers", fix) from error
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
        raise file_error(path, "is not an .npy file of real numbers", fix)
    if values.shape[-2:] != (3, 4) and values.shape[-1:] != (12,):
        raise file_error(path, f"holds an array of shape {values.shape}", fix)
    return values.astype(float)


def _text_values(path: Path) -> FloatArray:
    """Numbers between blanks, commas, semicolons and brackets; # starts a comment."""
    values: list[float] = []
    for number, line in enumerate(path.read_text("utf-8-sig").splitlines(), 1):
        for word in re.split(r"[\s,;\[\](){}]+", line.partition("#")[0].strip()):
            try:
                values += [float(word)] if word else []
            except ValueError as error:
                raise file_error(
                    path,
                    f"{word!r} is not a number",
                    "a file of matrices holds 12 numbers per view",
                    place=f"line {number}",
                ) from error
    return np.array(values)
