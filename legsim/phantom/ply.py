"""Stanford's polygons (.ply): ascii or binary of either order, faces of any number of corners.

The format is that of Turk's "The PLY Polygon File Format" (1994). Polygons become triangles about
their first corner; colors, normals and other elements are passed over.

legsim reads the format itself: trimesh refuses binary faces of mixed sizes, and plyfile is under
the GPL.
"""

import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from legsim.core.values import FloatArray

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}

_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}

_CORNERS = ("vertex_indices", "vertex_index")


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    kind: str
    """type of a number, as numpy names it"""
    counted_by: str | None
    """type of a list's length; None: one number"""


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


def read(path: Path) -> tuple[FloatArray, np.ndarray]:
    """Vertices (p, 3) in the file's unit and triangles (t, 3).

    Raises:
        ValueError: the file is malformed, or holds strips instead of faces; the text says which.
    """
    content = path.read_bytes()
    order, elements, start = _header(content)
    if order:
        source: _Binary | _Text = _Binary(content, start, order)
    else:
        source = _Text(_numbers(content[start:]))
    vertices, triangles = np.empty((0, 3)), np.empty((0, 3), np.int64)
    for element in elements:
        columns = _columns(source, element)
        if element.name == "vertex":
            missing = [axis for axis in "xyz" if axis not in columns]
            if missing:
                raise ValueError(f"its vertices have no {', '.join(missing)}")
            vertices = np.stack([np.asarray(columns[axis], float) for axis in "xyz"], axis=-1)
        elif element.name == "face":
            corners = next((columns[name] for name in _CORNERS if name in columns), None)
            if corners is None and element.count:
                raise ValueError("its faces have no vertex_indices")
            triangles = _triangles([] if corners is None else corners)
        elif element.name == "tristrips" and element.count:
            raise ValueError("holds strips of triangles; write them as faces")
    source.check_end()
    return vertices, triangles


def _header(content: bytes) -> tuple[str, list[_Element], int]:
    """(order of bytes, "" of text; elements; where the numbers begin)."""
    end = re.search(rb"\nend_header[ \t]*\r?\n", content)
    if not content.startswith(b"ply") or end is None:
        raise ValueError("has no header of a PLY")
    order, elements = None, list[_Element]()
    for line in content[: end.start()].decode("latin-1").splitlines():
        match line.split():
            case ["format", name, *_] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count), []))
            case ["property", "list", count, kind, name] if elements:
                elements[-1].properties.append(_Property(name, _type(kind), _type(count)))
            case ["property", kind, name] if elements:
                elements[-1].properties.append(_Property(name, _type(kind), None))
            case ["element" | "property", *_]:
                raise ValueError(f"its header has the line {line.strip()!r}, which is malformed")
            case _:
                pass  # comments, and what programs add of their own
    if order is None:
        raise ValueError("its header states no known format")
    _check(elements)
    return order, elements, end.end()


def _type(name: str) -> str:
    if name not in _TYPES:
        raise ValueError(f"its header has the unknown type {name!r}; known: {', '.join(_TYPES)}")
    return _TYPES[name]


def _check(elements: list[_Element]) -> None:
    """Raises ValueError where names occur twice, or a list is where a number belongs."""
    for k, element in enumerate(elements):
        if element.name in [other.name for other in elements[:k]]:
            raise ValueError(f"its element {element.name!r} occurs twice")
        named = [p.name for p in element.properties]
        for p in element.properties:
            if named.count(p.name) > 1:
                raise ValueError(f"{p.name} of the element {element.name!r} occurs twice")
            if element.name == "vertex" and p.name in ("x", "y", "z") and p.counted_by:
                raise ValueError(f"{p.name} of its vertices is a list")
            if element.name == "face" and p.name in _CORNERS and not p.counted_by:
                raise ValueError(f"its {p.name} are no lists")


def _numbers(text: bytes) -> FloatArray:
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, sep=" ")
        except (DeprecationWarning, ValueError) as error:  # by numpy's version
            raise ValueError("holds a word that is no number") from error


class _Binary:
    """Bytes from which numbers are taken in turn."""

    def __init__(self, content: bytes, start: int, order: str) -> None:
        self._content, self._at, self._order = content, start, order

    def rows(self, count: int, kinds: list[tuple[str, int]]) -> list[np.ndarray]:
        """Columns (count, n) of rows of (kind, n) numbers; the place stays where it is."""
        size = count * sum(np.dtype(kind).itemsize * n for kind, n in kinds)
        if self._at + size > len(self._content):  # numpy refuses to name types beyond 2 GB
            return []
        dtype = np.dtype([(f"_{k}", self._order + kind, n) for k, (kind, n) in enumerate(kinds)])
        found = np.frombuffer(self._content, dtype, count, self._at)
        return [found[name].reshape(count, -1) for name in dtype.names or ()]

    def advance(self, count: int, kinds: list[tuple[str, int]]) -> None:
        """Goes beyond so many rows."""
        self._at += count * sum(np.dtype(kind).itemsize * n for kind, n in kinds)

    def check_end(self) -> None:
        """Nothing: some programs append bytes of their own."""


class _Text:
    """Numbers of a text that are taken in turn."""

    def __init__(self, numbers: FloatArray) -> None:
        self._numbers, self._at = numbers, 0

    def rows(self, count: int, kinds: list[tuple[str, int]]) -> list[np.ndarray]:
        """As :meth:`_Binary.rows`."""
        widths = [n for _, n in kinds]
        found = self._numbers[self._at : self._at + count * sum(widths)]
        if len(found) < count * sum(widths):
            return []
        return np.split(found.reshape(count, -1), np.cumsum(widths)[:-1], axis=1)

    def advance(self, count: int, kinds: list[tuple[str, int]]) -> None:
        """As :meth:`_Binary.advance`."""
        self._at += count * sum(n for _, n in kinds)

    def check_end(self) -> None:
        """Raises ValueError where numbers are left: rows then hold others than the header says."""
        if self._at != len(self._numbers):
            raise ValueError("its rows hold more numbers than its header says")


def _columns(source: _Binary | _Text, element: _Element) -> dict[str, np.ndarray | list]:
    """Each property's numbers (count,), or its lists: (count, n), or one by one where n differs."""
    columns: dict[str, list] = {p.name: [] for p in element.properties}
    left = element.count
    while left and element.properties:
        kinds = _next_row(source, element)
        alike = _alike(source, element, kinds, left)
        rows = source.rows(alike, kinds)
        source.advance(alike, kinds)
        left -= alike
        at = 0
        for p in element.properties:
            at += p.counted_by is not None
            columns[p.name].append(rows[at] if p.counted_by else rows[at][:, 0])
            at += 1
    return {
        p.name: columns[p.name]
        if p.counted_by
        else np.concatenate(columns[p.name])
        if columns[p.name]
        else np.empty(0)
        for p in element.properties
    }


def _next_row(source: _Binary | _Text, element: _Element) -> list[tuple[str, int]]:
    """(type, how many) of the numbers in the next row."""
    kinds: list[tuple[str, int]] = []
    for p in element.properties:
        if p.counted_by is not None:
            kinds.append((p.counted_by, 1))
            rows = source.rows(1, kinds)
            if not rows:
                raise ValueError("it is cut short")
            length = float(rows[-1][0, 0])
            if not (length >= 0 and length.is_integer()):  # also of nan
                raise ValueError(
                    f"a list of the element {element.name!r} has the length {length:g}"
                )
            kinds.append((p.kind, int(length)))
        else:
            kinds.append((p.kind, 1))
    if not source.rows(1, kinds):
        raise ValueError("it is cut short")
    return kinds


def _alike(
    source: _Binary | _Text, element: _Element, kinds: list[tuple[str, int]], most: int
) -> int:
    """How many rows from the next on, up to ``most``, have lists of the same lengths."""
    lengths = [k for k, p in enumerate(_flat(element)) if p]
    if not lengths:
        if not source.rows(most, kinds):
            raise ValueError("it is cut short")
        return most
    tried = 1
    while True:
        rows = source.rows(tried, kinds)
        if not rows:
            return max(tried // 2, 1)
        same = np.all([rows[k][:, 0] == kinds[k + 1][1] for k in lengths], axis=0)
        if not same.all():
            return int(np.argmin(same))
        if tried == most:
            return tried
        tried = min(2 * tried, most)


def _flat(element: _Element) -> list[bool]:
    """Whether each number or list of a row is a list's length."""
    return [
        is_length
        for p in element.properties
        for is_length in ((True, False) if p.counted_by else (False,))
    ]


def _triangles(faces: list[np.ndarray] | np.ndarray) -> np.ndarray:
    """(t, 3) of runs of polygons (count, n), about the first corner of each."""
    found = [np.empty((0, 3), np.int64)]
    for run in faces:
        numbers = np.asarray(run)
        broken = ~(np.abs(numbers) < 2**53) | (numbers != np.floor(numbers))  # also of nan
        if broken.any():
            raise ValueError(f"has the index {numbers[broken][0]:g}, which is no whole number")
        corners = numbers.astype(np.int64)
        first = np.broadcast_to(corners[:, :1], corners[:, 2:].shape)
        found.append(np.stack([first, corners[:, 1:-1], corners[:, 2:]], axis=-1).reshape(-1, 3))
    return np.concatenate(found)
