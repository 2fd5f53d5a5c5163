"""Samples across gaps: what a spline through noisy samples must not be left to guess.

A spline of fifth degree multiplies the samples' noise by 60 across 20 missing ones, and by 2000 in
the integral over 30. So every longer gap is filled before any spline: with the cubic of least
squares through about as much time beside the gap as is missing in it, half on each side. Where
that is too little for a cubic, as where uneven samples crowd there or one side is short, up to
twice as many samples carry it, or a parabola or a line takes its place: the noise in the gap (RMS)
is never greater than beside it. What a movement did there alone stays unknown.
"""

import numpy as np
from numpy.typing import NDArray

from legsim.core.values import FloatArray

_SPLINED = 2
"""missing samples that a spline may bridge: it adds less noise than they had"""

_BESIDE = 4
"""samples on each side at least, to which the polynomial is fitted, where there are so many"""

MOST = 4096
"""samples in one gap"""


def bridged(times: FloatArray, values: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fills gaps of more than two samples in values (n, ...) at times (n,), at the usual step.

    Only gaps between the first and the last of the times ``at`` (k,) are filled, at which values
    are wanted. Returns times (m,) and values (m, ...); the given samples are among them as they
    are.
    """
    if len(times) < 2 * _BESIDE or not len(at):
        return times, values
    during = (times[1:] > at[0]) & (times[:-1] < at[-1])
    steps, wide = np.diff(times), np.flatnonzero(wide_steps(times) & during)
    if not wide.size:
        return times, values
    step = float(np.median(steps))
    new_times, new_values, first = [], [], 0
    for k in wide:
        missing = int(min(np.rint(steps[k] / step) - 1, MOST))
        within = times[k] + steps[k] * np.arange(1, missing + 1) / (missing + 1)
        new_times += [times[first : k + 1], within]
        new_values += [values[first : k + 1], _across(times, values, int(k), missing, within)]
        first = int(k) + 1
    return (
        np.concatenate([*new_times, times[first:]]),
        np.concatenate([*new_values, values[first:]]),
    )


def about(times: FloatArray, at: FloatArray, margin: float, beside: int = _BESIDE) -> slice:
    """Samples at times (n,) within ``margin`` s of the span of ``at`` (k,), and at least ``beside``
    before and after it, however long the gaps there are.
    """
    first = np.searchsorted(times, [at[0] - margin, at[0]])
    last = np.searchsorted(times, [at[-1] + margin, at[-1]], side="right")
    return slice(max(min(first[0], first[1] - beside), 0), max(last[0], last[1] + beside))


def wide_steps(times: FloatArray) -> NDArray[np.bool_]:
    """Which steps (n - 1,) between samples are gaps of more than two of them."""
    steps = np.diff(times)
    return np.asarray(steps > (_SPLINED + 1.5) * np.median(steps))


def _across(
    times: FloatArray, values: FloatArray, before: int, missing: int, at: FloatArray
) -> FloatArray:
    """Values (m, ...) in the gap after sample ``before``, by the polynomial about it."""
    reach = max(_BESIDE, (missing + 1) // 2)
    # where uneven samples crowd beside the gap, up to twice as many carry the cubic
    cubics = [(further, 3) for further in range(reach, 2 * reach + 1, reach // 4)]
    for further, degree in (*cubics, (reach, 2)):
        beside = _beside(before, further)
        powers, factors = _polynomial(times[beside], at, degree)
        # variances against that of a sample
        if (powers @ (factors @ factors.T) * powers).sum() <= len(at):
            break
    else:  # between samples a line has at most their noise
        beside = _beside(before, reach)
        powers, factors = _polynomial(times[beside], at, 1)
    filled = powers @ (factors @ values[beside].reshape(factors.shape[1], -1))
    return np.asarray(filled, float).reshape(len(at), *values.shape[1:])


def _beside(before: int, reach: int) -> slice:
    """So many samples on each side of the gap after sample ``before``, where there are."""
    return slice(max(before + 1 - reach, 0), before + 1 + reach)


def _polynomial(read: FloatArray, wanted: FloatArray, degree: int) -> tuple[FloatArray, FloatArray]:
    """Powers (m, d) of wanted times (m,), and their factors (d, n) per value at the times (n,) that
    were read, by least squares.
    """
    middle = float(wanted.mean())
    half = float(np.abs(read - middle).max())
    factors = np.linalg.pinv(np.vander((read - middle) / half, degree + 1))
    return np.vander((wanted - middle) / half, degree + 1), np.asarray(factors, float)
