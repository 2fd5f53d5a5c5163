"""TIFF stacks, and the files of a folder in the order of their view numbers."""

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from legsim.core.errors import LegsimError, file_error

if TYPE_CHECKING:
    import tifffile
else:
    tifffile = lazy_loader.load("tifffile")

SUFFIXES = (".tif", ".tiff")

_PAGE_BYTES = 32
"""of the smallest description of a page: a count, two tags, and where the next one is"""

_VIEWS = (
    *SUFFIXES,
    ".dcm",
    ".ima",
    ".dicom",
    ".npy",
    ".mha",
    ".mhd",
    ".png",
    ".raw",
    ".bin",
    ".img",
)
"""Endings of files that hold a view; others in a folder are left out"""


def read(path: Path) -> NDArray:
    """(v, rows, columns) of all pages. TIFF's resolution is for printers and not used.

    Raises:
        LegsimError: no TIFF, one that is broken, pages of several sizes, or colors.
    """
    try:
        with _without_a_word(), tifffile.TiffFile(path) as file:
            pages = _pages(file, path.stat().st_size)
            first = file.pages.first
            colors = first.samplesperpixel > 1 and first.planarconfig == 1
            others = [k for k, page in enumerate(pages) if page != pages[0]]
            if others:
                raise file_error(
                    path,
                    f"page {others[0]} has {pages[others[0]]}, page 0 {pages[0]}",
                    "export the views alone, without previews",
                )
            # more images than pages: ImageJ's stacks beyond 4 GB have one page
            values = np.asarray(
                file.asarray() if len(pages) == 1 else file.asarray(key=slice(None))
            )
    except LegsimError:
        raise
    except Exception as error:  # tifffile raises many kinds of errors on broken files
        raise file_error(
            path, f"cannot be read as TIFF ({_line(error)})", "export it again, uncompressed"
        ) from error
    values = values[None] if values.ndim == 2 else values
    if values.ndim != 3 or colors:
        raise file_error(
            path,
            f"holds images of shape {values.shape}",
            "expected views of rows and columns; export gray images, not colors",
        )
    if values.dtype.kind not in "fiu":
        raise file_error(path, f"holds {values.dtype} numbers", "export real numbers")
    return values


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


def members(place: Path) -> tuple[list[Path], tuple[str, ...]]:
    """(images in a folder or of a pattern, a note on what is left out).

    Raises:
        LegsimError: there are none.
    """
    folder, pattern = (place, "*") if place.is_dir() else (place.parent, place.name)
    files = [path for path in folder.glob(pattern) if path.is_file() and path.name[0] != "."]
    found = [path for path in files if path.suffix.lower() in _VIEWS or not path.suffix]
    if not found:
        raise file_error(place, "holds no images", f"expected files like {', '.join(_VIEWS)}")
    left = sorted({path.name for path in files} - {path.name for path in found})
    return found, (f"not images, left out: {', '.join(left[:5])}",) if left else ()


def by_number(place: Path, members: list[Path]) -> tuple[list[Path], tuple[str, ...]]:
    """(files in the order of the last number in their names, notes).

    Raises:
        LegsimError: files of several kinds or names, or one number twice.
    """
    kinds: dict[tuple[str, str], list[Path]] = {}
    for path in members:
        stem = re.sub(r"\d+(?!.*\d)", "#", path.stem)
        kinds.setdefault((stem, path.suffix.lower()), []).append(path)
    if len(kinds) > 1:
        names = ", ".join(f"{stem}{ending} ({len(p)})" for (stem, ending), p in kinds.items())
        raise file_error(
            place,
            f"holds images of several names: {names[:200]}",
            "give a pattern, as in 'folder/view_*.tif', or a folder with the views alone",
        )
    numbered = sorted((_number(path), path) for path in members)
    numbers = [number for number, _ in numbered]
    twice = [k for k, number in enumerate(numbers[1:]) if number == numbers[k]]
    if twice:
        raise file_error(
            numbered[twice[0]][1],
            f"has the same view number, {numbers[twice[0]]}, as {numbered[twice[0] + 1][1].name}",
            "leave one of them out",
        )
    steps = np.diff(numbers)
    notes = []
    if len(steps) and (steps != np.median(steps)).any():
        k = int(np.flatnonzero(steps != np.median(steps))[0])
        notes.append(
            f"view numbers jump from {numbers[k]} to {numbers[k + 1]}: views may be missing"
        )
    return [path for _, path in numbered], tuple(notes)


def _number(path: Path) -> int:
    """The last number in a file's name; -1 without any."""
    found = re.findall(r"\d+", path.stem)
    return int(found[-1]) if found else -1
