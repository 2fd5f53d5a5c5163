"""Opens a recording of any kind by what is in it: markers (TRC, C3D) or joint coordinates (MOT, STO)."""

import re
from pathlib import Path

from legsim import c3d, storage, trc
from legsim.errors import at
from legsim.raw_markers import RawMarkers
from legsim.signals import JointTrajectories, Motion

_CURE = "give a marker file (.trc, .c3d) or joint coordinates (.mot, .sto)"


def load(path: Path | str, *, unit: str | None = None, up: str | None = None, in_degrees: bool | None = None) -> Motion | JointTrajectories:
    """Reads markers (metres in world) or joint coordinates (radians and metres), whichever the file holds.

    ``unit`` and ``up`` override what a marker file says, ``in_degrees`` what a coordinate file says.

    Raises:
        LegsimError: the file is of no known kind, or damaged.
    """
    if kind(path) == "storage":
        return storage.load(path, in_degrees=in_degrees)
    return read_markers(path).to_motion(unit=unit, up=up)


def load_markers(path: Path | str, *, unit: str | None = None, up: str | None = None) -> Motion:
    """Reads markers as metres in world.

    Raises:
        LegsimError: the file is no marker file, or damaged.
    """
    return read_markers(path).to_motion(unit=unit, up=up)


def read_markers(path: Path | str) -> RawMarkers:
    """Reads markers as they are in the file, with notes about what the reader put right.

    Raises:
        LegsimError: the file is no marker file, or damaged.
    """
    found = kind(path)
    if found == "storage":
        raise at(path, "holds joint coordinates, not markers", "give a marker file (.trc, .c3d)")
    return c3d.read(path) if found == "c3d" else trc.read(path)


def kind(path: Path | str) -> str:
    """ "trc", "c3d" or "storage": by the first bytes, by the name's ending where they do not tell.

    Raises:
        LegsimError: neither tells.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            start = file.read(4096)
    except OSError as error:
        raise at(path, f"cannot be read ({error.strerror})", "check the path") from error
    if len(start) > 1 and start[1] == 0x50 and 2 <= start[0] < 32:
        return "c3d"
    text = start.decode("latin-1").removeprefix("\xef\xbb\xbf").lstrip(" \t\r\n\"'").lower()
    if text.startswith("pathfiletype"):
        return "trc"
    if re.search(r"^\s*endheader\s*$", text, re.M):
        return "storage"
    by_ending = {".trc": "trc", ".c3d": "c3d", ".mot": "storage", ".sto": "storage"}.get(path.suffix.lower())
    if by_ending is None:
        raise at(path, "is no recording that can be told by its first bytes or its name", _CURE)
    return by_ending
