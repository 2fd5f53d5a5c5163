"""Recordings of two dimensions: a video from one side, written as if it were of three."""

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray

_FLAT = 1e-3
"""m between all markers across a plane: of one plane"""

_LEAST = 6
"""markers that tell a plane along no axis: three always have one, and those of a pelvis may"""

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
    plane = _plane(seen)
    if plane:
        raise LegsimError(
            f"all markers lie in one plane ({plane}), as of a video from one side: legs need "
            "markers in three dimensions"
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


def _plane(seen: FloatArray) -> str:
    """The plane that holds all markers (n, m, 3), in words; empty where there is none."""
    points = seen[np.isfinite(seen).all(-1)]
    if len(points) == 0:
        return ""
    axis = int(np.argmin(np.ptp(points, axis=0)))
    if np.ptp(points[:, axis]) < _FLAT:
        return f"the same {'xyz'[axis]} in m, y up"
    if seen.shape[1] < _LEAST:
        return ""
    centered = points - points.mean(0)
    across = np.linalg.eigh(centered.T @ centered)[1][:, 0]
    if np.ptp(centered @ across) >= _FLAT:
        return ""
    return f"across {(np.round(across, 2) + 0.0).tolist()}, y up"
