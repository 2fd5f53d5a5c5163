"""How far a command is, on the console that it is given: bars on a terminal; in a log, where bars would be noise, plain lines."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

_COLUMNS = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())

OnProgress = Callable[[str, int, int], None]
"""name of the stage, how much of it is done, how much there is"""


@contextmanager
def of_stages(console: Console) -> Iterator[OnProgress]:
    """A bar a stage, or a line a stage."""
    with Progress(*_COLUMNS, TimeRemainingColumn(), console=console, disable=not console.is_terminal) as bars:
        known: dict[str, object] = {}

        def update(stage: str, done: int, total: int) -> None:
            if stage not in known:
                known[stage] = bars.add_task(stage, total=total)
                if not console.is_terminal:
                    console.print(f"{stage} ...")
            bars.update(known[stage], completed=done, total=total)  # pyright: ignore[reportArgumentType]

        yield update


@contextmanager
def of_study(console: Console) -> Iterator[tuple[OnProgress, OnProgress]]:
    """A bar for the whole study and one for what is being done; or a line a run.

    Yields what to call when a run begins or ends, and what to call as its stages go on.
    """
    # runs take minutes: the time left is told by all that have ended, not by those of the last seconds
    shown = Progress(*_COLUMNS, TimeRemainingColumn(), console=console, disable=not console.is_terminal, speed_estimate_period=1e9)
    with shown as bars:
        whole, part = bars.add_task("runs", total=None), bars.add_task("", total=None)
        doing = ""

        def runs(name: str, done: int, total: int) -> None:
            if not console.is_terminal:
                console.print(f"{done}/{total} {name}", markup=False)
            bars.update(whole, completed=done, total=total, description=escape(f"runs {name}"))

        def stages(stage: str, done: int, total: int) -> None:
            nonlocal doing
            if stage != doing:
                bars.reset(part, description=escape(f"  {stage}"), total=total)
                doing = stage
            bars.update(part, completed=done, total=total)

        yield runs, stages
