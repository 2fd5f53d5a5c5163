"""Recordings in files: opened by what is in the file, written by its name.

``FORMATS`` is the one place that knows which formats there are.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from legsim.core import other_kinds
from legsim.core.errors import LegsimError, file_error
from legsim.core.files import beginning
from legsim.mocap import c3d, csv, opensim, program_tables, trc
from legsim.mocap.coordinates import RawCoordinates
from legsim.mocap.raw import RawMarkers
from legsim.mocap.trajectories import JointTrajectories, MarkerTrajectories

RawRecording = RawMarkers | RawCoordinates | MarkerTrajectories
"""what a reader gives: the file's own units and axes, or markers that are in meters in world"""


@dataclass(frozen=True, slots=True)
class Format:
    """A kind of file that holds markers or joint coordinates."""

    name: str
    suffixes: tuple[str, ...]
    begins: Callable[[bytes], bool]
    """whether the first bytes of a file are of this format"""
    read: Callable[[Path], RawRecording]
    write_markers: Callable[[Path, MarkerTrajectories], None] | None = None
    write_coordinates: Callable[[Path, JointTrajectories], None] | None = None
    write_degrees: Callable[[Path, JointTrajectories], None] | None = None


def _begins_text(pattern: str) -> Callable[[bytes], bool]:
    def begins(start: bytes) -> bool:
        encoding = "utf-16" if start[:2] in (b"\xff\xfe", b"\xfe\xff") else "latin-1"
        text = start.decode(encoding, errors="ignore").removeprefix("\xef\xbb\xbf")
        return re.search(pattern, text.lstrip(" \t\r\n\"'"), re.I | re.M) is not None

    return begins


_begins_trc = _begins_text(r"\Apathfiletype")


def _begins_c3d(start: bytes) -> bool:
    # a blank line, or a tab, and "P" are such bytes too
    blocks = len(start) > 1 and start[1] == 0x50 and 2 <= start[0] < 32
    return blocks and not _begins_trc(start)


FORMATS = (
    Format("C3D", (".c3d",), _begins_c3d, c3d.read),
    Format("TRC", (".trc",), _begins_trc, trc.read, write_markers=trc.save),
    Format(
        "storage",
        (".mot", ".sto"),
        _begins_text(r"^\s*endheader\s*$"),
        opensim.read,
        write_coordinates=opensim.save,
        write_degrees=lambda path, motion: opensim.save(path, motion, in_degrees=True),
    ),
    Format("Motive's CSV", (), _begins_text(r"\AFormat Version,"), program_tables.read_motive),
    Format(
        "Nexus' CSV",
        (),
        _begins_text(r"\A(Trajectories|Devices|Joints|Model Outputs)\W*$"),
        program_tables.read_nexus,
    ),
    Format(
        "Qualisys' TSV",
        (".tsv",),
        _begins_text(r"\ANO_OF_FRAMES\t"),
        program_tables.read_qualisys,
    ),
    Format(
        "CSV",
        (".csv",),
        _begins_text(r"\Atime_s,"),
        csv.read,
        write_markers=csv.save_markers,
        write_coordinates=csv.save_coordinates,
    ),
)
"""in the order in which their first bytes are looked for"""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What a file holds, in SI in world, and what its reader has to say about it."""

    value: MarkerTrajectories | JointTrajectories
    notes: tuple[str, ...] = ()
    """guesses and what was put right, one line each"""


def read_recording(
    path: Path | str,
    *,
    unit: str | None = None,
    up: str | None = None,
    in_degrees: bool | None = None,
) -> Recording:
    """Reads markers (meters in world) or joint coordinates (radians and meters), whichever the file
    holds, with notes.

    Args:
        path: the file.
        unit: of lengths, "m", "cm" or "mm", where the file is wrong or silent.
        up: lab axis of the markers that points up.
        in_degrees: whether the coordinates' angles are in degrees.

    Raises:
        LegsimError: the file is of no known kind, damaged, or not what a body does; or an option is
            given that cannot apply to it.
    """
    return resolve(path, read_raw(path), unit=unit, up=up, in_degrees=in_degrees)


def resolve(
    path: Path | str,
    raw: RawRecording,
    *,
    unit: str | None = None,
    up: str | None = None,
    in_degrees: bool | None = None,
) -> Recording:
    """What :func:`read_raw` read, in SI in world: the second half of :func:`read_recording`.

    Raises:
        LegsimError: as :func:`read_recording`.
    """
    given = {"unit": unit, "up": up, "angles": in_degrees}
    if isinstance(raw, MarkerTrajectories):
        refuse_options(path, given, "a table of markers, in meters with y up")
        return Recording(raw)
    if isinstance(raw, RawCoordinates):
        if raw.place == "column names":
            refuse_options(path, given, "a table whose columns name their units")
        refuse_options(path, {"up": up}, "joint coordinates, not markers")
        return Recording(*raw.to_plausible_motion(in_degrees=in_degrees, unit=unit))
    refuse_options(path, {"angles": in_degrees}, "markers, not joint coordinates")
    motion, vertical = raw.oriented(unit=unit, up=up)
    said = f"lengths in {raw.resolved_unit(unit)}, {vertical.axis} up ({vertical.reason})"
    return Recording(motion, (said, *raw.notes))


def refuse_options(path: Path | str, options: dict[str, Any], what: str) -> None:
    """Refuses options that are given, that is not None, for a file that holds ``what``.

    Raises:
        LegsimError: names the options.
    """
    given = [name for name, value in options.items() if value is not None]
    if given:
        raise file_error(
            path,
            f"holds {what}: {' and '.join(given)} cannot apply",
            f"leave out {' and '.join(given)}",
        )


def load_recording(
    path: Path | str,
    *,
    unit: str | None = None,
    up: str | None = None,
    in_degrees: bool | None = None,
) -> MarkerTrajectories | JointTrajectories:
    """The value of :func:`read_recording`, without its notes.

    >>> load_recording("motions/subject01/squat_30.trc").marker_names[:2]
    ('SACR', 'RASI')
    """
    return read_recording(path, unit=unit, up=up, in_degrees=in_degrees).value


def load_markers(
    path: Path | str, *, unit: str | None = None, up: str | None = None
) -> MarkerTrajectories:
    """Reads markers as meters in world.

    Raises:
        LegsimError: the file is no marker file, or damaged.
    """
    return read_markers(path, unit=unit, up=up)[0]


def read_markers(
    path: Path | str,
    *,
    unit: str | None = None,
    up: str | None = None,
    raw: RawRecording | None = None,
) -> tuple[MarkerTrajectories, tuple[str, ...]]:
    """Reads markers as meters in world, with the reader's notes; ``raw`` is what :func:`read_raw`
    read already.

    Raises:
        LegsimError: as :func:`load_markers`.
    """
    found = resolve(path, read_raw(path) if raw is None else raw, unit=unit, up=up)
    if not isinstance(found.value, MarkerTrajectories):
        raise file_error(
            path, "holds joint coordinates, not markers", "give a marker file (.trc, .c3d, .csv)"
        )
    return found.value, found.notes


def labels_of(raw: RawRecording) -> tuple[str, ...]:
    """The labels of markers that :func:`read_raw` read; none of joint coordinates."""
    if isinstance(raw, RawMarkers):
        return raw.labels
    return raw.marker_names if isinstance(raw, MarkerTrajectories) else ()


def save_recording(
    path: Path | str, recording: MarkerTrajectories | JointTrajectories, *, in_degrees: bool = False
) -> None:
    """Writes markers or joint coordinates in the format that the ending of the name says.

    Raises:
        LegsimError: the ending does not fit what is to be written.

    >>> save_recording("squat.trc", load_recording("squat.c3d"))
    """
    path = Path(path)
    markers = isinstance(recording, MarkerTrajectories)
    writer = "write_degrees" if in_degrees else "write_markers" if markers else "write_coordinates"
    able = [f for f in FORMATS if getattr(f, writer) and not (markers and in_degrees)]
    for form in able:
        if path.suffix.lower() in form.suffixes:
            getattr(form, writer)(path, recording)
            return
    what = "markers" if markers else "joint coordinates"
    if markers and in_degrees:
        raise LegsimError(f"{path}: {what} are no angles, to be written in degrees; leave it out")
    raise file_error(
        path,
        f"{'degrees' if in_degrees else what} cannot be written as "
        f"{path.suffix.lower() or 'a file without ending'}",
        f"end the name in {_listed([suffix for form in able for suffix in form.suffixes], 'or')}",
    )


def read_raw(path: Path | str) -> RawRecording:
    """Reads what a file of any format holds, as it is in it.

    Raises:
        LegsimError: the file is of no known kind, or damaged.
    """
    return format_of(path).read(Path(path))


def format_of(path: Path | str) -> Format:
    """The format of a file: by the first bytes, by the name's ending where they do not tell.

    Raises:
        LegsimError: neither tells.
    """
    path = Path(path)
    start = beginning(path, 4096)
    for form in FORMATS:
        if form.begins(start):
            return form
    other_kinds.refuse(path, start)
    if _of_sensors(start):
        raise file_error(
            path,
            "holds signals of sensors, not markers or joint coordinates",
            "give it by --imu, beside a recording of the same movement",
        )
    for form in FORMATS:
        if path.suffix.lower() in form.suffixes:
            return form
    if not start:
        raise file_error(path, "the file is empty", "export it again")
    raise file_error(
        path,
        "is no recording that can be told by its first bytes or its name",
        f"give a {known_suffixes()} file",
    )


_ACC, _GYR = r"(?<![a-z])(free|lin)?acc(?![ou])", r"(?<![a-z])gyr(?!us)"
_of_sensors = _begins_text(rf"{_ACC}(?s:.*){_GYR}|{_GYR}(?s:.*){_ACC}")
"""whether the first bytes name both, and not within other words"""


def known_suffixes() -> str:
    """The endings of all formats, for messages."""
    return _listed([suffix for form in FORMATS for suffix in form.suffixes], "or")


def _listed(words: list[str], last: str) -> str:
    return f"{', '.join(words[:-1])} {last} {words[-1]}" if len(words) > 1 else words[0]
