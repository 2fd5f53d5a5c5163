"""Progress of a command: bars on a terminal, plain lines in a log."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from legsim.core.progress import OnProgress
from legsim.study.engine import OnStep, Step

_FOUND_S = 1.0
"""a task that ends sooner found its results finished"""

_COLUMNS = (
    TextColumn("{task.description}", markup=False),
    BarColumn(),
    MofNCompleteColumn(),
    TimeElapsedColumn(),
)


@contextmanager
def of_stages(console: Console) -> Iterator[OnProgress]:
    """Shows one bar per stage, or one line per stage in a log."""
    with Progress(
        *_COLUMNS, TimeRemainingColumn(), console=console, disable=not console.is_terminal
    ) as bars:
        known: dict[str, object] = {}

        def update(stage: str, done: int, total: int) -> None:
            if stage not in known:
                known[stage] = bars.add_task(stage, total=total)
                if not console.is_terminal:
                    console.print(f"{stage} ...", markup=False, emoji=False)
            bars.update(known[stage], completed=done, total=total)  # pyright: ignore[reportArgumentType]

        yield update


class Pace:
    """How long the tasks that are left will take, by those that ended."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Starts counting."""
        self._clock, self._begun, self._worked = clock, clock(), 0

    def left(self, step: Step) -> str:
        """Text on what the other tasks will take, after one that ended; empty where nothing can be
        said.
        """
        # what is found finished, or fails, says nothing of the time that others take
        self._worked += step.seconds is not None and step.seconds >= _FOUND_S and not step.failure
        if not self._worked or step.ended == step.total:
            return ""
        passed = self._clock() - self._begun
        return f"about {_hours(passed / self._worked * (step.total - step.ended))} left"


def _hours(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))


def _ended(step: Step, left: str) -> str:
    """For a log: how many of how many, which, how long it took or why it failed, and what is
    left.
    """
    said = f"failed: {step.failure}" if step.failure else f"in {_hours(step.seconds or 0.0)}"
    return f"{step.ended}/{step.total} {step.name} {said}" + (f"; {left}" if left else "")


@contextmanager
def of_study(console: Console) -> Iterator[tuple[OnStep, OnProgress]]:
    """Shows a bar for the whole study and one for the current stage; in a log, a line when a run
    begins or ends.

    Yields what to call when a run begins or ends, and what to call as its stages go on.
    """
    columns = (*_COLUMNS, TextColumn("{task.fields[left]}", markup=False))
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        whole, part = (
            bars.add_task("runs", total=None, left=""),
            bars.add_task("", total=None, left=""),
        )
        doing, pace = "", Pace()

        def runs(step: Step) -> None:
            if step.seconds is None:
                line = f"{step.name} ..."
                bars.update(
                    whole,
                    completed=step.ended,
                    total=step.total,
                    description=f"runs {step.name}",
                )
            else:
                left = pace.left(step)
                line = _ended(step, left)
                bars.update(whole, completed=step.ended, total=step.total, left=left)
            if not console.is_terminal:
                console.print(line, markup=False, emoji=False)

        def stages(stage: str, done: int, total: int) -> None:
            nonlocal doing
            if stage != doing:
                bars.reset(part, description=f"  {stage}", total=total)
                doing = stage
            bars.update(part, completed=done, total=total)

        yield runs, stages
