"""How a stage reports its progress: name of the work, steps done, total steps."""

from collections.abc import Callable

OnProgress = Callable[[str, int, int], None]
"""name of the stage, steps done, total steps"""
