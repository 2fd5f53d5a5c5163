"""The tables of a study's report: ours beside the published values, what was left of the motion,
tests, and every scan with its folder.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from legsim.evaluation.registration import RegistrationError
from legsim.evaluation.scores import MeanAndDeviation, spread
from legsim.imu.noise import Convention
from legsim.report import published_tables, published_values
from legsim.report.page import Table
from legsim.report.published_tables import NONE, Entry, counted, quality_entry
from legsim.study import results, statistics
from legsim.study.results import NoiseLevel, ScanScore, SensorScore, StageCost
from legsim.study.statistics import LadderCell, Measure, PairedTest

SPREAD_NOTE = "Mean ± standard deviation (of a sample, n − 1) over scans."


def quality(scores: Sequence[ScanScore]) -> tuple[Table, Table]:
    """SSIM and RMSE by condition, method and region."""
    kinds = []
    for measure in ("SSIM", "RMSE"):
        entries = []
        for condition, method, group, label, of_method in _rows(scores):
            for region in results.regions(scores):
                ours = statistics.over_scans(
                    of_method, statistics.of_region(measure.lower(), region)
                )
                published = quality_entry(measure, condition, method, region, ours).published
                entries.append(Entry(group, label, region, ours, published))
        kinds.append(entries)
    return published_tables.quality_tables(
        kinds[0], kinds[1], "Table 1, seven scans a condition", results.protocol(scores)
    )


def to_phantom(scores: Sequence[ScanScore]) -> Table | None:
    """SSIM and RMSE to the phantom itself, which has no streaks; None where they are unknown."""
    columns = [
        (f"{measure} {region}", _mean_of(statistics.of_region(f"{field}_phantom", region), 3))
        for measure, field in (("SSIM", "ssim"), ("RMSE", "rmse"))
        for region in results.regions(scores)
    ]
    return _by_method(
        "SSIM and RMSE to the phantom",
        scores,
        columns,
        f"{published_tables.PHANTOM} {results.protocol(scores)} {SPREAD_NOTE}",
        "phantom",
    )


def _rows(scores: Sequence[ScanScore]) -> list[tuple[str, str, str, str, tuple[ScanScore, ...]]]:
    """(condition, method, heading, label, scores) of each row of a table by condition and
    method.
    """
    rows = []
    for condition, block in statistics.blocks(scores).items():
        counts = {
            m: len({(s.subject, s.posture) for s in statistics.of_method(block, m)})
            for m in results.methods_of(block)
        }
        most = max(counts.values())
        group = f"{published_tables.heading(condition)} ({counted(most, 'scan')})"
        for method, count in counts.items():
            label = method if count == most else f"{method} ({counted(count, 'scan')})"
            rows.append((condition, method, group, label, statistics.of_method(block, method)))
    return rows


def _by_method(
    caption: str,
    scores: Sequence[ScanScore],
    columns: Sequence[tuple[str, Callable[[Sequence[ScanScore]], str]]],
    note: str,
    name: str,
) -> Table | None:
    """One row per condition and method, without columns that are empty everywhere; None where no
    column is left.
    """
    rows = _rows(scores)
    filled = [(head, [take(of_method) for *_, of_method in rows]) for head, take in columns]
    filled = [(head, cells) for head, cells in filled if set(cells) != {NONE}]
    if not filled:
        return None
    lines: list[tuple[str, ...]] = []
    for k, (_, _, group, label, _) in enumerate(rows):
        if k == 0 or rows[k - 1][2] != group:
            lines.append((group,))
        lines.append((label, *(cells[k] for _, cells in filled)))
    return Table(caption, ("method", *(head for head, _ in filled)), tuple(lines), note, name)


def _mean_of(measure: Measure, digits: int) -> Callable[[Sequence[ScanScore]], str]:
    return lambda scores: published_tables.text(statistics.over_scans(scores, measure), digits)


def residuals(scores: Sequence[ScanScore]) -> tuple[Table, ...]:
    """One table per unit: what was left of the motion, by structure."""
    structures = tuple(dict.fromkeys(r.structure for score in scores for r in score.residuals))
    notes = {
        "mm": (
            "How far the method has the points of each structure from where they were. "
            "Deformed images know no depth: pixels alone."
        ),
        "degrees": "By how much a bone is turned in excess.",
        "pixels": (
            "How far apart the images see where the method has the points and where they were."
        ),
        "pixels_after_similarity": (
            "The same after the constant turn, shift and scale of the scene that bring all bones "
            "nearest. Images cannot tell these three, and they blur nothing."
        ),
    }
    tables = []
    for unit, note in notes.items():
        columns = [(s, _mean_of(statistics.of_structure(unit, s), 2)) for s in structures]
        tables.append(
            _by_method(
                f"Motion that was not undone ({unit.replace('_', ' ')})",
                scores,
                columns,
                f"RMS over views and points within a scan, before any registration. {note} "
                f"{SPREAD_NOTE}",
                f"residuals_{unit}",
            )
        )
    return tuple(t for t in tables if t is not None)


def sharpness(scores: Sequence[ScanScore]) -> Table | None:
    """Gradient entropy by region, and seconds."""
    columns = [
        (f"gradient entropy {r}", _mean_of(statistics.of_region("gradient_entropy", r), 3))
        for r in results.regions(scores)
    ]
    note = (
        f"{published_tables.ENTROPY} Seconds: estimation, with the images of beads that only some "
        f"methods have, and reconstruction. {SPREAD_NOTE}"
    )
    return _by_method(
        "Sharpness and time",
        scores,
        [*columns, ("seconds", _mean_of(lambda s: s.seconds, 1))],
        note,
        "sharpness",
    )


def registration(
    scores: Sequence[ScanScore], errors: Sequence[RegistrationError] = ()
) -> Table | None:
    """What the registration to the motion-free volume found: part of a method's error that SSIM and
    RMSE do not see.

    ``errors`` are the registration's own, one per scan, and stand in the note.
    """

    def largest(field: str) -> Callable[[Sequence[ScanScore]], str]:
        def take(chosen: Sequence[ScanScore]) -> str:
            found = statistics.over_scans(chosen, statistics.of_registration(field))
            return NONE if found is None else f"{found.largest:.2f}"

        return take

    def applied(chosen: Sequence[ScanScore]) -> str:
        found = [
            s.metrics.registration.applied for s in chosen if s.metrics.registration is not None
        ]
        return f"{sum(found)} of {len(found)}" if found else NONE

    columns = []
    for field, what in (("translation_mm", "shift (mm)"), ("rotation_deg", "rotation (deg)")):
        columns += [
            (what, _mean_of(statistics.of_registration(field), 2)),
            (f"largest {what}", largest(field)),
        ]
    note = (
        "The rigid transform found between each volume and the motion-free one before they were "
        "compared, and in how many scans it was "
        f"applied because it raised the correlation. {_own_error(errors)}{SPREAD_NOTE}"
    )
    return _by_method(
        "Registration to the motion-free volume",
        scores,
        [*columns, ("applied", applied)],
        note,
        "registration",
    )


def _own_error(errors: Sequence[RegistrationError]) -> str:
    shift, turn = spread(e.translation_mm for e in errors), spread(e.rotation_deg for e in errors)
    if shift is None or turn is None:
        return ""
    mean, largest = (
        f"{size(mm)} mm and {size(deg)}°"
        for mm, deg in ((shift.mean, turn.mean), (shift.largest, turn.largest))
    )
    return (
        "The registration's own error, by which it misses a known motion of about a millimeter "
        "and a degree of the motion-free volume: "
        f"mean {mean}, at most {largest}, in {counted(shift.count, 'scan')}. "
    )


def tests(caption: str, found: Sequence[PairedTest], name: str, how: str) -> Table:
    """A matrix: the median difference above the diagonal, Holm's p below it.

    ``how`` says how volumes were compared.
    """
    methods = tuple(dict.fromkeys(m for test in found for m in (test.first, test.second)))
    pairs = {(test.first, test.second): test for test in found}

    def cell(row: int, column: int) -> str:
        if row == column:
            return ""
        test = pairs[methods[min(row, column)], methods[max(row, column)]]
        if test.p_holm is None:
            return "too few scans"
        return (
            f"{test.median_difference:+.4f}".replace("-", "−")
            if row < column
            else p_text(test.p_holm)
        )

    rows = tuple(
        (method, *(cell(i, j) for j in range(len(methods)))) for i, method in enumerate(methods)
    )
    note = (
        "Below the diagonal: p of Wilcoxon's signed-rank test (two-sided, exact), adjusted by "
        "Holm for all pairs of this table. "
        f"Above it: the median difference, row minus column. {how}"
    ).rstrip()
    return Table(caption, ("method", *methods), rows, note, name)


def p_text(p: float) -> str:
    """Three digits after the point, or less than the last of them."""
    return "<0.001" if p < 0.001 else f"{p:.3f}"


def ladder(cells: dict[NoiseLevel, LadderCell], convention: Convention) -> Table:
    """One row per pair of exponents, headed by the accelerometer's: ours, the published mean
    and their ratio.
    """
    rows: list[tuple[str, ...]] = []
    levels = [level for level in cells if level.convention == convention]
    for f_a in sorted({level.f_a for level in levels}, key=_last):
        rows.append((f"f_a = {exponent(f_a)}",))
        for level in sorted(
            (level for level in levels if level.f_a == f_a), key=lambda level: _last(level.f_g)
        ):
            cell, published = cells[level], published_values.deviation(level.f_a, level.f_g)
            shift = _beside(cell.translation_mm, published and published.translation_mm)
            rows.append(
                (
                    exponent(level.f_g),
                    *shift,
                    *_beside(cell.rotation_deg, published and published.rotation_deg),
                )
            )
    count = max((cells[level].translation_mm.count for level in levels), default=0)
    over = (
        "one draw of noise"
        if count == 1
        else f"mean ± standard deviation of {count} draws of noise"
    )
    note = (
        f"RMSE over the views of noisy against noise-free motion, mean of three axes, {over}. "
        f"Convention of the noise: {convention}. Published: Maier et al. 2021, Table 2. The "
        "numbers "
        "span nine powers of ten, so their ratio "
        "stands where a difference would say nothing."
    )
    columns = ("f_g", "translation (mm)", "published translation", "ours / published translation")
    columns = (*columns, "rotation (deg)", "published rotation", "ours / published rotation")
    return Table(
        f"Noise ladder, {convention} convention", columns, tuple(rows), note, f"ladder_{convention}"
    )


def catalogued(scores: Sequence[SensorScore]) -> Table:
    """One row per sensor of the catalogue, headed by the calibration before the scan."""
    rows: list[tuple[str, ...]] = []
    headings = {
        "none": "not calibrated, exact start",
        "rest": "rest before the scan",
        "six-positions": "six positions and a rest before the scan",
    }
    for calibration in dict.fromkeys(s.calibration for s in scores):
        rows.append((headings[calibration],))
        for sensor in dict.fromkeys(s.sensor for s in scores):
            found = [s for s in scores if (s.sensor, s.calibration) == (sensor, calibration)]
            sizes = (spread(s.translation_mm for s in found), spread(s.rotation_deg for s in found))
            rows.append((sensor, *(_alone(of) for of in sizes)))
    note = (
        "RMSE over the views of the motion from the sensor's readings against that from exact "
        "ones, mean of three axes, mean ± standard deviation over draws and scans. A rest removes "
        "the gyroscope's bias and levels the start; six positions calibrate the accelerometer. "
        "What a sensor's file marks as missing (legsim sensors NAME) is not in its row."
    )
    columns = ("sensor", "translation (mm)", "rotation (deg)")
    return Table("Sensors that one can buy", columns, tuple(rows), note, "sensors")


def _alone(ours: MeanAndDeviation | None) -> str:
    return NONE if ours is None else _beside(ours, None)[0]


def exponent(value: float | None) -> str:
    """As it is written in tables and pictures."""
    return "no noise" if value is None else f"{value:g}"


def _last(value: float | None) -> float:
    """Sorts "no noise" behind all exponents."""
    return float("inf") if value is None else value


def _beside(ours: MeanAndDeviation, published: float | None) -> tuple[str, str, str]:
    alone = ours.count < 2
    text = size(ours.mean) if alone else f"{size(ours.mean)} ± {size(ours.deviation)}"
    ratio = NONE if not published or not ours.mean else size(ours.mean / published)
    return text, NONE if published is None else size(published), ratio


def size(value: float) -> str:
    """Two or three digits of a number of any size: 8470, 0.943, 2.0e-5."""
    if math.isnan(value):
        return NONE
    if value == 0 or abs(value) >= 100:
        return f"{value:.0f}"
    if abs(value) >= 0.01:
        return f"{value:.3g}"
    mantissa, _, power = f"{value:.1e}".partition("e")
    return f"{mantissa}e{int(power)}"


@dataclass(frozen=True, slots=True)
class _NoiseGroup:
    """Scores of one method at one level of noise, as read by one convention."""

    method: str
    convention: str
    level: tuple[float | None, float | None]
    """f_a, f_g; both None without noise"""
    scores: tuple[ScanScore, ...]

    @property
    def heading(self) -> str:
        return f"{self.method}, noise read as {self.convention}"

    @property
    def label(self) -> str:
        if self.level == (None, None):
            return "no noise"
        f_a, f_g = self.level
        return f"f_a = {exponent(f_a)}, f_g = {exponent(f_g)}"


def _noise_groups(noisy: Sequence[ScanScore], clean: Sequence[ScanScore]) -> Iterator[_NoiseGroup]:
    """By convention, method and level, the clean ones of the method first."""
    for convention in dict.fromkeys(s.noise.convention for s in noisy if s.noise is not None):
        of_convention = [s for s in noisy if s.noise and s.noise.convention == convention]
        for method in results.methods_of(of_convention):
            without = tuple(statistics.of_method(clean, method))
            yield _NoiseGroup(method, convention, (None, None), without)
            of_level: dict[tuple[float | None, float | None], list[ScanScore]] = {}
            for score in statistics.of_method(of_convention, method):
                if score.noise is not None:
                    of_level.setdefault((score.noise.f_a, score.noise.f_g), []).append(score)
            for level, chosen in of_level.items():
                same = without if level == (None, None) else tuple(chosen)
                yield _NoiseGroup(method, convention, level, same)


def noisy_quality(scores: Sequence[ScanScore]) -> tuple[Table, Table]:
    """SSIM and RMSE of reconstructions from noisy sensors, with the clean ones of the same scans,
    by convention and method.
    """
    noisy = [s for s in scores if s.noise is not None]
    scans = {(s.subject, s.posture) for s in noisy}
    # the published values are of held squats, and say nothing of other recordings
    squats = all(results.condition(posture) in statistics.POOLED for _, posture in scans)
    clean = [s for s in scores if s.clean and (s.subject, s.posture) in scans]
    ssim, rmse = [], []
    for group in _noise_groups(noisy, clean):
        ended, label = len({(s.subject, s.posture) for s in group.scores}), group.label
        if ended < len(scans):
            label = f"{label} ({ended} of {counted(len(scans), 'scan')})"
        for region in results.regions(noisy):
            published = squats and group.method == "rigid"
            for entries, measure, published_of in (
                (ssim, "ssim", published_values.noisy_ssim),
                (rmse, "rmse", published_values.noisy_rmse),
            ):
                ours = statistics.over_scans(group.scores, statistics.of_region(measure, region))
                theirs = published_of(*group.level, region) if published else None
                entries.append(Entry(group.heading, label, region, ours, theirs))
    note = (
        f"Over {counted(len(scans), 'scan')}; repetitions of a scan are averaged first. "
        f"{SPREAD_NOTE} The noise of the sensors is divided "
        f"by 10^f_a (accelerometer) and 10^f_g (gyroscope). {results.protocol(noisy)}"
    )
    source = "Maier et al. 2021, Table 3"
    return (
        published_tables.table(
            "SSIM from noisy sensors",
            "noise",
            ssim,
            note=note,
            source=source,
            name="noisy_ssim",
        ),
        published_tables.table(
            "RMSE from noisy sensors",
            "noise",
            rmse,
            note=note,
            source=source,
            name="noisy_rmse",
        ),
    )


def costs(stages: Sequence[StageCost]) -> Table:
    """Seconds and memory of every stage that the runs went through."""
    rows = [
        (
            c.stage,
            str(c.runs),
            f"{c.seconds:.1f}",
            NONE if c.peak_mib is None else f"{c.peak_mib:.0f}",
        )
        for c in stages
    ]
    note = (
        "Mean over the runs that computed the stage; what runs share is counted once. The "
        "most memory that a process held during it."
    )
    return Table(
        "Cost by stage",
        ("stage", "runs", "seconds", "peak memory (MiB)"),
        tuple(rows),
        note,
        "costs",
    )


def every_scan(scores: Sequence[ScanScore], name: str) -> tuple[Table, ...]:
    """One row per run, linked to its folder: SSIM, then RMSE, of the whole leg by method."""
    whole = results.regions(scores)[0]
    methods = results.methods_of(scores)
    runs: dict[tuple[str, str, str], dict[str, ScanScore]] = {}
    for score in scores:
        noise = "" if score.noise is None else f", {score.noise.label}, draw {score.repetition + 1}"
        if score.sensor:
            noise = f", {score.sensor}, draw {score.repetition + 1}"
        runs.setdefault((f"{score.subject}, {score.posture}{noise}", score.folder, noise), {})[
            score.method
        ] = score
    tables = []
    for measure in ("ssim", "rmse"):
        take = statistics.of_region(measure, whole)
        rows = []
        for (label, folder, _), found in runs.items():
            values = [take(found[m]) if m in found else None for m in methods]
            rows.append((label, *(NONE if v is None else f"{v:.4f}" for v in values), folder))
        caption = (
            f"{measure.upper()} of the {'whole leg' if whole == 'leg' else whole}, scan by scan"
        )
        links = tuple(folder for _, folder, _ in runs)
        tables.append(
            Table(
                caption,
                ("scan", *methods, "run folder"),
                tuple(rows),
                results.protocol(scores),
                f"{name}_{measure}",
                links,
            )
        )
    return tuple(tables)
