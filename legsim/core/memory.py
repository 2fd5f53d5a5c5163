"""Available memory, the peak memory of this process, and sizes in words.

Both memories are known on Linux alone.
"""

import contextlib
import ctypes
import re
import sys
from pathlib import Path

_PROCESS = Path("/proc/self")

_SYSTEM = Path("/proc/meminfo")


def begin_peak() -> None:
    """Resets the peak (proc(5): 5 in clear_refs); does nothing where the system cannot."""
    with contextlib.suppress(OSError):
        (_PROCESS / "clear_refs").write_text("5")


def peak_mebibytes() -> float | None:
    """Peak of the resident memory in MiB since :func:`begin_peak`, None where unknown."""
    found = _kibibytes(_PROCESS / "status", "VmHWM")
    return None if found is None else found / 1024


def resident_mebibytes() -> float | None:
    """Resident memory in MiB now, None where unknown."""
    found = _kibibytes(_PROCESS / "status", "VmRSS")
    return None if found is None else found / 1024


def give_back() -> None:
    """Returns memory that nothing uses to the system; does nothing without glibc on Linux.

    From the first call on, all threads share one heap. By itself malloc makes a heap for each
    thread, up to eight per core, and keeps up to 64 MiB of each when its thread has ended.
    """
    if sys.platform != "linux":
        return
    libc = ctypes.CDLL(None)
    with contextlib.suppress(AttributeError):  # other C libraries have neither
        libc.mallopt(_ARENA_MAX, 1)
        libc.malloc_trim(0)


_ARENA_MAX = -8
"""glibc's M_ARENA_MAX"""


def available() -> int | None:
    """Bytes that could be used now without swapping, None where unknown."""
    found = _kibibytes(_SYSTEM, "MemAvailable")
    return None if found is None else 1024 * found


def in_words(count: float) -> str:
    """Bytes as GiB, or as MiB where they are fewer than 1 GiB."""
    return f"{count / 2**30:.1f} GiB" if count >= 2**30 else f"{count / 2**20:.1f} MiB"


def _kibibytes(path: Path, name: str) -> int | None:
    try:
        found = re.search(rf"^{name}:\s+(\d+) kB$", path.read_text(), re.M)
    except OSError:
        return None
    return int(found[1]) if found else None
