"""VTK's XML polygons (.vtp): ascii, base64 or raw, appended or inline, zlib or not.

The format is that of "VTK XML Formats" (docs.vtk.org). Polygons and strips become triangles; lines,
single points and data on them are left out.
"""

import base64
import itertools
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from legsim.core.values import FloatArray

_APPENDED = re.compile(rb"<AppendedData[^>]*>\s*_")

_TYPES = {
    "Float32": "f4",
    "Float64": "f8",
    **{f"Int{8 * n}": f"i{n}" for n in (1, 2, 4, 8)},
    **{f"UInt{8 * n}": f"u{n}" for n in (1, 2, 4, 8)},
}


@dataclass(frozen=True, slots=True)
class _Encoding:
    """How a file's arrays are stored."""

    order: str
    """"<" or ">" as of struct"""
    header: str
    """"I" or "Q": the type of counts"""
    compressed: bool
    appended: bytes
    """what follows the mark of the appended data"""
    appended_base64: bool


def read(path: Path) -> tuple[FloatArray, np.ndarray]:
    """Vertices (p, 3) in the file's unit and triangles (t, 3).

    Raises:
        ValueError: the file is malformed, or of a kind that is not read; the text says which.
    """
    root, encoding = _parsed(path.read_bytes())
    pieces = list(root.iterfind("PolyData/Piece"))
    if root.get("type") != "PolyData" or not pieces:
        raise ValueError(f"holds {root.get('type')!r}, not PolyData")
    vertices, triangles, first = [], [], 0
    for piece in pieces:
        points = piece.find("Points/DataArray")
        if points is None:
            raise ValueError("a Piece has no Points")
        here = np.asarray(_array(points, encoding), float).reshape(-1, 3)
        vertices.append(here)
        for kind, split in (("Polys", _fans), ("Strips", _strips)):
            for corners in _cells(piece.find(kind), encoding):
                triangles.extend((first + a, first + b, first + c) for a, b, c in split(corners))
        first += len(here)
    return np.concatenate(vertices), np.array(triangles, np.int64).reshape(-1, 3)


def field(path: Path, name: str) -> str:
    """The text of a field of text; empty where there is none.

    Raises:
        ValueError: the file is malformed.
    """
    content = path.read_bytes()
    if name.encode() not in content:  # parsing takes a while
        return ""
    root, encoding = _parsed(content)
    for element in root.iterfind("PolyData/FieldData/Array"):
        if element.get("Name") == name and element.get("type") == "String":
            if (
                element.get("format", "ascii") == "ascii"
                and (plain := (element.text or "").strip()).isalpha()
            ):
                return plain
            codes = _array(element, encoding, "UInt8")
            if not ((codes >= 0) & (codes < 256)).all():
                raise ValueError("holds numbers that are no characters")
            return codes.astype(np.uint8).tobytes().decode("latin-1").strip("\0")
    return ""


def _parsed(content: bytes) -> tuple[ElementTree.Element, _Encoding]:
    """The XML, and how its arrays are stored. Raw appended data are no XML and are cut out."""
    mark = _APPENDED.search(content)
    appended = b""
    if mark is not None:
        end = content.rfind(b"</AppendedData>")
        appended = content[mark.end() : end if end > 0 else len(content)]
        content = content[: mark.end()] + b"</AppendedData></VTKFile>"
    try:
        root = ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        raise ValueError(f"is not XML: {error}") from error
    block = root.find("AppendedData")
    compressor = root.get("compressor", "")
    if compressor not in ("", "vtkZLibDataCompressor"):
        raise ValueError(f"is compressed by {compressor}; write it with zlib or uncompressed")
    return root, _Encoding(
        ">" if root.get("byte_order") == "BigEndian" else "<",
        "Q" if root.get("header_type") == "UInt64" else "I",
        bool(compressor),
        appended,
        block is not None and block.get("encoding") == "base64",
    )


def _cells(cells: ElementTree.Element | None, encoding: _Encoding) -> Iterator[np.ndarray]:
    """Corners of each polygon or strip."""
    if cells is None:
        return
    arrays = {a.get("Name"): a for a in cells.iterfind("DataArray")}
    if not {"connectivity", "offsets"} <= set(arrays):
        return
    corners = np.asarray(_array(arrays["connectivity"], encoding)).astype(np.int64)
    ends = np.asarray(_array(arrays["offsets"], encoding)).astype(np.int64)
    if len(ends) and (ends[-1] > len(corners) or (np.diff(ends, prepend=0) < 0).any()):
        raise ValueError("offsets of polygons go beyond their corners; it may be cut short")
    for begin, end in zip([0, *ends[:-1]] if len(ends) else [], ends, strict=True):
        yield corners[begin:end]


def _fans(corners: np.ndarray) -> Iterator[tuple[int, int, int]]:
    for k in range(1, len(corners) - 1):
        yield corners[0], corners[k], corners[k + 1]


def _strips(corners: np.ndarray) -> Iterator[tuple[int, int, int]]:
    """Every other triangle of a strip runs backwards."""
    for k in range(len(corners) - 2):
        a, b, c = corners[k : k + 3]
        yield (b, a, c) if k % 2 else (a, b, c)


def _array(
    element: ElementTree.Element, encoding: _Encoding, kind: str | None = None
) -> np.ndarray:
    """Numbers of the type that the element says, or of ``kind``."""
    kind, form = kind or element.get("type", ""), element.get("format", "ascii")
    if kind not in _TYPES:
        raise ValueError(f"holds numbers of type {kind!r}")
    if form == "ascii":
        return np.array((element.text or "").split(), float)
    dtype = np.dtype(encoding.order + _TYPES[kind])
    if form == "appended":
        data = encoding.appended[int(element.get("offset", "0")) :]
        return np.frombuffer(_decoded(data, encoding, encoding.appended_base64), dtype)
    text = (element.text or "").encode()
    return np.frombuffer(_decoded(b"".join(text.split()), encoding, text=True), dtype)


def _decoded(data: bytes, encoding: _Encoding, text: bool) -> bytes:
    """The bytes of one array at the begin of ``data``: its header says how many."""
    size = struct.calcsize(encoding.header)

    def counts(number: int) -> tuple[int, ...]:
        head = _bytes(data, number * size, text)
        return struct.unpack(encoding.order + number * encoding.header, head)

    if not encoding.compressed:
        (length,) = counts(1)
        packed = _encoded_length(size) if text else size
        if text and data[:packed].endswith(b"="):
            return _bytes(data[packed:], length, text)
        return _bytes(data, size + length, text)[size:]
    blocks = counts(1)[0]
    sizes = counts(3 + blocks)[3:]
    header = (3 + blocks) * size
    packed = _bytes(data[_encoded_length(header) if text else header :], sum(sizes), text)
    ends = np.cumsum([0, *sizes])
    return b"".join(zlib.decompress(packed[a:b]) for a, b in itertools.pairwise(ends))


def _encoded_length(size: int) -> int:
    return 4 * ((size + 2) // 3)


def _bytes(data: bytes, size: int, text: bool) -> bytes:
    """The first bytes of raw or base64 data."""
    found = base64.b64decode(data[: _encoded_length(size)]) if text else data
    if len(found) < size:
        raise ValueError("an array is cut short")
    return found[:size]
