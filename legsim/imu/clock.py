"""Clocks of sensors, and samples that are lost on the way to the file."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.imu.signals import ImuSignals

Lost = Literal["marked", "held"]
"""what a file holds in place of a lost sample: no number, or the reading before"""

_ROUNDING = 1e-6
"""share of a sample by which a recording may be too short for its last one"""


@dataclass(frozen=True, slots=True)
class SensorClock:
    """The sensors' clock against the recording's, which is the C-arm's.

    What happens at t is stamped t + offset + drift (t - t0), with t0 the recording's first time.
    """

    offset: float = 0.0
    """s at the recording's first time"""
    drift: float = 0.0
    """s per s; 20e-6 is a clock that is fast by 20 ppm"""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.offset) and np.isfinite(self.drift) and abs(self.drift) < 0.1):
            raise LegsimError(
                f"a clock needs a finite offset and a drift below 100000 ppm; got "
                f"{self.offset:g} s and {1e6 * self.drift:g} ppm"
            )

    def sample_times(self, first: float, last: float, rate_hz: float) -> FloatArray:
        """True times (n,) of samples that are even, ``rate_hz``, on the sensors' own clock."""
        rate = rate_hz * (1 + self.drift)
        count = int(np.floor((last - first) * rate + _ROUNDING)) + 1
        return np.minimum(first + np.arange(count) / rate, last)

    def stamps(self, times: FloatArray) -> FloatArray:
        """What the sensors' clock shows at true times (n,), the first of them the recording's."""
        return times + self.offset + self.drift * (times - times[0])


def lose_samples(
    signals: ImuSignals, share: float, lost: Lost, rngs: tuple[np.random.Generator, ...]
) -> ImuSignals:
    """Loses samples at random: each sensor for itself, all six readings at once.

    The first sample is always there.

    Args:
        signals: of all sensors.
        share: probability that a sample is lost, 0 to below 1.
        lost: "marked" leaves NaN, which :meth:`ImuSignals.samples` leaves out; "held" repeats the
            sample before, as a receiver does that does not know of the loss.
        rngs: one random generator per sensor.
    """
    if not 0 <= share < 1:
        raise LegsimError(f"the share of lost samples is at least 0 and below 1; got {share:g}")
    if share == 0:
        return signals
    rate, force = signals.angular_velocity.copy(), signals.specific_force.copy()
    for k, rng in enumerate(rngs):
        gone = rng.random(len(signals.times)) < share
        gone[0] = False
        if lost == "held":
            there = np.maximum.accumulate(np.where(gone, 0, np.arange(len(gone))))
            rate[:, k], force[:, k] = rate[there, k], force[there, k]
        else:
            rate[gone, k], force[gone, k] = np.nan, np.nan
    return replace(signals, angular_velocity=rate, specific_force=force)
