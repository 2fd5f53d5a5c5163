"""Two labels of different segments that are exchanged throughout a recording on a user's model: the
distances of each from its segment's other markers fit where the other one is, and not where it is.
"""

from itertools import combinations

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray
from legsim.kinematics.marker_sites import MarkerSites
from legsim.mocap.trajectories import MarkerTrajectories

_WRONG, _RIGHT = 0.12, 0.05
"""m by which distances are off under an exchanged label, and under the right one: people differ
from an unscaled model by a fifth of 40 cm, and markers are put on within 3 cm
"""

_SOME = 20
"""frames"""


def check(sites: MarkerSites, measured: MarkerTrajectories) -> None:
    """Refuses a recording in which two labels are exchanged.

    Raises:
        LegsimError: names both labels and their segments.
    """
    names = [name for name in sites.names if name in measured.marker_names]
    known = sites.only(names)
    some = np.unique(np.linspace(0, len(measured.times) - 1, _SOME).astype(int))
    shown = np.stack([measured.marker(name)[some] for name in names], 1)
    seen = _median_distances(shown)
    model = np.linalg.norm(known.positions[:, None] - known.positions[None], axis=-1)
    mates = np.equal.outer(np.array(known.segments), np.array(known.segments))
    mates &= ~np.eye(len(names), dtype=bool)
    plain = np.arange(len(names))
    off = [_off(k, plain, seen, model, mates) for k in range(len(names))]
    for one, other in combinations(range(len(names)), 2):
        if mates[one, other] or not max(off[one], off[other]) > _WRONG:
            continue
        turned = plain.copy()
        turned[[one, other]] = other, one
        if max(_off(k, turned, seen, model, mates) for k in (one, other)) < _RIGHT:
            raise LegsimError(
                f"by their distances from the other markers the labels {names[one]} (on "
                f"{known.segments[one]}) and {names[other]} (on {known.segments[other]}) are "
                "exchanged; exchange them in the recording"
            )


def _median_distances(shown: FloatArray) -> FloatArray:
    """(m, m) m over frames (n, m, 3); NaN for markers that are not seen together."""
    apart = np.linalg.norm(shown[:, :, None] - shown[:, None], axis=-1)
    there = np.isfinite(apart)
    filled = np.where(there.any(0), apart, 0.0)
    return np.where(there.any(0), np.nanmedian(filled, axis=0), np.nan)


def _off(
    k: int, played: np.ndarray, seen: FloatArray, model: FloatArray, mates: np.ndarray
) -> float:
    """Median m by which distances of marker k from those of its segment are not the model's, where
    marker j is the one that is seen as ``played[j]``; 0 without any.
    """
    rows = np.flatnonzero(mates[k])
    away = np.abs(seen[played[k], played[rows]] - model[k, rows])
    away = away[np.isfinite(away)]
    return float(np.median(away)) if away.size else 0.0
