"""Projections with the geometry of another file, which may leave the detector to them."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.geometry import files as geometry_files
from legsim.geometry import image_files
from legsim.geometry.cone_beam import ConeBeamGeometry

_WITHOUT_PIXELS = (".tif", ".tiff")
"""endings of images whose spacing is not that of a detector"""

_HAVE_TIMES = (".json",)
"""endings of geometries that hold a time per view"""


def load_geometry(
    projections_file: Path,
    geometry_file: Path,
    *,
    columns: int | None = None,
    rows: int | None = None,
    pixel_mm: float | None = None,
    view_rate_hz: float = 31.0,
) -> ConeBeamGeometry:
    """The geometry; where its file does not say the detector's size, the projections do.

    RTK's is in mm on the detector: there size, spacing and origin of the projections say where
    pixels are.
    """
    header = image_files.read_header(projections_file)
    in_mm = geometry_file.suffix.lower() == ".xml" and pixel_mm is None
    if in_mm and projections_file.suffix.lower() in _WITHOUT_PIXELS:
        raise file_error(
            projections_file,
            "does not say how large its pixels are, and the geometry is in mm",
            "give pixel_mm",
        )
    pitch = header.spacing_mm[0]
    geometry = geometry_files.load_geometry(
        geometry_file,
        columns=columns or header.size[0],
        rows=rows or header.size[1],
        pixel_mm=pixel_mm or pitch,
        view_rate_hz=view_rate_hz,
    )
    if not in_mm:
        return geometry
    if abs(header.spacing_mm[1] - pitch) > 1e-6 * pitch:
        raise file_error(
            projections_file,
            f"has pixels of {pitch:g} x {header.spacing_mm[1]:g} mm",
            "resample the projections to square pixels",
        )
    shift = np.eye(3)
    shift[:2, 2] = [
        -header.origin_mm[k] / pitch - 0.5 * (n - 1) for k, n in enumerate(header.size[:2])
    ]
    return replace(geometry, matrices=shift @ geometry.matrices)


def with_times(
    geometry: ConeBeamGeometry,
    geometry_file: Path,
    view_rate_hz: float | None,
    times_file: Path | None,
) -> ConeBeamGeometry | None:
    """The geometry at the views' own times; None where nothing says them.

    Times come from ``times_file``, else from ``view_rate_hz`` (the first view at 0 s), else from
    the geometry's file if its kind holds times.

    Raises:
        LegsimError: both are given, or a file of times that is none, or of another scan.
    """
    if times_file is not None and view_rate_hz is not None:
        raise LegsimError("view_rate_hz and view_times both say when views are; give one of them")
    if times_file is not None:
        times = _times(times_file, len(geometry))
        try:
            return replace(geometry, times=times)
        except LegsimError as error:
            raise file_error(times_file, str(error), "give the views in order") from error
    if view_rate_hz is not None:
        return replace(geometry, times=np.arange(len(geometry)) / view_rate_hz)
    return geometry if geometry_file.suffix.lower() in _HAVE_TIMES else None


def _times(path: Path, count: int) -> np.ndarray:
    """Times (count,) s of a text file with one a line, under a line with a name or not."""
    lines = [line.strip() for line in files.read(path, "times") if line.strip()]
    numbers = []
    for k, line in enumerate(lines):
        try:
            numbers.append(float(line.rstrip(",;")))
        except ValueError:
            if k > 0:
                raise file_error(
                    path,
                    f"{line[:40]!r} is not a time",
                    "give one number of seconds per line",
                    place=f"line {k + 1}",
                ) from None
    if len(numbers) != count:
        raise file_error(
            path,
            f"holds {len(numbers)} times, the geometry {count} views",
            "give one time in s per view",
        )
    return np.array(numbers)
