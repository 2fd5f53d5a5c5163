"""Finds samples of a trajectory that belong to something else: spikes, ghosts, a stretch in which
two markers' labels are exchanged.

The trajectory is cut where it steps farther than its own smoothness allows. Of the pieces, the
longest chain whose members can follow each other is kept; what lies off the chain is a jump.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legsim.core.values import FloatArray

BoolArray = NDArray[np.bool_]

MIN_STEP = 0.003
"""m: a step that deviates less from its neighbors' is never a jump"""

IMPACT = 20.0
"""m/s^2: acceleration that a marker on a leg may have within one sample"""

FAR = 0.05
"""m: no noise reaches as far"""

HARDEST, FASTEST = 25.0, 30.0
"""m/s by which a marker on a leg may change its velocity from one sample to the next, and that it
may have: more than a sprinter's foot, which goes at 20
"""

SMOOTHNESS = 6.0
"""a jump deviates this many times as far as nine tenths of the recording's own steps do"""

SLIP = 0.025
"""m: a step up to this far that never returns may be a marker that slipped; beyond, it is another
marker
"""

SLIP_COST_S = 0.25
"""s: a piece between two such steps is kept if it lasts longer than twice this"""

NEIGHBORS = 5
"""steps on either side that a step is compared with"""

LOOK_BACK = 200
"""pieces before a piece that are tried as its predecessor"""


@dataclass(frozen=True, slots=True, eq=False)
class _Pieces:
    starts: NDArray[np.intp]
    """index of each piece's first sample"""
    ends: NDArray[np.intp]
    """index of each piece's last sample"""
    speed_limit: float
    """m/s at which the marker may have moved while it was not seen"""
    threshold: float
    """m of deviation from a smooth step"""


def find_jumps(positions: FloatArray, dt: float) -> BoolArray:
    """True (n,) for the samples of one marker (n, 3) in meters, ``dt`` seconds apart, that are
    jumps; never where it is NaN.
    """
    seen = np.flatnonzero(np.isfinite(positions).all(1))
    jumps = np.zeros(len(positions), bool)
    if len(seen) < 3:
        return jumps
    pieces, deviation = _cut(positions, seen, dt)
    if len(pieces.starts) == 1:
        return jumps
    jumps[seen] = True
    for k in _longest_chain(positions, pieces, deviation, dt):
        jumps[pieces.starts[k] : pieces.ends[k] + 1] = False
    return jumps


def _cut(positions: FloatArray, seen: NDArray[np.intp], dt: float) -> tuple[_Pieces, FloatArray]:
    """(pieces that run smoothly, short gaps included, and the deviation in meters of the step into
    each sample from its neighbors').
    """
    gap = np.diff(seen)
    velocity = np.diff(positions[seen], axis=0) / gap[:, None]
    distance = np.linalg.norm(velocity - neighbors_median(velocity), axis=1) * gap
    adjacent = distance[gap == 1]
    own = np.quantile(adjacent, 0.9) if adjacent.size else 0.0
    # a marker that flickers between two places has no smoothness of its own
    usual = min(SMOOTHNESS * float(own), max(FAR, HARDEST * dt))
    threshold = max(MIN_STEP + IMPACT * dt**2, usual)
    cut = distance > threshold
    starts, ends = seen[np.r_[True, cut]], seen[np.r_[cut, True]]
    speeds = np.linalg.norm(velocity, axis=1) / dt
    deviation = np.zeros(len(positions))
    deviation[seen[1:]] = distance
    # 0.2 m/s beyond what is usual: somebody who stands may begin to move while the marker is hidden
    fastest = min(0.2 + 1.5 * float(np.quantile(speeds, 0.95)), FASTEST)
    return _Pieces(starts, ends, fastest, threshold), deviation


def neighbors_median(velocity: FloatArray) -> FloatArray:
    """Median of each step's neighbors (n, 3), the step itself left out."""
    n = len(velocity)
    offsets = np.r_[-NEIGHBORS:0, 1 : NEIGHBORS + 1]
    index = np.arange(n)[:, None] + offsets
    inside = (index >= 0) & (index < n)
    around = np.where(inside[..., None], velocity[np.clip(index, 0, n - 1)], np.nan)
    return np.nanmedian(around, axis=1) if n > 1 else velocity


def _longest_chain(
    positions: FloatArray, pieces: _Pieces, deviation: FloatArray, dt: float
) -> list[int]:
    """Indices of the pieces that follow each other plausibly and hold most samples."""
    count = len(pieces.starts)
    lengths = (pieces.ends - pieces.starts + 1).astype(float)
    best, before = lengths.copy(), np.full(count, -1)
    for k in range(1, count):
        earlier = np.arange(max(0, k - LOOK_BACK), k)
        total = best[earlier] - _cost(positions, pieces, deviation, earlier, k, dt) + lengths[k]
        choice = int(np.argmax(total))
        if total[choice] > best[k]:
            best[k], before[k] = total[choice], earlier[choice]
    chain, k = [], int(np.argmax(best))
    while k >= 0:
        chain.append(k)
        k = int(before[k])
    return chain


def _cost(
    positions: FloatArray,
    pieces: _Pieces,
    deviation: FloatArray,
    earlier: NDArray[np.intp],
    k: int,
    dt: float,
) -> FloatArray:
    """Samples that the step from each earlier piece to piece k costs: none if it is smooth,
    infinite if it is too far.
    """
    gap = pieces.starts[k] - pieces.ends[earlier]
    distance = np.linalg.norm(positions[pieces.starts[k]] - positions[pieces.ends[earlier]], axis=1)
    allowed = pieces.threshold + pieces.speed_limit * gap * dt
    # without a sample between them, the step itself was judged
    excess = np.where(
        gap == 1,
        np.maximum(deviation[pieces.starts[k]] - pieces.threshold, 0),
        np.maximum(distance - allowed, 0),
    )
    return np.where(excess <= 0, 0.0, np.where(excess <= SLIP, SLIP_COST_S / dt, np.inf))
