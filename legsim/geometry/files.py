"""Geometry files in millimeters: legsim's JSON and those of other toolkits.

docs/formats.md describes each format. World axes are the file's own, unless told which one is up.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from legsim.core import files
from legsim.core.errors import LegsimError, file_error
from legsim.core.values import FloatArray
from legsim.geometry import (
    _legsim_json,
    astra,
    conrad_xml,
    leap,
    matrix_tables,
    projtable,
    rtk_xml,
    tigre,
)
from legsim.geometry._file_parts import BY_NUMBERS, Given, geometry_of_matrices, matrices_mm
from legsim.geometry.cone_beam import ConeBeamGeometry

FORMATS = {
    "legsim": (".json",),
    "rtk": (".xml",),
    "matrices": (".txt", ".npy"),
    "astra": (".txt", ".npy"),
    "tigre": (".json",),
    "conrad": (".xml",),
    "projtable": (".txt",),
}
"""Formats that are written, each with its endings; the first with an ending is its usual one"""

_READ = (".json", ".xml", *matrix_tables.SUFFIXES)

_OF_SCANNERS = {
    **dict.fromkeys((".xtekct", ".xtekvolume", ".ang"), "Nikon's"),
    **dict.fromkeys((".log",), "Bruker's or another scanner's"),
    **dict.fromkeys((".txrm", ".txm"), "Zeiss'"),
    **dict.fromkeys((".pca", ".pcp"), "phoenix'"),
    **dict.fromkeys((".vgi",), "Volume Graphics'"),
    **dict.fromkeys((".ini", ".rcd", ".cfg"), "a scanner's"),
}
"""whose own description of a scan a file is, by its ending"""

_OLD_FROM_NEW = {
    "x": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
    "y": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "z": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
}
"""A file's axes from world's, by which of the file's axes is up, as recordings are turned"""


@dataclass(frozen=True, slots=True)
class GeometryFile:
    """A geometry as it was read."""

    geometry: ConeBeamGeometry
    format: str
    """one of :data:`FORMATS`, or "leap", which is only read"""
    notes: tuple[str, ...] = ()
    """what a user may not expect"""

    @property
    def pixel_open(self) -> bool:
        """Whether the format leaves the pixel's size open, and with it the detector's distance."""
        return self.format in ("matrices", "projtable")


def read_geometry(
    path: Path | str,
    *,
    columns: int | None = None,
    rows: int | None = None,
    pixel_mm: float | tuple[float, float] | None = None,
    header_pixel_mm: tuple[float, float] | None = None,
    view_rate_hz: float = 31.0,
    format: str | None = None,
    up: str = "y",
) -> GeometryFile:
    """Reads a geometry of legsim or another toolkit.

    Args:
        path: .json (legsim, TIGRE), .xml (RTK, CONRAD), .txt, .csv, .ompl, .npy or .mat (matrices,
            ASTRA's vectors, projtable.txt, LEAP's parameters).
        columns: pixels in a row of the detector, for files that do not say; RTK's XML then has
            its detector centered.
        rows: rows of the detector, with ``columns``.
        pixel_mm: pixel pitch, or that between columns and that between rows, for files that do not
            say; RTK's XML is in mm on the detector and cannot be read without it.
        header_pixel_mm: what the projections' header says, used where nothing else does.
        view_rate_hz: views per second, for files without times.
        format: one of :data:`FORMATS`; None goes by the content.
        up: the file's axis ("x", "y" or "z") that becomes world's y, the vertical.

    Raises:
        LegsimError: the file is missing, of another kind or malformed, it contradicts what was
            given, or what it leaves open was not given.
    """
    path = Path(path)
    if files.is_file(path):
        files.refuse_packed(path)
    if path.suffix.lower() not in _READ:
        raise _unknown_ending(path)
    if (columns is None) != (rows is None):
        raise LegsimError("a detector needs both columns and rows; give the other one too")
    if (format is not None and format not in FORMATS) or up not in _OLD_FROM_NEW:
        raise LegsimError(
            f"unknown format {format!r} or axis {up!r} of a geometry; known are "
            f"{', '.join(FORMATS)} and {', '.join(_OLD_FROM_NEW)}"
        )
    if not 0 < view_rate_hz < np.inf:
        raise LegsimError(f"a view rate of {view_rate_hz} Hz was given; it must be positive")
    pixel = None if pixel_mm is None else _both_ways(pixel_mm)
    shape_vu = None if columns is None or rows is None else (rows, columns)
    given = Given(shape_vu, pixel, view_rate_hz, header_pixel_mm)
    try:
        found = _read(path, given, format)
    except OSError as error:
        raise file_error(
            path, f"cannot be read ({error.strerror or error})", "check the path"
        ) from error
    except UnicodeDecodeError as error:
        raise file_error(path, "is not text", "check that it is a geometry") from error
    if format is not None and found.format != format:
        raise file_error(
            path, f"is of the format {found.format}, not {format}", "leave the format out"
        )
    return _turned(found, up)


def load_geometry(
    path: Path | str,
    *,
    columns: int | None = None,
    rows: int | None = None,
    pixel_mm: float | tuple[float, float] | None = None,
    view_rate_hz: float = 31.0,
) -> ConeBeamGeometry:
    """The geometry alone of :func:`read_geometry`.

    >>> load_geometry("matrices.txt", columns=620, rows=480, pixel_mm=0.616).shape_vu
    (480, 620)
    """
    return read_geometry(
        path, columns=columns, rows=rows, pixel_mm=pixel_mm, view_rate_hz=view_rate_hz
    ).geometry


def save_geometry(
    path: Path | str, geometry: ConeBeamGeometry, *, format: str | None = None
) -> None:
    """Writes a geometry in one of :data:`FORMATS`; None takes the usual one of the ending.

    The file appears whole or not at all. Only legsim's JSON and RTK's XML keep the times.

    Raises:
        LegsimError: an unknown ending or format, a file that cannot be written, or views that the
            format cannot express; the line names view and quantity.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    usual = next((name for name, suffixes in FORMATS.items() if suffix in suffixes), None)
    if usual is None:
        raise _unknown_ending(path)
    format = usual if format is None else format
    if format not in FORMATS or suffix not in FORMATS[format]:
        raise file_error(
            path,
            f"the format {format!r} is not written with the ending {suffix!r}",
            "known are "
            + ", ".join(f"{name} ({' '.join(endings)})" for name, endings in FORMATS.items()),
        )
    if suffix == ".npy":
        with files.whole(path) as partial:
            rows = astra.vectors_of(geometry) if format == "astra" else matrices_mm(geometry)
            np.save(partial, rows)
    else:
        files.write_text(path, _text(path, geometry, format))


def _text(path: Path, geometry: ConeBeamGeometry, format: str) -> str:
    if format == "legsim":
        return _legsim_json.text_of(geometry)
    if format == "rtk":
        return rtk_xml.text_of(path, geometry)
    if format == "tigre":
        return tigre.text_of(path, geometry)
    if format == "conrad":
        return conrad_xml.text_of(geometry)
    if format == "projtable":
        return projtable.text_of(geometry)
    if format == "astra":
        return matrix_tables.text_of(
            astra.vectors_of(geometry),
            "ASTRA's cone_vec in mm: source, middle of the detector, steps along u and v",
        )
    return matrix_tables.text_of(
        matrices_mm(geometry).reshape(-1, 12),
        "one 3x4 matrix per view, row by row: world mm to (column, row) pixels",
    )


def _unknown_ending(path: Path) -> LegsimError:
    if maker := _OF_SCANNERS.get(path.suffix.lower()):
        return file_error(path, f"is {maker} own description, which is not read", BY_NUMBERS)
    return file_error(
        path, f"unknown kind of geometry {path.suffix!r}", f"name it with one of {', '.join(_READ)}"
    )


def _read(path: Path, given: Given, format: str | None) -> GeometryFile:
    suffix = path.suffix.lower()
    if suffix == ".json":
        content = _legsim_json.parsed(path)
        if tigre.is_tigre(content):
            ordered, notes = tigre.in_python_order(path, content, given)
            return GeometryFile(tigre.geometry(path, ordered, given), "tigre", notes)
        return GeometryFile(_legsim_json.geometry(path, content, given), "legsim")
    if suffix == ".xml":
        root = _xml_root(path)
        if root.tag == "java":
            return GeometryFile(conrad_xml.load(path, root, given), "conrad")
        return GeometryFile(rtk_xml.geometry(path, root, given), "rtk")
    if suffix not in (".npy", ".mat"):
        text = path.read_text("utf-8-sig")
        if projtable.is_table(text):
            matrices = projtable.matrices(path, text)
            geometry = geometry_of_matrices(path, matrices, given)
            return GeometryFile(geometry, "projtable", _unknown_pixel(given))
        if leap.is_leap(text):
            return GeometryFile(leap.geometry(path, text, given), "leap")
    return _of_rows(path, matrix_tables.load(path), given, format)


def _of_rows(path: Path, rows: FloatArray, given: Given, format: str | None) -> GeometryFile:
    """Twelve numbers per view are a matrix or ASTRA's vectors."""
    vectors = astra.looks_like_vectors(rows) if format is None else format == "astra"
    if not vectors:
        geometry = geometry_of_matrices(path, rows.reshape(-1, 3, 4), given)
        return GeometryFile(geometry, "matrices", _unknown_pixel(given))
    notes: tuple[str, ...] = ()
    if format is None:
        notes = (
            f"{path.name}: read as ASTRA's cone_vec (source, detector, u and v make sense in all "
            f"{len(rows)} views); say otherwise with the format",
        )
    scale = astra.scale(path, rows, given)
    if abs(scale - 1) > 1e-3:
        notes += (f"all lengths are times {scale:.6g}, so that pixels have the size given",)
    return GeometryFile(astra.geometry(path, rows, given), "astra", notes)


def _unknown_pixel(given: Given) -> tuple[str, ...]:
    """A note where nobody says the pixel's size, which matrices to pixels do not hold."""
    if given.pixel_mm is not None or given.header_pixel_mm is not None:
        return ()
    return (
        "the pixel size is not known and taken as 1 mm: rays are right, lengths on the detector "
        "and its distance are not",
    )


def _both_ways(pixel_mm: float | Sequence[float]) -> tuple[float, float]:
    """(between columns, between rows) of one size or both."""
    try:
        sizes = np.asarray(pixel_mm, float).ravel().tolist()
    except (TypeError, ValueError) as error:
        raise LegsimError(f"pixel_mm is {pixel_mm!r}; give numbers, in mm") from error
    if len(sizes) not in (1, 2):
        raise LegsimError(f"pixel_mm is {pixel_mm}; give one size, or (columns, rows)")
    if not all(0 < size < np.inf for size in sizes):
        raise LegsimError(f"pixel_mm is {pixel_mm}; give positive, finite sizes, in mm")
    return sizes[0], sizes[-1]


def _xml_root(path: Path) -> ElementTree.Element:
    try:
        return ElementTree.fromstring(
            path.read_bytes(),
            ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True)),
        )
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        # of an encoding that Python does not know, or of several bytes
        raise file_error(path, f"is not XML ({error})", "correct it there") from error


def _turned(found: GeometryFile, up: str) -> GeometryFile:
    """With the axis ``up`` of the file as world's y; notes where another axis seems to be up."""
    if up != "y":
        turn = np.eye(4)
        turn[:3, :3] = _OLD_FROM_NEW[up]
        return GeometryFile(found.geometry.moved(turn), found.format, found.notes)
    axis = _axis(found.geometry.sources())
    if axis is None or axis == 1:
        return found
    note = (
        f"the source turns about the file's {'xyz'[axis]}, but world's vertical is y; anatomical "
        f"directions hold if the file is read with {'xyz'[axis]} up"
    )
    return GeometryFile(found.geometry, found.format, (*found.notes, note))


def _axis(sources: FloatArray) -> int | None:
    """The coordinate axis within 20 degrees of the normal of the sources' plane, if any."""
    _, sizes, directions = np.linalg.svd(sources - sources.mean(0))
    if len(sources) < 3 or sizes[1] < 1e-3 * sizes[0]:
        return None
    axis = int(np.argmax(np.abs(directions[2])))
    return axis if abs(directions[2][axis]) > np.cos(np.radians(20.0)) else None
