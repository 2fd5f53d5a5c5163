"""A plain writer of C3D files, for any of the format's processors, to read back in tests."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ORDER = {84: "<", 85: "<", 86: ">"}


def floats(values: NDArray, processor: int) -> bytes:
    """32-bit numbers in the processor's form."""
    if processor == 85:
        words = np.frombuffer((np.asarray(values, "<f4") * np.float32(4)).tobytes(), "<u2").reshape(
            -1, 2
        )
        return np.ascontiguousarray(words[:, ::-1]).tobytes()
    return np.asarray(values, "<f4" if processor == 84 else ">f4").tobytes()


def group(name: str, number: int, processor: int) -> bytes:
    body = struct.pack(ORDER[processor] + "h", 3) + b"\0"
    return struct.pack("bb", len(name), -number) + name.encode() + body


def parameter(
    name: str, number: int, processor: int, kind: int, shape: Sequence[int], content: bytes
) -> bytes:
    body = struct.pack("bB", kind, len(shape)) + bytes(shape) + content + b"\0"
    return (
        struct.pack("bb", len(name), number)
        + name.encode()
        + struct.pack(ORDER[processor] + "h", 2 + len(body))
        + body
    )


def texts(name: str, number: int, processor: int, values: Sequence[str]) -> bytes:
    width = max(len(v) for v in values)
    return parameter(
        name,
        number,
        processor,
        -1,
        (width, len(values)),
        "".join(v.ljust(width) for v in values).encode(),
    )


@dataclass(frozen=True)
class Channels:
    """Analog channels: numbers as stored (frames * per frame, k), and what the file says of them."""

    stored: NDArray
    labels: Sequence[str]
    units: Sequence[str]
    scales: Sequence[float]
    offsets: Sequence[int]
    gen_scale: float = 1.0
    unsigned: bool = False
    rate: float = 400.0

    @property
    def values(self) -> NDArray:
        """(n, k) in the stated units."""
        return (self.stored - self.offsets) * np.asarray(self.scales) * self.gen_scale

    def records(self, number: int, processor: int) -> bytes:
        """The group ANALOG."""
        order, count = ORDER[processor], len(self.labels)
        offsets = np.asarray(self.offsets, float).astype("u2" if self.unsigned else "i2")
        made = group("ANALOG", number, processor)
        made += parameter("USED", number, processor, 2, (), struct.pack(order + "H", count))
        made += texts("LABELS", number, processor, self.labels)
        made += texts("UNITS", number, processor, self.units)
        made += parameter(
            "SCALE", number, processor, 4, (count,), floats(np.array(self.scales), processor)
        )
        made += parameter(
            "OFFSET", number, processor, 2, (count,),
            offsets.astype(offsets.dtype.newbyteorder(order)).tobytes(),
        )  # fmt: skip
        for name, value in (("GEN_SCALE", self.gen_scale), ("RATE", self.rate)):
            stored = floats(np.array([value]), processor)
            made += parameter(name, number, processor, 4, (), stored)
        return made + texts(
            "FORMAT", number, processor, ["UNSIGNED" if self.unsigned else "SIGNED"]
        )


def c3d_bytes(
    positions: NDArray,
    labels: Sequence[str],
    *,
    processor: int = 84,
    scale: float = -1.0,
    rate: float = 100.0,
    first_frame: int = 1,
    unit: str = "mm",
    screens: tuple[str, str] | None = None,
    analog_words: int = 0,
    model_outputs: Sequence[str] = (),
    channels: Channels | None = None,
    actual: tuple[int, int] | None = None,
    rotations: Sequence[str] = (),
) -> bytes:
    """File with points (n, m, 3) in the file's unit; a positive scale stores 16-bit numbers.

    NaN is written as a leftover position with residual -1. ``actual`` are the trial's first and
    last frame in 32 bits; ``rotations`` the names of segments whose poses the file would hold.
    """
    n, m = positions.shape[:2]
    analog = np.full((n, analog_words), 7) if channels is None else channels.stored.reshape(n, -1)
    order = ORDER[processor]
    integer = {"USED": m, "FRAMES": n, "DATA_START": 0}
    records = group("POINT", 1, processor)
    records += b"".join(
        parameter(k, 1, processor, 2, (), struct.pack(order + "H", v)) for k, v in integer.items()
    )
    records += b"".join(
        parameter(k, 1, processor, 4, (), floats(np.array([v]), processor))
        for k, v in (("SCALE", scale), ("RATE", rate))
    )
    records += texts("LABELS", 1, processor, labels) if labels else b""
    records += texts("UNITS", 1, processor, [unit]) if unit else b""
    if screens:
        records += texts("X_SCREEN", 1, processor, [screens[0]]) + texts(
            "Y_SCREEN", 1, processor, [screens[1]]
        )
    if model_outputs:
        records += texts("ANGLES", 1, processor, model_outputs)
    if channels is not None:
        records += channels.records(2, processor)
    if actual is not None:
        records += group("TRIAL", 3, processor)
        for name, frame in zip(("START", "END"), actual, strict=True):
            words = struct.pack(order + "2H", frame % 65536, frame // 65536)
            records += parameter(f"ACTUAL_{name}_FIELD", 3, processor, 2, (2,), words)
    if rotations:
        records += group("ROTATION", 4, processor) + texts("LABELS", 4, processor, rotations)
    per_frame = 1 if channels is None else len(channels.stored) // n
    blocks = (4 + len(records) + 1 + 511) // 512
    section = (bytes([1, 80, blocks, processor]) + records).ljust(512 * blocks, b"\0")
    header = bytes([2, 80]) + struct.pack(
        order + "5H", m, analog.shape[1], first_frame, min(first_frame + n - 1, 65535), 10
    )
    header += (
        floats(np.array([scale]), processor)
        + struct.pack(order + "2H", 2 + blocks, per_frame)
        + floats(np.array([rate]), processor)
    )
    return header.ljust(512, b"\0") + section + _data(positions, processor, scale, analog)


def _data(positions: NDArray, processor: int, scale: float, analog: NDArray) -> bytes:
    n, m = positions.shape[:2]
    unseen = np.isnan(positions).any(-1)
    table = np.zeros((n, 4 * m + analog.shape[1]))
    points = table[:, : 4 * m].reshape(n, m, 4)
    points[..., :3] = np.where(unseen[..., None], 99.0, positions)
    points[..., 3] = np.where(unseen, -1, 0)
    table[:, 4 * m :] = analog
    if scale < 0:
        return floats(table.reshape(-1), processor)
    points[..., :3] /= scale
    whole = np.rint(table).astype(int) % 65536
    return whole.astype("<u2" if ORDER[processor] == "<" else ">u2").tobytes()
