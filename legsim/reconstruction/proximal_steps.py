"""Steps to the least 1/2 |A f - p|^2 plus a convex penalty: proximal gradient, never uphill.

Step lengths are those of Barzilai and Borwein, each followed by a line search (SpaRSA of Wright,
Nowak and Figueiredo, IEEE Trans Signal Process 57, 2009). Without a penalty but f >= 0 that is
GPSR-BB, monotone variant, of the same authors (IEEE J Sel Top Signal Process 1, 2007, section III).
"""

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from legsim.core.values import Float32Array
from legsim.reconstruction.system_matrix import SystemMatrix, dot, energy

_MOST_TRIALS = 10
"""times that a penalty is asked for its nearest volume"""


class Penalty(Protocol):
    """A convex function of volumes without negative values."""

    def value(self, volume: Float32Array) -> float:
        """The penalty of a volume (z, y, x)."""
        ...

    def nearest(self, volume: Float32Array, length: float) -> Float32Array:
        """The x >= 0 with the least 1/2 |x - volume|^2 + length x penalty: its proximal map.

        It may be near it only, and nearer when it is asked again.
        """
        ...


class Nonnegative:
    """No penalty, but that no value is below 0."""

    def value(self, volume: Float32Array) -> float:
        return 0.0

    def nearest(self, volume: Float32Array, length: float) -> Float32Array:
        return np.maximum(volume, 0)


def steps(
    system: SystemMatrix,
    found: Float32Array,
    residual: Float32Array,
    iterations: int,
    penalty: Penalty,
) -> Iterator[float]:
    """Takes steps from ``found`` (z, y, x), 0 or above, with its ``residual`` p - A f, in place.

    Yields the objective after each; ends early at the minimum. Of a step to ``nearest`` the share
    is taken that lowers a bound of the objective most: the misfit is quadratic along it, and a
    convex penalty lies below its chord.
    """
    gradient = system.adjoint(residual)
    length = _steepest_length(system, np.where((found > 0) | (gradient > 0), gradient, 0))
    level = penalty.value(found)
    for _ in range(iterations):
        change, gain = _downhill(found, gradient, length, level, penalty)
        if gain <= 0:
            return
        size, seen = energy(change), system.forward(change)
        curvature = energy(seen)
        share = np.float32(min(gain / curvature, 1)) if curvature else np.float32(1)
        # of two nonnegative values, so that rounding leaves none below 0
        np.maximum(found + share * change, 0, out=found)
        residual -= share * seen
        level = penalty.value(found)
        gradient = system.adjoint(residual)
        length = np.float32(size / curvature) if curvature else length
        yield 0.5 * energy(residual) + level


def _downhill(
    found: Float32Array, gradient: Float32Array, length: np.float32, level: float, penalty: Penalty
) -> tuple[Float32Array, float]:
    """A change of ``found``, and how steeply the objective falls along it; 0 at the minimum.

    The exact nearest volume always leads downhill. One that is not yet near enough is asked for
    again.
    """
    target = np.add(found, length * gradient, dtype=np.float32)
    for _ in range(_MOST_TRIALS):
        nearest = penalty.nearest(target, float(length))
        change = nearest - found
        gain = dot(gradient, change) - (penalty.value(nearest) - level)
        if gain > 0:
            return change, gain
    return np.zeros_like(found), 0.0


def _steepest_length(system: SystemMatrix, gradient: Float32Array) -> np.float32:
    """Length of the exact step along the gradient; 0 where that is zero."""
    size = energy(gradient)
    return np.float32(size / energy(system.forward(gradient)) if size else 0.0)
