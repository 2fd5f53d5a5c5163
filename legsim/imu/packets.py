"""Times of samples from the counter that sensors send with each packet."""

import numpy as np
from numpy.typing import ArrayLike

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen

_PERIODS = (1 << 8, 1 << 12, 1 << 16, 1 << 24, 1 << 32)
"""counts after which counters start at 0 again: 8, 12, 16, 24 and 32 bits"""


def unwrapped(counter: ArrayLike, period: int | None = None) -> FloatArray:
    """Packets (n,) since the first one; numbers that are left out are packets that were lost.

    Args:
        counter: (n,) whole numbers as sent, which start at 0 again after some count.
        period: that count; None takes the span of the numbers where the counter mostly falls from
            the greatest to the least, and more than once; else the smallest of 2^8, 2^12, 2^16,
            2^24 and 2^32 that holds all numbers.

    Raises:
        LegsimError: numbers that are not whole, a packet that is there twice or out of order.
    """
    counts = frozen("packet counter", counter, (None,))
    if not (np.isfinite(counts).all() and (counts == np.rint(counts)).all() and counts.min() >= 0):
        raise LegsimError("the packet counter holds values that are no whole numbers from 0")
    steps = np.diff(counts)
    if (steps < 0).any():
        wraps_at = period or _wraps_at(counts, steps)
        if wraps_at is None or counts.max() - (0 if period else counts.min()) >= wraps_at:
            raise LegsimError(
                f"the packet counter reaches {counts.max():.0f}, beyond its period of {wraps_at}; "
                "correct counter_period"
            )
        steps = np.mod(steps, wraps_at)
        back = np.flatnonzero(steps > wraps_at / 2)
        if back.size:
            raise LegsimError(
                f"packet {counts[back[0] + 1]:.0f} (sample {back[0] + 1}) comes after packet "
                f"{counts[back[0]]:.0f}; sort the samples, or state counter_period"
            )
    twice = np.flatnonzero(steps == 0)
    if twice.size:
        raise LegsimError(
            f"packet {counts[twice[0]]:.0f} is there twice (samples {twice[0]} and "
            f"{twice[0] + 1}); keep one of them"
        )
    return np.concatenate([[0.0], np.cumsum(steps)])


def sparse_note(sent: FloatArray, rate_hz: float, in_turn: int = 1) -> tuple[str, ...]:
    """Describes numbers of packets (n,) that mostly grow by more than 1; nothing where they do not,
    or where they grow by as many as there are instruments that take turns.

    Such a counter counts the packets of other sensors too, or ticks of a clock.
    """
    step = float(np.median(np.diff(sent))) if len(sent) > 1 else 1.0
    if step <= 1 or step == in_turn:
        return ()
    return (
        f"the packets' numbers grow by {step:g} from one sample to the next; rate_hz is "
        f"taken for {rate_hz:g} numbers per second, which makes {rate_hz / step:.4g} samples of "
        "them",
    )


def found_period(counts: FloatArray) -> int | None:
    """Count after which numbers (n,) start again; None where they do not, or are beyond any."""
    steps = np.diff(counts)
    return _wraps_at(counts, steps) if (steps < 0).any() else None


def _wraps_at(counts: FloatArray, steps: FloatArray) -> int | None:
    falls = np.flatnonzero(steps < 0)
    least, most = counts.min(), counts.max()
    whole = int(((counts[falls] == most) & (counts[falls + 1] == least)).sum())
    if whole >= max(2, 0.5 * len(falls)):
        return int(most - least) + 1
    return next((p for p in _PERIODS if p > most), None)
