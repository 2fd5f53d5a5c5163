"""Projections and geometry that a SCAN.toml names, and the times of its views."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from legsim.config.measured_scan import MeasuredScanConfig
from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.geometry import projection_images, scan_files
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.projection_images import RawLayout
from legsim.geometry.scan_files import ScanFiles


def read(settings: MeasuredScanConfig, folder: Path) -> ScanFiles:
    """Line integrals with their geometry, of files relative to ``folder``.

    Raises:
        LegsimError: as of :func:`legsim.geometry.scan_files.read_scan`; or a detector that the
            images contradict.
    """
    given, path = settings.counts, folder / settings.projections
    raw = RawLayout.parsed(settings.raw) if settings.raw else None
    flat, dark, bad = (
        folder / name if name else None for name in (given.flat, given.dark, given.bad_pixels)
    )
    counts = projection_images.read_counts(
        i0=given.i0, air=given.air or None, flat=flat, dark=dark, bad=bad, raw=raw
    )
    found = scan_files.read_scan(
        path,
        folder / settings.geometry,
        counts=counts,
        raw=raw,
        pixel_mm=settings.pixel_mm,
        origin_mm=settings.origin_mm,
        turn_rows=settings.turn_rows,
        line_integrals=settings.line_integrals,
        format=settings.format or None,
        up=settings.up,
    )
    rows, columns = found.geometry.shape_vu
    if settings.columns not in (None, columns) or settings.rows not in (None, rows):
        raise file_error(
            path,
            f"has {columns} columns and {rows} rows, not those that are given",
            "leave columns and rows out",
        )
    return found


_OTHER_UNIT = re.compile(
    r"(?<![a-z])(ms|msec|milliseconds?|us|µs|usec|microseconds?|ns|min|minutes?)(?![a-z])", re.I
)
"""of times, in the name of their column"""


def files_of(settings: MeasuredScanConfig, folder: Path) -> list[Path]:
    """All files that :func:`read` reads."""
    counts = settings.counts
    places = [settings.projections, counts.flat, counts.dark, counts.bad_pixels]
    found = [p for name in places if name for p in projection_images.members(folder / name)]
    return [*found, folder / settings.geometry]


def with_times(
    geometry: ConeBeamGeometry,
    timed: bool,
    view_rate_hz: float | None,
    times_file: Path | None,
) -> ConeBeamGeometry | None:
    """The geometry at the views' own times; None where nothing says them.

    Times come from ``times_file``, else from ``view_rate_hz`` (the first view at 0 s), else from
    the geometry itself where its file holds times (``timed``).

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
    return geometry if timed else None


def _times(path: Path, count: int) -> np.ndarray:
    """Times (count,) s of a text file with one a line, under a line with a name or not."""
    lines = [line.strip() for line in files.read(path, "times") if line.strip()]
    numbers = []
    for k, line in enumerate(lines):
        try:
            numbers.append(float(line.rstrip(",;")))
        except ValueError:
            other = _OTHER_UNIT.search(line)
            if k == 0 and other:
                problem = f"states times in {other.group()}"
                raise file_error(path, problem, "write them in s", place="line 1") from None
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
