"""Marker trajectories of C3D files from any of the format's three processor families.

The decoder is our own: it must neither hang nor crash on a damaged file, and it must know the
big-endian (SGI/MIPS) files too. Facts of the format: "The C3D File Format, A Technical User Guide",
c3d.org.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from legsim.core import files
from legsim.core.errors import file_error
from legsim.core.values import FloatArray
from legsim.mocap._c3d_header import BLOCK, CURE, C3dHeader, floats, integers, read_header
from legsim.mocap._c3d_scale import with_true_sign
from legsim.mocap.raw import RawMarkers
from legsim.mocap.trajectories import MarkerTrajectories

_MODEL_OUTPUTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")

_WIDEST = 1e7
"""A coordinate beyond this, in any unit of length in use, is no position in a laboratory (10 km in
mm).
"""


def load(path: Path | str, *, unit: str | None = None, up: str | None = None) -> MarkerTrajectories:
    """Reads markers as meters in world; a marker not seen (negative residual, or exactly 0, 0, 0)
    is NaN.

    Args:
        unit: "m", "cm" or "mm" where POINT:UNITS is wrong or absent.
        up: lab axis that points up; judged from the markers by default, then by POINT:Y_SCREEN, z
            being this format's habit.

    Raises:
        LegsimError: the file is not C3D, or it cannot be read without guessing.
    """
    return read(path).to_motion(unit=unit, up=up)


def read(path: Path | str) -> RawMarkers:
    """Reads markers in the file's own unit and axes, with notes about what was put right.

    Raises:
        LegsimError: as :func:`load`.
    """
    path = Path(path)
    data = files.content(path)
    header = with_true_sign(read_header(path, data), data)
    notes = list(header.notes)
    _check_points(header)
    frames = frame_count(header, len(data), notes)
    rate = frame_rate(header, notes)
    positions = _positions(header, data, frames)
    labels, kept = _labels(header, notes)
    _check_positions(header, positions[:, kept])
    times = (first_frame(header) - 1 + np.arange(frames)) / rate
    unit = next(iter(header.texts("POINT", "UNITS")), "")
    return RawMarkers(
        str(path), times, labels, positions[:, kept], unit, _screen_up(header), "z", tuple(notes)
    )


def _check_points(header: C3dHeader) -> None:
    if header.points == 0 and header.analog_words > 0:
        problem = "the file holds analog channels (forces, EMG, sensors) and no marker"
        cure = "export the trial again with its marker trajectories"
        raise file_error(header.path, problem, cure, place="header")
    segments = header.texts("ROTATION", "LABELS")
    if header.points == 0 and segments:
        problem = f"the file holds poses of {len(segments)} segments, as Theia's, and no marker"
        cure = "export the joint angles for OpenSim (.mot), or markers"
        raise file_error(header.path, problem, cure, place="header")
    if header.points == 0:
        raise file_error(header.path, "the file holds no point", CURE, place="header")


def frame_count(header: C3dHeader, size: int, notes: list[str]) -> int:
    """Frames to read: as many as the header says, which must be there.

    Raises:
        LegsimError: no frame, or the file ends before the last frame.
    """
    _check_data(header, size)
    held = (size - (header.data_block - 1) * BLOCK) // frame_bytes(header)
    said = _said_frames(header, held)
    if said < 1:
        problem = f"frames {header.first_frame} to {header.last_frame} are none"
        raise file_error(header.path, problem, CURE, place="header")
    if said > held:
        problem = f"the file ends after frame {held} of {said}"
        raise file_error(header.path, problem, "copy the file again, or " + CURE, place="header")
    if held - said > BLOCK // frame_bytes(header):
        notes.append(
            f"warning: the file is long enough for {held} frames, the header says {said}: "
            f"{said} are read; export it again if more were recorded"
        )
    parameter = header.numbers("POINT", "FRAMES")
    if parameter.size and parameter[0] % 65536 != said % 65536:
        notes.append(
            f"POINT:FRAMES says {parameter[0]:.0f} frames, the header {said}; {said} are read"
        )
    return said


def _check_data(header: C3dHeader, size: int) -> None:
    """Refuses a data section that is not in the file's ``size`` bytes, or has no scale."""
    if header.scale == 0 or not np.isfinite(header.scale):
        problem = f"the file has the scale {header.scale:g}"
        raise file_error(header.path, problem, CURE, place="header")
    if header.data_block < 2 or (header.data_block - 1) * BLOCK >= size:
        problem = (
            f"the data should start at block {header.data_block}, outside the file of "
            f"{size // BLOCK} blocks"
        )
        raise file_error(header.path, problem, CURE, place="header")


def _said_frames(header: C3dHeader, held: int) -> int:
    """Frames the file says it has, where there is room for ``held``.

    16 bits of the header hold 65535: longer trials stop or wrap there. A parameter says how long
    they are, or the room alone where it is that of the wraps.
    """
    said = header.last_frame - header.first_frame + 1
    stated = [
        int(n[0])
        for name in ("LONG_FRAMES", "FRAMES")
        if (n := header.numbers("POINT", name)).size and np.isfinite(n[0])
    ]
    start, end = _actual_field(header, "START"), _actual_field(header, "END")
    if start is not None and end is not None:
        stated.insert(0, end - start + 1)
    stops = header.last_frame >= 65535
    for count in stated:
        if count > said and (stops or (count <= held and (count - said) % 65536 == 0)):
            return count
    more, left = divmod(held - said, 65536)
    return said + 65536 * more if more > 0 and left <= BLOCK // frame_bytes(header) else said


def _actual_field(header: C3dHeader, which: str) -> int | None:
    """The trial's first ("START") or last ("END") frame of its 32-bit parameter; None without."""
    words = header.numbers("TRIAL", f"ACTUAL_{which}_FIELD")
    if words.size != 2 or not np.isfinite(words).all():
        return None
    return int(words[0] % 65536) + 65536 * int(words[1] % 65536)


def first_frame(header: C3dHeader) -> int:
    """Number of the first frame, from 1 on.

    The header's 16 bits stop or wrap at 65535; a parameter has it in full.
    """
    actual, short = _actual_field(header, "START"), header.first_frame
    if actual is not None and (short >= 65535 or (actual - short) % 65536 == 0):
        return max(actual, short, 1)
    return max(short, 1)


def frame_bytes(header: C3dHeader) -> int:
    """Bytes of the points and analog samples of one frame."""
    return (4 * header.points + header.analog_words) * (2 if header.scale > 0 else 4)


def frame_rate(header: C3dHeader, notes: list[str]) -> float:
    """Frames per second: POINT:RATE, or the header's where that is absent or no rate.

    Raises:
        LegsimError: neither is a positive number.
    """
    numbers = header.numbers("POINT", "RATE")
    said = float(numbers[0]) if numbers.size else header.rate
    rate = next((hz for hz in (said, header.rate) if np.isfinite(hz) and 1e-3 < hz < 1e6), None)
    if rate is None:
        raise file_error(header.path, f"the frame rate is {said:g} Hz", CURE, place="POINT:RATE")
    if rate != said or abs(header.rate - rate) > 1e-3 * rate:
        notes.append(
            f"POINT:RATE says {said:g} Hz, the header {header.rate:g} Hz; {rate:g} Hz is taken"
        )
    return rate


def _positions(header: C3dHeader, data: bytes, frames: int) -> FloatArray:
    """(frames, points, 3) in the file's unit; NaN where the fourth number, the residual, is
    negative.
    """
    start = (header.data_block - 1) * BLOCK
    block = data[start : start + frames * frame_bytes(header)]
    if header.scale > 0:
        table = integers(block, header.processor).reshape(frames, -1).astype(float)
        scale = header.scale
    else:
        table = floats(block, header.processor).reshape(frames, -1)
        scale = 1.0
    points = table[:, : 4 * header.points].reshape(frames, header.points, 4)
    with np.errstate(invalid="ignore"):
        return np.where(points[..., 3:] < 0, np.nan, points[..., :3] * scale)


def _labels(header: C3dHeader, notes: list[str]) -> tuple[tuple[str, ...], NDArray[np.intp]]:
    """(labels of the kept points, their indices); what a body model computed (angles, moments) is
    left out: it is no position.

    Raises:
        LegsimError: POINT:LABELS is absent.
    """
    labels = header.texts("POINT", "LABELS")[: header.points]
    if not any(labels):
        raise file_error(
            header.path,
            "no point has a label",
            "label the markers and export again",
            place="POINT:LABELS",
        )
    named = [label or f"*{k + 1}" for k, label in enumerate(labels)]
    named += [f"*{k + 1}" for k in range(len(labels), header.points)]
    computed = {text for name in _MODEL_OUTPUTS for text in header.texts("POINT", name) if text}
    kept = np.array([k for k, label in enumerate(named) if label not in computed], dtype=np.intp)
    if len(kept) < header.points:
        notes.append(
            f"{header.points - len(kept)} trajectories are results of a body model (angles, "
            "forces, ...), not markers: left out"
        )
    if kept.size == 0:
        raise file_error(
            header.path,
            "every point is a result of a body model, none a marker",
            "export the marker trajectories too",
            place="POINT:LABELS",
        )
    return tuple(named[k] for k in kept), kept


def _check_positions(header: C3dHeader, positions: FloatArray) -> None:
    """Refuses numbers that cannot be positions: the sign of damage, or of numbers in another format
    than the file says.
    """
    with np.errstate(invalid="ignore"):
        wild = np.isinf(positions) | (np.abs(positions) > _WIDEST)
    if wild.any():
        frame, point = (int(k) for k in np.argwhere(wild)[0][:2])
        problem = (
            f"coordinate {positions[wild][0]:g} cannot be a position (frame {frame + 1}, "
            f"point {point + 1})"
        )
        raise file_error(header.path, problem, CURE, place="data section")


def _screen_up(header: C3dHeader) -> str:
    """Lab axis that POINT:Y_SCREEN calls up, empty where it names none."""
    text = next(iter(header.texts("POINT", "Y_SCREEN")), "").lower().lstrip("+")
    return text if text in ("x", "y", "z", "-x", "-y", "-z") else ""
