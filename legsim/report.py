"""One self-contained page a run: nothing is fetched, nothing runs, it reads on a phone and prints."""

import base64
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, StrictUndefined

from legsim import published
from legsim.errors import LegsimError


@dataclass(frozen=True, slots=True)
class Table:
    """A table with a row of headings; a row of one cell heads the rows that follow it."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", tuple(self.columns))
        object.__setattr__(self, "rows", tuple(tuple(row) for row in self.rows))
        for row in self.rows:
            if len(row) not in (1, len(self.columns)):
                raise LegsimError(f"table {self.caption!r} has {len(self.columns)} columns but a row of {len(row)} cells: {row}")


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure with the words that stand for it where it cannot be seen."""

    caption: str
    png: bytes
    alt: str = ""
    """what it shows, for those who cannot see it; the caption where empty"""

    @property
    def source(self) -> str:
        """The picture as a data address."""
        return "data:image/png;base64," + base64.b64encode(self.png).decode("ascii")

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels, from the PNG's header, so that the page does not jump while it loads."""
        return int.from_bytes(self.png[16:20], "big"), int.from_bytes(self.png[20:24], "big")


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the page."""

    title: str
    lines: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Picture, ...] = ()


@dataclass(frozen=True, slots=True)
class FileNote:
    """A file of the run folder and what is in it."""

    name: str
    """relative to the report"""
    what: str


@dataclass(frozen=True, slots=True)
class ReportContent:
    """All that a page says."""

    title: str
    summary: tuple[str, ...]
    """the most important first; each a sentence"""
    sections: tuple[Section, ...] = ()
    provenance: tuple[tuple[str, str], ...] = ()
    """(what, value): version, device, seed, hash of the configuration ..."""
    files: tuple[FileNote, ...] = ()
    warnings: tuple[str, ...] = ()


def render(content: ReportContent) -> str:
    """The page as HTML."""
    environment = Environment(
        loader=PackageLoader("legsim"), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.tests["numeric"] = _is_numeric
    return environment.get_template("report.html.j2").render(content=content)


def _is_numeric(cell: str) -> bool:
    """Whether a cell is set to the right: a number, with or without unit, deviation or a printed value beside it."""
    return re.match(r"[+\-−±<>≤≥]*\d|[–—]$", cell) is not None


@dataclass(frozen=True, slots=True)
class MethodScore:
    """What one method reached in one region: one volume's values, or mean and deviation over several."""

    method: str
    region: str
    ssim: float
    rmse: float
    entropy: float
    """of the gradient, in nats"""
    ssim_deviation: float = 0.0
    rmse_deviation: float = 0.0
    entropy_deviation: float = 0.0
    count: int = 1


def quality_tables(scores: Sequence[MethodScore], *, condition: str = "all") -> tuple[Table, Table, Table]:
    """SSIM and RMSE by method and region, with the study's printed values beside ours where it has that method; gradient entropy.

    ``condition`` picks the block of the printed table: "30", "60" (degrees of the squat) or "all".
    """
    which = "all scans" if condition == "all" else f"{condition} degree squats"
    source = f"Printed: Maier et al. 2021, Table 1, {which}; another phantom, other recordings, and a third digit that means little."
    ssim = _quality("SSIM", scores, lambda s: (s.ssim, s.ssim_deviation), lambda m, r: published.ssim(m, r, condition))
    rmse = _quality("RMSE", scores, lambda s: (s.rmse, s.rmse_deviation), lambda m, r: published.rmse(m, r, condition))
    return (
        Table("Structural similarity (SSIM) to the motion-free reconstruction", *ssim, f"1 is equal. {source}"),
        Table("RMSE against the motion-free reconstruction", *rmse, f"Of volumes scaled from 0 to 1; 0 is equal. {source}"),
        _entropy(scores),
    )


def _entropy(scores: Sequence[MethodScore]) -> Table:
    regions = list(dict.fromkeys(score.region for score in scores))
    found = {(score.method, score.region): score for score in scores}
    methods = dict.fromkeys(score.method for score in scores)
    rows = tuple((m, *(_value(found.get((m, region)), lambda s: (s.entropy, s.entropy_deviation)) for region in regions)) for m in methods)
    note = "Entropy (nats) of the normalized gradient magnitude, without any reference: blur and streaks raise it. Only differences count."
    return Table("Sharpness by gradient entropy", ("method", *regions), rows, note)


def _quality(
    measure: str,
    scores: Sequence[MethodScore],
    ours: Callable[[MethodScore], tuple[float, float]],
    printed: Callable[[str, str], published.Score | None],
) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Column heads and rows: two columns a region, ours and the printed value."""
    regions = list(dict.fromkeys(score.region for score in scores))
    found = {(score.method, score.region): score for score in scores}
    rows = []
    for method in dict.fromkeys(score.method for score in scores):
        cells = [cell for region in regions for cell in (_value(found.get((method, region)), ours), _printed(printed(method, region)))]
        rows.append((method, *cells))
    return ("method", *(head for region in regions for head in (f"{measure} {region}", "printed"))), tuple(rows)


def _value(score: MethodScore | None, ours: Callable[[MethodScore], tuple[float, float]]) -> str:
    if score is None:
        return "–"
    mean, deviation = ours(score)
    return f"{mean:.3f} ± {deviation:.3f}" if score.count > 1 else f"{mean:.3f}"


def _printed(score: published.Score | None) -> str:
    return "–" if score is None else f"{score.mean:.3f} ± {score.deviation:.3f}"
