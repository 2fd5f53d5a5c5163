"""A study's report from its results: the page, and the same as Markdown, CSV, LaTeX and
pictures.
"""

from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from legsim import figures
from legsim.core import files
from legsim.evaluation.similarity import RegionScores
from legsim.figures import BoxGroup, ErrorLine, ErrorPanel, Figure, HeatMap
from legsim.imu.noise import Convention
from legsim.report import formats, page, published_tables, published_values
from legsim.report.page import FileNote, PageSection, Picture, ReportContent
from legsim.report.published_tables import counted
from legsim.run import methods
from legsim.study import statistics
from legsim.study import tables as study_tables
from legsim.study.results import (
    RESULTS_FILE,
    LadderScore,
    NoiseLevel,
    ScanScore,
    StudyResults,
    methods_of,
)
from legsim.study.statistics import LIMIT_DEG, LIMIT_MM, LadderCell, PairedTest
from legsim.study.tables import SPREAD_NOTE, every_scan, noisy_quality

CONVENTIONS = (
    "Every noise number is made in one of two conventions, which is written beside it. SI: the "
    "data sheet's RMS on every sample, in "
    "m/s² and rad/s. Per-sample: the same numbers put into the paper's equations without their "
    "time steps (degrees a sample, and m a "
    "squared projection interval), which is what reproduces its published ladder."
)

_TRANSLATION, _ROTATION = "translation (mm)", "rotation (deg)"


def write(
    folder: Path,
    results: StudyResults,
    pictures: Sequence[Picture] = (),
    noisy_pictures: Sequence[Picture] = (),
) -> ReportContent:
    """Writes report.html, report.md, tables.tex, tables/, scores.csv, ladder.csv and the pictures
    drawn here; gives back what it says.
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
        files.write_text(folder / "scores.csv", scores_csv(results.scores))
    if results.ladder:
        files.write_text(folder / "ladder.csv", ladder_csv(results.ladder))
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
    clean = tuple(s for s in scores if s.noise is None)
    noisy = tuple(s for s in scores if s.noise is not None)
    cells = statistics.ladder_cells(results.ladder)
    sections = [
        *((_quality(clean), _residuals(clean, results), _tests(clean)) if clean else ()),
        *((PageSection("Pictures of one scan", figures=tuple(pictures)),) if pictures else ()),
        *(_ladder(results.ladder, cells) if cells else ()),
        *((_noisy(scores, noisy_pictures),) if noisy or noisy_pictures else ()),
        *((_scans(clean, noisy),) if scores else ()),
        *(
            (PageSection("What it took", tables=(study_tables.costs(results.costs),)),)
            if results.costs
            else ()
        ),
    ]
    return ReportContent(
        title=results.title,
        summary=(*_sizes(clean, noisy, results.ladder), *_headlines(clean), *_needed(cells)),
        sections=tuple(
            section for section in sections if section.tables or section.figures or section.lines
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


def _pools(scores: Sequence[ScanScore]) -> dict[str, tuple[ScanScore, ...]]:
    """The blocks that say it all: all squats together where they are there, else every
    condition.
    """
    blocks = statistics.blocks(scores)
    return {
        name: block
        for name, block in blocks.items()
        if "all" not in blocks or name == "all" or name not in statistics.POOLED
    }


def _headlines(clean: Sequence[ScanScore]) -> list[str]:
    """The whole leg's means, a line a measure."""
    if not clean:
        return []
    whole = study_tables.regions(clean)[0]
    lines = []
    for condition, pool in _pools(clean).items():
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
    """By what factor sensors must improve, a line a convention."""
    lines = []
    for convention in _conventions(cells):
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


def _conventions(cells: dict[NoiseLevel, LadderCell]) -> tuple[Convention, ...]:
    return tuple(dict.fromkeys(level.convention for level in cells))


def _quality(clean: tuple[ScanScore, ...]) -> PageSection:
    blocks = {name: block for name, block in statistics.blocks(clean).items() if name != "all"}
    whole = study_tables.regions(clean)[0]
    drawn = []
    for measure, published_of in (("SSIM", published_values.ssim), ("RMSE", published_values.rmse)):
        groups = []
        for condition, block in blocks.items():
            for method in methods_of(block):
                values = statistics.per_scan(
                    statistics.of_method(block, method),
                    statistics.of_region(measure.lower(), whole),
                )
                published = published_of(method, whole, condition)
                series = published_tables.heading(condition)
                groups.append(
                    BoxGroup(
                        method,
                        series,
                        np.array(list(values.values())),
                        None if published is None else published.mean,
                    )
                )
        caption = (
            f"{measure} of the whole leg over scans: median, quartiles, whiskers from the 5th to "
            "the 95th percentile, a dot a scan"
        ) + (
            "; diamonds are the published means."
            if any(group.published is not None for group in groups)
            else "."
        )
        drawn.append(
            _picture(
                f"box-{measure.lower()}",
                caption,
                figures.box_plots(groups, axis_label=f"{measure}, whole leg"),
            )
        )
    lines = (
        "Beside each of our values stand the published one and the difference, ours minus "
        "published. "
        "The published values are of another, closed "
        "phantom that followed other people's movements: an equal order of methods means more "
        "than an equal digit, and the third digit "
        "means little even within the published table, where means over all scans are not always "
        "between the means of their parts.",
    )
    tables = study_tables.quality(clean)
    beside = any("paper" in column for column in tables[0].columns)
    return PageSection(
        "Image quality", (*(lines if beside else ()), SPREAD_NOTE), tables, tuple(drawn)
    )


def _residuals(clean: tuple[ScanScore, ...], results: StudyResults) -> PageSection:
    # how sharp the motion-free volume is says what sharpness can be reached
    with_reference = tuple(s for s in results.scores if s.noise is None)
    tables = (
        *study_tables.residuals(clean),
        study_tables.sharpness(with_reference),
        study_tables.registration(clean, results.registration_errors),
    )
    return PageSection("What was left of the motion", (), tuple(t for t in tables if t is not None))


def _tests(clean: tuple[ScanScore, ...]) -> PageSection:
    title = "Are the differences more than chance?"
    if len(methods_of(clean)) < 2:
        return PageSection(title)
    pools, whole = _pools(clean), study_tables.regions(clean)[0]
    tables, few, told = [], [], []
    for condition, pool in pools.items():
        heading, count, made = published_tables.heading(condition), 0, []
        for measure in ("SSIM", "RMSE"):
            found = statistics.paired_tests(pool, statistics.of_region(measure.lower(), whole))
            count = max((test.scans for test in found), default=0)
            if any(test.p is not None for test in found):
                where, stem = (
                    ("", "")
                    if len(pools) == 1
                    else (f", {heading}", f"_{condition.replace('/', '_')}")
                )
                caption = (
                    f"Paired test between methods, {measure} of the whole leg{where}, n = "
                    f"{_counts(found)}"
                )
                made.append(study_tables.tests(caption, found, f"test_{measure.lower()}{stem}"))
        tables += made
        if made:
            told.append(heading)
        else:
            few.append(f"{count}" if len(pools) == 1 else f"{count} of {heading}")
    lines = []
    if told:
        lines.append(
            f"Methods are compared scan by scan over {' and over '.join(told)}. Two postures of "
            "one subject count as two scans. A "
            "small p says that the sign of a difference is no chance, not that the difference "
            "matters: see the median difference."
        )
    if few:
        lines.append(
            f"Too few scans for a paired test: {', '.join(few)}, where {statistics.FEWEST_SCANS} "
            "are the fewest that can tell."
        )
    return PageSection(title, tuple(lines), tuple(tables))


def _counts(found: Sequence[PairedTest]) -> str:
    counts = sorted({test.scans for test in found})
    return f"{counts[0]} scans" if len(counts) == 1 else f"{counts[0]} to {counts[-1]} scans"


def _ladder(
    ladder: Sequence[LadderScore], cells: dict[NoiseLevel, LadderCell]
) -> tuple[PageSection, PageSection]:
    scans = ", ".join(dict.fromkeys(f"{s.subject} {s.posture}" for s in ladder))
    lines = (
        "The BMI160's noise (1.8 mg and 0.07 deg/s RMS) is divided by 10^f_a in the accelerometer "
        "and by 10^f_g in the gyroscope; the "
        "rigid motion that is then estimated is compared with that of clean sensors. Scans: "
        f"{scans}. Every draw is a row of ladder.csv.",
        CONVENTIONS,
    )
    drawn = []
    for axis, field in ((_TRANSLATION, "translation_mm"), (_ROTATION, "rotation_deg")):
        maps = [_heat_map(cells, convention, field) for convention in _conventions(cells)]
        caption = (
            f"Mean {axis.partition(' ')[0]} error by noise level, a map a convention, in one "
            "color scale."
        )
        figure = figures.heat_maps(
            maps, row_axis="f_a, accelerometer", column_axis="f_g, gyroscope", unit=axis
        )
        drawn.append(_picture(f"ladder-{axis.partition(' ')[0]}", caption, figure))
    caption = (
        f"Errors against the factor by which noise is divided, with the lines of {LIMIT_MM:g} mm "
        f"and {LIMIT_DEG:g}°; diamonds are published. "
        "Zeros cannot be drawn."
    )
    panels = _panels(cells)
    if panels:
        drawn.append(_picture("ladder-errors", caption, figures.error_lines(panels)))
    tables = tuple(study_tables.ladder(cells, convention) for convention in _conventions(cells))
    return PageSection("Sensor noise without images", lines, figures=tuple(drawn)), PageSection(
        "The noise ladder in numbers", tables=tables
    )


def _heat_map(cells: dict[NoiseLevel, LadderCell], convention: Convention, field: str) -> HeatMap:
    of_convention = {
        (level.f_a, level.f_g): cell
        for level, cell in cells.items()
        if level.convention == convention
    }
    rows, columns = (_sorted({key[k] for key in of_convention}) for k in (0, 1))
    values = np.full((len(rows), len(columns)), np.nan)
    for (f_a, f_g), cell in of_convention.items():
        values[rows.index(f_a), columns.index(f_g)] = getattr(cell, field).mean
    return HeatMap(
        f"noise read as {convention}",
        values,
        *(tuple(map(study_tables.exponent, axis)) for axis in (rows, columns)),
    )


def _sorted(exponents: set[float | None]) -> list[float | None]:
    return sorted(exponents, key=lambda x: np.inf if x is None else x)


def _panels(cells: dict[NoiseLevel, LadderCell]) -> list[ErrorPanel]:
    """A row for both sensors, the accelerometer alone and the gyroscope alone, as far as the ladder
    has them; translation and rotation.
    """
    panels = []
    for title, pair in (
        ("both sensors", lambda f: (f, f)),
        ("accelerometer alone", lambda f: (f, None)),
        ("gyroscope alone", lambda f: (None, f)),
    ):
        for axis, field, limit in (
            (_TRANSLATION, "translation_mm", LIMIT_MM),
            (_ROTATION, "rotation_deg", LIMIT_DEG),
        ):
            lines = []
            for convention in _conventions(cells):
                found = {f: cells.get(NoiseLevel(convention, *pair(f))) for f in _exponents(cells)}
                points = {
                    f: getattr(cell, field).mean for f, cell in found.items() if cell is not None
                }
                if points:
                    lines.append(
                        ErrorLine(
                            convention, np.array(list(points)), np.array(list(points.values()))
                        )
                    )
            if not lines:
                continue
            published = {
                f: published_values.deviation(*pair(f))
                for f in published_values.EXPONENTS
                if f is not None
            }
            values = np.array([getattr(cell, field) for cell in published.values()])
            panels.append(
                ErrorPanel(
                    title,
                    axis,
                    limit,
                    (*lines, ErrorLine("paper", np.array(list(published)), values, published=True)),
                )
            )
    return panels


def _exponents(cells: dict[NoiseLevel, LadderCell]) -> list[float]:
    return sorted({f for level in cells for f in (level.f_a, level.f_g) if f is not None})


def _noisy(scores: tuple[ScanScore, ...], pictures: Sequence[Picture]) -> PageSection:
    tables = noisy_quality(scores) if any(s.noise is not None for s in scores) else ()
    return PageSection("Images from noisy sensors", (CONVENTIONS,), tables, tuple(pictures))


def _scans(clean: tuple[ScanScore, ...], noisy: tuple[ScanScore, ...]) -> PageSection:
    lines = (
        "The tables above are made of these numbers. Each scan is linked to its run folder, which "
        "holds its settings and what they "
        "made; made again by: legsim run FOLDER/config.toml --out OTHER. All regions, residuals "
        "and registrations are in scores.csv, a "
        "row a score and region.",
    )
    tables = (
        *(every_scan(clean, "scans") if clean else ()),
        *(every_scan(noisy, "noisy_scans") if noisy else ()),
    )
    return PageSection("Every scan and its folder", lines, tables)


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
                "a row a score and region, in full precision, with run folder and command",
            )
        )
    if results.ladder:
        notes.append(FileNote("ladder.csv", "a row a draw of noise"))
    return tuple(notes)


def _picture(stem: str, caption: str, figure: Figure) -> Picture:
    return Picture(caption, figures.png(figure), caption, f"pictures/{stem}.png")


_NOISE_COLUMNS = ("convention", "f_a", "f_g")


def _noise_cells(noise: NoiseLevel | None) -> tuple[object, ...]:
    return (None, None, None) if noise is None else (noise.convention, noise.f_a, noise.f_g)


def scores_csv(scores: Sequence[ScanScore]) -> str:
    """A row a score and region: who, what, the region's metrics, the registration, every residual,
    seconds, folder and command.

    Clean sensors have no convention; an exponent of a noisy one that is empty means that this
    sensor was clean.
    """
    metrics = [f.name for f in fields(RegionScores)]
    structures = tuple(dict.fromkeys(r.structure for score in scores for r in score.residuals))
    found = ("translation_mm", "rotation_deg", "applied", "correlation_before", "correlation_after")
    header = [
        "subject",
        "posture",
        "method",
        *_NOISE_COLUMNS,
        "repetition",
        *metrics,
        *(f"registration_{name}" for name in found),
    ]
    header += [
        f"{structure}_{unit}" for structure in structures for unit in ("mm", "degrees", "pixels")
    ]
    rows = []
    for score in scores:
        registration, left = score.metrics.registration, {r.structure: r for r in score.residuals}
        rest = [None if registration is None else getattr(registration, name) for name in found]
        rest += [
            getattr(left.get(structure), unit, None)
            for structure in structures
            for unit in ("mm", "degrees", "pixels")
        ]
        rest += [score.seconds, score.folder, f"legsim run {score.folder}/config.toml --out OTHER"]
        who = (
            score.subject,
            score.posture,
            score.method,
            *_noise_cells(score.noise),
            score.repetition,
        )
        rows += [(*who, *asdict(region).values(), *rest) for region in score.metrics.regions]
    return formats.csv_text([*header, "seconds", "folder", "command"], rows)


def ladder_csv(ladder: Sequence[LadderScore]) -> str:
    """A row a draw of noise; an empty exponent means that this sensor was clean."""
    header = ("subject", "posture", *_NOISE_COLUMNS, "repetition", "translation_mm", "rotation_deg")
    rows = [
        (
            s.subject,
            s.posture,
            *_noise_cells(s.noise),
            s.repetition,
            s.translation_mm,
            s.rotation_deg,
        )
        for s in ladder
    ]
    return formats.csv_text(header, rows)
