"""Projections and geometry that a SCAN.toml names, and the times of its views."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from legsim.config.measured_scan import MeasuredScanConfig
from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.geometry import projection_images, scan_files
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.projection_images import RawLayout
from legsim.geometry.scan_files import ScanFiles
from legsim.imu import units


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


_AROUND = " \t,;\"'"
"""what stands around a number or a title of a table of one column"""

_LONGER = re.compile(r"(?i)^(?:min(?:ute)?s?|h|hrs?|hours?)$")
"""units of time that are not read"""


def _times(path: Path, count: int) -> FloatArray:
    """Times (count,) s of a text file with one a line, under a line with a name or not; the name
    may end in a unit.
    """
    lines = [line.strip(_AROUND) for line in files.read(path, "times") if line.strip()]
    numbers, seconds = [], 1.0
    for k, line in enumerate(lines):
        try:
            numbers.append(float(line))
        except ValueError:
            if k > 0:
                raise file_error(
                    path,
                    f"{line[:40]!r} is not a time",
                    "give one number of seconds per line",
                    place=f"line {k + 1}",
                ) from None
            seconds = _seconds(path, line)
    if len(numbers) != count:
        raise file_error(
            path,
            f"holds {len(numbers)} times, the geometry {count} views",
            "give one time in s per view",
        )
    return seconds * np.array(numbers)


def _seconds(path: Path, title: str) -> float:
    """s per unit of the times below a title; 1 where it states no unit of time."""
    unit = units.known(title) or units.of_name(title) or "s"
    if _LONGER.search(unit):
        problem = f"the times are stated to be in {unit!r}"
        raise file_error(path, problem, "give seconds", place="line 1")
    return units.seconds_of(unit) or 1.0


_SCANS_S = (0.5, 300.0)
"""of a scan that a C-arm makes of somebody who stands"""


def time_doubts(times: FloatArray) -> tuple[str, ...]:
    """Doubts views (v,) s whose time no scan takes, as times in another unit."""
    seconds = float(times[-1] - times[0])
    if len(times) < 2 or _SCANS_S[0] <= seconds <= _SCANS_S[1]:
        return ()
    guess = unit_guess(seconds)
    return (
        f"In doubt: the views are said to take {seconds:.4g} s, which no scan of somebody who "
        f"stands does: check their times{guess and f' ({guess})'}.",
    )


def unit_guess(seconds: float) -> str:
    """In which unit a number of seconds that no scan takes would be one that it does; or empty."""
    for unit, factor in units.SECONDS.items():
        longer = factor < 1 and seconds > _SCANS_S[1]
        if longer and _SCANS_S[0] <= factor * seconds <= _SCANS_S[1]:
            return f"in {unit} they would be {factor * seconds:.4g} s"
    return ""
