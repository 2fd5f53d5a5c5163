"""Non-rigid motion from a few followed points: moving least squares, rigid variant, in space.

Schaefer et al. 2006 and Zhu and Gortler 2007, as used by Maier et al. 2022, section 2.6: every
point of space moves by the rotation and translation that fit the control points best under weights
1/distance^2. At a control point the limit is that point's own motion. :func:`warp_points` is
the general form for any number of points; :mod:`legsim.deformation.three_points` prepares the
closed form of three points that the device uses (kernels/moving_least_squares.cl).
"""

import numpy as np
from numpy.typing import ArrayLike

from legsim.core.values import FloatArray

# breaks the tie where the points leave a rotation open (fewer than three, or on a line): towards
# turning as little as possible
_TIE_BREAK = 1e-13

NEARLY_STRAIGHT = 0.02
"""spread of points across the line through them over that along it, below which they do not tell
half a turn about that line from a leg that bends the other way
"""


def warp_points(points: ArrayLike, reference: ArrayLike, moved: ArrayLike) -> FloatArray:
    """Moves points (n, d) as control points (m, d) go from ``reference`` to ``moved``, d = 2, 3.

    One singular value decomposition per point, its determinant fixed to +1. Where the control
    points leave the rotation open (one or two of them, or all on a line) the smallest one is taken.
    Points nearly on a line (:data:`NEARLY_STRAIGHT`) turn space by less than a quarter turn about
    it: a knee that passes through straight bends backwards. Exactly the identity where nothing
    moves.
    """
    points, reference, moved = (np.asarray(a, float) for a in (points, reference, moved))
    arms = reference - points[:, None]
    weights = _weights((arms**2).sum(-1))
    center = np.einsum("nm,nmd->nd", weights, arms)
    shift = np.einsum("nm,md->nd", weights, moved - reference)
    centered = arms - center[:, None]
    centered_moved = centered + (moved - reference) - shift[:, None]
    covariances = np.einsum("nm,nmi,nmj->nij", weights, centered_moved, centered)
    straight = straightness(np.stack([reference, moved])).min() < NEARLY_STRAIGHT
    rotation = _best_rotations(covariances, least_twist=bool(straight) and points.shape[1] == 3)
    rotation[(centered_moved == centered).all((-2, -1))] = np.eye(points.shape[1])
    # v - p* is -center; written as a displacement, so that p = q gives v itself and not v up to
    # rounding
    return points + shift - np.einsum("nij,nj->ni", rotation - np.eye(points.shape[1]), center)


def _weights(squared: FloatArray) -> FloatArray:
    """(n, m) 1/distance^2, normalized to the sum 1; all on one point where the distance is 0."""
    nearest = squared.min(-1, keepdims=True)
    ratio = np.divide(nearest, squared, out=np.ones_like(squared), where=squared > 0)
    # beside a control point that is hit exactly, the others have no weight (nearest = 0)
    return ratio / ratio.sum(-1, keepdims=True)


def straightness(points: FloatArray) -> FloatArray:
    """(v,) spread of points (v, m, d) across the line that fits them best, over that along it."""
    if points.shape[1] < 3:
        return np.zeros(len(points))
    spread = np.linalg.svd(points - points.mean(1, keepdims=True), compute_uv=False)
    return spread[:, 1] / np.maximum(spread[:, 0], np.finfo(float).tiny)


def smallest_turned(a: FloatArray, b: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors (n, 3) under the smallest rotations that carry unit vectors a (n, 3) to b (n, 3)."""
    axis = np.cross(a, b)
    once = np.cross(axis, vectors)
    share = np.maximum(1 + (a * b).sum(-1, keepdims=True), 1e-12)
    return np.asarray(vectors + once + np.cross(axis, once) / share, np.float64)


def _best_rotations(covariances: FloatArray, *, least_twist: bool = False) -> FloatArray:
    """(n, d, d) rotations that fit best, from sums (n, d, d) of moved resting^T.

    ``least_twist`` (d = 3): of the two that carry the main direction alike and differ by half a
    turn about it, the one with the smaller twist.
    """
    size = covariances.shape[-1]
    scale = np.sqrt((covariances**2).sum((-2, -1)))[:, None, None]
    steady = covariances + (_TIE_BREAK * scale + np.finfo(float).tiny) * np.eye(size)
    u, _, vt = np.linalg.svd(steady)
    u[:, :, -1] *= np.where(np.linalg.det(u @ vt) < 0, -1.0, 1.0)[:, None]
    if least_twist:
        untwisted = smallest_turned(vt[:, 0], u[:, :, 0], vt[:, 2])
        twisted = (untwisted * u[:, :, 2]).sum(-1) < 0
        u[:, :, 1:] *= np.where(twisted, -1.0, 1.0)[:, None, None]
    return u @ vt
