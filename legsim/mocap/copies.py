"""Finds frames that repeat the frame before in everything that moves: cameras that dropped a frame,
or a recording that was exported at a higher rate than it was made.

A body that is measured never repeats itself in all coordinates while it moves. Who stands still in
a file of few digits does, so a repeat counts only where the frames around it move on by several of
the file's smallest steps.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legsim.core.values import FloatArray
from legsim.mocap.low_pass import runs

_SHORT_S = 0.25
"""s: the movement across a longer stretch is not known"""

_AROUND = 10
"""frames on either side that show whether the body moves on"""

_CLEARLY = 4.0
"""smallest steps of the file by which it does"""

_FEWEST = 3
"""numbers that move: fewer may repeat together by chance"""

_FEWEST_FRAMES = 20

_BEAT = 0.15
"""share of the frames: so many are copied at a beat, not by chance"""


@dataclass(frozen=True, slots=True, eq=False)
class Copies:
    """Frames of a recording that repeat the frame before."""

    frames: NDArray[np.bool_]
    """(n,) those of short stretches, which a spline bridges"""
    long: tuple[tuple[int, int], ...] = ()
    """first and last frame of each longer stretch"""
    share: float = 0.0
    """of the copies in frames in which the body clearly moves"""

    @property
    def at_a_beat(self) -> bool:
        """Whether so many are copied that the recording was made at a lower rate."""
        return bool(self.frames.any()) and self.share > _BEAT

    def notes(self, times: FloatArray) -> list[str]:
        """Sentences on both, with times (n,) s."""
        said, count = [], int(self.frames.sum())
        if self.at_a_beat:
            rate = (len(times) - 1) / float(times[-1] - times[0])
            made = float(f"{rate * (1 - self.share):.2g}")
            said.append(
                f"warning: {count} of {len(times)} frames repeat the frame before exactly, so that "
                f"a recording of about {made:g} Hz was exported at {rate:.4g} Hz: they are left "
                "out; export it at its own rate"
            )
        elif count:
            first = float(times[int(self.frames.argmax())])
            said.append(
                f"{count} frame{'s repeat' if count > 1 else ' repeats'} the frame before exactly, "
                f"the first at {first:.4g} s: left out and bridged"
            )
        said += [
            f"warning: nothing moves from {times[first - 1]:.4g} to {times[last]:.4g} s: all "
            f"{last - first + 1} frames repeat one exactly, so that nothing was measured there; "
            "leave it out"
            for first, last in self.long[:3]
        ]
        if len(self.long) > 3:
            said.append(f"warning: and so in {len(self.long) - 3} stretches more")
        return said


def find_copies(values: FloatArray, dt: float) -> Copies:
    """Finds the copies among frames of (n, k) numbers, ``dt`` seconds apart, NaN where unknown."""
    none = np.zeros(len(values), bool)
    steps = np.abs(np.diff(values, axis=0))
    moving = np.nan_to_num(steps).max(0, initial=0.0) > 0
    if moving.sum() < _FEWEST or len(values) < _FEWEST_FRAMES:
        return Copies(none)
    steps = steps[:, moving]
    known = np.isfinite(steps).sum(1) >= _FEWEST
    widest = np.where(known, np.nan_to_num(steps).max(1), np.nan)
    if not (widest == 0).any():
        return Copies(none)
    digit = float(steps[steps > 0].min())
    short, sure, long = none.copy(), none.copy(), []
    for first, last in runs(np.concatenate([[False], widest == 0])):
        moves = _moves_on(widest, first - 1, last - 1, digit)
        if (last - first + 2) * dt <= _SHORT_S:
            short[first : last + 1], sure[first : last + 1] = True, moves
        elif moves:
            long.append((first, last))
    share = sure.sum() / max(int(sure.sum() + (widest > _CLEARLY * digit).sum()), 1)
    # where copies come at a beat, those of slow movements are such too
    return Copies(short if share > _BEAT else sure, tuple(long), float(share))


def _moves_on(widest: FloatArray, first: int, last: int, digit: float) -> bool:
    """Whether the body moves before and after the steps ``first`` to ``last`` (n - 1,), as far as
    the recording goes.
    """
    sides = widest[max(first - _AROUND, 0) : first], widest[last + 1 : last + 1 + _AROUND]
    moved = [side[side > 0] for side in sides if (side > 0).any()]
    return bool(moved) and all(float(np.median(side)) > _CLEARLY * digit for side in moved)
