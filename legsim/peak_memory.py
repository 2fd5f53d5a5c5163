"""The most memory that this process has held since it was last asked to begin anew; on Linux, elsewhere unknown."""

import contextlib
import re
from pathlib import Path

_PROCESS = Path("/proc/self")


def begin() -> None:
    """Forgets the peak so far (proc(5): 5 in clear_refs); does nothing where the system cannot."""
    with contextlib.suppress(OSError):
        (_PROCESS / "clear_refs").write_text("5")


def mebibytes() -> float | None:
    """Peak of the resident memory in MiB since :func:`begin`, None where the system does not tell."""
    try:
        found = re.search(r"^VmHWM:\s+(\d+) kB$", (_PROCESS / "status").read_text(), re.M)
    except OSError:
        return None
    return int(found[1]) / 1024 if found else None
