"""One self-contained page per run.

Nothing is fetched and nothing runs; it is readable on a phone and in print.
"""

import base64
import re
from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, StrictUndefined

from legsim.core.errors import LegsimError


@dataclass(frozen=True, slots=True)
class Table:
    """A table with a row of headings; a row of one cell heads the rows that follow it."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    name: str = ""
    """stem of the table's own file, if any"""
    links: tuple[str, ...] = ()
    """one address per row, relative to the report, for the row's head; none where empty"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", tuple(self.columns))
        object.__setattr__(self, "rows", tuple(tuple(row) for row in self.rows))
        for row in self.rows:
            if len(row) not in (1, len(self.columns)):
                raise LegsimError(
                    f"table {self.caption!r} has {len(self.columns)} columns but a row of "
                    f"{len(row)} cells: {row}"
                )
        if self.links and len(self.links) != len(self.rows):
            raise LegsimError(
                f"table {self.caption!r} has {len(self.rows)} rows but {len(self.links)} links"
            )


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure with a caption and a text alternative."""

    caption: str
    png: bytes
    alt: str = ""
    """text alternative; the caption where empty"""
    file: str = ""
    """its own file, relative to the report"""

    @property
    def source(self) -> str:
        """Encodes the picture as a data address."""
        return "data:image/png;base64," + base64.b64encode(self.png).decode("ascii")

    @property
    def size(self) -> tuple[int, int]:
        """Reads (width, height) in pixels from the PNG's header.

        The page then does not jump while it loads.
        """
        return int.from_bytes(self.png[16:20], "big"), int.from_bytes(self.png[20:24], "big")


@dataclass(frozen=True, slots=True)
class PageSection:
    """A part of the page."""

    title: str
    lines: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Picture, ...] = ()


@dataclass(frozen=True, slots=True)
class FileNote:
    """A file of the run folder and its content."""

    name: str
    """path relative to the report"""
    what: str


@dataclass(frozen=True, slots=True)
class ReportContent:
    """All content of a page."""

    title: str
    summary: tuple[str, ...]
    """the most important first; each a sentence"""
    sections: tuple[PageSection, ...] = ()
    provenance: tuple[tuple[str, str], ...] = ()
    """(what, value): version, device, seed, hash of the configuration ..."""
    files: tuple[FileNote, ...] = ()
    warnings: tuple[str, ...] = ()


def render(content: ReportContent) -> str:
    """Renders the page as HTML."""
    environment = Environment(
        loader=PackageLoader("legsim.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.tests["numeric"] = is_numeric
    return environment.get_template("report.html.j2").render(content=content)


def is_numeric(cell: str) -> bool:
    """Whether a cell is aligned to the right.

    It is a number, with or without unit, deviation or a published value next to it.
    """
    return re.match(r"[+\-−±<>≤≥]*\d|[–—]$", cell) is not None
