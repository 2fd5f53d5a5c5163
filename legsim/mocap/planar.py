"""Recordings of two dimensions: a video from one side, written as if it were of three."""

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray

_FLAT = 1e-3
"""m between all markers along one axis: of one plane"""

_STILL, _MOVES = 1e-5, 0.02
"""m that a marker moves along one axis, where it does not, and along the others, where it does"""

_MOST = 0.8
"""of the markers"""


def objections(positions: FloatArray) -> tuple[str, ...]:
    """A warning where markers (n, m, 3) in m, NaN where not seen, move in planes alone.

    Raises:
        LegsimError: all markers are in one plane, which shows no width of anything.
    """
    seen = positions[:, np.isfinite(positions).any((0, 2))]
    if seen.shape[1] < 3:
        return ()
    axis = int(np.argmin(np.nanmax(seen, (0, 1)) - np.nanmin(seen, (0, 1))))
    if np.nanmax(seen[..., axis]) - np.nanmin(seen[..., axis]) < _FLAT:
        raise LegsimError(
            f"all markers lie in one plane (the same {'xyz'[axis]} in m, y up), as of a video from "
            "one side: legs need markers in three dimensions"
        )
    ranges = np.nanmax(seen, 0) - np.nanmin(seen, 0)
    moving = ranges[ranges.max(1) > _MOVES]
    if len(moving) < 3:
        return ()
    still = (moving < _STILL).mean(0)
    axis = int(np.argmax(still))
    if still[axis] < _MOST:
        return ()
    return (
        f"warning: {100 * still[axis]:.0f} % of the markers that move never do along {'xyz'[axis]} "
        "(y up), as of a video from one side: widths, adduction and rotation are not measured",
    )
