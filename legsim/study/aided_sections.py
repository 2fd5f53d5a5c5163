"""The sections of a study's report on sensors and what aids them: their motion, and volumes."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from legsim import figures
from legsim.evaluation.scores import spread
from legsim.figures import BoxGroup
from legsim.report import published_tables
from legsim.report.page import PageSection, Picture, Table
from legsim.report.published_tables import NONE, counted
from legsim.study import results as study_results
from legsim.study import statistics, tables
from legsim.study.results import AidedScore, ScanScore, methods_of

SHARP_PX = 0.1
"""of motion that was not undone, after similarity: less does not blur a volume that is seen"""

_NOT_DRAWN = "dead-reckoning"
"""meters off: it would hide all others"""


def headlines(scores: Sequence[AidedScore]) -> list[str]:
    """Share of the scans that stay sharp, one line per sensor and aid that ever do."""
    lines = []
    for sensor, aid, chosen in _cells(scores):
        sharp, count = _sharp(chosen)
        if sharp:
            lines.append(
                f"{aid} with {_named(sensor)}: {sharp} of {counted(count, 'scan')} within "
                f"{SHARP_PX:g} px after similarity."
            )
    return lines


def of_motion(scores: Sequence[AidedScore]) -> tuple[PageSection, ...]:
    """Errors of the motion by sensor and aid; nothing where the study has none."""
    if not scores:
        return ()
    scans = tuple(dict.fromkeys((s.subject, s.posture) for s in scores))
    draws = 1 + max(s.repetition for s in scores)
    lines = (
        f"One sensor on the bone, {_started(scores)}, in {counted(len(scans), 'scan')} with "
        f"{counted(draws, 'draw')} of its errors each. Shadows of beads and fiducials are exact "
        "with noise; no image is made. px after similarity is what blurs a volume "
        "(docs/methods.md, Errors). Every draw is a row of aided.csv.",
    )
    drawn = figures.box_plots(
        [
            BoxGroup(_named(sensor), aid, _by_scan(chosen, lambda s: s.px_after_similarity))
            for sensor, aid, chosen in _cells(scores)
            if aid != _NOT_DRAWN
        ],
        axis_label="px after similarity",
    )
    caption = (
        "Motion that was not undone, by sensor and aid: one dot per scan (mean of its draws), "
        f"median, quartiles, whiskers from the 5th to the 95th percentile. {_NOT_DRAWN} is meters "
        "off and not drawn."
    )
    picture = Picture(caption, figures.png(drawn), caption, "pictures/aided-px.png")
    return (
        PageSection(
            "Sensors and what aids them, without images",
            lines,
            (_table(scores), *_scan_tables(scores)),
            (picture,),
        ),
    )


def of_volumes(scores: Sequence[ScanScore]) -> tuple[PageSection, ...]:
    """Image quality by sensor and method; nothing where the study has none."""
    if not scores:
        return ()
    whole = study_results.regions(scores)[0]
    take = statistics.of_region("ssim", whole)
    groups = [
        BoxGroup(
            _named(sensor),
            method,
            np.array(list(statistics.per_scan(statistics.of_method(block, method), take).values())),
        )
        for sensor, block in _by_sensor(scores)
        for method in methods_of(block)
    ]
    how = study_results.protocol(scores)
    caption = f"SSIM of the whole leg by sensor and method: one dot per scan. {how}"
    drawn = figures.box_plots(groups, axis_label="SSIM, whole leg")
    picture = Picture(caption, figures.png(drawn), caption, "pictures/aided-ssim.png")
    return (
        PageSection(
            "Sensors and what aids them, in images", (), (_volume_table(scores),), (picture,)
        ),
    )


def _by_sensor(scores: Sequence[ScanScore]) -> list[tuple[str, tuple[ScanScore, ...]]]:
    names = dict.fromkeys(s.sensor for s in scores)
    return [(name, tuple(s for s in scores if s.sensor == name)) for name in names]


def _cells(scores: Sequence[AidedScore]) -> list[tuple[str, str, tuple[AidedScore, ...]]]:
    """Sensor, aid and scores, in the order of the scores."""
    found: dict[tuple[str, str], list[AidedScore]] = {}
    for score in scores:
        found.setdefault((score.sensor, score.aid), []).append(score)
    sensors, aids = (dict.fromkeys(key[k] for key in found) for k in (0, 1))
    return [(s, a, tuple(found[s, a])) for s in sensors for a in aids if (s, a) in found]


def _named(sensor: str) -> str:
    return "no errors" if sensor == "none" else sensor


def _started(scores: Sequence[AidedScore]) -> str:
    """How the sensors' starts were found."""
    named = {"rough": "from a rough start", "truth": "from its true start"}
    named["fiducials"] = "from a start that fiducials show"
    found = [named.get(s.start, "from the start of the settings") for s in scores]
    return " or ".join(dict.fromkeys(found))


def _by_scan(scores: Iterable[AidedScore], measure: Callable[[AidedScore], float]) -> np.ndarray:
    """Mean over the draws of each scan."""
    found: dict[tuple[str, str], list[float]] = {}
    for score in scores:
        found.setdefault((score.subject, score.posture), []).append(measure(score))
    return np.array([float(np.mean(values)) for values in found.values()])


def _sharp(scores: Sequence[AidedScore]) -> tuple[int, int]:
    """Scans whose mean over the draws stays sharp, and all."""
    by_scan = _by_scan(scores, lambda s: s.px_after_similarity)
    return int((by_scan <= SHARP_PX).sum()), len(by_scan)


def _table(scores: Sequence[AidedScore]) -> Table:
    """One row per aid, headed by the sensor."""
    rows: list[tuple[str, ...]] = []
    for sensor, aid, chosen in _cells(scores):
        if (f"{_named(sensor)}",) not in rows:
            rows.append((_named(sensor),))
        px = [s.px_after_similarity for s in chosen]
        sharp, count = _sharp(chosen)
        rows.append(
            (
                aid,
                _mean(chosen, lambda s: s.px_after_similarity),
                tables.size(float(np.median(px))),
                tables.size(max(px)),
                f"{sharp} of {count}",
                _mean(chosen, lambda s: s.px),
                _mean(chosen, lambda s: s.mm),
                _mean(chosen, lambda s: s.degrees),
                f"{sum(s.followed for s in chosen)} of {len(chosen)}",
            )
        )
    columns = (
        *("aid", "px after similarity", "median", "greatest", f"scans within {SHARP_PX:g} px"),
        *("px", "mm", "degrees", "followed"),
    )
    note = (
        "RMS over views and points of the bone; mean ± standard deviation over scans, draws "
        "averaged first; median and greatest of all draws. Scans within: mean of the draws. "
        "Followed: in how many draws the method followed a motion; elsewhere it left the scan as "
        "it is."
    )
    return Table(
        "Motion that was not undone, by sensor and aid", columns, tuple(rows), note, "aided"
    )


def _mean(scores: Sequence[AidedScore], measure: Callable[[AidedScore], float]) -> str:
    found = spread(_by_scan(scores, measure).tolist())
    if found is None:
        return NONE
    alone = found.count < 2
    return tables.size(found.mean) + ("" if alone else f" ± {tables.size(found.deviation)}")


def _scan_tables(scores: Sequence[AidedScore]) -> list[Table]:
    """px after similarity of every scan by aid, one table per sensor."""
    made = []
    for sensor in dict.fromkeys(s.sensor for s in scores):
        own = [s for s in scores if s.sensor == sensor]
        aids = tuple(dict.fromkeys(s.aid for s in own))
        rows = []
        for subject, posture in dict.fromkeys((s.subject, s.posture) for s in own):
            scan = [s for s in own if (s.subject, s.posture) == (subject, posture)]
            means = (np.mean([s.px_after_similarity for s in scan if s.aid == aid]) for aid in aids)
            rows.append((f"{subject}, {posture}", *(tables.size(float(m)) for m in means)))
        made.append(
            Table(
                f"px after similarity, scan by scan: {_named(sensor)}",
                ("scan", *aids),
                tuple(rows),
                "Mean over the draws.",
                f"aided_{sensor.rpartition('/')[2].removesuffix('.toml')}",
            )
        )
    return made


def _volume_table(scores: Sequence[ScanScore]) -> Table:
    """One row per method, headed by the sensor."""
    regions, rows = study_results.regions(scores), []
    for sensor, block in _by_sensor(scores):
        count = len({(s.subject, s.posture) for s in block})
        rows.append((f"{_named(sensor)} ({counted(count, 'scan')})",))
        for method in methods_of(block):
            chosen = statistics.of_method(block, method)
            cells = [
                published_tables.text(
                    statistics.over_scans(chosen, statistics.of_region(measure, region)), 4
                )
                for measure in ("ssim", "rmse")
                for region in regions
            ]
            rows.append((method, *cells))
    columns = ("method", *(f"{m} {region}" for m in ("SSIM", "RMSE") for region in regions))
    note = f"{tables.SPREAD_NOTE} {study_results.protocol(scores)}"
    return Table("Image quality by sensor and method", columns, tuple(rows), note, "aided_volumes")
