"""Rigid transforms as 4x4 matrices and rotations as 3x3, always stacked on leading axes.

``a_from_b`` maps coordinates in b to coordinates in a; names cancel when composed: ``a_from_b @
b_from_c``.
"""

import numpy as np
from numpy.typing import ArrayLike

from legsim.core.values import FloatArray


def rigid(rotation: ArrayLike, translation: ArrayLike) -> FloatArray:
    """Builds (..., 4, 4) from rotations (..., 3, 3) and translations (..., 3).

    Both are broadcast against each other.
    """
    rotation, translation = np.asarray(rotation, float), np.asarray(translation, float)
    lead = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    matrix = np.zeros((*lead, 4, 4))
    matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3, 3] = rotation, translation, 1.0
    return matrix


def translation(offset: ArrayLike) -> FloatArray:
    """Pure translations (..., 4, 4) by ``offset`` (..., 3)."""
    return rigid(np.eye(3), offset)


def inverse(a_from_b: ArrayLike) -> FloatArray:
    """Inverse of rigid transforms (..., 4, 4): b_from_a, by the transpose of the rotation."""
    a_from_b = np.asarray(a_from_b, float)
    rotation = np.swapaxes(a_from_b[..., :3, :3], -1, -2)
    return rigid(rotation, -np.einsum("...ij,...j->...i", rotation, a_from_b[..., :3, 3]))


def apply(a_from_b: ArrayLike, points_b: ArrayLike) -> FloatArray:
    """Maps points (..., p, 3) in b to a by (..., 4, 4)."""
    a_from_b, points_b = np.asarray(a_from_b, float), np.asarray(points_b, float)
    return points_b @ np.swapaxes(a_from_b[..., :3, :3], -1, -2) + a_from_b[..., None, :3, 3]


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product (..., 3) on the last axis: np.cross without its overhead, to the bit."""
    x = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    y = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    return np.stack([x, y, a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]], -1)


def cross_matrix(vectors: ArrayLike) -> FloatArray:
    """Matrices (..., 3, 3) with ``cross_matrix(a) @ b == cross(a, b)``."""
    x, y, z = np.moveaxis(np.asarray(vectors, float), -1, 0)
    zero = np.zeros_like(x)
    return np.stack(
        [np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], -2
    )


def rotation_from_vector(rotation_vectors: ArrayLike) -> FloatArray:
    """Rotations (..., 3, 3) by |v| radians about v (Rodrigues).

    Exact to rounding at zero (half-angle form).
    """
    vectors = np.asarray(rotation_vectors, float)
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    skew = cross_matrix(vectors)
    # np.sinc(x) = sin(pi x)/(pi x) is finite at 0; 2 sin(a/2)^2/a^2 = sinc(a/2pi)^2/2 has no
    # cancellation
    return (
        np.eye(3)
        + np.sinc(angle / np.pi) * skew
        + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (skew @ skew)
    )


def vector_from_rotation(rotations: ArrayLike) -> FloatArray:
    """Rotation vectors (..., 3) in radians, |v| <= pi.

    The inverse of :func:`rotation_from_vector`.
    """
    w, x, y, z = np.moveaxis(quaternion_from_rotation(rotations), -1, 0)
    vector = np.stack([x, y, z], -1)
    sine = np.linalg.norm(vector, axis=-1)
    angle = 2 * np.arctan2(sine, w)
    return (
        vector * np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 2.0)[..., None]
    )


def rotation_angle(rotations: ArrayLike) -> FloatArray:
    """Angles (...,) of rotations (..., 3, 3) in radians, accurate near zero."""
    return np.linalg.norm(vector_from_rotation(rotations), axis=-1)


def quaternion_from_rotation(rotations: ArrayLike) -> FloatArray:
    """Unit quaternions wxyz (..., 4), w >= 0, of rotations (..., 3, 3).

    Bar-Itzhack's largest-of-four rule: stable for every angle (Shepperd 1978).
    """
    r = np.asarray(rotations, float)
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    four_w = np.stack(
        [
            1 + xx + yy + zz,
            r[..., 2, 1] - r[..., 1, 2],
            r[..., 0, 2] - r[..., 2, 0],
            r[..., 1, 0] - r[..., 0, 1],
        ],
        -1,
    )
    four_x = np.stack(
        [
            four_w[..., 1],
            1 + xx - yy - zz,
            r[..., 0, 1] + r[..., 1, 0],
            r[..., 0, 2] + r[..., 2, 0],
        ],
        -1,
    )
    four_y = np.stack(
        [four_w[..., 2], four_x[..., 2], 1 - xx + yy - zz, r[..., 1, 2] + r[..., 2, 1]], -1
    )
    four_z = np.stack([four_w[..., 3], four_x[..., 3], four_y[..., 3], 1 - xx - yy + zz], -1)
    candidates = np.stack([four_w, four_x, four_y, four_z], -2)
    best = np.argmax(
        np.stack([four_w[..., 0], four_x[..., 1], four_y[..., 2], four_z[..., 3]], -1), -1
    )
    chosen = np.take_along_axis(candidates, best[..., None, None], -2)[..., 0, :]
    chosen = chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)
    return np.where(chosen[..., :1] < 0, -chosen, chosen)


def axis_rotation(axis: ArrayLike, angle: ArrayLike) -> FloatArray:
    """Rotations (..., 3, 3) about a fixed ``axis`` (3,) by ``angle`` (...,) radians.

    The axis is normalized here.
    """
    axis = np.asarray(axis, float)
    return rotation_from_vector(np.asarray(angle, float)[..., None] * (axis / np.linalg.norm(axis)))


def best_rigid(
    points_b: ArrayLike, points_a: ArrayLike, weights: ArrayLike | None = None
) -> FloatArray:
    """Rigid a_from_b (..., 4, 4) of least weighted squared distance between points (..., p, 3).

    Minimizes the weighted sum of |points_a - a_from_b points_b|^2. Leading axes are broadcast
    against each other. ``weights`` (p,) are of the points. Kabsch's method with the determinant
    fixed to +1 (Arun 1987; Umeyama 1991).
    """
    b, a = np.asarray(points_b, float), np.asarray(points_a, float)
    w = np.ones(b.shape[-2]) if weights is None else np.asarray(weights, float)
    w = w / w.sum()
    mean_b, mean_a = w @ b, w @ a
    spread = w[:, None] * (b - mean_b[..., None, :])
    u, _, vt = np.linalg.svd(np.swapaxes(spread, -1, -2) @ (a - mean_a[..., None, :]))
    v, ut = np.swapaxes(vt, -1, -2), np.swapaxes(u, -1, -2)
    signs = np.zeros(v.shape) + np.eye(3)
    signs[..., 2, 2] = np.sign(np.linalg.det(v @ ut))
    rotation = v @ signs @ ut
    return rigid(rotation, mean_a - (rotation @ mean_b[..., None])[..., 0])
