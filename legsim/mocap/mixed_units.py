"""Finds joints that are in radians in a file of degrees: all else of the file speaks for degrees.

Read as degrees, such a joint hardly moves. A stiff joint does so too, so this is a doubt.
"""

import numpy as np

from legsim.core.values import FloatArray
from legsim.mocap.trajectories import JointTrajectories

_MOST = np.radians(3.2)
"""rad that radians read as degrees reach at most"""

_LEAST, _MOVING = np.radians(0.05), np.radians(15.0)
"""rad of range: a joint that is not held, and one that clearly moves"""

_ALIKE = 2.5
"""times that the ranges of right and left may differ"""

_SAGITTAL = ("hip_flexion", "knee_angle", "ankle_angle")
"""joints that move where others of the leg do"""


def doubts(motion: JointTrajectories) -> list[str]:
    """Sentences on joints of ``motion`` (rad) that look as if they were in radians in the file."""
    names = [n for n in motion.coordinate_names if n[:-2] in _SAGITTAL and n[-2:] in ("_r", "_l")]
    ranges = {name: _range(motion.coordinate(name)) for name in names}
    moving = [name for name in names if ranges[name] > _MOVING]
    small = [
        name
        for name in names
        if ranges[name] > _LEAST and np.abs(motion.coordinate(name)).max() <= _MOST
    ]
    said = []
    for name in small:
        other = f"{name[:-2]}_{'l' if name.endswith('_r') else 'r'}"
        ratio = np.degrees(ranges[name]) / ranges[other] if other in moving else 0.0
        alone = other in moving and 1 / _ALIKE < ratio < _ALIKE
        both = (
            other in small
            and bool(moving)
            and _range(np.degrees(motion.coordinate(name))) > (_MOVING)
        )
        if alone or both:
            against = other if alone else max(moving, key=lambda n: ranges[n])
            said.append(
                f"warning: {name} moves by {np.degrees(ranges[name]):.2g} degrees only, "
                f"{against} by {np.degrees(ranges[against]):.0f}: its column looks like radians in "
                "a file of degrees; convert that column, unless the joint is stiff"
            )
    return said


def _range(angle: FloatArray) -> float:
    """Width of what an angle (n,) does in nine tenths of the time."""
    low, high = np.quantile(angle, [0.05, 0.95])
    return float(high - low)
