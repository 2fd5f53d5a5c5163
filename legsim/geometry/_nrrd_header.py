"""A look at an NRRD's header before ITK reads it.

NRRD's library copies a line that it cannot understand into a message of a fixed length, and writes
beyond that: the process ends. Comments, pairs of key and value and the field `content` may be long.
"""

import re
from pathlib import Path

from legsim.core.errors import file_error

_LONGEST = 800
"""bytes of a field's line; from 1000 on the message overflows, and no field needs that many"""

_MM = (b"mm", b"millimeter", b"millimeters", b"millimetre", b"millimetres", b"", b"???")
"""units that are mm, or say nothing (??? is NRRD's word for unknown)"""

_UNITS = (b"space units", b"spaceunits", b"units")
"""fields of units; NRRD's library knows them in capitals too"""


def check(path: Path) -> None:
    """Refuses an NRRD with a line that would end the process, or in another unit than mm.

    ITK does not look at units. Other files are passed over.

    Raises:
        LegsimError: a field's line is too long to be one, or lengths are not in mm.
    """
    with path.open("rb") as stream:
        if stream.read(4) != b"NRRD":
            return
        for number, line in enumerate(stream, 1):
            if not line.strip():
                return
            if len(line) > _LONGEST and not _may_be_long(line):
                raise file_error(
                    path,
                    f"its header has a line of {len(line)} bytes, which is no field",
                    "write the file again",
                    place=f"line {number}",
                )
            field, _, stated = line.partition(b": ")
            units = re.findall(rb'"([^"]*)"', stated) if field.lower() in _UNITS else []
            others = [unit.decode("latin-1") for unit in units if unit.lower() not in _MM]
            if others:
                problem, cure = f"its lengths are in {others[0]!r}", "write it in mm"
                raise file_error(path, problem, cure, place=f"line {number}")


def _may_be_long(line: bytes) -> bool:
    """Whether it is a comment, a pair of key and value, or free text."""
    key, separator, _ = line.partition(b":=")
    pair = bool(separator) and b": " not in key
    return pair or line.startswith(b"#") or line.lower().startswith(b"content: ")
