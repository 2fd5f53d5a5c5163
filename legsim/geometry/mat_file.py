"""Arrays of numbers in MATLAB's files of versions 5 to 7.

After MathWorks, "MAT-File Format": elements of a type, a count of bytes and their data, compressed
ones by zlib. The usual reader ends the process at a damaged type, so this one checks what it reads.
"""

import math
import struct
import zlib
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

_TYPES = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
"""numpy's types of an element's type"""

_MATRIX, _COMPRESSED = 14, 15

_NUMERIC = range(6, 16)
"""classes of arrays that hold numbers: double, single, and whole numbers of 8 to 64 bits"""

_COMPLEX = 0x800

_MOST_BYTES = 1 << 30
"""of a compressed element, unpacked"""


def arrays(data: bytes) -> dict[str, NDArray | None]:
    """Variables by their names; None for those that hold no real numbers.

    Raises:
        NotImplementedError: version 7.3, which is HDF5.
        ValueError: not such a file, or a broken one.
    """
    marks = {b"IM": "<", b"MI": ">"}
    if data[126:128] not in marks:
        raise ValueError("no mark of MATLAB's version 5")
    order = marks[data[126:128]]
    (version,) = struct.unpack_from(f"{order}H", data, 124)
    if version == 0x200:
        raise NotImplementedError
    found: dict[str, NDArray | None] = {}
    for kind, content in _elements(data[128:], order):
        if kind == _COMPRESSED:
            kind, content = next(_elements(_unpacked(content), order), (0, b""))
        if kind == _MATRIX:
            name, values = _variable(content, order)
            found[name] = values
    return found


def _unpacked(content: bytes) -> bytes:
    try:
        return zlib.decompressobj().decompress(content, _MOST_BYTES)
    except zlib.error as error:
        raise ValueError(str(error)) from error


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """(type, content) one after the other."""
    place = 0
    while place + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, place)
        begin = place + 8
        if kind >> 16:  # up to four bytes stand in the element's own head
            kind, size, begin = kind & 0xFFFF, kind >> 16, place + 4
            place += 8
        else:
            place = begin + size + (0 if kind == _COMPRESSED else -size % 8)
        if begin + size > len(data):
            raise ValueError(f"an element has {size} bytes, {len(data) - begin} are there")
        yield kind, data[begin : begin + size]


def _variable(content: bytes, order: str) -> tuple[str, NDArray | None]:
    """Name and values of an array's element."""
    parts = list(_elements(content, order))
    if len(parts) < 3 or len(parts[0][1]) < 4:
        raise ValueError("an array lacks its flags, its size or its name")
    flags = struct.unpack_from(f"{order}I", parts[0][1])[0]
    name = parts[2][1].decode("utf-8", "replace")
    if flags & 0xFF not in _NUMERIC or flags & _COMPLEX or len(parts) < 4:
        return name, None
    shape = tuple(_numbers(parts[1], order).tolist())
    values = _numbers(parts[3], order)
    if min(shape, default=0) < 0 or math.prod(shape) != len(values):
        raise ValueError(f"{name} has {len(values)} numbers for the size {shape}")
    return name, values.reshape(shape, order="F")


def _numbers(part: tuple[int, bytes], order: str) -> NDArray:
    kind, content = part
    if kind not in _TYPES:
        raise ValueError(f"numbers of an unknown type {kind}")
    return np.frombuffer(content, np.dtype(order + _TYPES[kind]))
