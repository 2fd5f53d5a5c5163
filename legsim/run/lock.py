"""One writer per folder: a lock that ends with its process.

The system's own lock is used (flock, on Windows a locked byte), which it releases when the process
ends for any reason. On a file system without locks a file that only one process can create stands
for it; where its process has ended, the next one takes it over.
"""

import errno
import os
import socket
import sys
import warnings
import weakref
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO

from legsim.core.errors import LegsimError, file_error, printable

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

LOCK = ".in-use"
"""file that is locked; it names the holder and is removed at the end"""

_CLAIM = ".in-use-here"
"""file whose existence is the lock where the file system has none"""

_NO_LOCKS = {
    getattr(errno, name) for name in ("ENOLCK", "EOPNOTSUPP", "ENOTSUP", "ENOSYS", "EINVAL")
}

_WINDOWS_BYTE = 1 << 30
"""place of the byte that is locked on Windows, beyond the text, which stays readable"""


class FolderLock:
    """The sole right to write into a folder, until :meth:`release` or the process ends."""

    def __init__(self, folder: Path) -> None:
        """Takes the lock of a folder that exists.

        A warning says where the last holder ended without releasing it.

        Raises:
            LegsimError: another writer holds it, here or in another process.
        """
        stream = _opened(folder)
        if stream is None:
            _claim(folder)
        self._finalizer = weakref.finalize(self, _release, folder, stream, os.getpid())

    def release(self) -> None:
        """Gives the folder free; a second call does nothing."""
        self._finalizer()

    def __enter__(self) -> "FolderLock":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()


def _opened(folder: Path) -> IO[str] | None:
    """The locked file, with this process's name in it; None where there are no locks."""
    path = folder / LOCK
    while True:
        stream = path.open("a+", encoding="utf-8", errors="replace")
        try:
            _lock(stream)
        except OSError as error:
            holder = _holder(stream)
            stream.close()
            if error.errno in _NO_LOCKS:
                path.unlink(missing_ok=True)
                return None
            raise _refusal(folder, holder) from None
        # the last holder may have removed the file between opening and locking
        if path.exists() and os.path.samestat(os.fstat(stream.fileno()), path.stat()):
            break
        stream.close()
    left = _holder(stream)
    if left:
        _warn_of_left(folder, left)
    stream.truncate(0)
    stream.write(_own_name())
    stream.flush()
    return stream


def _lock(stream: IO[str]) -> None:
    if sys.platform == "win32":
        stream.seek(_WINDOWS_BYTE)
        msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _claim(folder: Path) -> None:
    """Takes the folder by creating a file; takes over one of a process that has ended."""
    path = folder / _CLAIM
    for _ in range(2):
        try:
            with path.open("x", encoding="utf-8") as stream:
                stream.write(_own_name())
            return
        except FileExistsError:
            holder = path.read_text("utf-8", "replace").strip() if path.exists() else ""
            if not _has_ended(holder):
                raise _refusal(
                    folder, holder, f"; if nothing runs there any more, delete {_CLAIM}"
                ) from None
            _warn_of_left(folder, holder)
            path.unlink(missing_ok=True)
    raise _refusal(folder, "")


def _release(folder: Path, stream: IO[str] | None, owner: int) -> None:
    # a forked process inherits the value, not the lock
    if os.getpid() != owner:
        return
    with suppress(OSError):
        if sys.platform == "win32" and stream is not None:
            stream.close()
        (folder / (LOCK if stream is not None else _CLAIM)).unlink(missing_ok=True)
    if stream is not None:
        stream.close()


def _own_name() -> str:
    return f"process {os.getpid()} on {socket.gethostname()}"


def _holder(stream: IO[str]) -> str:
    with suppress(OSError):
        stream.seek(0)
        return stream.read(200).strip()
    return ""


def _has_ended(holder: str) -> bool:
    """Whether the holder was a process of this machine that is no longer there."""
    words = holder.split()
    if sys.platform == "win32" or len(words) != 4 or words[3] != socket.gethostname():
        return False
    try:
        os.kill(int(words[1]), 0)
    except (ProcessLookupError, ValueError):
        return True
    except PermissionError:
        return False
    return False


def _warn_of_left(folder: Path, holder: str) -> None:
    warnings.warn(
        f"{printable(folder)}: {holder} ended there before it was finished; its finished stages "
        "are used",
        stacklevel=4,
    )


def _refusal(folder: Path, holder: str, more: str = "") -> LegsimError:
    return file_error(
        folder,
        f"is in use by {holder or 'another process'}",
        f"wait until that has ended, or choose another folder with --out{more}",
    )
