"""The sections of a study's report: tables and pictures of one question each."""

from collections.abc import Callable, Sequence

import numpy as np

from legsim import figures
from legsim.figures import BoxGroup, ErrorLine, ErrorPanel, Figure, HeatMap
from legsim.imu.noise import Convention
from legsim.report import published_tables, published_values
from legsim.report.page import PageSection, Picture, Table
from legsim.report.published_values import Score
from legsim.study import results as study_results
from legsim.study import statistics
from legsim.study import tables as study_tables
from legsim.study.results import (
    LadderScore,
    NoiseLevel,
    ScanScore,
    SensorScore,
    StudyResults,
    methods_of,
)
from legsim.study.statistics import LIMIT_DEG, LIMIT_MM, LadderCell, PairedTest

CONVENTIONS = (
    "Every noise number is made in one of two conventions, which is written beside it. SI: the "
    "data sheet's RMS on every sample, in "
    "m/s² and rad/s. Per-sample: the same numbers put into the paper's equations without their "
    "time steps (degrees a sample, and m a "
    "squared projection interval), which is what reproduces its published ladder."
)

_TRANSLATION, _ROTATION = "translation (mm)", "rotation (deg)"


def without_noise(clean: tuple[ScanScore, ...], results: StudyResults) -> tuple[PageSection, ...]:
    """What is said of clean sensors: image quality, what was left of the motion, paired tests."""
    return _quality(clean, results), _residuals(clean, results), _tests(clean)


def _quality(clean: tuple[ScanScore, ...], results: StudyResults) -> PageSection:
    """SSIM and RMSE beside the published values, as tables and box plots; both to the phantom."""
    drawn = (
        _boxes(clean, "SSIM", published_values.ssim),
        _boxes(clean, "RMSE", published_values.rmse),
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
    # how near the motion-free volume comes to the phantom says how near any can come
    phantom = study_tables.to_phantom(tuple(s for s in results.scores if s.clean))
    return PageSection(
        "Image quality",
        (*(lines if beside else ()), study_tables.SPREAD_NOTE),
        (*tables, *(() if phantom is None else (phantom,))),
        drawn,
    )


def _boxes(
    clean: tuple[ScanScore, ...],
    measure: str,
    published_of: Callable[[str, str, str], Score | None],
) -> Picture:
    """Box plots of a measure of the whole leg, by posture and method."""
    whole = study_results.regions(clean)[0]
    groups = []
    for condition, block in statistics.blocks(clean).items():
        for method in methods_of(block) if condition != "all" else ():
            values = statistics.per_scan(
                statistics.of_method(block, method), statistics.of_region(measure.lower(), whole)
            )
            published = published_of(method, whole, condition)
            groups.append(
                BoxGroup(
                    method,
                    published_tables.heading(condition),
                    np.array(list(values.values())),
                    None if published is None else published.mean,
                )
            )
    diamonds = any(group.published is not None for group in groups)
    caption = (
        f"{measure} of the whole leg over scans: median, quartiles, whiskers from the 5th to the "
        f"95th percentile, one dot per scan{'; diamonds are the published means' * diamonds}. "
        f"{study_results.protocol(clean)}"
    )
    figure = figures.box_plots(groups, axis_label=f"{measure}, whole leg")
    return _picture(f"box-{measure.lower()}", caption, figure)


def _residuals(clean: tuple[ScanScore, ...], results: StudyResults) -> PageSection:
    """What was left of the motion, how sharp the volumes are, and what their registration found."""
    # how sharp the motion-free volume is says what sharpness can be reached
    with_reference = tuple(s for s in results.scores if s.clean)
    tables = (
        *study_tables.residuals(clean),
        study_tables.sharpness(with_reference),
        study_tables.registration(clean, results.registration_errors),
    )
    return PageSection("What was left of the motion", (), tuple(t for t in tables if t is not None))


def _tests(clean: tuple[ScanScore, ...]) -> PageSection:
    """Paired tests between methods, or how many scans are missing for them."""
    title = "Are the differences more than chance?"
    if len(methods_of(clean)) < 2:
        return PageSection(title)
    pools = statistics.pools(clean)
    tables, few, tested = [], [], []
    for condition, pool in pools.items():
        heading = published_tables.heading(condition)
        alone = len(pools) == 1
        where, stem = ("", "") if alone else (f", {heading}", f"_{condition.replace('/', '_')}")
        made, count = _test_tables(pool, where, stem)
        tables += made
        if made:
            tested.append(heading)
        else:
            few.append(f"{count}" if alone else f"{count} of {heading}")
    lines = []
    if tested:
        lines.append(
            f"Methods are compared scan by scan over {' and over '.join(tested)}. Two postures of "
            "one subject count as two scans. A "
            "small p says that the sign of a difference is no chance, not that the difference "
            "matters: see the median difference."
        )
    if few:
        lines.append(
            f"Too few scans for a paired test: {', '.join(few)}, where {statistics.FEWEST_SCANS} "
            "are the fewest for a result."
        )
    return PageSection(title, tuple(lines), tuple(tables))


def _test_tables(pool: tuple[ScanScore, ...], where: str, stem: str) -> tuple[list[Table], int]:
    """(paired tests by SSIM and RMSE of the whole leg, none where scans are too few; scans).

    ``where`` and ``stem`` name the pool in captions and files.
    """
    whole, tables, count = study_results.regions(pool)[0], [], 0
    for measure in ("SSIM", "RMSE"):
        found = statistics.paired_tests(pool, statistics.of_region(measure.lower(), whole))
        count = max((test.scans for test in found), default=0)
        if any(test.p is not None for test in found):
            caption = (
                f"Paired test between methods, {measure} of the whole leg{where}, n = "
                f"{_counts(found)}"
            )
            name, note = f"test_{measure.lower()}{stem}", study_results.protocol(pool)
            tables.append(study_tables.tests(caption, found, name, note))
    return tables, count


def _counts(found: Sequence[PairedTest]) -> str:
    counts = sorted({test.scans for test in found})
    return f"{counts[0]} scans" if len(counts) == 1 else f"{counts[0]} to {counts[-1]} scans"


def ladder(
    ladder: Sequence[LadderScore], cells: dict[NoiseLevel, LadderCell]
) -> tuple[PageSection, PageSection]:
    """Errors of the motion by noise level: pictures, and the numbers in a section of their own."""
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
        maps = [_heat_map(cells, convention, field) for convention in statistics.conventions(cells)]
        caption = (
            f"Mean {axis.partition(' ')[0]} error by noise level, one map per convention, in one "
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
    tables = tuple(
        study_tables.ladder(cells, convention) for convention in statistics.conventions(cells)
    )
    return PageSection("Sensor noise without images", lines, figures=tuple(drawn)), PageSection(
        "The noise ladder in numbers", tables=tables
    )


def sensors(scores: Sequence[SensorScore]) -> PageSection:
    """Errors of the motion by sensor of the catalogue and calibration."""
    scans = ", ".join(dict.fromkeys(f"{s.subject} {s.posture}" for s in scores))
    lines = (
        "The rigid motion from sensors with all errors of their data sheets is compared with that "
        f"from exact ones. Scans: {scans}. Every draw is a row of sensors.csv; legsim sensors "
        "lists what each error costs.",
    )
    return PageSection(
        "Sensors that one can buy, without images",
        lines,
        tables=(study_tables.catalogued(scores),),
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
            for convention in statistics.conventions(cells):
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


def noisy(scores: tuple[ScanScore, ...], pictures: Sequence[Picture]) -> PageSection:
    """Image quality from noisy sensors."""
    tables = study_tables.noisy_quality(scores) if any(s.noise is not None for s in scores) else ()
    return PageSection("Images from noisy sensors", (CONVENTIONS,), tables, tuple(pictures))


def every_scan(clean: tuple[ScanScore, ...], noisy: tuple[ScanScore, ...]) -> PageSection:
    """A table of all scans, each linked to its run folder."""
    lines = (
        "The tables above are made of these numbers. Each scan is linked to its run folder, which "
        "holds its settings and what they "
        "made; made again by: legsim run FOLDER/config.toml --out OTHER. All regions, residuals "
        "and registrations are in scores.csv, a "
        "row per score and region.",
    )
    tables = (
        *(study_tables.every_scan(clean, "scans") if clean else ()),
        *(study_tables.every_scan(noisy, "noisy_scans") if noisy else ()),
    )
    return PageSection("Every scan and its folder", lines, tables)


def _picture(stem: str, caption: str, figure: Figure) -> Picture:
    return Picture(caption, figures.png(figure), caption, f"pictures/{stem}.png")
