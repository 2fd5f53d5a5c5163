"""The report in other forms: Markdown, and its tables as CSV and LaTeX.

Every form has the cells of the page.
"""

import csv
import io
import re
from collections.abc import Iterable, Sequence
from itertools import zip_longest

from legsim.report import page
from legsim.report.page import ReportContent, Table

_DEVIATION = " ± "


def markdown(content: ReportContent) -> str:
    """Formats the whole report as Markdown; pictures are links to their files."""
    parts = [f"# {_plain(content.title)}", _bullets(content.summary)]
    if content.warnings:
        parts += ["**To be aware of**", _bullets(content.warnings)]
    for section in content.sections:
        parts += [f"## {_plain(section.title)}", *(_plain(line) for line in section.lines)]
        for table in section.tables:
            parts += [f"**{_plain(table.caption)}**", markdown_table(table), _plain(table.note)]
        for figure in section.figures:
            parts += [
                f"![{_plain(figure.alt or figure.caption)}]({_address(figure.file)})"
                if figure.file
                else "",
                _plain(figure.caption),
            ]
    if content.files:
        parts += [
            "## Files",
            "\n".join(
                f"- [{_plain(f.name)}]({_address(f.name)}): {_plain(f.what)}" for f in content.files
            ),
        ]
    if content.provenance:
        parts += [
            "## How this was made",
            "\n".join(f"- {_plain(what)}: {_plain(value)}" for what, value in content.provenance),
        ]
    return "\n\n".join(part for part in parts if part) + "\n"


def markdown_table(table: Table) -> str:
    """Formats a table with pipes; a row that heads others is bold."""
    lines = [
        _pipes(map(_plain, table.columns)),
        _pipes("---:" if _numbers(table, k) else "---" for k in range(len(table.columns))),
    ]
    for row, link in zip_longest(table.rows, table.links, fillvalue=""):
        head = f"[{_plain(row[0])}]({_address(link)})" if link else _plain(row[0])
        if len(row) < len(table.columns):
            lines.append(_pipes([f"**{head}**", *[""] * (len(table.columns) - 1)]))
        else:
            lines.append(_pipes([head, *map(_plain, row[1:])]))
    return "\n".join(lines)


def _bullets(lines: Iterable[str]) -> str:
    return "\n".join(f"- {_plain(line)}" for line in lines)


def _pipes(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _plain(text: str) -> str:
    """Puts text on one line and escapes what Markdown would interpret."""
    return re.sub(r"([\\`*_\[\]<>|])", r"\\\1", " ".join(text.split()))


def _address(path: str) -> str:
    return re.sub(r"[ ()<>]", lambda found: f"%{ord(found[0]):02X}", path)


def _numbers(table: Table, column: int) -> bool:
    cells = [row[column] for row in table.rows if len(row) == len(table.columns)]
    return column > 0 and bool(cells) and all(page.is_numeric(cell) for cell in cells)


def csv_table(table: Table) -> str:
    """Formats a table for programs: numbers in ASCII, empty where there is none.

    The head of a group becomes a first column, and a column of means with deviations becomes two.
    """
    grouped = any(len(row) < len(table.columns) for row in table.rows)
    full = [row for row in table.rows if len(row) == len(table.columns)]
    split = [any(_DEVIATION in row[k] for row in full) for k in range(len(table.columns))]
    header = ["group"] * grouped
    for head, two in zip(table.columns, split, strict=True):
        header += [head, f"{head} sd"] if two else [head]
    rows, group = [], ""
    for row in table.rows:
        if len(row) < len(table.columns):
            group = row[0]
            continue
        cells = [group] * grouped
        for cell, two in zip(row, split, strict=True):
            mean, _, deviation = cell.partition(_DEVIATION)
            cells += [_ascii(mean), _ascii(deviation)] if two else [_ascii(cell)]
        rows.append(cells)
    return csv_text(header, rows)


def csv_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Formats comma-separated values, quoted where needed; None is empty."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return stream.getvalue()


def _ascii(cell: str) -> str:
    return "" if cell == "–" else re.sub(r"^−(?=\d)", "-", cell)


_LATEX = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": "$<$",
    ">": "$>$",
    "|": "$|$",
    '"': "''",
    "±": r"$\pm$",
    "−": "$-$",
    "×": r"$\times$",
    "·": r"$\cdot$",
    "°": r"$^\circ$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "–": "--",
    "—": "---",
    "µ": r"$\mu$",
}


def latex(tables: Iterable[Table]) -> str:
    r"""Formats each table as an environment in plain LaTeX without packages, for \input."""
    return "\n".join(latex_table(table) for table in tables)


def latex_table(table: Table) -> str:
    """Formats one table environment."""
    columns = "".join("r" if _numbers(table, k) else "l" for k in range(len(table.columns)))
    lines = [
        r"\begin{table}",
        r"\centering\scriptsize\setlength{\tabcolsep}{2pt}",
        rf"\caption{{{_tex(table.caption)}}}",
    ]
    if table.name:
        lines.append(rf"\label{{tab:{table.name}}}")
    lines += [rf"\begin{{tabular}}{{{columns}}}", r"\hline", _ampersands(table.columns), r"\hline"]
    for row in table.rows:
        if len(row) < len(table.columns):
            lines.append(
                rf"\multicolumn{{{len(table.columns)}}}{{l}}{{\textbf{{{_tex(row[0])}}}}} \\"
            )
        else:
            lines.append(_ampersands(row))
    lines += [r"\hline", r"\end{tabular}"]
    if table.note:
        lines.append(rf"\par\smallskip {_tex(table.note)}")
    return "\n".join([*lines, r"\end{table}", ""])


def _ampersands(cells: Sequence[str]) -> str:
    # a line that begins with a bracket would be read as the length of the one before it
    return (
        " & ".join(
            "{" + text + "}" if (text := _tex(cell)).startswith("[") else text for cell in cells
        )
        + r" \\"
    )


def _tex(text: str) -> str:
    return "".join(_LATEX.get(letter, letter) for letter in text)
