"""Whether somebody moves at the pace of people: else the recording's rate is another one.

A rate that is wrong by a factor k changes speeds by k, accelerations by its square.
"""

import numpy as np
from scipy.signal import savgol_filter

from legsim.core.constants import STANDARD_GRAVITY
from legsim.core.values import FloatArray
from legsim.kinematics.skeleton import JointCenters

_FALLING, _OFTEN = 1.2 * STANDARD_GRAVITY, 0.05
"""m/s^2 down of hips above feet that stay where they are, and share of that time: whoever lets go
falls by 1 g. Hips of runners have 1.5 g, filtered
"""

_PARABOLA = 0.15
"""s of a parabola"""

_GAP = 5
"""usual steps of time between two samples, at most: what lies between others is not known"""

_STAYS, _LONG = 0.4, 0.5
"""m/s of an ankle, and s of both together"""

_STRIDE = 0.3
"""m that an ankle goes ahead of the other one, at least: a step"""

_LEVEL, _FLAT = 0.15, 0.75
"""m of the hips up and down (0.1 in walks, 0.2 and more in lunges), and way of the feet past each
other up and down over that to and fro: 1 on cranks, up to 0.65 of runners
"""

_FEW, _STEPS = 10, 3
"""frames, and whole steps, that say something"""

_LOWEST, _HIGHEST, _LEG = 0.12, 1.0, 0.85
"""m per step, over steps per second, of legs so long in m from hip to ankle: 0.2 to 0.4 of people
who walk or run at the pace they like. Lengths of steps go with the leg's, their durations with its
square root
"""

_ALIKE = 0.2
"""standard deviation of the steps' durations over their mean: those of a walk, not of somebody who
places one foot at a time
"""

_TURNED = 0.2
"""of the way between the feet's farthest: a step's end, whatever trembles"""


def falling(centers: JointCenters) -> tuple[str, ...]:
    """A sentence on hips that go down faster than gravity pulls, above feet that stay."""
    times = centers.times
    if len(times) < _FEW:
        return ()
    stay = np.ones(len(times), bool)
    for side in "rl":
        moved = np.gradient(centers.of(f"ankle_{side}"), times, axis=0)
        stay &= np.linalg.norm(moved, axis=1) < _STAYS
    if stay.sum() * np.median(np.diff(times)) < _LONG:
        return ()
    fall = -float(np.quantile(_acceleration(_hips(centers), times)[stay], _OFTEN))
    if fall < _FALLING:
        return ()
    return (
        f"above feet that stay, the hips are accelerated downwards by {fall / STANDARD_GRAVITY:.1f}"
        f" g and more in {100 * _OFTEN:.0f} % of the time, and nobody falls faster than by 1 g: "
        "see whether the recording's rate is lower than the file says",
    )


def _hips(centers: JointCenters) -> FloatArray:
    """(n,) m of the hips' height."""
    return (centers.of("hip_r") + centers.of("hip_l"))[:, 1] / 2


def _acceleration(place: FloatArray, times: FloatArray) -> FloatArray:
    """(n,) m/s^2 of parabolas through ``place`` (n,) m around each sample, none across a gap:
    coordinates that nobody filtered tremble.
    """
    steps = np.diff(times)
    step = float(np.median(steps))
    width = max(5, 2 * round(_PARABOLA / step / 2) + 1)
    bent = np.zeros(len(times))
    for part in np.split(np.arange(len(times)), np.flatnonzero(steps > _GAP * step) + 1):
        here = times[part]
        even = np.arange(here[0], here[-1] + step / 2, step)
        if len(even) >= width:
            at_even = np.interp(even, here, place[part])
            parabolas = savgol_filter(at_even, width, 2, deriv=2, delta=step)
            bent[part] = np.interp(here, even, parabolas)
    return bent


def odd_steps(centers: JointCenters) -> tuple[str, ...]:
    """A sentence on a walk whose steps are far too quick or too slow for their length."""
    found = _steps(centers.of("ankle_r") - centers.of("ankle_l"), centers.times)
    if found is None or _range(_hips(centers)) > _LEVEL:
        return ()
    length, per_second = found
    ratio = length / per_second * (_LEG / _leg(centers)) ** 1.5
    if _LOWEST < ratio < _HIGHEST:
        return ()
    quick, lower = ("quick", "lower") if ratio < _LOWEST else ("slow", "higher")
    return (
        f"steps of {length:.2f} m at {per_second:.2g} a second are far too {quick} for their "
        f"length: see whether the recording's rate is {lower} than the file says",
    )


def _range(places: FloatArray) -> float:
    """m within which ``places`` (n,) lie nine times out of ten."""
    return float(np.ptp(np.quantile(places, [0.05, 0.95])))


def _leg(centers: JointCenters) -> float:
    """m from hip to ankle, by way of the knee."""
    parts = [
        np.linalg.norm(centers.of(f"{one}_{side}") - centers.of(f"knee_{side}"), axis=1)
        for one in ("hip", "ankle")
        for side in "rl"
    ]
    return float(np.median(np.sum(parts, 0))) / 2


def _steps(between: FloatArray, times: FloatArray) -> tuple[float, float] | None:
    """(m, 1/s) of the steps of feet that are ``between`` (n, 3) m apart; None where nobody
    walks.
    """
    level = between[:, [0, 2]] - between[:, [0, 2]].mean(0)
    along = level @ np.linalg.eigh(level.T @ level)[1][:, 1]
    length = _range(along) / 2
    if length < _STRIDE or _range(between[:, 1]) / 2 > _FLAT * length:
        return None
    ahead = np.sign(along) * (np.abs(along) > _TURNED * length)
    turned = np.flatnonzero(np.diff(ahead[ahead != 0]))
    durations = np.diff(times[ahead != 0][turned])
    if len(durations) < _STEPS or durations.std() > _ALIKE * durations.mean():
        return None
    return length, 1 / float(durations.mean())
