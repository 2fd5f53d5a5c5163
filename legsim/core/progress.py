"""How a stage reports its progress: name of the work, steps done, total steps."""

from collections.abc import Callable

OnProgress = Callable[[str, int, int], None]
"""name of the stage, steps done, total steps"""


def silent(_stage: str, _done: int, _whole: int, /) -> None:
    """Ignores the progress."""
