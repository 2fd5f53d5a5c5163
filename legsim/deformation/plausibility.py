"""What no motion of a scanned person is like: of other views, or in another unit."""

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.deformation.models import Motion

FARTHEST = 0.1
"""m by which somebody who stands moves within a scan, at most"""

_NEVER = 1.0
"""m: no more than this within a scan is a motion at all"""


def objections(motion: Motion, center: FloatArray, times: FloatArray | None) -> tuple[str, ...]:
    """Lines on what is doubtful about a motion, with the fix; none where nothing is.

    Args:
        motion: with a time per view.
        center: (3,) m, the rotation center.
        times: (v,) s of the views, or None where nothing says them.

    Raises:
        LegsimError: it carries the rotation center by more than a meter.
    """
    carried = motion.carry(center[None])[:, 0] - center
    far = float(np.linalg.norm(carried, axis=-1).max())
    if far > _NEVER:
        raise LegsimError(
            f"the motion moves the rotation center by {far:.4g} m: is it in mm, or of poses in "
            "another world? give moved_from_reference in m, in the geometry's world"
        )
    lines = []
    if far > FARTHEST:
        lines.append(
            f"the motion moves the rotation center by {1e3 * far:.0f} mm, as nobody who stands "
            "does: is it of this scan, in m and in the geometry's world?"
        )
    if times is not None and len(times) > 1:
        step = float(np.median(np.diff(times)))
        if np.abs(motion.times - times).max() > 0.5 * step:
            lines.append(
                f"the motion is from {motion.times[0]:.6g} to {motion.times[-1]:.6g} s, the views "
                f"are from {times[0]:.6g} to {times[-1]:.6g} s: is it of this scan? its samples "
                "are taken for the views in order"
            )
    return tuple(lines)
