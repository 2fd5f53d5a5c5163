"""Mean and standard deviation of a few values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from legsim.evaluation.registration import Registration
from legsim.evaluation.residual_motion import Residual
from legsim.evaluation.similarity import RegionScores, Scores

if TYPE_CHECKING:
    pass


def scores_from(entry: dict[str, Any]) -> Scores:
    """Scores from what ``dataclasses.asdict`` made of them."""
    registration = entry["registration"]
    return Scores(
        tuple(RegionScores(**r) for r in entry["regions"]),
        None if registration is None else Registration(**registration),
    )


@dataclass(frozen=True, slots=True)
class MethodResult:
    """One row of the table."""

    method: str
    metrics: Scores
    residual_mm: float | None
    """RMS over the views at femur and tibia of the motion that was not undone; None for the
    motion-free scan and for warped images
    """
    seconds: float
    """estimation and reconstruction"""
    residuals: tuple[Residual, ...] = ()
    """the same by bone and at the skin, with degrees and pixels"""

    @property
    def residual_px(self) -> float:
        """RMS over the bones of where the images see them beside where the method has them."""
        bones = [r.pixels for r in self.residuals if r.structure != "skin"]
        return float(np.sqrt(np.mean(np.square(bones)))) if bones else float("nan")


def result_from(entry: dict[str, Any]) -> MethodResult:
    """From an entry of metrics.json."""
    left = tuple(Residual(**r) for r in entry["residuals"])
    return MethodResult(
        entry["method"],
        scores_from(entry["metrics"]),
        entry["residual_mm"],
        entry["seconds"],
        left,
    )


@dataclass(frozen=True, slots=True)
class MeanAndDeviation:
    """Mean and standard deviation (of a sample: over n - 1) of n values."""

    mean: float
    deviation: float
    """NaN for a single value"""
    count: int
    largest: float


def spread(values: Iterable[float]) -> MeanAndDeviation | None:
    """Of the values; None where there are none."""
    array = np.array(tuple(values), float)
    if len(array) == 0:
        return None
    deviation = float(array.std(ddof=1)) if len(array) > 1 else float("nan")
    return MeanAndDeviation(float(array.mean()), deviation, len(array), float(array.max()))
