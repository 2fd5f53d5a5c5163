"""What a person sees of a command at work: on a terminal and in a log."""

import io

from rich.console import Console

from legsim import progress


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
