"""Over the scans of a study: means and standard deviations, paired tests between methods, and the
means of the noise ladder.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from scipy import stats

from legsim.evaluation.scores import MeanAndDeviation, spread
from legsim.imu.noise import Convention
from legsim.study import results
from legsim.study.results import LadderScore, NoiseLevel, ScanScore

FEWEST_SCANS = 6
"""for a paired test: with fewer, not even all differences of one sign reach p < 0.05"""

LIMIT_MM = 1.0

LIMIT_DEG = 1.0
"""deviations above which the study expects images to suffer (Maier et al. 2021, section 4.2)"""

POOLED = ("30", "60")
"""conditions that the published study also takes together"""

Scan = tuple[str, str]
"""subject and posture"""

Measure = Callable[[ScanScore], float | None]
"""what is taken from a score; None where the method has no such number"""


def of_region(field: str, region: str) -> Measure:
    """A number of the image quality in one region: a field of ``RegionScores``."""

    def take(score: ScanScore) -> float | None:
        return next((getattr(m, field) for m in score.metrics.regions if m.region == region), None)

    return take


def of_structure(field: str, structure: str) -> Measure:
    """A residual of one structure: mm, degrees, pixels or pixels_after_similarity."""

    def take(score: ScanScore) -> float | None:
        return next((getattr(r, field) for r in score.residuals if r.structure == structure), None)

    return take


def of_registration(field: str) -> Measure:
    """A number of the registration to the motion-free volume: translation_mm or rotation_deg."""

    def take(score: ScanScore) -> float | None:
        found = score.metrics.registration
        return None if found is None else float(getattr(found, field))

    return take


def per_scan(scores: Iterable[ScanScore], measure: Measure) -> dict[Scan, float]:
    """The measure of each scan, the mean where a scan was repeated; scans without it are left
    out.
    """
    found: dict[Scan, list[float]] = {}
    for score in scores:
        value = measure(score)
        if value is not None:
            found.setdefault((score.subject, score.posture), []).append(value)
    return {scan: float(np.mean(values)) for scan, values in found.items()}


def over_scans(scores: Iterable[ScanScore], measure: Measure) -> MeanAndDeviation | None:
    """Mean and deviation over scans."""
    return spread(per_scan(scores, measure).values())


def blocks(scores: Sequence[ScanScore]) -> dict[str, tuple[ScanScore, ...]]:
    """Scores by condition, in the order of the scores; "all" pools the 30 and 60 degree squats, as
    published, where both are there.
    """
    found: dict[str, tuple[ScanScore, ...]] = {}
    for score in scores:
        name = results.condition(score.posture)
        found[name] = (*found.get(name, ()), score)
    if all(name in found for name in POOLED):
        found["all"] = tuple(s for s in scores if results.condition(s.posture) in POOLED)
    return found


def pools(scores: Sequence[ScanScore]) -> dict[str, tuple[ScanScore, ...]]:
    """Blocks that hold each scan once: the two published squats together, every other condition
    alone.
    """
    found = blocks(scores)
    return {
        name: block
        for name, block in found.items()
        if "all" not in found or name == "all" or name not in POOLED
    }


def of_method(scores: Iterable[ScanScore], method: str) -> tuple[ScanScore, ...]:
    """Those of one method."""
    return tuple(s for s in scores if s.method == method)


@dataclass(frozen=True, slots=True)
class PairedTest:
    """Wilcoxon's signed-rank test of two methods over the scans that both have."""

    first: str
    second: str
    scans: int
    median_difference: float
    """of first minus second"""
    p: float | None
    """two-sided, exact for up to 50 scans; None where scans are too few"""
    p_holm: float | None
    """adjusted by Holm for all pairs of the same family"""


def paired_tests(scores: Sequence[ScanScore], measure: Measure) -> tuple[PairedTest, ...]:
    """Every pair of methods, in the order of the scores, as one family."""
    values = {
        method: per_scan(of_method(scores, method), measure)
        for method in results.methods_of(scores)
    }
    pairs = [
        (a, b, _differences(values[a], values[b]))
        for a, b in combinations([m for m in values if values[m]], 2)
    ]
    found = [_signed_rank(d) for _, _, d in pairs]
    adjusted = iter(holm([p for p in found if p is not None]))
    return tuple(
        PairedTest(
            a,
            b,
            len(d),
            float(np.median(d)) if len(d) else float("nan"),
            p,
            None if p is None else next(adjusted),
        )
        for (a, b, d), p in zip(pairs, found, strict=True)
    )


def _differences(first: Mapping[Scan, float], second: Mapping[Scan, float]) -> np.ndarray:
    return np.array([first[scan] - second[scan] for scan in first if scan in second])


def _signed_rank(differences: np.ndarray) -> float | None:
    if len(differences) < FEWEST_SCANS:
        return None
    unequal = differences[differences != 0]
    if len(unequal) == 0:
        return 1.0
    return float(np.array(stats.wilcoxon(unequal))[1])


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's step-down adjustment (1979): the k-th smallest of m times m - k + 1, never below a
    smaller one's, at most 1.
    """
    order = np.argsort(p_values, kind="stable")
    adjusted = np.empty(len(p_values))
    highest = 0.0
    for rank, index in enumerate(order):
        highest = max(highest, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = highest
    return adjusted.tolist()


@dataclass(frozen=True, slots=True)
class LadderCell:
    """How far one noise level carries the motion, over scans and repetitions."""

    translation_mm: MeanAndDeviation
    rotation_deg: MeanAndDeviation


def ladder_cells(ladder: Iterable[LadderScore]) -> dict[NoiseLevel, LadderCell]:
    """Mean and deviation by noise level, over all repetitions and scans."""
    found: dict[NoiseLevel, list[LadderScore]] = {}
    for score in ladder:
        found.setdefault(score.noise, []).append(score)
    cells = {}
    for level, scores in found.items():
        shift, turn = (
            spread(s.translation_mm for s in scores),
            spread(s.rotation_deg for s in scores),
        )
        assert shift is not None
        assert turn is not None
        cells[level] = LadderCell(shift, turn)
    return cells


def conventions(cells: Mapping[NoiseLevel, LadderCell]) -> tuple[Convention, ...]:
    """Conventions of the noise, in the order of the ladder."""
    return tuple(dict.fromkeys(level.convention for level in cells))


def needed_factor(cells: Mapping[NoiseLevel, LadderCell], convention: Convention) -> float | None:
    """By how much the noise of both sensors must be divided so that its mean errors stay within 1
    mm and 1 degree.

    Straight between the levels of equal exponents in double-logarithmic scale; the noisiest level's
    own factor where even that stays within them. None where the ladder does not come down that far.
    """
    level = [
        (noise.f_a, max(cell.translation_mm.mean / LIMIT_MM, cell.rotation_deg.mean / LIMIT_DEG))
        for noise, cell in cells.items()
        if noise.convention == convention and noise.f_a is not None and noise.f_a == noise.f_g
    ]
    level.sort()
    if level and level[0][1] <= 1:
        return 10 ** level[0][0]
    for (low, above), (high, below) in pairwise(level):
        if above > 1 >= below:
            share = 1.0 if below == 0 else np.log10(above) / np.log10(above / below)
            return float(10 ** (low + share * (high - low)))
    return None
