"""What a person sees of a command at work: on a terminal and in a log."""

import io

from rich.console import Console

from legsim.cli import progress
from legsim.cli.progress import Pace
from legsim.study.engine import Step


def console(*, terminal: bool) -> tuple[Console, io.StringIO]:
    stream = io.StringIO()
    return Console(file=stream, force_terminal=terminal, highlight=False, width=120), stream


def test_in_a_log_each_stage_is_one_line():
    shown, stream = console(terminal=False)
    with progress.of_stages(shown) as update:
        for done in range(3):
            update("projecting", done, 2)
        update("comparing", 0, 1)
    assert stream.getvalue().split("\n") == ["projecting ...", "comparing ...", ""]


def test_on_a_terminal_each_stage_is_a_bar():
    shown, stream = console(terminal=True)
    with progress.of_stages(shown) as update:
        update("projecting", 1, 2)
    assert "projecting" in stream.getvalue()
    assert "1/2" in stream.getvalue()


def test_in_a_log_each_run_is_reported_as_it_begins_and_as_it_ends():
    shown, stream = console(terminal=False)
    with progress.of_study(shown) as (runs, stages):
        runs(Step("anna [1]", 0, 2, None))
        stages("projecting", 1, 2)
        runs(Step("anna [1]", 1, 2, 200.4))
        runs(Step("ben", 1, 2, None))
        runs(Step("ben", 2, 2, 3.0, "no such recording"))
    assert [line.partition("; about")[0] for line in stream.getvalue().splitlines()] == [
        "anna [1] ...",
        "1/2 anna [1] in 0:03:20",
        "ben ...",
        "2/2 ben failed: no such recording",
    ]


def test_on_a_terminal_a_study_is_two_bars():
    shown, stream = console(terminal=True)
    with progress.of_study(shown) as (runs, stages):
        runs(Step("anna [1]", 1, 3, None))
        stages("projecting", 1, 7)
    assert "runs anna [1]" in stream.getvalue()
    assert "1/3" in stream.getvalue()
    assert "1/7" in stream.getvalue()


def test_the_time_left_is_by_what_was_computed_and_not_by_what_was_found():
    now = 0.0
    pace = Pace(lambda: now)
    assert pace.left(Step("found", 1, 6, 0.01)) == ""
    now = 100.0
    assert pace.left(Step("b", 2, 6, 100.0)) == "about 0:06:40 left"
    now = 150.0  # two at once
    assert pace.left(Step("c", 3, 6, 150.0)) == "about 0:03:45 left"
    assert pace.left(Step("d", 4, 6, 90.0, "a method that raised")) == "about 0:02:30 left"
    assert pace.left(Step("e", 6, 6, 40.0)) == ""
