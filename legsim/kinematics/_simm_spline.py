"""OpenSim's SimmSpline: the cubic spline through which gait2392's knee moves, evaluated exactly
with two derivatives.

Rules (checked against OpenSim to rounding): cubic between knots with continuous value, slope and
second derivative; on the first and last interval the third derivative is six times the third
divided difference of the four end knots (Forsythe, Malcolm and Moler 1977, SPLINE); outside the
knots a straight line with the end slope.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen


class SimmSpline:
    """A function of one variable given by at least two knots ``x`` (k,), strictly increasing, and
    values ``y`` (k,): a straight line through two, a parabola through three.
    """

    __slots__ = ("_coefficients", "x", "y")

    def __init__(self, x: Sequence[float] | FloatArray, y: Sequence[float] | FloatArray) -> None:
        self.x = frozen("SimmSpline.x", x, (None,))
        self.y = frozen("SimmSpline.y", y, (len(self.x),))
        if len(self.x) < 2 or (np.diff(self.x) <= 0).any():
            raise LegsimError(
                "a SimmSpline needs at least two knots with x strictly increasing; got x = "
                f"{list(self.x)}"
            )
        self._coefficients = _cubics(self.x, self.y)

    def __call__(self, x: ArrayLike) -> FloatArray:
        """Values at ``x``, same shape."""
        return self.with_derivatives(x)[0]

    def with_derivatives(self, x: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Value, first and second derivative at ``x``, each of its shape."""
        x = np.asarray(x, float)
        inside = np.clip(x, self.x[0], self.x[-1])
        # the knot that starts the interval; the last knot belongs to the last interval
        k = np.clip(np.searchsorted(self.x, inside, side="right") - 1, 0, len(self.x) - 2)
        c0, c1, c2, c3 = self._coefficients[:, k]
        d = inside - self.x[k]
        slope = c1 + d * (2 * c2 + 3 * c3 * d)
        value = c0 + d * (c1 + d * (c2 + c3 * d)) + slope * (x - inside)
        second = np.where(x == inside, 2 * c2 + 6 * c3 * d, 0.0)
        return value, slope, second


def _cubics(x: FloatArray, y: FloatArray) -> FloatArray:
    """Coefficients (4, k - 1) of value = c0 + c1 d + c2 d^2 + c3 d^3 with d measured from the
    interval's first knot.
    """
    n, h = len(x), np.diff(x)
    divided = (y[1:] - y[:-1]) / h
    if n == 2:
        return np.array([[y[0]], [divided[0]], [0.0], [0.0]])
    # unknowns s_i = S''(x_i) / 6
    system, right = np.zeros((n, n)), np.zeros(n)
    for i in range(1, n - 1):
        system[i, i - 1 : i + 2] = h[i - 1], 2 * (h[i - 1] + h[i]), h[i]
        right[i] = divided[i] - divided[i - 1]
    system[0, :2], system[-1, -2:] = (-1 / h[0], 1 / h[0]), (-1 / h[-1], 1 / h[-1])
    if n > 3:
        right[0] = _third_divided_difference(x[:4], y[:4])
        right[-1] = _third_divided_difference(x[-4:], y[-4:])
    s = np.asarray(np.linalg.solve(system, right), np.float64)
    return np.stack([y[:-1], divided - h * (2 * s[:-1] + s[1:]), 3 * s[:-1], np.diff(s) / h])


def _third_divided_difference(x: FloatArray, y: FloatArray) -> float:
    """[y0, y1, y2, y3] on four knots."""
    for order in range(1, 4):
        y = (y[1:] - y[:-1]) / (x[order:] - x[:-order])
    return float(y[0])
