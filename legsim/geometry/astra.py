"""ASTRA's `cone_vec` geometries: source, detector and pixel steps as four vectors per view.

ASTRA's documentation gives each view (srcX, srcY, srcZ, dX, dY, dZ, uX, uY, uZ, vX, vY, vZ): the
source, the middle of the detector, the step from pixel (0, 0) to (0, 1), along a row, and that to
(1, 0), along a column. Any flat detector can be said so. ASTRA has no unit of length of its own;
here it is the mm, or a pixel's width where that is given.
"""

from pathlib import Path

import numpy as np

from legsim.core.errors import file_error
from legsim.core.values import FloatArray, within
from legsim.geometry._file_parts import Given, geometry_of, pixel_text
from legsim.geometry.cone_beam import ConeBeamGeometry


def geometry(path: Path, vectors: FloatArray, given: Given) -> ConeBeamGeometry:
    """The geometry of vectors (v, 12) that were read from ``path``.

    Where the pixel size is given, all lengths are scaled so that pixels have it: ASTRA's users
    often count in voxels.

    Raises:
        LegsimError: numbers that are not finite, no detector size, a detector through its source,
            or pixels of another shape than was given.
    """
    wrong = [k for k, vector in enumerate(vectors) if not within(vector)]
    if wrong:
        raise file_error(
            path,
            "holds numbers that are not finite or too large for a geometry",
            "correct them there",
            place=f"view {wrong[0]}",
        )
    rows, columns = given.shape(path, None)
    source, middle, step_u, step_v = (vectors[:, k : k + 3] for k in (0, 3, 6, 9))
    pixel, factor = _pixel(path, step_u, step_v, given), scale(path, vectors, given)
    first = middle - 0.5 * (columns - 1) * step_u - 0.5 * (rows - 1) * step_v
    back = factor * np.stack([step_u, step_v, first - source], -1)
    volumes = np.abs(np.linalg.det(back))
    if (volumes <= 1e-12 * np.prod(np.linalg.norm(back, axis=1), -1)).any():
        raise file_error(
            path,
            "its detector has no area, or its plane holds the source",
            "correct the vectors",
            place=f"view {int(np.argmin(volumes))}",
        )
    forward = np.linalg.inv(back)
    shift = -np.einsum("vij,vj->vi", forward, factor * source)
    matrices = np.concatenate([forward, shift[..., None]], -1)
    return geometry_of(
        path,
        given.times(len(vectors)),
        matrices,
        (rows, columns),
        factor * pixel[0],
        sides_stated=True,
    )


def scale(path: Path, vectors: FloatArray, given: Given) -> float:
    """mm of a unit of length in vectors (v, 12): 1, unless the pixel size is given."""
    if given.pixel_mm is None or not within(vectors):
        return 1.0
    return given.pixel_mm[0] / _pixel(path, vectors[:, 6:9], vectors[:, 9:], given)[0]


def _pixel(path: Path, step_u: FloatArray, step_v: FloatArray, given: Given) -> tuple[float, float]:
    """(between columns, between rows), the same in all views and in the ratio that was given."""
    sizes = np.stack([np.linalg.norm(step_u, axis=1), np.linalg.norm(step_v, axis=1)], -1)
    pixel = np.median(sizes, axis=0)
    if pixel.min() <= 0 or np.abs(sizes - pixel).max() > 1e-3 * pixel.max():
        view = int(np.argmax(np.abs(sizes - pixel).max(1)))
        raise file_error(
            path,
            f"its pixels are {pixel_text(tuple(sizes[view]))}, in most views "
            f"{pixel_text(tuple(pixel))}",
            "one detector has one size of pixels; correct the vectors",
            place=f"view {view}",
        )
    if given.pixel_mm is not None:
        stated, wanted = pixel[1] / pixel[0], given.pixel_mm[1] / given.pixel_mm[0]
        if abs(stated - wanted) > 0.01 * wanted:
            raise file_error(
                path,
                f"pixels of {pixel_text(given.pixel_mm)} mm were given, but the vectors make them "
                f"{stated:.6g} times as high as wide",
                "give the size between columns and between rows, as in 0.4x0.3",
            )
    return float(pixel[0]), float(pixel[1])


def vectors_of(geometry: ConeBeamGeometry) -> FloatArray:
    """(v, 12) vectors in mm; the detector stands where its columns are a pixel pitch apart."""
    rows, columns = geometry.shape_vu
    back = np.linalg.inv(geometry.matrices[:, :, :3])
    depth = geometry.pixel_pitch / np.linalg.norm(back[:, :, 0], axis=1)
    source, steps = geometry.sources(), depth[:, None, None] * back
    middle = source + steps @ np.array([0.5 * (columns - 1), 0.5 * (rows - 1), 1.0])
    return 1e3 * np.concatenate([source, middle, steps[:, :, 0], steps[:, :, 1]], -1)


def looks_like_vectors(rows: FloatArray) -> bool:
    """Whether numbers (v, 12) make sense as ASTRA's vectors, which a matrix does by no chance.

    Steps of one length and perpendicular to each other in all views, small beside the distance to
    the source, and a detector that roughly faces it.
    """
    if not within(rows):
        return False
    source, middle, step_u, step_v = (rows[:, k : k + 3] for k in (0, 3, 6, 9))
    wide, high = np.linalg.norm(step_u, axis=1), np.linalg.norm(step_v, axis=1)
    ray, normal = middle - source, np.cross(step_u, step_v)
    distance, area = np.linalg.norm(ray, axis=1), np.linalg.norm(normal, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return bool(
            (np.ptp(wide) < 1e-3 * wide.mean())
            and (np.ptp(high) < 1e-3 * high.mean())
            and (np.abs((step_u * step_v).sum(1)) < 1e-3 * wide * high).all()
            and (distance > 10 * np.maximum(wide, high)).all()
            and (np.abs((ray * normal).sum(1)) > 0.7 * distance * area).all()
        )
