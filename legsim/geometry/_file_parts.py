"""What all kinds of geometry files share: matrices in millimeters, checked counts and numbers."""

from pathlib import Path
from typing import Any

import numpy as np

from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry

_LARGEST = float(np.finfo(float).max)

_MOST_PIXELS = 1 << 20
"""in a row or column; more is no detector"""

NEEDS_DETECTOR = (
    "give the detector's rows and columns (and its pixel_mm), which this kind of file does not hold"
)


def matrices_mm(geometry: ConeBeamGeometry) -> FloatArray:
    """(v, 3, 4): world mm to (u w, v w, w), w in mm."""
    return geometry.matrices * np.array([1.0, 1.0, 1.0, 1e3])


def geometry_of(
    path: Path,
    times: Any,
    matrices_mm: Any,
    shape_vu: tuple[int, int],
    pixel_mm: float | None,
    place: str = "",
) -> ConeBeamGeometry:
    """A geometry from what a file holds; errors name the file."""
    try:
        matrices = np.asarray(matrices_mm, float) * np.array([1.0, 1.0, 1.0, 1e-3])
        return ConeBeamGeometry(
            times, matrices, shape_vu, 1e-3 if pixel_mm is None else pixel_mm * 1e-3
        )
    except LegsimError as error:
        raise file_error(path, str(error), "correct the file", place=place) from error


def is_number(value: Any) -> bool:
    return (
        isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= _LARGEST
    )


def count_of(path: Path, content: dict[str, Any], key: str) -> int:
    value = content[key]
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= _MOST_PIXELS:
        raise file_error(
            path, f"{value!r} is not a count of pixels", "give a positive whole number", place=key
        )
    return value


def numbers_of(path: Path, values: Any, place: str, count: int | None = None) -> list[float]:
    if not isinstance(values, list) or not all(is_number(v) for v in values):
        raise file_error(path, "is not a list of finite numbers", "correct it there", place=place)
    if count is not None and len(values) != count:
        raise file_error(
            path, f"has {len(values)} numbers", f"a 3x4 matrix has {count}, row by row", place=place
        )
    return [float(v) for v in values]
