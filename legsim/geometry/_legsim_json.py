"""legsim's own geometry file: JSON with times, detector and one matrix per view, in millimeters.

With "sides_stated": true, which legsim writes, the third row of each matrix times a point is
positive in front of the source; without it, readers find that side from all views.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from legsim.core.errors import file_error
from legsim.geometry._file_parts import (
    BY_NUMBERS,
    Given,
    count_of,
    geometry_of,
    matrices_mm,
    numbers_of,
    pixel_of,
)
from legsim.geometry.cone_beam import ConeBeamGeometry


def text_of(geometry: ConeBeamGeometry) -> str:
    """A geometry as JSON."""
    rows, columns = geometry.shape_vu
    head = {
        "unit": "mm",
        "columns": columns,
        "rows": rows,
        "pixel_mm": geometry.pixel_pitch * 1e3,
        "times_s": geometry.times.tolist(),
        "sides_stated": True,
    }
    lines = ",\n".join(
        json.dumps(matrix) for matrix in matrices_mm(geometry).reshape(-1, 12).tolist()
    )
    return json.dumps(head)[:-1] + ', "matrices": [\n' + lines + "\n]}\n"


def parsed(path: Path) -> Any:
    """The content of a JSON file.

    Raises:
        LegsimError: it is not JSON.
    """
    try:
        return json.loads(path.read_text("utf-8-sig"))
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


def geometry(path: Path, content: Any, given: Given) -> ConeBeamGeometry:
    """The geometry of a file's content.

    Raises:
        LegsimError: missing or malformed keys, or a detector other than was given.
    """
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
            'expected the keys "unit", "columns", "rows", "times_s", "matrices"; of another '
            f"program {BY_NUMBERS}",
        )
    if content["unit"] != "mm":
        raise file_error(
            path, f"the unit is {content['unit']!r}", 'only "mm" is known', place="unit"
        )
    shape_vu = (count_of(path, content, "rows"), count_of(path, content, "columns"))
    given.shape(path, shape_vu)
    stated = content.get("pixel_mm")
    pixel_mm = None if stated is None else pixel_of(path, stated)[0]
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
    matrices = np.reshape(rows, (-1, 3, 4))
    stated = content.get("sides_stated") is True
    found = geometry_of(path, times, matrices, shape_vu, pixel_mm, sides_stated=stated)
    if given.pixel_mm is not None:
        if pixel_mm is None:
            pixel_mm = given.pixel_mm[0]
            found = replace(found, pixel_pitch=1e-3 * pixel_mm)
        given.pixel(path, (pixel_mm, 1e3 * found.row_pitch()))
    return found
