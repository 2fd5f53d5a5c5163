"""Files of pixels: shadows of beads on the skin, and of points in a sensor, as CSV.

Whether they fit images and geometry is looked at too: rows or columns from the other edge and (row,
column) instead of (column, row) give plausible numbers.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from legsim.core.errors import file_error
from legsim.core.values import FloatArray
from legsim.correction.fiducials import FIDUCIAL_NAMES
from legsim.correction.triangulation import triangulated
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.imu import table_rows

_MOST_BEADS = 1000

_FEWEST_VIEWS = 3
"""views whose rays meet in no point by themselves"""

_APART = 0.015
"""m RMS between a point and its rays, at the rotation center, more than a standing person moves"""

_AROUND_PX = 7
"""half of the square about a shadow that it stands out from"""

_STANDS_OUT = 4.0
"""times the contrast of the pixels that are given, from which others show the shadows"""

_CLEAR = 0.05
"""contrast of a metal bead's shadow, as a line integral"""


def load_beads(path: Path, geometry: ConeBeamGeometry) -> FloatArray:
    """Reads pixels (v, b, 2) of a CSV ``view,bead,u,v``; NaN where a bead is not seen.

    Views and beads count from 0. A shadow that is not seen has no row, or empty pixels.

    Raises:
        LegsimError: missing columns, what is no number, a view or bead that is not there or there
            twice, or a pixel beyond the detector.
    """
    known = {str(number): number for number in range(_MOST_BEADS)}
    fix = f"beads from 0 to {_MOST_BEADS - 1}"
    seen = _shadows(path, "bead", known, fix, geometry)
    named = sorted({bead for _, bead in seen})
    if named != list(range(len(named))):
        raise file_error(path, f"has beads {named}", "count beads from 0 without gaps")
    return _table(seen, len(geometry), len(named))


def load_fiducials(path: Path, geometry: ConeBeamGeometry, *, bounded: bool = True) -> FloatArray:
    """Reads pixels (v, 4, 2) of a CSV ``view,point,u,v``, as :func:`load_beads`; the points are
    origin, x, y and z. Not ``bounded``, they may lie beyond the detector.
    """
    known = {name: number for number, name in enumerate(FIDUCIAL_NAMES)}
    fix = f"name the points {', '.join(FIDUCIAL_NAMES)}"
    seen = _shadows(path, "point", known, fix, geometry, bounded=bounded)
    return _table(seen, len(geometry), len(known))


def first_views(path: Path, pixels: FloatArray) -> FloatArray:
    """(k, 4, 2) of the first views that show all points, of pixels (v, 4, 2).

    Raises:
        LegsimError: the first view does not.
    """
    hidden = np.flatnonzero(~np.isfinite(pixels).all(axis=(1, 2)))
    count = int(hidden[0]) if len(hidden) else len(pixels)
    if not count:
        name = FIDUCIAL_NAMES[int(np.argmin(np.isfinite(pixels[0]).all(-1)))]
        raise file_error(
            path,
            f"lacks point {name!r} of view 0",
            "give all four points of consecutive views from 0",
        )
    return pixels[:count]


def doubts(path: Path, what: str, pixels: FloatArray, projections: Projections) -> list[str]:
    """Sentences on pixels (v, p, 2) that images or geometry speak against."""
    geometry = projections.geometry
    rows, columns = geometry.shape_vu
    turned = {
        "(column, row) are exchanged": pixels[..., ::-1],
        "rows are counted from the other edge": pixels * [1, -1] + [0, rows - 1],
        "columns are counted from the other edge": pixels * [-1, 1] + [columns - 1, 0],
    }
    shown = {said: _contrast(projections, other) for said, other in turned.items()}
    best = max(shown, key=lambda said: shown[said])
    if shown[best] > max(_CLEAR, _STANDS_OUT * _contrast(projections, pixels)):
        return [f"{path}: the images show the shadows where they would be if {best}"]
    apart = _apart(geometry, pixels)
    if apart > _APART:
        return [
            f"{path}: the rays of a {what} miss each other by {1e3 * apart:.0f} mm RMS, more "
            f"than a standing person moves: check which {what} is which, the views' order, and "
            "that pixels are (column, row) from 0"
        ]
    return []


def _contrast(projections: Projections, pixels: FloatArray) -> float:
    """Median over shadows (v, p, 2) of how far the image stands out there from its surroundings."""
    rows, columns = projections.geometry.shape_vu
    found = []
    for image, shadows in zip(projections.line_integrals, pixels, strict=True):
        for u, v in shadows[np.isfinite(shadows).all(-1)].round().astype(int):
            if not (0 <= u < columns and 0 <= v < rows):
                continue
            around = np.median(_square(image, u, v, _AROUND_PX))
            found.append(float(_square(image, u, v, 1).max() - around))
    return float(np.median(found)) if found else 0.0


def _square(image: FloatArray, u: int, v: int, reach: int) -> FloatArray:
    return image[max(v - reach, 0) : v + reach + 1, max(u - reach, 0) : u + reach + 1]


def _apart(geometry: ConeBeamGeometry, pixels: FloatArray) -> float:
    """Largest RMS distance (m) of a point, at rest, to its rays, where they pass it."""
    often = np.isfinite(pixels).all(-1).sum(0) >= _FEWEST_VIEWS
    if not often.any():
        return 0.0
    kept = pixels[:, often]
    places = triangulated(geometry, kept)
    off = geometry.project(places)[0] - kept
    arm = np.linalg.norm(geometry.sources() - geometry.rotation_center(), axis=-1).mean()
    pixel = arm / geometry.focal_lengths().mean()
    return float(pixel * np.sqrt(np.nanmean((off**2).sum(-1), axis=0)).max())


def _shadows(
    path: Path,
    what: str,
    known: Mapping[str, int],
    fix: str,
    geometry: ConeBeamGeometry,
    *,
    bounded: bool = True,
) -> dict[tuple[int, int], tuple[float, float]]:
    """Pixels by view and number of a CSV ``view,<what>,u,v``; rows without pixels are left out."""
    views, (rows, columns) = len(geometry), geometry.shape_vu
    seen: dict[tuple[int, int], tuple[float, float]] = {}
    table = table_rows.read_rows(path, ("view", "u", "v", what), fewest=1)
    for line, (*cells, name) in table.rows:
        place, named = f"line {line}", name.strip().lower().removesuffix(".0")
        view, u, v = (
            table_rows.number_in(path, line, cell, column)
            for cell, column in zip(cells, ("view", "u", "v"), strict=True)
        )
        if np.isnan([u, v]).all():
            continue
        if what == "bead" and not named.removeprefix("-").isdecimal():
            problem = f"bead {name!r} is no whole number"
            raise file_error(path, problem, "number the beads from 0", place=place)
        if named not in known or view not in range(views) or np.isnan([u, v]).any():
            raise file_error(
                path,
                f"view {cells[0]}, {what} {name} at {cells[1]}, {cells[2]} is none of this scan",
                f"count views from 0 to {views - 1}, {fix}, and leave out what is not seen",
                place=place,
            )
        if bounded and not (-0.5 <= u <= columns - 0.5 and -0.5 <= v <= rows - 0.5):
            raise file_error(
                path,
                f"{what} {name} of view {view:g} at {u:g}, {v:g} is beyond the {columns} columns "
                f"and {rows} rows",
                "give pixels of these images, (column, row) counted from 0, in the order of the "
                "geometry's rows, and leave out what is not seen",
                place=place,
            )
        if (int(view), known[named]) in seen:
            problem = f"{what} {name} of view {view:g} is there twice"
            raise file_error(path, problem, "keep one of the lines", place=place)
        seen[int(view), known[named]] = (u, v)
    if not seen:
        raise file_error(path, f"holds no {what} that is seen", "give its pixels")
    return seen


def _table(
    seen: Mapping[tuple[int, int], tuple[float, float]], views: int, count: int
) -> FloatArray:
    """(views, count, 2) pixels; NaN where nothing was seen."""
    pixels = np.full((views, count, 2), np.nan)
    for (view, one), pixel in seen.items():
        pixels[view, one] = pixel
    return pixels
