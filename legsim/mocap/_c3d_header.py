"""Header and parameter section of C3D files, decoded from bytes without trust in any count or
offset they hold.

Facts of the format: "The C3D File Format, A Technical User Guide", c3d.org. Files come from three
families of processors, which differ in byte order and in floating-point numbers; every offset is
checked, so that a damaged file is refused and never loops.
"""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from legsim.core.errors import file_error

BLOCK = 512

INTEL, DEC, MIPS = 84, 85, 86

CURE = "export the trial again as C3D"

_TYPE_BYTES = {-1: 1, 1: 1, 2: 2, 4: 4}


@dataclass(frozen=True, slots=True, eq=False)
class Parameter:
    """One parameter: its numbers in file order, or its texts."""

    numbers: NDArray[np.float64]
    texts: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class C3dHeader:
    """What the first block and the parameter section say."""

    path: Path
    processor: int
    """INTEL, DEC or MIPS"""
    points: int
    analog_words: int
    """analog numbers stored after the points of each frame"""
    first_frame: int
    last_frame: int
    scale: float
    """negative: points are floating-point numbers; positive: whole numbers to multiply by it"""
    data_block: int
    """block of the first frame, counted from 1"""
    rate: float
    parameters: dict[tuple[str, str], Parameter]
    """by (group, name) in upper case"""
    notes: tuple[str, ...]

    def numbers(self, group: str, name: str) -> NDArray[np.float64]:
        """Numbers of a parameter, none where it is absent or text."""
        found = self.parameters.get((group, name))
        return found.numbers if found else np.zeros(0)

    def texts(self, group: str, name: str) -> tuple[str, ...]:
        """Texts of a parameter and of its continuations (LABELS, LABELS2, ...), without blanks at
        their ends.
        """
        result: list[str] = []
        names = [name] + [f"{name}{k}" for k in range(2, 100)]
        for key in names:
            found = self.parameters.get((group, key))
            if found is None:
                break
            result += found.texts
        return tuple(result)


def read_header(path: Path, data: bytes) -> C3dHeader:
    """Decodes header and parameters of a whole file's bytes.

    Raises:
        LegsimError: the bytes are not C3D, or the parameter section lies outside the file.
    """
    if not data:
        raise file_error(path, "the file is empty", CURE)
    if len(data) < 2 * BLOCK or data[1] != 0x50:
        raise file_error(
            path,
            "the first block is not that of a C3D file (byte 2 should be 80)",
            "check the file's type, or " + CURE,
            place="header",
        )
    section = (data[0] - 1) * BLOCK
    if data[0] < 2 or section + 4 > len(data):
        problem = (
            f"the parameter section should start at block {data[0]}, outside the file of "
            f"{len(data) // BLOCK} blocks"
        )
        raise file_error(path, problem, CURE, place="header")
    processor = data[section + 3]
    if processor not in (INTEL, DEC, MIPS):
        problem = f"processor type {processor} is not 84 (Intel), 85 (DEC) or 86 (MIPS)"
        raise file_error(path, problem, CURE, place="parameter section")
    order = ">" if processor == MIPS else "<"
    words = struct.unpack(order + "5H", data[2:12])
    data_block = struct.unpack(order + "H", data[16:18])[0]
    scale, rate = (float(floats(data[k : k + 4], processor)[0]) for k in (12, 20))
    end = (data_block - 1) * BLOCK
    parameters, notes = _parameters(data[: end if end > section else len(data)], section, processor)
    if not parameters:
        raise file_error(
            path, "the parameter section holds no parameter", CURE, place="parameter section"
        )
    return C3dHeader(
        path,
        processor,
        words[0],
        words[1],
        words[2],
        words[3],
        scale,
        data_block,
        rate,
        parameters,
        notes,
    )


def floats(data: bytes, processor: int) -> NDArray[np.float64]:
    """32-bit floating-point numbers of a processor family; DEC's have their words swapped and are
    four times as large.
    """
    # damage may look like a signaling NaN
    with np.errstate(invalid="ignore"):
        if processor == DEC:
            swapped = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1]
            return np.ascontiguousarray(swapped).view("<f4")[:, 0].astype(float) / 4
        return np.frombuffer(data, ">f4" if processor == MIPS else "<f4").astype(float)


def integers(data: bytes, processor: int) -> NDArray[np.int16]:
    """Signed 16-bit numbers of a processor family."""
    return np.frombuffer(data, ">i2" if processor == MIPS else "<i2").astype(np.int16)


def _parameters(
    data: bytes, section: int, processor: int
) -> tuple[dict[tuple[str, str], Parameter], tuple[str, ...]]:
    """All parameters by (group, name), and a note where the chain of records breaks off."""
    order = ">" if processor == MIPS else "<"
    groups: dict[int, str] = {}
    found: list[tuple[int, str, Parameter]] = []
    place = section + 4
    notes: tuple[str, ...] = ()
    while place + 4 <= len(data) and data[place] != 0:
        length, group = (int(b) for b in np.frombuffer(data[place : place + 2], np.int8))
        link = place + 2 + abs(length)
        if group == 0 or link + 2 > len(data):
            notes = (f"the parameter section breaks off at byte {place}",)
            break
        name = data[place + 2 : link].decode("latin-1").strip().upper()
        step = struct.unpack(order + "H", data[link : link + 2])[0]
        if group < 0:
            groups[-group] = name
        else:
            parameter = _parameter(data, link + 2, processor)
            if parameter is None:
                notes = (f"the parameter section breaks off at byte {place}",)
                break
            found.append((group, name, parameter))
        if step < 2:
            break
        place = link + step
    return {(groups.get(group, ""), name): parameter for group, name, parameter in found}, notes


def _parameter(data: bytes, place: int, processor: int) -> Parameter | None:
    """The value stored at ``place``, None where it would reach beyond the section or has no known
    type.
    """
    if place + 2 > len(data):
        return None
    kind = int(np.frombuffer(data[place : place + 1], np.int8)[0])
    rank = data[place + 1]
    shape = tuple(data[place + 2 : place + 2 + rank])
    start = place + 2 + rank
    size = _TYPE_BYTES.get(kind, 0) * int(np.prod(shape, dtype=np.int64))
    if kind not in _TYPE_BYTES or rank > 7 or start + size > len(data):
        return None
    content = data[start : start + size]
    if kind == -1:
        width = shape[0] if shape else 1
        # texts without letters may claim to be 255**6, in no bytes at all
        count = size // width if width else 0
        texts = [
            content[k * width : (k + 1) * width].decode("latin-1").strip(" \0")
            for k in range(count)
        ]
        return Parameter(np.zeros(0), tuple(texts))
    if kind == 1:
        return Parameter(np.frombuffer(content, np.int8).astype(float), ())
    numbers = (
        integers(content, processor).astype(float) if kind == 2 else floats(content, processor)
    )
    return Parameter(numbers, ())
