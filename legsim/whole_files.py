"""Files that appear whole or not at all: they are written under a partial name beside their place and then renamed."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from legsim.errors import at

PREFIX = ".partial-"
"""how partial names begin; what a killed process left can be told by it"""


@contextmanager
def whole(path: Path | str) -> Iterator[Path]:
    """Yields a partial name beside ``path`` (same ending), renamed to it at the end, or removed if anything went wrong.

    Raises:
        LegsimError: the file cannot be written: no such folder, no permission, no space left.
    """
    path = Path(path)
    partial = path.with_name(f"{PREFIX}{os.getpid()}-{path.name}")
    try:
        yield partial
        os.replace(partial, path)
    except OSError as error:
        # of a write that fails halfway no name is known; what concerns other files is not ours to explain
        if error.filename not in (None, str(partial), partial):
            raise
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        cure = "free some space or choose another folder" if full else "check that its folder exists and is writable"
        raise at(path, "the disk is full" if full else f"cannot be written ({error.strerror or error})", cure) from error
    finally:
        with suppress(NotADirectoryError):  # nothing was written there
            partial.unlink(missing_ok=True)


def write_text(path: Path | str, text: str) -> None:
    """Writes a whole UTF-8 text file, its lines as they are.

    Raises:
        LegsimError: as :func:`whole`.
    """
    with whole(path) as partial:
        partial.write_text(text, "utf-8", newline="\n")


def write_bytes(path: Path | str, content: bytes) -> None:
    """Writes a whole file.

    Raises:
        LegsimError: as :func:`whole`.
    """
    with whole(path) as partial:
        partial.write_bytes(content)
