"""The one exception that a user is meant to read: a single line saying where, what, and what to
do.
"""

from pathlib import Path


class LegsimError(Exception):
    """Bad input or an unusable machine. The message is one line and names the cure; the CLI prints
    it without a traceback.
    """


def file_error(path: Path | str, problem: str, cure: str, *, place: str = "") -> LegsimError:
    """Builds the usual error about a file: ``path (place): problem; cure``."""
    where = f"{path} ({place})" if place else f"{path}"
    return LegsimError(f"{where}: {problem}; {cure}")
