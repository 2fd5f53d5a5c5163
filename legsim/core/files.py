"""Text files from any system, whole writes, and hashes of content.

A file is written under a partial name next to its place and then renamed.
"""

import codecs
import errno
import hashlib
import json
import os
import re
import stat
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from legsim.core import other_kinds
from legsim.core.errors import LegsimError, file_error


def sha256(path: Path) -> str:
    """Returns the hex digest of a file's content."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def key_of(*parts: Any) -> str:
    """Hashes JSON-able parts: the key of a stage."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def save_npz(path: Path, **arrays: np.ndarray) -> None:
    with whole(path) as partial, partial.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def read(path: Path, kind: str) -> list[str]:
    """Reads the file's lines without their ends.

    The last line is empty where the file ends with a line end.

    Args:
        path: the file.
        kind: what the file should be, for the error messages.

    Raises:
        LegsimError: the file cannot be read, is empty, or is of another kind, as binary data are.
    """
    data = content(path)
    other_kinds.refuse(path, data)
    text = _text(data)
    if not text.strip():
        raise file_error(path, "the file is empty", "export it again")
    if b"\0" in data and not data.startswith(_UTF16):
        raise file_error(
            path,
            f"holds binary data, not the text of a {kind} file",
            "check the file's type, or export it again",
        )
    return _split(text)


def beginning(path: Path, count: int, fix: str = "check the path") -> bytes:
    """Up to ``count`` bytes at a file's begin; all of them, where it is -1.

    Raises:
        LegsimError: as :func:`content`, but for a packed file.
    """
    try:
        with path.open("rb") as stream:
            return stream.read(count)
    except OSError as error:
        raise file_error(path, f"cannot be read ({error.strerror})", fix) from error
    except ValueError as error:  # a null in the name
        raise file_error(path, f"cannot be read ({error})", fix) from error


def refuse_packed(path: Path) -> None:
    """Refuses a packed file.

    Raises:
        LegsimError: it is packed, or a spreadsheet, which is packed too, or cannot be read.
    """
    other_kinds.refuse_packed(path, beginning(path, 4096))


def content(path: Path, fix: str = "check the path") -> bytes:
    """A file's bytes.

    Raises:
        LegsimError: it cannot be read, is packed, or no file can have that name; ``fix`` says what
            to do.
    """
    data = beginning(path, -1, fix)
    other_kinds.refuse_packed(path, data)
    return data


def load_npy(path: Path, fix: str) -> Any:
    """What numpy reads from an .npy file, of plain numbers or not an array at all.

    Raises:
        LegsimError: it cannot be read, or asks for more memory than there is; ``fix`` says what to
            do.
    """
    try:
        return np.load(path, allow_pickle=False)
    except OSError as error:
        raise file_error(path, f"cannot be read ({error.strerror or error})", fix) from error
    except Exception as error:  # a broken header raises many kinds of errors
        raise file_error(path, "is not an .npy file of numbers", fix) from error


_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
"""how "Unicode text" of spreadsheets begins"""


def load_toml(path: Path, fix: str = "fix that place") -> dict[str, Any]:
    """Content of a TOML file, a byte order mark or not.

    Raises:
        LegsimError: it cannot be read, or is not TOML; ``fix`` says what to do about the latter.
    """
    find = "give the path of a TOML file"
    if not os.path.exists(path):
        raise file_error(path, "no such file", find)
    try:
        return tomllib.loads(content(path, find).decode("utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise file_error(path, f"is not TOML ({error})", fix) from error


def _text(data: bytes) -> str:
    if data.startswith(_UTF16):
        # half a character at the end is the last line's, which its reader will miss
        return data.decode("utf-16", errors="ignore")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _split(text: str) -> list[str]:
    return re.split(r"\r\n|\n|\r", text)


PREFIX = ".partial-"
"""how partial names begin, by which the leftovers of a killed process are found"""


_read: set[tuple[int, int]] = set()
"""device and number of each file that is being read and must not be written"""


@contextmanager
def reading(paths: Iterable[Path]) -> Iterator[None]:
    """Names files that nothing may be written over in this process while the block lasts.

    Of a folder, the files in it. Files are told apart by what they are, not by their names: a link
    to one is that one. What does not exist is passed over.
    """
    members = [m for path in paths for m in (path.iterdir() if path.is_dir() else (path,))]
    added = {found for member in members if (found := _identity(member))} - _read
    _read.update(added)
    try:
        yield
    finally:
        _read.difference_update(added)


def is_file(path: Path | str) -> bool:
    """Whether a file exists; False for a name that no file can have, where Path.is_file raises."""
    return os.path.isfile(path)


def refuse_input(path: Path | str) -> None:
    """Refuses to write over a file named by :func:`reading`.

    Raises:
        LegsimError: it is one.
    """
    if _read and _identity(Path(path)) in _read:
        raise file_error(
            path, "is a file that is read here, and would be lost", "give --out another name"
        )


def _identity(path: Path) -> tuple[int, int] | None:
    """Device and number of a file; None where there is none."""
    try:
        status = path.stat()
    except (OSError, ValueError):  # a name with a null is no file
        return None
    return None if stat.S_ISDIR(status.st_mode) else (status.st_dev, status.st_ino)


def full_disk(path: Path, error: OSError) -> LegsimError | None:
    """The error that no space is left for ``path``; None where something else failed."""
    if error.errno not in (errno.ENOSPC, errno.EDQUOT):
        return None
    return file_error(path, "the disk is full", "free some space or choose another folder")


@contextmanager
def whole(path: Path | str) -> Iterator[Path]:
    """Yields a partial name next to ``path`` that is renamed to it at the end.

    The partial name has the same ending. It is removed if anything fails.

    Raises:
        LegsimError: the file cannot be written: no such folder, no permission, no space left; or
            it is one that :func:`reading` names.
    """
    path = Path(path)
    refuse_input(path)
    partial = path.with_name(f"{PREFIX}{os.getpid()}-{path.name}")
    try:
        yield partial
        os.replace(partial, path)
    except OSError as error:
        # a write that fails halfway names no file; errors of other files are passed on
        if error.filename not in (None, str(partial), partial):
            raise
        raise full_disk(path, error) or file_error(
            path,
            f"cannot be written ({error.strerror or error})",
            "check that its folder exists and is writable",
        ) from error
    finally:
        with suppress(NotADirectoryError):  # nothing was written there
            partial.unlink(missing_ok=True)


def write_text(path: Path | str, text: str) -> None:
    """Writes a whole UTF-8 text file, its lines unchanged.

    Characters that cannot be encoded, from a file's name that is not UTF-8, become "?".

    Raises:
        LegsimError: as :func:`whole`.
    """
    with whole(path) as partial:
        partial.write_text(text, "utf-8", "replace", "\n")


def write_bytes(path: Path | str, content: bytes) -> None:
    """Writes a whole file.

    Raises:
        LegsimError: as :func:`whole`.
    """
    with whole(path) as partial:
        partial.write_bytes(content)
