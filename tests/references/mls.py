"""Moving least squares written out point by point, for comparison: slow and plain."""

import numpy as np

from legsim.core import transforms
from legsim.core.values import FloatArray


def displaced_in_space(point: FloatArray, reference: FloatArray, moved: FloatArray) -> FloatArray:
    """Zhu and Gortler's form: the best rigid motion under weights 1/d^2, by Kabsch's method."""
    squared = ((reference - point) ** 2).sum(-1)
    if (squared == 0).any():
        return moved[int(np.argmin(squared))]
    return transforms.apply(transforms.best_rigid(reference, moved, 1 / squared), point[None])[0]


def displaced_in_image(point: FloatArray, reference: FloatArray, moved: FloatArray) -> FloatArray:
    """Schaefer's rigid form as published (Maier et al. 2022, eq. 17 and 18), matrices A_j and
    all.
    """

    def perpendicular(x: FloatArray) -> FloatArray:
        return np.array([-x[1], x[0]])

    weights = 1 / ((reference - point) ** 2).sum(-1)
    center, center_moved = weights @ reference / weights.sum(), weights @ moved / weights.sum()
    arm, total = point - center, np.zeros(2)
    for w, p, q in zip(weights, reference - center, moved - center_moved, strict=True):
        a = w * np.stack([p, -perpendicular(p)]) @ np.stack([arm, -perpendicular(arm)]).T
        total += q @ a
    return np.linalg.norm(arm) * total / np.linalg.norm(total) + center_moved


def keys_weight(x: float) -> float:
    """Cubic convolution kernel of Keys (1981), a = -1/2."""
    x = abs(x)
    if x < 1:
        return 1.5 * x**3 - 2.5 * x**2 + 1
    return -0.5 * x**3 + 2.5 * x**2 - 4 * x + 2 if x < 2 else 0.0


def read_image(image: FloatArray, u: float, v: float) -> float:
    """Keys' cubic interpolation at column u and row v, the border pixels going on outside."""
    rows, columns = image.shape
    u, v = float(np.clip(u, 0, columns - 1)), float(np.clip(v, 0, rows - 1))
    i, j = int(u), int(v)
    total = 0.0
    for dj in range(-1, 3):
        for di in range(-1, 3):
            value = image[min(max(j + dj, 0), rows - 1), min(max(i + di, 0), columns - 1)]
            total += keys_weight(u - i - di) * keys_weight(v - j - dj) * value
    return total
