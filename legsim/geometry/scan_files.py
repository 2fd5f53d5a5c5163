"""A scan from two files: its projections in any format, and its geometry in any format."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from legsim.core.errors import LegsimError
from legsim.geometry import files, odd_views, opposite_rays, plausibility, projection_images
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.counts import Counts
from legsim.geometry.projection_images import ProjectionImages, RawLayout

_OTHER_PIXEL = 0.01
"""share by which pixels of two files differ that are not the same"""

_OTHER_DISTANCE = 0.05
"""share by which a calibrated distance is off the nominal one of the images at most"""


@dataclass(frozen=True, slots=True, eq=False)
class ScanFiles:
    """Projections with their geometry, and what a user may not expect of them."""

    projections: Projections
    notes: tuple[str, ...] = ()
    timed: bool = False
    """whether the geometry's file says when the views were taken"""

    @property
    def geometry(self) -> ConeBeamGeometry:
        """Of the projections."""
        return self.projections.geometry


def read_scan(
    projections: Path | str,
    geometry: Path | str,
    *,
    counts: Counts | None = None,
    raw: RawLayout | None = None,
    pixel_mm: float | tuple[float, float] | None = None,
    origin_mm: tuple[float, float] | None = None,
    turn_rows: bool = False,
    line_integrals: bool = False,
    format: str | None = None,
    up: str = "y",
) -> ScanFiles:
    """Reads a scan. The size of the detector is that of the images.

    Args:
        projections: as of :func:`legsim.geometry.projection_images.read_images`.
        geometry: as of :func:`legsim.geometry.files.read_geometry`.
        counts: how counts become line integrals; None: the images hold line integrals.
        raw: layout of projections without a header.
        pixel_mm: pixel size, where neither file says it; (between columns, between rows) if two.
        origin_mm: center of the first pixel on the detector, for RTK's geometries, where the
            images do not say it. Default: the detector is centered.
        turn_rows: takes the images' rows from the last to the first.
        line_integrals: the images hold line integrals, whatever their values look like.
        format: of the geometry, as in :func:`legsim.geometry.files.read_geometry`.
        up: the geometry's vertical axis, likewise.

    Raises:
        LegsimError: as of the two readers; or an origin with a geometry that places its pixels
            itself.
    """
    images = projection_images.read_images(projections, raw=raw)
    _, rows, columns = images.values.shape
    described = files.read_geometry(
        geometry,
        columns=columns,
        rows=rows,
        pixel_mm=pixel_mm,
        header_pixel_mm=images.pixel_mm,
        format=format,
        up=up,
    )
    placed, notes = described.geometry, list(described.notes)
    if described.format == "rtk":
        placed, more = _placed(placed, images, origin_mm, turn_rows)
        notes += more
    elif origin_mm is not None:
        raise LegsimError(
            f"an origin places pixels for RTK's geometries only, {geometry} is of the format "
            f"{described.format}; leave it out"
        )
    if pixel_mm is None:
        notes += _other_pixel(placed, images)
    made, more = projection_images.projections_of(
        projections,
        images,
        placed,
        counts,
        turn_rows=turn_rows,
        line_integrals=line_integrals,
    )
    by_reading = counts is not None and counts.air is None
    doubts = odd_views.objections(made.line_integrals, by_reading=by_reading)
    doubts += () if counts is None else odd_views.coarse(images.values)
    known = pixel_mm is not None or images.pixel_mm is not None or not described.pixel_open
    wrong = plausibility.objections(placed, pixel_known=known)
    wrong += _other_distance(placed, images) if known else ()
    # where the geometry itself is doubted, that its rays do not fit is no news
    doubts += wrong or tuple(line for line in [opposite_rays.objection(made)] if line)
    said = (*notes, *more, *(f"In doubt: {line}" for line in doubts))
    return ScanFiles(made, said, described.format == "legsim")


def _other_pixel(geometry: ConeBeamGeometry, images: ProjectionImages) -> list[str]:
    """A note where the images state pixels of another size than the geometry's, which are used.

    1 mm is what programs write that know none.
    """
    stated = images.pixel_mm
    used = 1e3 * geometry.pixel_pitch, 1e3 * geometry.row_pitch()
    if stated is None or stated == (1.0, 1.0) or np.allclose(stated, used, rtol=_OTHER_PIXEL):
        return []
    if np.allclose(stated[::-1], used, rtol=_OTHER_PIXEL):
        return [
            f"In doubt: the images state pixels of {stated[0]:g} mm between columns and "
            f"{stated[1]:g} mm between rows, the geometry the other way around, which is used: "
            "exchange the two in one of them"
        ]
    return [
        f"the images state pixels of {stated[0]:g} x {stated[1]:g} mm, the geometry "
        f"{used[0]:.6g} x {used[1]:.6g} mm: the geometry's are used"
    ]


def _other_distance(geometry: ConeBeamGeometry, images: ProjectionImages) -> tuple[str, ...]:
    """A line where the images state the detector at another distance than the geometry."""
    used = 1e3 * float(np.median(geometry.focal_lengths())) * geometry.pixel_pitch
    stated = images.detector_mm
    if stated is None or abs(used - stated) <= _OTHER_DISTANCE * stated:
        return ()
    return (
        f"the images state {stated:.4g} mm from source to detector, the geometry has {used:.4g} "
        "mm, which is used: check its distances and the pixel size",
    )


def _placed(
    geometry: ConeBeamGeometry,
    images: ProjectionImages,
    origin_mm: tuple[float, float] | None,
    turn_rows: bool,
) -> tuple[ConeBeamGeometry, list[str]]:
    """(a geometry of a centered detector for pixels that start at the images' origin, notes).

    RTK's numbers are in mm on the detector, and the images' origin says where pixels are.
    """
    rows, columns = geometry.shape_vu
    pitch = np.array([geometry.pixel_pitch, geometry.row_pitch()]) * 1e3
    centered = -0.5 * (np.array([columns, rows]) - 1) * pitch
    origin = images.origin_mm if origin_mm is None else origin_mm
    if origin is None:
        return geometry, ["the images do not say where they start: the detector is centered"]
    notes = []
    shift = np.eye(3)
    shift[:2, 2] = (centered - np.array(origin)) / pitch
    if turn_rows:
        # the images' last row becomes the first: what lay above the middle now lies below
        shift[1, 2] *= -1
    off = np.abs(shift[:2, 2]) / np.array([columns, rows])
    if off.max() > 0.25:
        notes.append(
            f"the images start at ({origin[0]:g}, {origin[1]:g}) mm, {100 * off.max():.0f} % of "
            "their size from where a centered detector does: if their header is wrong, give the "
            "origin"
        )
    matrices = shift @ geometry.matrices
    return replace(geometry, matrices=matrices), notes
