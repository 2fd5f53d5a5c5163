"""Weights of markers beside gaps: no marker comes or goes at once."""

import numpy as np

from legsim.core.values import FloatArray

_FADE_S = 0.2
"""s in which a marker's weight rises behind a gap, and falls before it"""


def faded(seen: np.ndarray, rate_hz: float) -> FloatArray:
    """Shares (n, m) of their weights that markers keep, 0 where not ``seen`` (n, m) and 1 away from
    gaps.

    Markers disagree by millimeters. If one came or went from one frame to the next, the solution
    would step by that much, which a sensor on it would read as tens of g. The start and end of the
    recording are no gaps.
    """
    frames = np.arange(len(seen))[:, None]
    before = np.maximum.accumulate(np.where(seen, -np.inf, frames), axis=0)
    after = np.minimum.accumulate(np.where(seen, np.inf, frames)[::-1], axis=0)[::-1]
    away = np.minimum(frames - before, after - frames)
    part = np.minimum(away / (_FADE_S * rate_hz + 1), 1.0)
    return np.asarray(np.sin(0.5 * np.pi * part) ** 2)
