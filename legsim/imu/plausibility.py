"""What no sensor on a person's leg reads: rates and accelerations that say that the movement under
it is wrong somewhere.
"""

import numpy as np

from legsim.core.constants import STANDARD_GRAVITY
from legsim.imu.signals import ImuSignals

_STRONGEST = 20 * STANDARD_GRAVITY
"""m/s^2; impacts at the shank of a runner are 10 g"""

_FASTEST_DEG_PER_S = 1500.0
"""a sprinter's shank turns by 1200 deg/s"""


def objections(signals: ImuSignals) -> tuple[str, ...]:
    """Sentences on readings above 20 g or 1500 deg/s, one per sensor and kind, with the time of the
    strongest.

    First and last samples are held to the same as all others.
    """
    lines = []
    for name in signals.sensor_names:
        times, turn, force = signals.samples(name)
        for readings, limit, factor, unit, verb in (
            (force, _STRONGEST, 1 / STANDARD_GRAVITY, "g", "is accelerated by"),
            (turn, np.radians(_FASTEST_DEG_PER_S), np.degrees(1.0), "deg/s", "turns by"),
        ):
            size = np.linalg.norm(readings, axis=1)
            worst = int(size.argmax())
            if size[worst] > limit:
                lines.append(
                    f"sensor {name} {verb} {factor * size[worst]:.0f} {unit} at "
                    f"{times[worst]:.3f} s, and in {int((size > limit).sum())} samples by "
                    "more than any leg"
                )
    return tuple(lines)
