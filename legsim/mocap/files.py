"""Opens markers (TRC, C3D, CSV) or joint coordinates (MOT, STO, CSV) by what is in the file, and
writes them by its name.
"""

import re
from pathlib import Path

from legsim.core.errors import file_error
from legsim.mocap import c3d, csv, opensim, trc
from legsim.mocap.raw import RawMarkers
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

_CURE = "give a marker file (.trc, .c3d) or joint coordinates (.mot, .sto)"


def load_recording(
    path: Path | str,
    *,
    unit: str | None = None,
    up: str | None = None,
    in_degrees: bool | None = None,
) -> MarkerTrajectories | JointTrajectories:
    """Reads markers (meters in world) or joint coordinates (radians and meters), whichever the file
    holds.

    ``unit`` and ``up`` override what a marker file says, ``in_degrees`` what a coordinate file
    says.

    Raises:
        LegsimError: the file is of no known kind, or damaged.
    """
    found = kind(path)
    if found == "storage":
        return opensim.load(path, in_degrees=in_degrees)
    if found == "csv":
        return csv.load(path)
    return read_markers(path).to_motion(unit=unit, up=up)


def load_markers(
    path: Path | str, *, unit: str | None = None, up: str | None = None
) -> MarkerTrajectories:
    """Reads markers as meters in world.

    Raises:
        LegsimError: the file is no marker file, or damaged.
    """
    found = load_recording(path, unit=unit, up=up)
    if not isinstance(found, MarkerTrajectories):
        raise file_error(
            path, "holds joint coordinates, not markers", "give a marker file (.trc, .c3d)"
        )
    return found


def save_recording(
    path: Path | str, recording: MarkerTrajectories | JointTrajectories, *, in_degrees: bool = False
) -> None:
    """Writes markers (.trc, .csv) or joint coordinates (.mot, .sto, .csv), by the ending of the
    name; .mot and .sto also ``in_degrees``.

    Raises:
        LegsimError: the ending does not fit what is to be written.
    """
    ending = Path(path).suffix.lower()
    if isinstance(recording, MarkerTrajectories) and ending in (".trc", ".csv"):
        (trc.save if ending == ".trc" else csv.save_markers)(path, recording)
    elif isinstance(recording, JointTrajectories) and ending in (".mot", ".sto"):
        opensim.save(path, recording, in_degrees=in_degrees)
    elif isinstance(recording, JointTrajectories) and ending == ".csv" and not in_degrees:
        csv.save_coordinates(path, recording)
    else:
        what, endings = (
            ("markers", ".trc or .csv")
            if isinstance(recording, MarkerTrajectories)
            else ("joint coordinates", ".mot, .sto or .csv")
        )
        what, endings = ("degrees", ".mot or .sto") if in_degrees else (what, endings)
        raise file_error(
            path,
            f"{what} cannot be written as {ending or 'a file without ending'}",
            f"end the name in {endings}",
        )


def read_markers(path: Path | str) -> RawMarkers:
    """Reads the markers of a TRC or C3D file as they are in it, with notes about what the reader
    put right.

    Raises:
        LegsimError: the file is neither, or damaged.
    """
    found = kind(path)
    if found not in ("c3d", "trc"):
        raise file_error(path, "is neither TRC nor C3D", "give a marker file (.trc, .c3d)")
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
        raise file_error(path, f"cannot be read ({error.strerror})", "check the path") from error
    if len(start) > 1 and start[1] == 0x50 and 2 <= start[0] < 32:
        return "c3d"
    text = start.decode("latin-1").removeprefix("\xef\xbb\xbf").lstrip(" \t\r\n\"'").lower()
    if text.startswith("pathfiletype"):
        return "trc"
    if text.startswith("time_s,"):
        return "csv"
    if re.search(r"^\s*endheader\s*$", text, re.M):
        return "storage"
    by_ending = {
        ".trc": "trc",
        ".c3d": "c3d",
        ".mot": "storage",
        ".sto": "storage",
        ".csv": "csv",
    }.get(path.suffix.lower())
    if by_ending is None:
        raise file_error(
            path, "is no recording that can be told by its first bytes or its name", _CURE
        )
    return by_ending
