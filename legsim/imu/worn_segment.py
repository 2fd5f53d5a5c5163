"""The segment that a measured sensor moves with: that whose angular velocity it shares.

Legs that walk do the same half a step apart, so that a sensor of the other leg agrees well with a
clock that is wrong by as much. Only a movement can tell: people who stand sway as one.
"""

from collections.abc import Sequence

from legsim.imu.lag import find_lag
from legsim.imu.recording import ImuRecording
from legsim.imu.shared_time import MOVEMENT_HZ, MOVING, in_band, overlap, rms

_ALIKE = 0.75
"""correlation of the rates from which a segment may be the sensor's"""

_MARGIN = 0.1
"""by which it is higher there"""


def better_segment(
    measured: ImuRecording, named: str, correlation: float, segments: Sequence[ImuRecording]
) -> tuple[str, float, float] | None:
    """Finds a segment that the sensor follows clearly better than the named one.

    Args:
        measured: by the clock of the segments, as the named one has it.
        named: the segment on which it is said to be.
        correlation: of the rates there.
        segments: predicted angular velocity of each segment, by its name; ``named`` among them.

    Returns:
        its name, the correlation of the rates and the lag (s) there; None without one.

    Raises:
        LegsimError: recordings that overlap by less than 3 s.
    """
    step = 1 / min(measured.rate_hz, segments[0].rate_hz)
    lags, alike = {named: 0.0}, {named: correlation}
    for one in segments:
        if one.name == named:
            continue
        lags[one.name], alike[one.name] = find_lag(one, measured, step=step)
    best = max(alike, key=lambda name: alike[name])
    times = overlap(next(one for one in segments if one.name == named), measured, step)
    moves = rms(in_band(measured, times, MOVEMENT_HZ, "rate")) > MOVING
    clearly = alike[best] > max(_ALIKE, alike[named] + _MARGIN)
    return (best, alike[best], lags[best]) if moves and clearly else None
