"""The exception for users: one line that names the place, the problem and the fix."""

from pathlib import Path


class LegsimError(Exception):
    """Bad input or an unusable machine.

    The message is one line and names the fix. The CLI prints it without a traceback.
    """


def file_error(path: Path | str, problem: str, fix: str, *, place: str = "") -> LegsimError:
    """Builds the usual error about a file: ``path (place): problem; fix``."""
    where = f"{path} ({place})" if place else f"{path}"
    return LegsimError(f"{where}: {problem}; {fix}")
