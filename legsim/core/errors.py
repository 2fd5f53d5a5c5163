"""The exception for users: one line that names the place, the problem and the fix."""

import os
from pathlib import Path


class LegsimError(Exception):
    """Bad input or an unusable machine.

    The message is one line and names the fix. The CLI prints it without a traceback. Line ends and
    other characters that cannot be printed, which come from files, become blanks.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__("".join(c if c.isprintable() else " " for c in message))


def file_error(path: Path | str, problem: str, fix: str, *, place: str = "") -> LegsimError:
    """Builds the usual error about a file: ``path (place): problem; fix``."""
    name = printable(path)
    where = f"{name} ({place})" if place else name
    return LegsimError(f"{where}: {problem}; {fix}")


def printable(name: Path | str) -> str:
    """Returns a file's name as text that can be written, drawn and encoded.

    Bytes that are not UTF-8 become the replacement character.
    """
    return os.fsencode(name).decode("utf-8", "replace")
