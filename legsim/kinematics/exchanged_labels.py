"""Finds two labels of different segments that are exchanged throughout a recording, by what moves:
markers of one segment keep their distances, and under an exchanged label they do not.
"""

import warnings
from itertools import combinations

import numpy as np

from legsim.core.values import FloatArray
from legsim.mocap.trajectories import MarkerTrajectories

_FRAMES = 60
"""are looked at, evenly over the recording"""

_LEAST_FRAMES = 10
"""that show two markers together, to tell whether they keep their distance"""

_VARIES, _KEEPS, _TIMES = 0.006, 0.005, 2.2
"""m of standard deviation of the distances as labeled, m and by how many times less if exchanged.
None of 178 public recordings comes so far; heels and ankles that are exchanged do wherever somebody
walks or jumps
"""

_MATES = 2
"""markers on its segment that tell where a marker belongs"""


def notes(
    motion: MarkerTrajectories, segments: dict[str, str], labels: dict[str, str]
) -> tuple[str, ...]:
    """A warning on the two labels whose exchange lets all distances keep best, if any.

    Args:
        motion: markers.
        segments: body of each marker.
        labels: what the recording calls a marker, where it is another name.
    """
    names = motion.marker_names
    some = np.unique(np.linspace(0, len(motion.times) - 1, _FRAMES).astype(int))
    spread = _spread(motion.positions_world[some])
    on = np.array([segments[name] for name in names])
    mates = np.equal.outer(on, on) & ~np.eye(len(names), dtype=bool)
    plain = np.arange(len(names))
    found: list[tuple[float, int, int]] = []
    for one, other in combinations(range(len(names)), 2):
        if mates[one, other] or min(mates[one].sum(), mates[other].sum()) < _MATES:
            continue
        before = max(_varies(k, plain, spread, mates) for k in (one, other))
        if before < _VARIES:
            continue
        turned = plain.copy()
        turned[[one, other]] = other, one
        after = max(_varies(k, turned, spread, mates) for k in (one, other))
        if after < min(_KEEPS, before / _TIMES):
            found.append((after / before, one, other))
    if not found:
        return ()
    one, other = (
        f"{labels.get(n, n)} (on {segments[n]})" for n in (names[k] for k in min(found)[1:])
    )
    return (
        f"warning: markers of one segment keep their distances better if the labels {one} and "
        f"{other} are exchanged: see whether they are, and exchange them in the recording",
    )


def _spread(shown: FloatArray) -> FloatArray:
    """(m, m) m: standard deviations of the distances over frames (n, m, 3); NaN where few show
    both.
    """
    apart = np.linalg.norm(shown[:, :, None] - shown[:, None], axis=-1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of pairs that no frame shows
        spread = np.nanstd(apart, axis=0)
    return np.where(np.isfinite(apart).sum(0) >= _LEAST_FRAMES, spread, np.nan)


def _varies(k: int, played: np.ndarray, spread: FloatArray, mates: np.ndarray) -> float:
    """Median m by which distances of marker k from those of its segment vary, where marker j is the
    one that is seen as ``played[j]``; 0 without any.
    """
    varying = spread[played[k], played[np.flatnonzero(mates[k])]]
    varying = varying[np.isfinite(varying)]
    return float(np.median(varying)) if varying.size else 0.0
