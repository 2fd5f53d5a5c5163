"""One process at a time writes into a folder: the second is told who the first one is."""

import errno
import fcntl
import os
import socket
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from legsim.errors import at

_LOCK = ".in-use"


@contextmanager
def of_folder(folder: Path) -> Iterator[None]:
    """Holds the folder, which must be there, as long as the block runs; the system lets go of it when the process ends, however it does.

    Raises:
        LegsimError: another process holds it.
    """
    with (folder / _LOCK).open("a+", encoding="utf-8") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            stream.seek(0)
            holder = stream.read().strip() or "another process"
            raise at(folder, f"is in use by {holder}", "wait until that has ended, or choose another folder with --out") from None
        except OSError as error:
            if error.errno not in (errno.ENOLCK, errno.EOPNOTSUPP):
                raise
            warnings.warn(f"{folder}: its file system has no locks; see to it that nothing else writes there", stacklevel=3)
        stream.truncate(0)
        stream.write(f"process {os.getpid()} on {socket.gethostname()}")
        stream.flush()
        yield
