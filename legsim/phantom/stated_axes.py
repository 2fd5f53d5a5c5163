"""Which axes a mesh says its coordinates are along, and how world's follow from them.

3D Slicer writes SPACE=LPS (left, posterior, superior; RAS: right, anterior, superior) into the
header of STL, the comments of PLY and OBJ, and a field of VTP (its vtkMRMLModelStorageNode).
"""

import codecs
import re
from pathlib import Path
from types import MappingProxyType

import numpy as np

from legsim.core.errors import file_error
from legsim.core.files import beginning
from legsim.core.values import frozen
from legsim.geometry.image_files import LPS_FROM_WORLD
from legsim.phantom import vtp

WORLD_FROM = MappingProxyType(
    {
        "world": frozen("world", np.eye(3), (3, 3)),
        "lps": frozen("lps", LPS_FROM_WORLD.T, (3, 3)),
        "ras": frozen("ras", LPS_FROM_WORLD.T @ np.diag([-1.0, -1.0, 1.0]), (3, 3)),
    }
)
"""Rotation (3, 3) to world's axes from each that a part may have"""

_STATED = re.compile(rb"\bSPACE\s*=\s*(LPS|RAS)\b", re.IGNORECASE)

_HEAD = 4096
"""bytes in which headers and comments stand"""


def read(file: Path) -> str | None:
    """ "lps" or "ras" where a mesh's file says so, else None.

    Raises:
        LegsimError: a VTP whose field says nothing that can be read.
    """
    if file.suffix.lower() == ".vtp":
        said = b"SPACE=" + _field(file)
    else:
        said = beginning(file, _HEAD)
        if said.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            said = said.replace(b"\0", b"")
    found = _STATED.search(said)
    return None if found is None else found[1].decode().lower()


def _field(file: Path) -> bytes:
    try:
        return vtp.field(file, "SPACE").encode()
    except Exception as error:  # damaged numbers raise many kinds of errors
        problem = f"its field SPACE cannot be read ({error})"
        raise file_error(file, problem, "export it again, or correct it there") from error
