"""Tables of our values with the published ones and their difference."""

from collections.abc import Sequence
from dataclasses import dataclass

from legsim.evaluation.scores import MeanAndDeviation
from legsim.report import published_values
from legsim.report.page import Table
from legsim.report.published_values import Score

NONE = "–"

CAVEAT = "another phantom, other recordings, and a third digit that means little"

ENTROPY = (
    "Entropy (nats) of the normalized gradient magnitude, without any reference: blur and "
    "streaks raise it. Only differences count."
)

PHANTOM = (
    "The phantom itself at the first view: linear attenuation at one energy, in each voxel the "
    "mean of 2×2×2 points. It has no streaks, but also no blur: the motion-free scan's own "
    "distance from it is what the scanner and the filter leave."
)

_HEADINGS = {"30": "30 degree squats", "60": "60 degree squats", "all": "all scans"}


@dataclass(frozen=True, slots=True)
class Entry:
    """The value of one row in one column: ours, and the published one."""

    group: str
    """heads the rows that follow; no head where empty"""
    row: str
    column: str
    ours: MeanAndDeviation | None
    published: Score | None


def counted(count: int, what: str) -> str:
    """Counts in words: "1 scan", "2 scans"."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def heading(condition: str) -> str:
    """Names a condition in words."""
    return _HEADINGS.get(condition, condition)


def text(ours: MeanAndDeviation | Score | None, digits: int = 3) -> str:
    """Formats a mean, and its deviation where it is one of several."""
    if ours is None:
        return NONE
    alone = isinstance(ours, MeanAndDeviation) and ours.count < 2
    return (
        f"{ours.mean:.{digits}f}"
        if alone
        else f"{ours.mean:.{digits}f} ± {ours.deviation:.{digits}f}"
    )


def difference(ours: MeanAndDeviation | None, published: Score | None, digits: int = 3) -> str:
    """Formats ours minus the published mean, with sign."""
    if ours is None or published is None:
        return NONE
    away = round(ours.mean - published.mean, digits)
    return f"{away:+.{digits}f}".replace("-", "−") if away else f"{0:.{digits}f}"


def table(
    caption: str,
    head: str,
    entries: Sequence[Entry],
    *,
    note: str,
    source: str = "",
    name: str = "",
) -> Table:
    """Builds three columns per column of the entries, one where nothing was published.

    ``head`` is the heading of the first column. ``source`` says in the note where the published
    values are.
    """
    compared = any(e.published is not None for e in entries)
    columns = tuple(dict.fromkeys(e.column for e in entries))
    found = {(e.group, e.row, e.column): e for e in entries}
    rows: list[tuple[str, ...]] = []
    group = ""
    for place in dict.fromkeys((e.group, e.row) for e in entries):
        if place[0] != group:
            group = place[0]
            rows.append((group,))
        cells = [found.get((*place, column)) for column in columns]
        rows.append(
            (place[1], *(cell for entry in cells for cell in _cells(entry)[: 3 if compared else 1]))
        )
    heads = (
        h
        for column in columns
        for h in (column, f"published {column}", f"difference {column}")[: 3 if compared else 1]
    )
    note = f"{note} Published: {source}; {CAVEAT}." if compared and source else note
    return Table(caption, (head, *heads), tuple(rows), note, name)


def _cells(entry: Entry | None) -> tuple[str, str, str]:
    if entry is None:
        return NONE, NONE, NONE
    return text(entry.ours), text(entry.published), difference(entry.ours, entry.published)


def quality_entry(
    measure: str,
    condition: str,
    method: str,
    region: str,
    ours: MeanAndDeviation | None,
    *,
    group: str = "",
) -> Entry:
    """An entry of Table 1; ``measure`` is SSIM or RMSE."""
    published = (published_values.ssim if measure == "SSIM" else published_values.rmse)(
        method, region, condition
    )
    return Entry(group, method, region, ours, published)


def quality_tables(
    ssim: Sequence[Entry], rmse: Sequence[Entry], source: str, protocol: str
) -> tuple[Table, Table]:
    """Builds both tables of image quality.

    ``source`` says where the published values are, ``protocol`` how volumes were compared.
    """
    source = f"Maier et al. 2021, {source}"
    similar = "Structural similarity (SSIM) to the motion-free reconstruction"
    return (
        table(similar, "method", ssim, note=f"1 is equal. {protocol}", source=source, name="ssim"),
        table(
            "RMSE against the motion-free reconstruction",
            "method",
            rmse,
            note=f"0 is equal. {protocol}",
            source=source,
            name="rmse",
        ),
    )
