"""Whether somebody stands over the own feet, on the floor, and as tall as an adult: else the
laboratory's vertical, origin or unit may be another one.
"""

import numpy as np

from legsim.core.values import FloatArray
from legsim.kinematics.leg import Leg
from legsim.kinematics.skeleton import JointCenters

_STILL, _OVER = 0.03, 0.25
"""m/s of hips and ankles over so many seconds"""

_STRAIGHT_KNEE, _STRAIGHT_HIP = np.radians(20.0), np.radians(35.0)
"""rad: who bends further at the hips holds the balance elsewhere"""

_TOGETHER = 0.45
"""m between the ankles: who stands with one foot far ahead may stand over either"""

_LEAST = 0.4
"""s of standing"""

_USUAL, _LEANING, _LYING = np.radians((5.5, 9.0, 50.0))
"""rad forwards of the vertical, from the middle of the ankles to that of the hips, as people stand
(3.4 to 7.5 degrees in public recordings), and off that direction
"""

_BEFORE, _BESIDE = np.radians((7.0, 1.5))
"""rad forwards or backwards, and sideways, by which the hips are beyond both ankles: who stands
over one of two feet has them between
"""

_HIGH, _DEEP = 0.8, -0.5
"""m of the lower ankle over the laboratory's zero, beyond any box or treadmill"""

_CHILD = 0.55
"""m from hip to ankle of a child of 1.1 m; two thirds of an adult's"""

_ADULT = 0.85
"""m from hip to ankle"""


def small(leg: Leg) -> tuple[str, ...]:
    """A sentence on legs that are a small child's."""
    length = float(np.mean([leg.thigh_length(side) + leg.shank_length(side) for side in "rl"]))
    if length > _CHILD:
        return ()
    return (
        f"the legs are {length:.2f} m long from hip to ankle, as a small child's; if they are an "
        f"adult's, lengths are about {_ADULT / length:.1f} times too short: see whether the unit "
        "of the file is another one",
    )


def off_the_floor(centers: JointCenters) -> tuple[str, ...]:
    """A sentence on feet that are far from the laboratory's zero."""
    heights = np.minimum(centers.of("ankle_r")[:, 1], centers.of("ankle_l")[:, 1])
    height = float(np.median(heights))
    if _DEEP < height < _HIGH:
        return ()
    way = "above" if height > 0 else "below"
    return (
        f"the lower ankle is {abs(height):.1f} m {way} the laboratory's zero; if the floor is "
        "there, the file's origin or unit is another one",
    )


def leaning(pelvis: FloatArray, centers: JointCenters) -> tuple[str, ...]:
    """A sentence on somebody who stands still with straight legs, and leans as nobody does without
    falling over; ``pelvis`` are its axes (n, 3, 3) in world.
    """
    times = centers.times
    hips, ankles = (_middle(centers, joint) for joint in ("hip", "ankle"))
    stands = _stands(pelvis, centers)
    if not stands.any() or stands.sum() * _step(times) < min(_LEAST, times[-1] - times[0]):
        return ()
    forward, right = _facing(pelvis)
    above = hips - ankles
    along, across, up = (
        float(np.median(part[stands]))
        for part in ((above * forward).sum(1), (above * right).sum(1), above[:, 1])
    )
    # both angles of one direction, about axes that are perpendicular
    ahead, aside = np.arctan2(along, up) - _USUAL, np.arctan2(across, np.hypot(along, up))
    over = _beyond(centers, forward, stands, np.tan(_USUAL) * up) > up * np.tan(_BEFORE)
    over |= _beyond(centers, right, stands, 0.0) > up * np.tan(_BESIDE)
    if not (over and _LEANING < np.hypot(ahead, aside) < _LYING):
        return ()
    return (
        f"somebody stands still with the hips {_way(along, 'ahead of', 'behind')} and "
        f"{_way(across, 'right of', 'left of')} the ankles, and would fall over: see whether the "
        "laboratory's vertical is tilted against gravity",
    )


def _beyond(centers: JointCenters, way: FloatArray, stands: np.ndarray, usual: float) -> float:
    """m by which the hips, less what is ``usual``, lie beyond both ankles, one way or the other
    along ``way`` (n, 3), while somebody ``stands`` (n,).
    """
    hips = (_middle(centers, "hip") * way).sum(1) - usual
    ankles = np.stack([(centers.of(f"ankle_{side}") * way).sum(1) for side in "rl"])
    beyond = np.maximum(hips - ankles.max(0), ankles.min(0) - hips)
    return float(np.median(beyond[stands]))


def _way(by: float, positive: str, negative: str) -> str:
    return f"{100 * abs(by):.0f} cm {positive if by > 0 else negative}"


def _facing(pelvis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Level directions (n, 3) in which the pelvis looks, and to its right."""
    forward = pelvis[:, :, 0] * [1.0, 0.0, 1.0]
    forward = forward / np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-9)
    return forward, np.cross(forward, [0.0, 1.0, 0.0])


def _step(times: FloatArray) -> float:
    return float(np.median(np.diff(times))) if len(times) > 1 else 0.0


def _middle(centers: JointCenters, joint: str) -> FloatArray:
    return (centers.of(f"{joint}_r") + centers.of(f"{joint}_l")) / 2


def _stands(pelvis: FloatArray, centers: JointCenters) -> np.ndarray:
    """Whether (n,) the legs are straight and nothing moves."""
    times = centers.times
    apart = np.linalg.norm(centers.of("ankle_r") - centers.of("ankle_l"), axis=1)
    stands = apart < _TOGETHER
    for side in "rl":
        hip, knee, ankle = (centers.of(f"{joint}_{side}") for joint in ("hip", "knee", "ankle"))
        stands &= _angle(hip - knee, knee - ankle) < _STRAIGHT_KNEE
        stands &= _angle(hip - knee, pelvis[:, :, 1]) < _STRAIGHT_HIP
        stands &= (_speed(hip, times) < _STILL) & (_speed(ankle, times) < _STILL)
    return stands


def _angle(one: FloatArray, other: FloatArray) -> FloatArray:
    """(n,) rad between vectors (n, 3)."""
    lengths = np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1)
    return np.arccos(np.clip((one * other).sum(1) / lengths, -1, 1))


def _speed(place: FloatArray, times: FloatArray) -> FloatArray:
    """(n,) m/s of a point (n, 3) over a quarter of a second about each sample."""
    step = _step(times)
    if step == 0:
        return np.zeros(len(times))
    half = max(1, round(_OVER / step / 2))
    first = np.maximum(np.arange(len(times)) - half, 0)
    last = np.minimum(np.arange(len(times)) + half, len(times) - 1)
    return np.linalg.norm(place[last] - place[first], axis=1) / (times[last] - times[first])
