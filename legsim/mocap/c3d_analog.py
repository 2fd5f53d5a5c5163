"""Analog channels of C3D files: what amplifiers and, in many laboratories, inertial sensors send.

Every frame of the points holds one or more samples of each channel. A sample is (raw - OFFSET) x
SCALE x GEN_SCALE of the group ANALOG ("The C3D File Format, A Technical User Guide", c3d.org).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from legsim.core import files
from legsim.core.errors import file_error
from legsim.core.values import FloatArray, within
from legsim.mocap import c3d
from legsim.mocap._c3d_header import BLOCK, CURE, C3dHeader, floats, integers, read_header
from legsim.mocap._c3d_scale import with_true_sign


@dataclass(frozen=True, slots=True, eq=False)
class AnalogChannels:
    """All channels of a file, in the file's units."""

    times: FloatArray
    """(n,) s, by the clock of the markers"""
    labels: tuple[str, ...]
    units: tuple[str, ...]
    """as the file states them; empty where it does not"""
    values: FloatArray
    """(n, k); NaN where a sample was stored as no number"""
    notes: tuple[str, ...]
    """oddities of the file's header"""


def load_analog(path: Path | str) -> AnalogChannels:
    """Reads the analog channels of a C3D file.

    Raises:
        LegsimError: a file that is no C3D or is damaged, or that has no channel.
    """
    path = Path(path)
    data = files.content(path)
    header = with_true_sign(read_header(path, data), data)
    channels, per_frame = _samples(header)
    notes = list(header.notes)
    frames, rate = c3d.frame_count(header, len(data), notes), c3d.frame_rate(header, notes)
    _check_rate(header, rate * per_frame)
    raw = _raw(header, data, frames).reshape(frames * per_frame, channels)
    first = (c3d.first_frame(header) - 1) / rate
    labels = _texts(header, "LABELS", channels)
    named = tuple(label or f"*{k + 1}" for k, label in enumerate(labels))
    times = first + np.arange(len(raw)) / (rate * per_frame)
    units = _texts(header, "UNITS", channels)
    return AnalogChannels(times, named, units, _scaled(header, raw), tuple(notes))


def has_points(path: Path | str) -> bool:
    """Whether a C3D file holds markers beside its channels, so that both are of one clock.

    Raises:
        LegsimError: a file that is no C3D or is damaged.
    """
    path = Path(path)
    return read_header(path, files.content(path)).points > 0


def _samples(header: C3dHeader) -> tuple[int, int]:
    """(channels, samples of each per frame)."""
    used = _one(header, "USED", 0.0)
    channels = int(used) if np.isfinite(used) else 0
    if channels < 1 or header.analog_words < 1:
        raise file_error(header.path, "holds no analog channel", "export the trial with channels")
    per_frame, rest = divmod(header.analog_words, channels)
    if rest:
        problem = (
            f"{header.analog_words} analog samples per frame are not those of {channels} channels"
        )
        raise file_error(header.path, problem, CURE, place="header")
    return channels, per_frame


def _check_rate(header: C3dHeader, rate: float) -> None:
    """Refuses a stated rate that is not that of the samples, ``rate`` in Hz."""
    stated = _one(header, "RATE", 0.0)
    if stated and not abs(stated - rate) <= 1e-3 * rate:
        problem = f"states {stated:g} Hz, and holds samples at {rate:g} Hz"
        raise file_error(header.path, problem, CURE, place="ANALOG:RATE")


def _scaled(header: C3dHeader, raw: FloatArray) -> FloatArray:
    """(n, k) in the stated units, of samples as stored."""
    channels = raw.shape[1]
    scales = _each(header, "SCALE", channels, 1.0) * _one(header, "GEN_SCALE", 1.0)
    offsets = _each(header, "OFFSET", channels, 0.0)
    if not within(np.concatenate([scales, offsets])):
        raise file_error(header.path, "a scale or offset is no number", CURE, place="ANALOG")
    if _unsigned(header):
        offsets = np.where(offsets < 0, offsets + 65536, offsets)
    values = (raw - offsets) * scales
    if not within(values[~np.isnan(values)]):
        raise file_error(header.path, "a sample is infinite", CURE, place="data section")
    return values


def _raw(header: C3dHeader, data: bytes, frames: int) -> FloatArray:
    """(frames, samples of all channels) as stored."""
    size = c3d.frame_bytes(header)
    start = (header.data_block - 1) * BLOCK
    block = data[start : start + frames * size]
    if header.scale < 0:
        return floats(block, header.processor).reshape(frames, -1)[:, 4 * header.points :]
    words = integers(block, header.processor).reshape(frames, -1)[:, 4 * header.points :]
    return (words.view(np.uint16) if _unsigned(header) else words).astype(float)


def _unsigned(header: C3dHeader) -> bool:
    """Whether samples and offsets of 16 bits have no sign."""
    return "UNSIGNED" in (text.upper() for text in header.texts("ANALOG", "FORMAT"))


def _one(header: C3dHeader, name: str, default: float) -> float:
    return float(next(iter(header.numbers("ANALOG", name)), default))


def _each(header: C3dHeader, name: str, count: int, default: float) -> FloatArray:
    """(count,) numbers of a parameter and its continuations, the default where they end."""
    parts = [header.numbers("ANALOG", name)]
    parts += [header.numbers("ANALOG", f"{name}{k}") for k in range(2, 10)]
    there = np.concatenate(parts)[:count]
    found = np.full(count, default)
    found[: len(there)] = there
    return found


def _texts(header: C3dHeader, name: str, count: int) -> tuple[str, ...]:
    found = header.texts("ANALOG", name)[:count]
    return (*found, *[""] * (count - len(found)))
