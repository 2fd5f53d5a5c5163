"""What a gap in a sensor's signals costs: gaps of the same length, cut where nothing was lost."""

import numpy as np

from legsim.core.values import FloatArray
from legsim.imu import bridging, strapdown
from legsim.imu.signals import SensorStart
from legsim.imu.strapdown import Scheme

_PLACES = 8
"""of the views' time at which the gap is cut anew"""

_MARGIN = 0.3
"""s of samples kept beyond the views and what bridges a gap there, for the splines"""

_SPLINED = 8
"""samples kept there at least, for the same"""


def longest_gap(times: FloatArray, views: FloatArray) -> float:
    """Seconds of the longest gap of more than two samples between samples (n,) s during the views
    (v,) s; 0 without one.
    """
    during = (times[1:] > views[0]) & (times[:-1] < views[-1])
    wide = during & bridging.wide_steps(times)
    return float(np.diff(times)[wide].max()) if wide.any() else 0.0


def gap_cost(
    samples: tuple[FloatArray, FloatArray, FloatArray],
    start: SensorStart,
    views: FloatArray,
    seconds: float,
    scheme: Scheme = "accurate",
) -> float:
    """RMS (m) by which a gap displaces the sensor at the last view.

    Args:
        samples: times (n,) s, angular velocities (n, 3) and specific forces (n, 3).
        start: pose and velocity at the first view.
        views: (v,) s.
        seconds: of the gap, shorter than the views' time.
        scheme: that poses are integrated by.
    """
    # what a bridge is fitted to is about as long as the gap: the rest of a long recording is left
    bridge = max(seconds, longest_gap(samples[0], views))
    beside = int(np.ceil(bridge / np.median(np.diff(samples[0])))) + _SPLINED
    near = bridging.about(samples[0], views, bridge + _MARGIN, beside)
    times, rate, force = (values[near] for values in samples)
    whole = strapdown.integrate(times, rate, force, start, views, scheme=scheme)[-1, :3, 3]
    squares = []
    for begin in np.linspace(views[0], views[-1] - seconds, _PLACES + 2)[1:-1]:
        kept = (times <= begin) | (times >= begin + seconds)
        cut = strapdown.integrate(times[kept], rate[kept], force[kept], start, views, scheme=scheme)
        squares.append(np.square(cut[-1, :3, 3] - whole).sum())
    return float(np.sqrt(np.mean(squares)))
