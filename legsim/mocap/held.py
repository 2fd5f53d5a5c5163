"""Finds samples that repeat one value while the body moves on: a tracker that holds the last
position of a marker it has lost.

Rounding repeats values too: a marker that stands still, in a file of whole millimeters, repeats
them for seconds. So a run of exact repeats counts as held only where (1) the marker's noise, as
coarse as the file's digits are, would not repeat so often by chance, nor does it elsewhere; or (2)
the marker leaves the value by a jump; or (3) its distance from another marker, the same all through
the recording, is not the same during the run. Where most markers repeat at once, nobody moved or
frames were copied: only those that leave by a jump are held.
"""

import numpy as np
from numpy.typing import NDArray

from legsim.core.values import FloatArray
from legsim.mocap.low_pass import runs
from legsim.mocap.outliers import IMPACT, MIN_STEP

BoolArray = NDArray[np.bool_]

FEWEST = 5
"""repeats of one value that may be a held marker"""

CHANCE = 1e-4
"""probability, for a whole recording, that noise repeats itself so often"""

RIGID = 0.015
"""m: a distance that varies by less is that of two markers on one segment; by more than this from
what it is elsewhere, one of them does not follow
"""

FEW_SHORT = 0.005
"""runs of fewer repeats, per sample: where there are more, digits repeat by themselves"""

LONG_S = 0.25
"""s: shorter runs are not compared with other markers; a body hardly moves meanwhile"""

_FARTHER = 3.0
"""times the step after it: a jump that catches up on at least FEWEST frames"""

_GAUSS = 0.6745
"""median of the magnitude of a standard normal variable"""


def find_held(positions: FloatArray, dt: float) -> BoolArray:
    """True (n, m) for the samples of markers (n, m, 3) in meters, ``dt`` seconds apart, that only
    repeat the sample before; the first of equal samples is kept.
    """
    samples, count = len(positions), positions.shape[1]
    same = np.zeros((samples, count), bool)
    same[1:] = (positions[1:] == positions[:-1]).all(-1)
    held = np.zeros_like(same)
    for k in map(int, np.flatnonzero(same.any(0))):
        others = np.delete(np.arange(count), k)
        stretches = runs(same[:, k])
        short = sum(last - first + 1 < FEWEST for first, last in stretches)
        coarse = short > FEW_SHORT * len(same)
        digit = _digit(positions[:, k])
        for first, last in stretches:
            if last - first + 1 < FEWEST:
                continue
            held[first : last + 1, k] = (
                _paused(positions[:, k], last, dt, digit)
                if _all_stand(same, positions, others, first, last)
                else _is_held(positions, k, first, last, dt, coarse, digit)
            )
    return held


def _all_stand(
    same: BoolArray, positions: FloatArray, others: NDArray[np.intp], first: int, last: int
) -> bool:
    """Whether most of the others that are seen repeat their values too, in most samples of the run;
    also where there is no other.
    """
    seen = others[np.isfinite(positions[first : last + 1, others]).all((0, 2))]
    return seen.size == 0 or float(np.median(same[first : last + 1, seen].mean(0))) > 0.5


def _is_held(
    positions: FloatArray, k: int, first: int, last: int, dt: float, coarse: bool, digit: float
) -> bool:
    own = positions[:, k]
    if first == 1 and last == len(own) - 1:
        return False  # never moves at all: a point on a device, or a person computed so
    by_chance = 1.0 if coarse else _repeat_probability(own, first, last, digit)
    if by_chance ** (last - first + 1) * len(own) < CHANCE:
        return True
    if _jumps_away(own, last, dt, digit):
        return True
    return (last - first + 1) * dt >= LONG_S and _leaves_its_segment(
        positions, k, first, last, digit
    )


def _jumps_away(own: FloatArray, last: int, dt: float, digit: float) -> bool:
    """Whether one marker (n, 3) leaves the value of sample ``last`` by a jump."""
    step = own[last + 1] - own[last] if last + 1 < len(own) else np.zeros(3)
    far = 2 * digit + MIN_STEP + IMPACT * dt**2
    return bool(np.nan_to_num(np.linalg.norm(step)) > far)


def _paused(own: FloatArray, last: int, dt: float, digit: float) -> bool:
    """Whether one marker (n, 3) goes on after sample ``last`` from somewhere else: by a jump that
    is no start of a movement, which the next step would go on with.
    """
    if not _jumps_away(own, last, dt, digit) or last + 2 >= len(own):
        return False
    step, after = np.linalg.norm(np.diff(own[last : last + 3], axis=0), axis=1)
    return bool(step > _FARTHER * after)


def _digit(own: FloatArray) -> float:
    """Smallest step of one marker (n, 3) in any coordinate, m: the file's last digit, or less than
    anybody's noise.
    """
    steps = np.abs(np.diff(own, axis=0))
    steps = steps[steps > 1e-9]
    return float(steps.min()) if steps.size else 0.0


def _repeat_probability(own: FloatArray, first: int, last: int, digit: float) -> float:
    """Probability that a sample of (n, 3) repeats the one before in all coordinates by chance.

    The noise is estimated by fourth differences outside the run, which take out what a body does
    within five samples. Rounded to ``digit``, two draws of normal noise s are equal with
    probability digit / (2 s sqrt(pi)); where the noise hardly exceeds the rounding's own, nothing
    is said: 1.
    """
    outside = np.r_[own[:first], np.full((1, 3), np.nan), own[last + 1 :]]
    if len(outside) < 6:
        return 1.0
    fourth = np.diff(outside, 4, axis=0)
    fourth = fourth[np.isfinite(fourth).all(1)]
    if len(fourth) < 2 * FEWEST:
        return 1.0
    noise = np.median(np.abs(fourth), axis=0) / (_GAUSS * np.sqrt(70))  # 1 + 16 + 36 + 16 + 1
    # below a micrometer it is no camera's noise but a computed or filtered trajectory's
    loud = noise > max(0.75 * digit, 1e-6)
    return float(
        np.prod(np.where(loud, digit / (2 * np.sqrt(np.pi) * np.maximum(noise, 1e-12)), 1))
    )


def _leaves_its_segment(positions: FloatArray, k: int, first: int, last: int, digit: float) -> bool:
    """Whether the distance to a marker that is elsewhere constant changes during the run."""
    others = positions[:, np.arange(positions.shape[1]) != k]
    apart = np.linalg.norm(others - positions[:, k : k + 1], axis=2)
    inside, outside = apart[first : last + 1], np.r_[apart[:first], apart[last + 1 :]]
    known = np.isfinite(inside).any(0) & (np.isfinite(outside).sum(0) >= 2 * FEWEST)
    if not known.any():
        return False
    low, high = np.nanquantile(outside[:, known], [0.02, 0.98], axis=0)
    slack = RIGID + 2 * digit
    off = (np.nanmax(inside[:, known], 0) > high + slack) | (
        np.nanmin(inside[:, known], 0) < low - slack
    )
    return bool((off & (high - low < RIGID)).any())
