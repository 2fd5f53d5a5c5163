"""How a stage reports its progress: name of the work, steps done, total steps."""

from collections.abc import Callable

OnProgress = Callable[[str, int, int], None]
"""name of the stage, how much of it is done, how much there is"""


def silent(_stage: str, _done: int, _whole: int, /) -> None:
    """Progress that nobody reads."""
