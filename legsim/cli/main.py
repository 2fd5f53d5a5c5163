"""The `legsim` command: its subcommands, and how a mistake, an error or an interruption ends it.

A subcommand imports what it runs, so that help and mistaken options are answered at once.
"""

import errno
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated

import typer
import typer.exceptions
from rich.text import Text

from legsim import __version__
from legsim.cli import (
    console,
    correct_command,
    geometry_commands,
    phantom_commands,
    run_commands,
    sensors_command,
    stage_commands,
    study_command,
)
from legsim.cli.inputs import kept
from legsim.core.errors import LegsimError

app = typer.Typer(
    help=(
        "Simulate a weight-bearing knee CT from motion capture, correct its motion, and "
        "report how well that worked."
    ),
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

geometry_app = typer.Typer(
    help="Look at a scan geometry, or convert it between the formats of legsim, RTK, ASTRA, TIGRE, "
    "CONRAD, projtable and plain matrices.",
    no_args_is_help=True,
)
app.add_typer(geometry_app, name="geometry")

phantom_app = typer.Typer(help="Make a phantom from a segmentation.", no_args_is_help=True)
app.add_typer(phantom_app, name="phantom")

for _command in (
    *(
        run_commands.run,
        correct_command.correct,
        run_commands.replay,
        stage_commands.convert,
        stage_commands.project,
    ),
    *(stage_commands.reconstruct, stage_commands.evaluate, study_command.study),
    *(sensors_command.sensors, run_commands.view, run_commands.doctor),
):
    app.command()(kept(_command))

geometry_app.command()(kept(geometry_commands.show))
geometry_app.command()(kept(geometry_commands.convert))

phantom_app.command("from-labels")(kept(phantom_commands.from_labels))

_INTERRUPTED = 130
"""exit code of a command that Ctrl-C ended, as shells have it and typer returns it"""

_RESUMED = ("run", "correct", "replay", "study")
"""commands whose folders keep each finished part"""

_warned: set[str] = set()
"""warnings already reported, without their numbers"""


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show where an error came from.")] = False,
) -> None:
    if version:
        console.out.print(f"legsim {__version__}")
        raise typer.Exit
    if debug:
        os.environ["LEGSIM_DEBUG"] = "1"


def _warn(message: Warning | str, *_: object) -> None:
    """Reports a warning once, whatever its numbers: the same one returns with every volume."""
    words = re.sub(r"[\d.]+", "", str(message))
    if words in _warned:
        return
    _warned.add(words)
    console.err.print(Text("warning:", "yellow") + f" {message}")


def _explain(error: Exception) -> str | None:
    """The line for an error that a user can fix; None for a defect of the program."""
    if isinstance(error, LegsimError):
        return str(error)
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        return (
            f"{error.filename or 'the output folder'}: the disk is full; free some space or "
            "choose another folder, then run this again"
        )
    if isinstance(error, OSError):
        return (
            f"{error.filename or ''}: {error.strerror or error}; check the path and its permissions"
        )
    if type(error).__module__.startswith("pyopencl"):
        from legsim.opencl import failures

        return failures.explain(error, "in use")
    if isinstance(error, MemoryError):
        return "the memory is full; use a smaller preset or grid (legsim doctor reports the memory)"
    return None


class _Terminated(SystemExit):
    """What SIGTERM becomes, so that half-written files are removed on the way out."""


@contextmanager
def _termination_handled() -> Iterator[None]:
    """Lets SIGTERM, as batch systems and process managers send it, end a command like Ctrl-C."""
    # Python lets only the main thread set handlers
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def terminate(number: int, _: object) -> None:
        raise _Terminated(128 + number)

    before = signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _report_end(how: str, arguments: list[str]) -> None:
    """Prints one line on what a stopped command leaves behind."""
    command = next((a for a in arguments if not a.startswith("-")), "")
    kept = "finished stages are kept, the same command continues from there"
    restarted = "half-written files are removed, the same command starts again"
    console.err.print(f"{how}; {kept if command in _RESUMED else restarted}")


def _plain(message: str) -> str:
    """A message of the parser in one line, without the name of its library's error."""
    return message.replace("\n", " ").replace("Value error, ", "")


def main(arguments: list[str] | None = None) -> None:
    """Runs the command line; exit code 0 only on success, 130 on Ctrl-C, 143 on SIGTERM, one line
    for an error unless --debug.
    """
    console.print_any_name()
    handler: Callable[..., None] = _warn
    warnings.showwarning = handler
    arguments = sys.argv[1:] if arguments is None else arguments
    if "--debug" in arguments:  # wherever it stands on the line
        arguments = ["--debug", *(a for a in arguments if a != "--debug")]
    try:
        with _termination_handled():
            code = app(args=arguments, prog_name="legsim", standalone_mode=False) or 0
        if code == _INTERRUPTED:
            _report_end("interrupted", arguments)
        sys.exit(code)
    except _Terminated:
        _report_end("terminated", arguments)
        raise
    except typer.exceptions.TyperException as error:
        console.err.print(
            f"error: {_plain(error.format_message())} (the command's --help says more)",
            style="red",
        )
        sys.exit(error.exit_code)
    except Exception as error:
        line = _explain(error)
        if line is None or "--debug" in arguments:
            raise
        console.err.print(f"error: {line}".replace("\n", " "), style="red")
        sys.exit(1)
