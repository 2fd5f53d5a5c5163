"""Files of kinds that hold no table of text and no recording, known by how they begin, and what
their owner can do with them.
"""

from pathlib import Path

from legsim.core.errors import file_error

_UNPACK = "unpack it, and give the file that is in it"
_AS_TEXT = "save its table as text or CSV"
_AS_MARKERS = (
    "export the markers as C3D or TRC, or a sensor's accelerations (with gravity) and angular "
    "velocities as text or CSV"
)

_PACKED = (
    (b"\x1f\x8b", "is packed (gzip)", _UNPACK),
    (b"BZh", "is packed (bzip2)", _UNPACK),
    (b"\xfd7zXZ", "is packed (xz)", _UNPACK),
    (b"7z\xbc\xaf\x27\x1c", "is a packed archive (7z)", _UNPACK),
    (b"Rar!\x1a", "is a packed archive (RAR)", _UNPACK),
    (b"\x28\xb5\x2f\xfd", "is packed (zstd)", _UNPACK),
    (b"PK\x03\x04", "is a packed archive (zip)", _UNPACK),
    (
        b"version https://git-lfs",
        "is a pointer of Git LFS, without the content",
        "fetch it by git lfs pull",
    ),
)

_BEGINS = (
    (b"\xd0\xcf\x11\xe0", "is a spreadsheet or document of Office", _AS_TEXT),
    (b"%PDF", "is a PDF", "give the numbers that it shows, as text or CSV"),
    (b"MATLAB 5.0", "is MATLAB's", _AS_TEXT),
    (b"\x89HDF", "is HDF5", _AS_TEXT),
    (b"Kaydara FBX", "is an animation (FBX)", _AS_MARKERS),
    (b"HIERARCHY", "is an animation of a skeleton (BVH), without markers", _AS_MARKERS),
)

_OWN = {
    ".tak": "Motive",
    ".qtm": "Qualisys Track Manager",
    ".x1d": "Nexus",
    ".x2d": "Nexus",
    ".trb": "Cortex",
    ".anb": "Cortex",
    ".cap": "Cortex",
    ".mvn": "MVN",
    ".mtb": "MT Manager",
    ".cwa": "Axivity's loggers",
    ".gt3x": "ActiGraph's loggers",
}
"""endings of files that only the program that wrote them reads, and that are no text"""

_SPREADSHEETS = (b"[Content_Types].xml", b"opendocument.spreadsheet", b"xl/")
"""what the beginning of a zip archive names where a spreadsheet is in it"""

_LOOKED_AT = 4096
"""bytes"""

_WITHOUT_MARK = 64
"""bytes that tell text of two bytes a character"""


def refuse(path: Path | str, content: bytes) -> None:
    """Refuses a file that begins (``content``) as one of another kind.

    Raises:
        LegsimError: says which kind, and what to give instead.
    """
    start = content[:_LOOKED_AT]
    program = _OWN.get(Path(path).suffix.lower())
    if program and b"\0" in start:
        raise file_error(path, f"is of the kind that {program} keeps for itself", _AS_MARKERS)
    refuse_packed(path, content)
    if b"<mvnx" in start and start.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        raise file_error(path, "is MVN's XML", _AS_MARKERS)
    if _utf16_without_mark(start):
        raise file_error(
            path, "is text in UTF-16 without the mark that says so", "save it as UTF-8"
        )
    _refuse_any(path, start, _BEGINS)


def refuse_packed(path: Path | str, content: bytes) -> None:
    """Refuses a packed file, and a spreadsheet, which is one, by how it begins (``content``).

    Raises:
        LegsimError: says how it is packed, and what to do.
    """
    start = content[:_LOOKED_AT]
    if start.startswith(b"PK\x03\x04") and any(word in start for word in _SPREADSHEETS):
        raise file_error(path, "is a spreadsheet", _AS_TEXT)
    _refuse_any(path, start, _PACKED)


def _refuse_any(path: Path | str, start: bytes, kinds: tuple[tuple[bytes, str, str], ...]) -> None:
    for begin, kind, cure in kinds:
        if start.startswith(begin):
            raise file_error(path, kind, cure)


def _utf16_without_mark(start: bytes) -> bool:
    """Whether every second byte is 0 and the others are characters of plain text."""
    few = start[: min(_WITHOUT_MARK, len(start) // 2 * 2)]
    return len(few) >= 8 and any(
        not any(few[zero::2]) and all(b in b"\t\r\n" or 32 <= b < 127 for b in few[1 - zero :: 2])
        for zero in (0, 1)
    )
