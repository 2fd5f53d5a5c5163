"""What images cannot see of a correction: one constant similarity of the scene.

Turned, moved or scaled as a whole, a scene that moves accordingly leaves every projection
unchanged: nearer to the source by a thousandth of its distance and smaller by a thousandth, it
looks the same. An error of that kind shifts, turns or scales the reconstructed volume and blurs
nothing. Here it is taken out before pixels are counted.
"""

from collections.abc import Callable

import numpy as np

from legsim.core import transforms
from legsim.core.values import FloatArray

Seen = Callable[[FloatArray], FloatArray]
"""pixels (v, p, 2) where a correction has the images of material points (p, 3) m in world"""

_ROUNDS = 20

_SHARES = tuple(0.5**k for k in range(6))

_STEP = 1e-4
"""m, of the differences that give the slopes of what is seen"""

_SETTLED = 1e-7
"""rad, and share of the size, of the last change: less than 1e-4 pixel"""


def best_similarity(seen: Seen, points: FloatArray, true: FloatArray) -> FloatArray:
    """Similarity G (4, 4) of least RMS distance of ``seen(G points)`` to ``true``.

    Gauss and Newton's rule from the identity, with steps that are halved where they do not help:
    the result is never worse.

    Args:
        seen: of the correction.
        points: (p, 3) m in world, at least three that are not on a line.
        true: (v, p, 2) pixels where the images have the points.
    """
    size = float(np.sqrt(((points - points.mean(0)) ** 2).sum(-1).mean()))
    similarity = np.eye(4)
    shown = seen(points)
    for _ in range(_ROUNDS):
        placed = transforms.apply(similarity, points)
        slopes = np.einsum("vpki,pij->vpkj", _slopes(seen, placed), _generators(placed, size))
        if not (np.isfinite(slopes).all() and np.isfinite(shown).all()):
            break
        step = np.linalg.lstsq(slopes.reshape(-1, 7), (true - shown).ravel(), rcond=1e-12)[0]
        for share in _SHARES:
            tried = _similarity(share * step, placed.mean(0), size) @ similarity
            made = seen(transforms.apply(tried, points))
            if ((made - true) ** 2).sum() < ((shown - true) ** 2).sum():
                similarity, shown = tried, made
                break
        else:
            break
        if np.abs(step).max() < _SETTLED:
            break
    return similarity


def _slopes(seen: Seen, points: FloatArray) -> FloatArray:
    """Derivatives (v, p, 2, 3) of what is seen by the points, by central differences."""
    return np.stack(
        [
            (seen(points + shift) - seen(points - shift)) / (2 * _STEP)
            for shift in _STEP * np.eye(3)
        ],
        -1,
    )


def _generators(points: FloatArray, size: float) -> FloatArray:
    """Derivatives (p, 3, 7) of points by rotation, shift in units of ``size``, and scale."""
    arms = points - points.mean(0)
    shifts = np.broadcast_to(size * np.eye(3), (len(points), 3, 3))
    return np.concatenate([-transforms.cross_matrix(arms), shifts, arms[..., None]], -1)


def _similarity(step: FloatArray, middle: FloatArray, size: float) -> FloatArray:
    """The similarity (4, 4) of a step (7,): rotation vector, shift, logarithm of the scale."""
    linear = np.exp(step[6]) * transforms.rotation_from_vector(step[:3])
    similarity = np.eye(4)
    similarity[:3, :3] = linear
    similarity[:3, 3] = middle + size * step[3:6] - linear @ middle
    return similarity
