"""Labels that two markers exchange on the way: each goes on where the other one was."""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from legsim.core.values import FloatArray

_LONGEST_S = 0.1
"""s between two sights of a marker: in a longer time legs pass each other"""

_FAR = 0.03
"""m that both must jump"""

_NEAR = 0.3
"""of that jump: so near must each come to where the other one was"""


class Exchange(NamedTuple):
    """Two markers whose labels change places."""

    frame: int
    """first with the labels exchanged"""
    one: int
    other: int


def find_exchanges(positions: FloatArray, dt: float) -> list[Exchange]:
    """Exchanges among the markers of ``positions`` (n, m, 3), NaN where not seen, in the order of
    their frames.
    """
    seen = np.isfinite(positions).all(-1)
    rows = np.where(seen, np.arange(len(positions))[:, None], -1)
    before = np.maximum.accumulate(rows, axis=0)[:-1]
    # where each marker was when it was last seen
    last = np.take_along_axis(positions, np.maximum(before, 0)[..., None], axis=0)
    jump = np.linalg.norm(positions[1:] - last, axis=-1)
    age = np.arange(1, len(positions))[:, None] - before
    jumping = (jump > _FAR) & (before >= 0) & (age <= max(1, int(_LONGEST_S / dt)))
    found = []
    for row in np.flatnonzero(jumping.sum(1) > 1):
        for one, other in combinations(np.flatnonzero(jumping[row]), 2):
            here, there = positions[row + 1], last[row]
            across = max(
                float(np.linalg.norm(here[one] - there[other])),
                float(np.linalg.norm(here[other] - there[one])),
            )
            if across < _NEAR * min(jump[row, one], jump[row, other]):
                found.append(Exchange(int(row) + 1, int(one), int(other)))
    return found


def notes_of(exchanges: list[Exchange], names: tuple[str, ...], times: FloatArray) -> list[str]:
    """A warning on each frame that exchanges labels, the first five of many."""
    frames = list(dict.fromkeys(exchange.frame for exchange in exchanges))
    lines = []
    for frame in frames[:5]:
        pairs = [f"{names[e.one]} and {names[e.other]}" for e in exchanges if e.frame == frame]
        more = f" and {len(pairs) - 3} pairs more" if len(pairs) > 3 else ""
        lines.append(
            f"warning: from {times[frame]:.4g} s on the labels {', '.join(pairs[:3])}{more} are "
            "exchanged: each marker goes on where the other one was; what does not fit the rest is "
            "left out; exchange them in the recording from there on"
        )
    if len(frames) > 5:
        lines.append(f"warning: labels are exchanged at {len(frames) - 5} times more")
    return lines
