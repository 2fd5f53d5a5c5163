"""What all kinds of geometry files share: matrices in millimeters, checked counts and numbers."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from legsim.core.errors import LegsimError, file_error
from legsim.core.values import LARGEST, FloatArray, within
from legsim.geometry.cone_beam import ConeBeamGeometry

_MOST_PIXELS = 1 << 20
"""in a row or column; more is no detector"""

NEEDS_DETECTOR = (
    "give the detector's rows and columns (and its pixel_mm), which this kind of file does not hold"
)


BY_NUMBERS = (
    "give its distances, detector and angles as TIGRE's JSON, or a matrix per view "
    "(docs/formats.md, Geometries)"
)
"""what to do with a description of a scanner that is not read"""


@dataclass(frozen=True, slots=True)
class Given:
    """What a caller says of a geometry beside its file; None: the file says it."""

    shape_vu: tuple[int, int] | None = None
    pixel_mm: tuple[float, float] | None = None
    """(between columns, between rows)"""
    view_rate_hz: float = 31.0
    header_pixel_mm: tuple[float, float] | None = None
    """what the projections' header says: for files that leave it open, and not compared"""

    def shape(self, path: Path, stated: tuple[int, int] | None) -> tuple[int, int]:
        """(rows, columns), from the file or the caller, who must agree.

        Raises:
            LegsimError: both say something else, or neither says anything.
        """
        if stated is None and self.shape_vu is None:
            raise file_error(path, "does not say how large the detector is", NEEDS_DETECTOR)
        if stated is not None and self.shape_vu not in (None, stated):
            assert self.shape_vu is not None
            raise file_error(
                path,
                f"says {stated[1]} columns and {stated[0]} rows, not {self.shape_vu[1]} and "
                f"{self.shape_vu[0]}",
                "give the geometry of these images, or leave out columns and rows",
            )
        return stated or self.shape_vu or (0, 0)

    def pixel(self, path: Path, stated: tuple[float, float] | None) -> tuple[float, float] | None:
        """(between columns, between rows) in mm, from the file or the caller, who must agree.

        Raises:
            LegsimError: they differ by more than a thousandth.
        """
        if stated is None or self.pixel_mm is None:
            return stated or self.pixel_mm or self.header_pixel_mm
        if not np.allclose(stated, self.pixel_mm, rtol=1e-3, atol=0):
            raise file_error(
                path,
                f"says pixels of {pixel_text(stated)} mm, not {pixel_text(self.pixel_mm)}",
                "leave out the pixel size, or give the file of this detector",
            )
        return stated

    def times(self, views: int) -> FloatArray:
        """(v,) s at the given rate."""
        return np.arange(views) / self.view_rate_hz


def pixel_text(pixel_mm: tuple[float, float]) -> str:
    """A pixel's size for people: "0.4" or "0.4 x 0.3"."""
    return " x ".join(dict.fromkeys(f"{size:.6g}" for size in pixel_mm))


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
    *,
    sides_stated: bool = False,
) -> ConeBeamGeometry:
    """A geometry from what a file holds, ``pixel_mm`` being between columns; errors name the
    file.

    ``sides_stated``: the file says where source and detector are, and the matrices' depths are
    positive between them.
    """
    try:
        matrices = np.asarray(matrices_mm, float) * np.array([1.0, 1.0, 1.0, 1e-3])
        if not within(matrices):
            raise LegsimError("holds numbers that are not finite or too large for a geometry")
        return ConeBeamGeometry(
            times,
            matrices,
            shape_vu,
            1e-3 if pixel_mm is None else pixel_mm * 1e-3,
            sides_stated,
        )
    except LegsimError as error:
        raise file_error(path, str(error), "correct the file", place=place) from error


def geometry_of_matrices(
    path: Path, matrices_mm: FloatArray, given: Given, shape_vu: tuple[int, int] | None = None
) -> ConeBeamGeometry:
    """A geometry of matrices (v, 3, 4) from world mm to pixels alone; the rest is given.

    Raises:
        LegsimError: numbers that are not finite, no detector, or pixels that are not as wide and
            high as was given by over a hundredth.
    """
    wrong = [k for k, matrix in enumerate(matrices_mm) if not within(matrix)]
    if wrong:
        raise file_error(
            path,
            "holds numbers that are not finite or too large for a geometry",
            "correct them there",
            place=f"matrix {wrong[0]}",
        )
    shape_vu = given.shape(path, shape_vu)
    pixel_mm = given.pixel_mm or given.header_pixel_mm
    geometry = geometry_of(
        path,
        given.times(len(matrices_mm)),
        matrices_mm,
        shape_vu,
        None if pixel_mm is None else pixel_mm[0],
    )
    if given.pixel_mm is not None and pixel_mm is not None:
        by_matrices = (pixel_mm[0], 1e3 * geometry.row_pitch())
        if abs(by_matrices[1] - pixel_mm[1]) > 0.01 * pixel_mm[1]:
            raise file_error(
                path,
                f"pixels of {pixel_text(pixel_mm)} mm were given, but by the matrices they are "
                f"{pixel_text(by_matrices)} mm",
                "give the size between columns and between rows, as in 0.4x0.3",
            )
    return geometry


def pixels_off(given: FloatArray, written: FloatArray, shape_vu: tuple[int, int]) -> FloatArray:
    """(v,) pixels between where two sets of matrices (v, 3, 4) of one source see a ray.

    The greatest of the detector's corners.
    """
    rows, columns = shape_vu
    corners = np.array([[u, v, 1.0] for u in (0, columns - 1) for v in (0, rows - 1)])
    onto = written[:, :, :3] @ np.linalg.inv(given[:, :, :3])
    seen = np.einsum("vij,cj->vci", onto, corners)
    return np.linalg.norm(seen[..., :2] / seen[..., 2:] - corners[:, :2], axis=-1).max(-1)


_MOST_OFF = 1e-3
"""of a pixel by which a written geometry may see a ray elsewhere: far below a calibration's"""


def refuse_other_pixels(
    path: Path, program: str, geometry: ConeBeamGeometry, written: FloatArray
) -> None:
    """Refuses views that ``written`` (v, 3, 4), what a format can say, does not hold.

    Raises:
        LegsimError: a view is off by more than a thousandth of a pixel; the line says by how much,
            and how its pixels are shaped.
    """
    off = pixels_off(geometry.matrices, written, geometry.shape_vu)
    if off.max() <= _MOST_OFF:
        return
    view = int(np.argmax(off))
    steps = np.linalg.inv(geometry.matrices[view, :, :3])[:, :2]
    u, v = np.linalg.norm(steps, axis=0)
    skew = 90 - np.degrees(np.arccos(np.clip(steps[:, 0] @ steps[:, 1] / (u * v), -1, 1)))
    raise file_error(
        path,
        f"{program} cannot say view {view}: its pixels are skewed by {skew:.3g} deg and "
        f"{v / u:.6g} times as high as wide, {geometry.row_pitch() / geometry.pixel_pitch:.6g} on "
        f"average, so that rays would be off by {off[view]:.3g} pixels",
        "write legsim JSON, matrices or ASTRA's vectors instead",
    )


def refuse_mirrored(path: Path, program: str, geometry: ConeBeamGeometry) -> None:
    """Refuses views whose rows run the other way, where a format has no mirror.

    Raises:
        LegsimError: there are such views.
    """
    mirrored = np.flatnonzero(geometry.mirrored())
    if len(mirrored):
        raise file_error(
            path,
            f"view {mirrored[0]} is mirrored (rows or columns run backwards), and {program} has no "
            "mirror",
            "turn the rows of geometry and projections (`legsim geometry convert` does the "
            "former), or write legsim JSON, matrices or ASTRA's vectors",
        )


def pixel_of(path: Path, value: Any) -> tuple[float, float]:
    """(between columns, between rows) in mm of a file's number or pair of numbers.

    Raises:
        LegsimError: it is none.
    """
    pair = value if isinstance(value, list) else [value, value]
    if len(pair) != 2 or not all(is_number(size) and size > 0 for size in pair):
        raise file_error(
            path,
            f"{value!r} is not a positive number",
            "give the pixel pitch in mm or leave it out",
            place="pixel_mm",
        )
    return float(pair[0]), float(pair[1])


def is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= LARGEST


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
