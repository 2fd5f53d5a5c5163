"""Static trials: a single frame is enough for a pose, where a movement needs more."""

import numpy as np

from legsim.mocap.trajectories import MarkerTrajectories

_FEWEST = 4
"""samples that cleaning needs, and too few to be taken for a marker that is held"""

_STEP_S = 0.01


def as_static(motion: MarkerTrajectories) -> MarkerTrajectories:
    """A trial of fewer frames than a movement needs, as its mean pose that stands still for so
    long; any other as it is.
    """
    if len(motion.times) >= _FEWEST:
        return motion
    seen = np.isfinite(motion.positions_world)
    count = np.where(seen.any(0), seen.sum(0), np.nan)
    mean = np.where(seen, motion.positions_world, 0.0).sum(0) / count
    times = motion.times[0] + _STEP_S * np.arange(_FEWEST)
    return MarkerTrajectories(times, motion.marker_names, np.tile(mean, (_FEWEST, 1, 1)))
