"""A study's report from its results: the page, and the same as Markdown, CSV, LaTeX and
pictures.
"""

from collections.abc import Sequence
from pathlib import Path

from legsim.core import files
from legsim.report import formats, page, published_tables, published_values
from legsim.report.page import FileNote, PageSection, Picture, ReportContent
from legsim.report.published_tables import counted
from legsim.run import methods
from legsim.study import aided_sections, csv_files, sections, statistics
from legsim.study import results as study_results
from legsim.study import tables as study_tables
from legsim.study.results import (
    RESULTS_FILE,
    LadderScore,
    NoiseLevel,
    ScanScore,
    StudyResults,
    methods_of,
)
from legsim.study.statistics import LIMIT_DEG, LIMIT_MM, LadderCell


def write(
    folder: Path,
    results: StudyResults,
    pictures: Sequence[Picture] = (),
    noisy_pictures: Sequence[Picture] = (),
) -> ReportContent:
    """Writes report.html, report.md, tables.tex, tables/, scores.csv, ladder.csv, sensors.csv,
    aided.csv and the pictures drawn here; gives back what it says.
    """
    made = content(results, pictures, noisy_pictures)
    (folder / "pictures").mkdir(parents=True, exist_ok=True)
    (folder / "tables").mkdir(exist_ok=True)
    given = {picture.file for picture in (*pictures, *noisy_pictures)}
    for picture in (figure for section in made.sections for figure in section.figures):
        if picture.file not in given:
            files.write_bytes(folder / picture.file, picture.png)
    tables = [table for section in made.sections for table in section.tables]
    for table in tables:
        files.write_text(folder / "tables" / f"{table.name}.csv", formats.csv_table(table))
    files.write_text(folder / "tables.tex", formats.latex(tables))
    if results.scores:
        files.write_text(folder / "scores.csv", csv_files.scores_csv(results.scores))
    if results.ladder:
        files.write_text(folder / "ladder.csv", csv_files.ladder_csv(results.ladder))
    if results.aided:
        files.write_text(folder / "aided.csv", csv_files.aided_csv(results.aided))
    if results.sensors:
        files.write_text(folder / "sensors.csv", csv_files.sensors_csv(results.sensors))
    files.write_text(folder / "report.md", formats.markdown(made))
    files.write_text(folder / "report.html", page.render(made))
    return made


def content(
    results: StudyResults, pictures: Sequence[Picture] = (), noisy_pictures: Sequence[Picture] = ()
) -> ReportContent:
    """The page.

    Args:
        results: of the study; what it does not hold is left out.
        pictures: slices and overlays of one scan.
        noisy_pictures: slices of one scan from noisy sensors.
    """
    scores = tuple(s for s in results.scores if s.method != methods.REFERENCE)
    clean = tuple(s for s in scores if s.clean)
    of_sensors = tuple(s for s in scores if s.sensor)
    noisy = tuple(s for s in scores if s.noise is not None)
    cells = statistics.ladder_cells(results.ladder)
    parts = [
        *(sections.without_noise(clean, results) if clean else ()),
        *((PageSection("Pictures of one scan", figures=tuple(pictures)),) if pictures else ()),
        *(sections.ladder(results.ladder, cells) if cells else ()),
        *((sections.sensors(results.sensors),) if results.sensors else ()),
        *aided_sections.of_motion(results.aided),
        *aided_sections.of_volumes(of_sensors),
        *((sections.noisy(scores, noisy_pictures),) if noisy or noisy_pictures else ()),
        *((sections.every_scan(clean, (*noisy, *of_sensors)),) if scores else ()),
        *(
            (PageSection("What it took", tables=(study_tables.costs(results.costs),)),)
            if results.costs
            else ()
        ),
    ]
    return ReportContent(
        title=results.title,
        summary=(
            *_sizes(clean, noisy, results.ladder),
            *_headlines(clean),
            *_needed(cells),
            *aided_sections.headlines(results.aided),
        ),
        sections=tuple(
            section for section in parts if section.tables or section.figures or section.lines
        ),
        provenance=results.provenance,
        files=_files(results),
        warnings=results.failures,
    )


def _sizes(
    clean: Sequence[ScanScore], noisy: Sequence[ScanScore], ladder: Sequence[LadderScore]
) -> list[str]:
    lines = []
    if clean:
        subjects, scans = {s.subject for s in clean}, {(s.subject, s.posture) for s in clean}
        lines.append(
            f"{counted(len(scans), 'scan')} of {counted(len(subjects), 'subject')}, "
            f"{counted(len(methods_of(clean)), 'method')}."
        )
    if noisy:
        lines.append(f"{counted(len(noisy), 'reconstruction')} from noisy sensors.")
    if ladder:
        lines.append(
            f"{counted(len({s.noise for s in ladder}), 'noise level')} without images, "
            f"{counted(len(ladder), 'draw')} of noise in all."
        )
    return lines


def _headlines(clean: Sequence[ScanScore]) -> list[str]:
    """The whole leg's means, one line per measure."""
    if not clean:
        return []
    whole = study_results.regions(clean)[0]
    lines = [study_results.protocol(clean)]
    for condition, pool in statistics.pools(clean).items():
        for measure, published_of in (
            ("SSIM", published_values.ssim),
            ("RMSE", published_values.rmse),
        ):
            take, parts = statistics.of_region(measure.lower(), whole), []
            for method in methods_of(pool):
                ours = statistics.over_scans(statistics.of_method(pool, method), take)
                published = published_of(method, whole, condition)
                beside = f" (published {published.mean:.3f})" if published else ""
                parts.append(f"{method} {'–' if ours is None else f'{ours.mean:.3f}'}{beside}")
            lines.append(
                f"Mean {measure}, whole leg, {published_tables.heading(condition)}: "
                f"{', '.join(parts)}."
            )
    return lines


def _needed(cells: dict[NoiseLevel, LadderCell]) -> list[str]:
    """By what factor sensors must improve, one line per convention."""
    lines = []
    for convention in statistics.conventions(cells):
        factor = statistics.needed_factor(cells, convention)
        wanted = f"errors within {LIMIT_MM:g} mm and {LIMIT_DEG:g}°"
        if factor is None:
            found = f"no level of the ladder keeps {wanted}"
        else:
            found = (
                f"{wanted} need the noise of both sensors divided by about "
                f"{float(f'{factor:.2g}'):g}"
            )
        lines.append(
            f"White noise alone, {convention} convention: {found}; published: by 10⁴ to 10⁵."
        )
    return lines


def _files(results: StudyResults) -> tuple[FileNote, ...]:
    notes = [
        FileNote(RESULTS_FILE, "all results, as the report was made from them"),
        FileNote("report.md", "this report as Markdown"),
        FileNote("tables", "its tables as CSV"),
        FileNote("tables.tex", "its tables as LaTeX"),
    ]
    if results.scores:
        notes.append(
            FileNote(
                "scores.csv",
                "one row per score and region, in full precision, with run folder and command",
            )
        )
    if results.ladder:
        notes.append(FileNote("ladder.csv", "one row per draw of noise"))
    if results.aided:
        notes.append(FileNote("aided.csv", "one row per draw of a sensor's errors and aid"))
    if results.sensors:
        notes.append(FileNote("sensors.csv", "one row per draw of a sensor's errors"))
    return tuple(notes)
