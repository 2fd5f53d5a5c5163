"""What a gap in a sensor's signals costs: gaps of the same length, cut where nothing was lost."""

import numpy as np

from legsim.core.values import FloatArray
from legsim.imu import bridging, strapdown
from legsim.imu.signals import SensorStart

_PLACES = 8
"""of the views' time at which the gap is cut anew"""


def longest_gap(times: FloatArray, views: FloatArray) -> float:
    """Seconds of the longest gap between samples (n,) s during the views (v,) s that is bridged by
    a cubic; 0 without one.
    """
    during = (times[1:] > views[0]) & (times[:-1] < views[-1])
    wide = during & bridging.wide_steps(times)
    return float(np.diff(times)[wide].max()) if wide.any() else 0.0


def gap_cost(
    samples: tuple[FloatArray, FloatArray, FloatArray],
    start: SensorStart,
    views: FloatArray,
    seconds: float,
) -> float:
    """RMS (m) by which a gap displaces the sensor at the last view.

    Args:
        samples: times (n,) s, angular velocities (n, 3) and specific forces (n, 3).
        start: pose and velocity at the first view.
        views: (v,) s.
        seconds: of the gap, shorter than the views' time.
    """
    times, rate, force = samples
    ends = views[[0, -1]]
    whole = strapdown.integrate(times, rate, force, start, ends)[-1, :3, 3]
    squares = []
    for begin in np.linspace(views[0], views[-1] - seconds, _PLACES + 2)[1:-1]:
        kept = (times <= begin) | (times >= begin + seconds)
        cut = strapdown.integrate(times[kept], rate[kept], force[kept], start, ends)
        squares.append(np.square(cut[-1, :3, 3] - whole).sum())
    return float(np.sqrt(np.mean(squares)))
