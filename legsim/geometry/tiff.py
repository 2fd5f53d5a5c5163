"""TIFF stacks."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from legsim.core.errors import LegsimError, file_error
from legsim.core.values import within
from legsim.geometry import image_files

if TYPE_CHECKING:
    import tifffile
else:
    tifffile = lazy_loader.load("tifffile")

SUFFIXES = (".tif", ".tiff")

_PALETTE = 3
"""PhotometricInterpretation of numbers of colors"""

_FROM_ABOVE, _FROM_BELOW = 1, 4
"""orientations: the first row stored is the uppermost, or the lowest one"""

_AXES = {"T": "times", "Z": "slices", "C": "channels"}

_UNCALIBRATED = (20, 21, 22)
"""ImageJ's functions that leave values as they are: none, and optical density not yet calibrated"""

_LONGEST = 65536
"""pixels along a side: a damaged header says millions, which take minutes and gigabytes to unpack
"""

_PAGE_BYTES = 32
"""of the smallest description of a page: a count, two tags, and where the next one is"""


@dataclass(frozen=True, slots=True, eq=False)
class TiffImages:
    """Images of a file."""

    values: NDArray
    """(v, rows, columns)"""
    notes: tuple[str, ...] = ()


def read(path: Path) -> TiffImages:
    """Reads all pages. TIFF's resolution is for printers and not used.

    Values are calibrated as ImageJ says. What tifffile cannot decompress (LZW) is read by ITK.

    Raises:
        LegsimError: no TIFF, one that is broken, pages of several sizes, colors, or images along
            several axes.
    """
    try:
        with _without_a_word(), tifffile.TiffFile(path) as file:
            pages = _pages(file, path.stat().st_size)
            _check(path, file, pages)
            calibrated = _calibration(path, file.imagej_metadata or {})
            values = _values(path, file, single=len(pages) == 1)
            notes = _unused(file)
    except LegsimError:
        raise
    except Exception as error:  # tifffile raises many kinds of errors on broken files
        raise file_error(
            path, f"cannot be read as TIFF ({_line(error)})", "export it again, uncompressed"
        ) from error
    values = values[None] if values.ndim == 2 else values
    if values.ndim != 3:
        raise _colors(path, values.shape)
    if values.dtype.kind not in "fiu":
        raise file_error(path, f"holds {values.dtype} numbers", "export real numbers")
    if calibrated == (0.0, 1.0):
        return TiffImages(values, notes)
    zero, slope = calibrated
    note = f"values calibrated as ImageJ says: times {slope:g} plus {zero:g}"
    return TiffImages(values * slope + zero, (note, *notes))


def _values(path: Path, file: "tifffile.TiffFile", *, single: bool) -> NDArray:
    try:
        # more images than pages: ImageJ's stacks beyond 4 GB have one page
        return np.asarray(file.asarray() if single else file.asarray(key=slice(None)))
    except ValueError as error:
        if "imagecodecs" not in str(error):
            raise
        values = image_files.read_stored(path)[0]
        # ITK turns rows that are stored from below
        return values[..., ::-1, :] if _orientation(file) == _FROM_BELOW else values


def _orientation(file: "tifffile.TiffFile") -> int:
    tag = file.pages.first.tags.get("Orientation")
    return _FROM_ABOVE if tag is None else int(tag.value)


def _unused(file: "tifffile.TiffFile") -> tuple[str, ...]:
    """A note on an orientation that is stated, since rows and columns are taken as stored."""
    stated = _orientation(file)
    if stated == _FROM_ABOVE:
        return ()
    return (f"the orientation {stated} that the file states is not used: rows are as stored",)


def _check(path: Path, file: "tifffile.TiffFile", pages: list[tuple[Any, Any]]) -> None:
    """Refuses what is not one gray image per view."""
    others = [k for k, page in enumerate(pages) if page != pages[0]]
    if others:
        raise file_error(
            path,
            f"page {others[0]} has {pages[others[0]]}, page 0 {pages[0]}",
            "export the views alone, without previews",
        )
    first = file.pages.first
    if max(first.shape) > _LONGEST:
        raise file_error(
            path,
            f"says that its images have {' x '.join(map(str, first.shape))} pixels, more along one "
            f"side than any detector ({_LONGEST}): it is damaged",
            "export it again",
        )
    if (first.samplesperpixel > 1 and first.planarconfig == 1) or first.photometric == _PALETTE:
        raise _colors(path, first.shape)
    if file.is_imagej or file.is_ome:
        series = file.series[0]
        sizes = dict(zip(series.axes, series.shape, strict=True))
        long = {axis: sizes[axis] for axis in "TZC" if sizes.get(axis, 1) > 1}
        if len(long) > 1:
            raise file_error(
                path,
                "holds images along several axes: "
                + ", ".join(f"{size} {_AXES[axis]}" for axis, size in long.items()),
                "export the views alone, as a stack with one axis",
            )


def _colors(path: Path, shape: tuple[int, ...]) -> LegsimError:
    return file_error(
        path,
        f"holds colors, or images of shape {shape}",
        "expected views of rows and columns; export gray images, not colors",
    )


def _calibration(path: Path, stated: dict[str, Any]) -> tuple[float, float]:
    """(zero, slope) that ImageJ states; signed numbers are stored so.

    Raises:
        LegsimError: another function than a line.
    """
    function = stated.get("cf", _UNCALIBRATED[0])
    if function in _UNCALIBRATED:
        return 0.0, 1.0
    if function != 0:
        problem = f"is calibrated by ImageJ's function {function}, no line"
        raise file_error(path, problem, "export it without calibration")
    zero, slope = float(stated.get("c0", 0)), float(stated.get("c1", 1))
    if not within(np.array([zero, slope])) or slope == 0:
        raise ValueError(f"calibrated by {zero:g} and {slope:g}")
    return zero, slope


def _pages(file: "tifffile.TiffFile", size: int) -> list[tuple[Any, Any]]:
    """(shape, type) of each page of a file of ``size`` bytes.

    Raises:
        ValueError: there is none, or their list runs in circles.
    """
    found = []
    for page in file.pages:
        found.append((page.shape, page.dtype))
        if len(found) * _PAGE_BYTES > size:
            raise ValueError("its list of pages runs in circles")
    if not found:
        raise ValueError("no page")
    return found


@contextmanager
def _without_a_word() -> Iterator[None]:
    """Drops what tifffile logs about broken tags: what it cannot read, it raises as well."""
    logger = logging.getLogger("tifffile")
    before, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = before


def _line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
