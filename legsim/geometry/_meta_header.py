"""A look at a MetaImage's header before ITK reads it, and the files that a header names.

MetaIO keeps numbers per dimension in arrays of ten, and writes beyond them where the header says
that there are more dimensions; it takes the name of the data's file as a format of C.
"""

import os
import re
from pathlib import Path

from legsim.core.errors import file_error
from legsim.core.files import is_file

_MOST = 10

_MOST_FILES = 10_000
"""slices of a numbered series"""

_HEADER_BYTES = 1 << 16

_DATA_FILE = re.compile(rb"^\s*ElementDataFile\s*[=:]?\s*([^\r\n]*)", re.M)

_PATTERN = re.compile(rb"%0?\d?d")
"""of numbered slices, as in slice%03d.raw 1 5 1"""

_NRRD_DATA = re.compile(rb"^data ?file:\s*([^\r\n]*)", re.M | re.I)

_NUMBER = re.compile(rb"^\s*NDims\s*[=:]?\s*([^\r\n]*)", re.M)


def check(path: Path) -> None:
    """Refuses a header that would end the process.

    Raises:
        LegsimError: a number of dimensions that is not a whole one from 1 to 10, or a data file's
            name that is no name.
    """
    with path.open("rb") as stream:
        start = stream.read(_HEADER_BYTES)
    named = _DATA_FILE.search(start)
    if named is not None and named[1].count(b"%") != len(_PATTERN.findall(named[1])[:1]):
        raise file_error(
            path,
            f"its header says ElementDataFile = {named[1].decode('latin-1')!r}",
            "expected LOCAL, a file, or numbered files as slice%03d.raw 1 5 1",
        )
    header = start.partition(b"ElementDataFile")[0]
    for text in _NUMBER.findall(header):
        word = text.strip().split()[0] if text.strip() else b""
        if not word.isdigit() or not 1 <= int(word) <= _MOST:
            raise file_error(
                path,
                f"its header says NDims = {text.strip().decode('latin-1')!r}",
                f"expected a whole number of dimensions from 1 to {_MOST}; write the file again",
            )


def data_files(path: Path) -> list[Path]:
    """Files with the values of a header (.mhd, .nhdr) that are there; none of other files."""
    kinds = {".mhd": _DATA_FILE, ".nhdr": _NRRD_DATA}
    kind = kinds.get(path.suffix.lower())
    if kind is None or not path.is_file():
        return []
    with path.open("rb") as stream:
        head = stream.read(_HEADER_BYTES)
    named = kind.search(head)
    if named is None:
        return []
    word = named[1].strip()
    words = head[named.end() :].splitlines() if word.upper().startswith(b"LIST") else [word]
    found = []
    for name in (os.fsdecode(one.strip()) for one in words if one.strip()):
        numbered = _PATTERN.search(os.fsencode(name))
        if numbered is None:
            found.append(path.parent / name)
        else:
            found += [path.parent / one for one in _numbered(name)]
    return [one for one in found if is_file(one)]


def _numbered(name: str) -> list[str]:
    """Names of a pattern as "s%03d.raw 1 5 1": of first, last and step, those that are there."""
    pattern, *counts = name.split()
    try:
        first, last, step = (*map(int, counts), *(1, _MOST_FILES, 1)[len(counts) :])[:3]
        return [pattern % k for k in range(first, min(last, first + _MOST_FILES) + 1, step)]
    except (TypeError, ValueError):
        return []  # the reader refuses it
