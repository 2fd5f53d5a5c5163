"""Images of a scan as other programs write them, and the line integrals in them.

One file with all views (TIFF, multi-frame DICOM, .npy, raw, or what ITK reads), a folder with one
file per view, or a pattern (`scan/view_*.tif`). Files of a folder are taken by the number that
differs between their names. Rows are as the file has them: the geometry's matrices say where they
are.
"""

import math
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.core.files import is_file
from legsim.core.values import FloatArray
from legsim.geometry import _meta_header, dicom, image_files, tiff, view_files
from legsim.geometry import counts as geometry_counts
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.counts import Counts

_ELSEWHERE = {
    **dict.fromkeys(
        (".his", ".hnd", ".hnc", ".xim", ".seq", ".edf"),
        "convert it by RTK's `rtkprojections -o projections.mha`, which reads it, or export TIFF",
    ),
    **dict.fromkeys(
        (".xtekct", ".ang", ".vff", ".vgi", ".rek", ".txrm", ".rcd", ".pca"),
        "export the views as TIFF or raw, and give a geometry file",
    ),
    **dict.fromkeys((".h5", ".hdf5", ".nxs", ".npz"), "save the views as .npy or TIFF"),
}
"""Formats of vendors that are not read, and what to do"""

_DICOM = (".dcm", ".ima", ".dicom")


@dataclass(frozen=True, slots=True, eq=False)
class ProjectionImages:
    """Images of a scan as a file holds them."""

    values: NDArray
    """(v, rows, columns), of the file's own kind of numbers"""
    pixel_mm: tuple[float, float] | None = None
    """(between columns, between rows) on the detector, where the file says it"""
    origin_mm: tuple[float, float] | None = None
    """(u, v) of the first pixel's center, where the file says it"""
    angles_deg: FloatArray | None = None
    """(v,) of the source about the patient, where the file says them"""
    no_counts: str = ""
    """what the file says against its values being counts; empty: nothing"""
    notes: tuple[str, ...] = ()
    detector_mm: float | None = None
    """from the source to the detector, where the file says it"""


@dataclass(frozen=True, slots=True)
class RawLayout:
    """How numbers lie in a file without a header."""

    dtype: str
    """numpy's name, byte order included"""
    columns: int
    rows: int
    views: int
    offset: int = 0
    """bytes before the first number"""

    @classmethod
    def parsed(cls, text: str) -> "RawLayout":
        """Of "U16:620x480x248" or "U16:620x480x248:512"; U, I or F, then bits, then BE or LE.

        Raises:
            LegsimError: it is none.
        """
        match = re.fullmatch(
            r"([uif])(8|16|32|64)(be|le)?:(\d+)x(\d+)x(\d+)(?::(\d+))?", text.strip().lower()
        )
        sizes = [int(number or 0) for number in match.groups()[3:]] if match else [0]
        if match is None or min(sizes[:3]) < 1 or match[1] + match[2] == "f8":
            raise LegsimError(
                f"{text!r} is no layout; give type, columns, rows and views, and the bytes to skip "
                "if any, as in U16:620x480x248:512 (U, I or F with 8 to 64 bits, BE for big-endian)"
            )
        order = ">" if match[3] == "be" else "<"
        return cls(f"{order}{match[1]}{int(match[2]) // 8}", *sizes)


def read_images(path: Path | str, *, raw: RawLayout | None = None) -> ProjectionImages:
    """Reads the images of a file, a folder of files or a pattern, as they are.

    Raises:
        LegsimError: nothing there, a format that is not read, files of several scans or sizes, or
            a file that is broken; the line says what to do.
    """
    path = Path(path)
    several = os.path.isdir(path) or view_files.is_pattern(path)
    images = _read_series(path, raw) if several else _read_file(path, raw)
    if not images.values.size:
        raise file_error(path, "holds no pixel", "export it again")
    return images


def members(path: Path | str) -> list[Path]:
    """The files that :func:`read_images` reads, those that a header names behind it."""
    path = Path(path)
    several = os.path.isdir(path) or view_files.is_pattern(path)
    images = sorted(view_files.members(path)[0]) if several else [path]
    return [one for image in images for one in (image, *_meta_header.data_files(image))]


def read_projections(
    path: Path | str,
    geometry: ConeBeamGeometry,
    *,
    counts: Counts | None = None,
    raw: RawLayout | None = None,
    turn_rows: bool = False,
    line_integrals: bool = False,
) -> tuple[Projections, tuple[str, ...]]:
    """(line integrals of ``geometry``, notes) of any images that :func:`read_images` reads.

    Args:
        path: as of :func:`read_images`.
        geometry: whose matrices place the pixels; the file's spacing and origin are not used.
        counts: how counts become line integrals; None: the file holds line integrals.
        raw: layout of a file without a header.
        turn_rows: takes the rows from the last to the first.
        line_integrals: the file holds line integrals, whatever its values look like.

    Raises:
        LegsimError: as :func:`read_images`; other counts of views, rows or columns than the
            geometry's; values that are not finite; or counts without a word on them.
    """
    images = read_images(path, raw=raw)
    return projections_of(
        path, images, geometry, counts, turn_rows=turn_rows, line_integrals=line_integrals
    )


def projections_of(
    path: Path | str,
    images: ProjectionImages,
    geometry: ConeBeamGeometry,
    counts: Counts | None,
    *,
    turn_rows: bool,
    line_integrals: bool,
) -> tuple[Projections, tuple[str, ...]]:
    """:func:`read_projections` of images that are read already; ``path`` is for messages."""
    values = images.values
    expected = (*geometry.shape_vu[::-1], len(geometry))
    if values.shape[::-1] != expected:
        cure = "give the geometry file that belongs to these projections"
        rows, columns = geometry.shape_vu
        if values.shape == (rows, len(geometry), columns):
            cure = "its views seem to be the second axis, as ASTRA stores them: make them the first"
        raise file_error(
            path,
            f"holds {values.shape[::-1]} columns, rows and views, but the geometry describes "
            f"{expected}",
            cure,
        )
    if counts is None and values.dtype.kind == "f":
        image_files.check_finite(path, values)
    notes = [*images.notes, *_angle_notes(images, geometry)]
    if counts is not None and line_integrals:
        raise LegsimError(f"{path}: counts or line integrals? say one of the two")
    if counts is None:
        if not line_integrals:
            geometry_counts.refuse_counts(values, str(path))
    else:
        if images.no_counts:
            notes.append(
                f"In doubt: the images say that their {images.no_counts}, so they may be no counts"
            )
        made = _integrals(path, values, counts)
        values = made.values
        notes += made.notes
    if turn_rows:
        values = values[:, ::-1]
    return Projections(geometry, values.astype(np.float32, copy=False)), tuple(notes)


def read_field(path: Path | str, raw: RawLayout | None = None) -> FloatArray:
    """(rows, columns) of a flat or dark field or a map of bad pixels: the mean of its images.

    Not finite where an image is not, which makes a bad pixel of it.
    """
    one = None if raw is None else replace(raw, views=1)
    with np.errstate(over="ignore", invalid="ignore"):
        return read_images(path, raw=one).values.mean(axis=0, dtype=float)


def read_counts(
    *,
    i0: float | None = None,
    air: str | None = None,
    flat: Path | str | None = None,
    dark: Path | str | None = None,
    bad: Path | str | None = None,
    raw: RawLayout | None = None,
) -> Counts | None:
    """How counts become line integrals, of files and texts; None where nothing is given.

    Args:
        i0: reading without an object.
        air: "X0:X1,Y0:Y1", columns and rows that see no object.
        flat: image without an object, as of :func:`read_field`.
        dark: image without a beam, likewise.
        bad: image that is not 0 at bad pixels, likewise.
        raw: layout of a view, for images without a header.

    Raises:
        LegsimError: a file that cannot be read, or a combination that says too much or too little.
    """
    if all(value is None for value in (i0, air, flat, dark, bad)):
        return None
    fields = [None if path is None else read_field(path, raw) for path in (flat, dark, bad)]
    return Counts(
        i0,
        None if air is None else geometry_counts.Region.parsed(air),
        fields[0],
        fields[1],
        None if fields[2] is None else fields[2] != 0,
    )


def _integrals(path: Path | str, values: NDArray, counts: Counts) -> geometry_counts.Integrals:
    try:
        return geometry_counts.line_integrals(values, counts)
    except LegsimError as error:
        raise LegsimError(f"{path}: {error}") from error


def _angle_notes(images: ProjectionImages, geometry: ConeBeamGeometry) -> tuple[str, ...]:
    """Compares the angles in the images with the turning of the geometry's source."""
    if images.angles_deg is None or len(geometry) < 2:
        return ()
    stated = float(np.abs(np.diff(images.angles_deg)).sum())
    arms = geometry.sources() - geometry.rotation_center()
    arms /= np.linalg.norm(arms, axis=-1, keepdims=True)
    turned = float(np.degrees(np.arccos(np.clip((arms[1:] * arms[:-1]).sum(-1), -1, 1))).sum())
    if abs(stated - turned) > 2.0 + 0.02 * turned:
        return (
            f"the images' angles turn by {stated:.1f} deg in all, the geometry by {turned:.1f} "
            "deg: do they belong together?",
        )
    return ()


def _read_file(path: Path, raw: RawLayout | None) -> ProjectionImages:
    if not is_file(path):
        raise file_error(path, "no such file", "check the name")
    files.beginning(path, 1)  # it may not be allowed to be read
    suffix = path.suffix.lower()
    if raw is not None:
        return ProjectionImages(_raw_values(path, raw))
    if suffix in _ELSEWHERE:
        raise file_error(path, f"the format {suffix} is not read", _ELSEWHERE[suffix])
    if suffix in (".raw", ".bin", ".img", ".dat"):
        raise file_error(
            path,
            "raw numbers have no header",
            "say their layout, as in --raw U16:620x480x248 (type:columns x rows x views)",
        )
    if suffix == ".npy" or suffix in tiff.SUFFIXES or suffix in _DICOM:
        files.refuse_packed(path)
    if suffix == ".npy":
        return ProjectionImages(_npy_values(path))
    if suffix in tiff.SUFFIXES:
        stack = tiff.read(path)
        return ProjectionImages(stack.values, notes=stack.notes)
    if _is_dicom(path):
        found = dicom.read_projections(path)
        return ProjectionImages(
            found.values,
            found.pixel_mm,
            None,
            found.angles_deg,
            found.no_counts,
            found.notes,
            found.detector_mm,
        )
    values, pixel_mm, origin_mm = image_files.read_stored(path)
    return ProjectionImages(values, pixel_mm, origin_mm)


def _is_dicom(path: Path) -> bool:
    return path.suffix.lower() in _DICOM or dicom.is_dicom(path)


def _read_series(place: Path, raw: RawLayout | None) -> ProjectionImages:
    """The files of a folder, one after the other; headers must agree."""
    members, notes = view_files.members(place)
    slices = [path for path in members if path.suffix or dicom.is_image(path)]
    by_dicom = raw is None and bool(slices) and all(_is_dicom(path) for path in slices)
    if by_dicom:
        left = sorted({path.name for path in members} - {path.name for path in slices})
        notes += (f"not images, left out: {', '.join(left[:5])}",) if left else ()
        members = dicom.in_order(slices)
    else:
        members, more = view_files.by_number(place, members)
        notes += more
    one = None if raw is None else replace(raw, views=1)
    parts = [_read_file(path, one) for path in members]
    # each file of DICOM has a rescaling of its own, which some leave out
    _check_alike(members, parts, own_kinds=by_dicom)
    first = parts[0]
    angles = [part.angles_deg for part in parts]
    known = [a for a in angles if a is not None]
    return ProjectionImages(
        np.concatenate([part.values for part in parts]),
        first.pixel_mm,
        first.origin_mm,
        np.unwrap(np.concatenate(known), period=360) if len(known) == len(angles) else None,
        first.no_counts,
        (*notes, *_few(dict.fromkeys(note for part in parts for note in part.notes))),
        first.detector_mm if len({part.detector_mm for part in parts}) == 1 else None,
    )


def _check_alike(members: list[Path], parts: list[ProjectionImages], *, own_kinds: bool) -> None:
    """Refuses files of several scans; those of ``own_kinds`` may hold several kinds of numbers."""
    first = parts[0]
    for path, part in zip(members, parts, strict=True):
        if part.values.shape[1:] != first.values.shape[1:] or (
            part.values.dtype != first.values.dtype and not own_kinds
        ):
            raise file_error(
                path,
                f"has {part.values.shape[:0:-1]} columns and rows of {part.values.dtype}, "
                f"{members[0].name} {first.values.shape[:0:-1]} of {first.values.dtype}",
                "give a folder or a pattern with the views of one scan alone",
            )
        if len(part.values) > len(first.values) or (
            len(part.values) < len(first.values) and path != members[-1]
        ):
            raise file_error(
                path,
                f"holds {len(part.values)} views, {members[0].name} {len(first.values)}",
                "give files with equally many views",
            )
        if part.pixel_mm != first.pixel_mm:
            raise file_error(
                path,
                f"has pixels of {part.pixel_mm} mm, {members[0].name} of {first.pixel_mm}",
                "give the views of one scan alone",
            )


def _few(notes: Iterable[str]) -> list[str]:
    """The first three notes of files, and how many more there are."""
    first = list(notes)
    return first if len(first) < 5 else [*first[:3], f"and {len(first) - 3} more notes"]


def _npy_values(path: Path) -> NDArray:
    fix = "write it with numpy.save of a (views, rows, columns) array"
    values = files.load_npy(path, fix)
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "bfiu":
        raise file_error(path, "is not an .npy file of real numbers", fix)
    values = values.astype(np.uint8) if values.dtype.kind == "b" else values
    values = values[None] if values.ndim == 2 else values
    if values.ndim != 3:
        raise file_error(path, f"holds an array of shape {values.shape}", fix)
    return values


def _raw_values(path: Path, raw: RawLayout) -> NDArray:
    shape = (raw.views, raw.rows, raw.columns)
    needed = raw.offset + math.prod(shape) * np.dtype(raw.dtype).itemsize
    size = path.stat().st_size
    if size != needed:
        files.refuse_packed(path)
        raise file_error(
            path,
            f"has {size} bytes, but {raw.columns}x{raw.rows}x{raw.views} numbers of "
            f"{np.dtype(raw.dtype).itemsize} bytes after {raw.offset} are {needed}",
            "correct the layout",
        )
    return np.fromfile(path, raw.dtype, offset=raw.offset).reshape(shape)
