"""A marker that is hidden for long, rebuilt from others on the same segment as if they were one
rigid body.
"""

from collections.abc import Sequence

import numpy as np

from legsim.core import transforms
from legsim.core.values import FloatArray

EDGE_SAMPLES = 10
"""samples on either side of a gap that tell where the marker sits among the others"""

THINNEST = 0.02
"""m: spread of the other markers across their longest direction; less tells nothing about the turn
about it
"""

LOOSEST = 0.02
"""m: RMS by which the others may deviate from one rigid body"""


def fill_from_segment(
    positions: FloatArray, others: FloatArray, gaps: Sequence[tuple[int, int]]
) -> FloatArray:
    """Copy of (n, 3) with gaps filled from the markers ``others`` (n, k, 3) where three or more of
    these are seen throughout.

    The marker's place among the others is taken just before and just after the gap, and what each
    side tells is blended linearly, so that the skin's shift between the two does not become a step.
    Meters.

    Args:
        positions: the marker; NaN where it is not seen.
        others: the markers on its segment.
        gaps: (first, last) index of each run of NaN.
    """
    result = positions.copy()
    for first, last in gaps:
        before = _predicted(
            positions, others, first, last, range(first - 1, first - 1 - EDGE_SAMPLES, -1)
        )
        after = _predicted(positions, others, first, last, range(last + 1, last + 1 + EDGE_SAMPLES))
        if before is not None and after is not None:
            weight = (np.arange(first, last + 1) - first + 1)[:, None] / (last - first + 2)
            result[first : last + 1] = (1 - weight) * before + weight * after
        elif before is not None or after is not None:
            result[first : last + 1] = after if before is None else before
    return result


def _predicted(
    positions: FloatArray, others: FloatArray, first: int, last: int, edge: range
) -> FloatArray | None:
    """Where the marker is during the gap (last - first + 1, 3), by its place among the others at
    the samples ``edge``.
    """
    samples = [k for k in edge if 0 <= k < len(positions) and np.isfinite(positions[k]).all()]
    if not samples:
        return None
    needed = np.r_[samples, first : last + 1]
    mates = others[:, np.isfinite(others[needed]).all((0, 2))]
    if (
        mates.shape[1] < 3
        or np.linalg.svd(mates[samples[0]] - mates[samples[0]].mean(0), compute_uv=False)[1]
        < THINNEST
    ):
        return None
    guesses = [_carried(mates[k], mates[first : last + 1], positions[k]) for k in samples]
    if any(residual > LOOSEST for _, residual in guesses):
        return None
    return np.mean([points for points, _ in guesses], axis=0)


def _carried(shape: FloatArray, bodies: FloatArray, point: FloatArray) -> tuple[FloatArray, float]:
    """(point (3,) of the body ``shape`` (k, 3) where the best rigid fit to each of ``bodies`` (n,
    k, 3) takes it, worst RMS misfit).
    """
    body_from_shape = transforms.best_rigid(shape, bodies)
    fitted = transforms.apply(body_from_shape, shape)
    misfit = np.sqrt(((fitted - bodies) ** 2).sum(-1).mean(-1)).max()
    return transforms.apply(body_from_shape, point[None])[..., 0, :], float(misfit)
