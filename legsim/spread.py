"""Mean and standard deviation of a few values."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and standard deviation (of a sample: over n - 1) of n values."""

    mean: float
    deviation: float
    """NaN for a single value"""
    count: int
    largest: float


def spread(values: Iterable[float]) -> Spread | None:
    """Of the values; None where there are none."""
    array = np.array(tuple(values), float)
    if len(array) == 0:
        return None
    deviation = float(array.std(ddof=1)) if len(array) > 1 else float("nan")
    return Spread(float(array.mean()), deviation, len(array), float(array.max()))
