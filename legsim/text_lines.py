"""Lines of a text file from any system: UTF-8, UTF-16 with its mark, or Latin-1, ended by LF, CRLF or CR."""

import codecs
import re
from pathlib import Path

from legsim.errors import at


def read(path: Path, kind: str) -> list[str]:
    """The file's lines without their ends; the last is empty where the file ends with a line end.

    Args:
        path: the file.
        kind: what the file should be, for the error messages.

    Raises:
        LegsimError: the file cannot be read, is empty, or holds binary data.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise at(path, f"cannot be read ({error.strerror})", "check the path") from error
    if not data.strip():
        raise at(path, "the file is empty", "export it again")
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        # "Unicode text" of spreadsheets; half a character at the end is the last line's, which its reader will miss
        return _split(data.decode("utf-16", errors="ignore"))
    if b"\0" in data:
        raise at(path, f"holds binary data, not the text of a {kind} file", "check the file's type, or export it again")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return _split(text)


def _split(text: str) -> list[str]:
    return re.split(r"\r\n|\n|\r", text)
