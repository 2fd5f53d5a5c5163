"""Times that a file states with few digits, as they were before they were rounded.

Differentiated twice, the rounding of a millisecond at 120 Hz is an acceleration of 0.2 g.
"""

from collections.abc import Iterable

import numpy as np

from legsim.core.values import FloatArray
from legsim.mocap.cells import decimals

_ENOUGH = 10
"""rows that are not even, or on a grid, by chance"""

_EXACT_S = 1e-9
"""s: times this near to even ones are those"""

_FINE_S = 1e-6
"""s: digits this fine are exact enough to be differentiated twice"""

_HALF = 0.75
"""of the last digit: what rounding and cutting change at most, with what a line's fit adds"""


def last_digit(texts: Iterable[str]) -> float:
    """What the last digit of the longest text counts."""
    return 10.0 ** -max(map(decimals, texts), default=0)


def full_times(stated: FloatArray, digit: float, rate: float | None = None) -> FloatArray:
    """Even times, or those of an even grid of which rows are left out, where these explain times
    (n,) s that are stated to a ``digit`` (s); else the times as they are.

    A ``rate`` (Hz) that the file states is tried before others. Times that repeat are explained by
    rows closer than the digit alone.
    """
    if len(stated) < _ENOUGH or digit <= _FINE_S or np.isnan(stated).any():
        return stated
    rising = bool((np.diff(stated) > 0).all())
    if rising and _is_exact(stated):
        return stated
    if rate is not None and (multiples := _multiples(stated, digit, rate)) is not None:
        return multiples
    rows = np.arange(len(stated), dtype=float)
    even = _on_line(rows, stated, digit)
    closest = np.inf if rising else 0.9 * digit
    if even is not None and 0 < even[1] - even[0] < closest:
        return even
    grid = _on_grid(stated, digit) if rising else None
    return stated if grid is None else grid


def _is_exact(stated: FloatArray) -> bool:
    """Whether rising times are multiples of their usual step, to the last digit of a float."""
    step = float(np.median(np.diff(stated)))
    rows = np.rint((stated - stated[0]) / step)
    return float(np.abs(stated - stated[0] - rows * step).max()) <= _EXACT_S


def _multiples(stated: FloatArray, digit: float, rate: float) -> FloatArray | None:
    """Multiples of 1 / ``rate`` that explain every time; None where none do."""
    if digit > 0.25 / rate:
        return None
    for origin in (0.0, float(stated[0])):
        rows = np.rint((stated - origin) * rate)
        times = origin + rows / rate
        if np.abs(times - stated).max() <= 1.001 * digit and (np.diff(rows) > 0).all():
            return times
    return None


def _on_grid(stated: FloatArray, digit: float) -> FloatArray | None:
    """Times on the finest even grid that the usual short steps show; None where there is none."""
    steps = np.diff(stated)
    step = float(np.quantile(steps, 0.25))
    if digit > 0.25 * step:
        return None
    # within runs of single steps the rounding cancels
    step = float(steps[np.rint(steps / step) == 1].mean())
    rows = np.cumsum(np.concatenate([[0.0], np.rint(steps / step)]))
    if not (np.diff(rows) > 0).all():
        return None
    return _on_line(rows, stated, digit)


def _on_line(rows: FloatArray, stated: FloatArray, digit: float) -> FloatArray | None:
    """Times (n,) linear in the numbers of the rows that explain the stated ones; else None."""
    middle = rows.mean()
    away = rows - middle
    slope = float(away @ (stated - stated.mean()) / (away @ away))
    line = stated.mean() + slope * away
    error = stated - line
    line = line + (error.max() + error.min()) / 2
    return line if float(np.abs(stated - line).max()) <= _HALF * digit else None
