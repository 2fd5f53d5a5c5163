"""The two consoles of the command line, and how a command prints lines and tables on them."""

from collections.abc import Iterable

from rich import box
from rich.console import Console
from rich.table import Table

out = Console(highlight=False, soft_wrap=True)
"""standard output: results"""

err = Console(stderr=True, highlight=False, soft_wrap=True)
"""standard error: progress, warnings and errors"""


def print_lines(lines: Iterable[str]) -> None:
    """Prints each line as it is, brackets included."""
    for line in lines:
        out.print(line, markup=False)


def print_table(title: str, columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Prints a table whose first column is text and whose other columns are numbers."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE)
    for k, column in enumerate(columns):
        table.add_column(column, justify="left" if k == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    # a line that the terminal wraps can still be read; a cell cut short cannot
    Console(highlight=False, width=max(out.width, 240)).print(table)
