"""Scores of methods and their statistics."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from legsim.evaluation.registration import Registration
from legsim.evaluation.residual_motion import Residual
from legsim.evaluation.similarity import RegionScores, Scores


def scores_from(entry: dict[str, Any]) -> Scores:
    """Restores scores from the output of ``dataclasses.asdict``."""
    registration = entry["registration"]
    return Scores(
        tuple(RegionScores(**r) for r in entry["regions"]),
        None if registration is None else Registration(**registration),
        entry["scaling"],
        entry["window"],
        entry["registered"],
    )


@dataclass(frozen=True, slots=True)
class MethodResult:
    """One row of the score table."""

    method: str
    metrics: Scores
    residual_mm: float | None
    """RMS over the views at femur and tibia of the residual motion

    None for the motion-free scan and for warped images.
    """
    seconds: float
    """time of estimation and reconstruction"""
    residuals: tuple[Residual, ...] = ()
    """the same by bone and at the skin, with degrees and pixels"""

    @property
    def residual_px(self) -> float:
        """RMS in pixels over the bones between true and corrected positions in the images."""
        bones = [r.pixels for r in self.residuals if r.structure != "skin"]
        return float(np.sqrt(np.mean(np.square(bones)))) if bones else float("nan")

    @property
    def residual_px_after_similarity(self) -> float:
        """The same after the one constant similarity that images cannot see."""
        bones = [r.pixels_after_similarity for r in self.residuals if r.structure != "skin"]
        known = [pixels for pixels in bones if pixels is not None]
        return float(np.sqrt(np.mean(np.square(known)))) if known else float("nan")


def result_from(entry: dict[str, Any]) -> MethodResult:
    """Restores a result from an entry of metrics.json."""
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
    """Computes mean and deviation of the values; None where there are none."""
    array = np.array(tuple(values), float)
    if len(array) == 0:
        return None
    deviation = float(array.std(ddof=1)) if len(array) > 1 else float("nan")
    return MeanAndDeviation(float(array.mean()), deviation, len(array), float(array.max()))
