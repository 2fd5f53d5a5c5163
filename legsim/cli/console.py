"""The two consoles of the command line, and how a command prints lines and tables on them."""

import io
import sys
from collections.abc import Iterable

from rich import box
from rich.console import Console
from rich.table import Table


def _console(*, stderr: bool = False, width: int | None = None) -> Console:
    """A console that prints text as it is: paths may hold brackets and colons."""
    return Console(
        stderr=stderr,
        width=width,
        highlight=False,
        soft_wrap=width is None,
        markup=False,
        emoji=False,
    )


out = _console()
"""standard output: results"""

err = _console(stderr=True)
"""standard error: progress, warnings and errors"""


_WIDEST = 10_000
"""greatest number of characters in a line of a table"""


def print_any_name() -> None:
    """Lets standard output and error print names of files that their encoding cannot hold."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def print_lines(lines: Iterable[str]) -> None:
    """Prints each line as it is, brackets included."""
    for line in lines:
        out.print(line)


def print_table(title: str, columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Prints a table whose first column is text and whose other columns are numbers."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE)
    for k, column in enumerate(columns):
        table.add_column(column, justify="left" if k == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    # a line that the terminal wraps can still be read; a cell cut short cannot
    needed = out.measure(table, options=out.options.update(width=_WIDEST)).maximum
    _console(width=max(out.width, needed)).print(table)
