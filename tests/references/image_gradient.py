"""Plain float64 derivative of a back-projection by its matrices."""

import numpy as np


def slopes_by_pixel(image: np.ndarray, homogeneous: np.ndarray) -> np.ndarray:
    """(n, 3) derivatives of bilinear image(u, v) / w^2 by (u w, v w, w) (n, 3)."""
    rows, columns = image.shape
    w = homogeneous[:, 2]
    front = w > 1e-6
    safe = np.where(front, w, 1.0)
    u, v = homogeneous[:, 0] / safe, homogeneous[:, 1] / safe
    seen = front & (u > -1) & (u < columns) & (v > -1) & (v < rows)
    u, v = np.where(seen, u, 0.0), np.where(seen, v, 0.0)
    i, j = np.floor(u).astype(int), np.floor(v).astype(int)
    a, b = u - i, v - j
    p = np.pad(np.asarray(image, float), 1)
    low_left, low_right = p[j + 1, i + 1], p[j + 1, i + 2]
    up_left, up_right = p[j + 2, i + 1], p[j + 2, i + 2]
    by_u = (1 - b) * (low_right - low_left) + b * (up_right - up_left)
    by_v = (1 - a) * (up_left - low_left) + a * (up_right - low_right)
    value = (1 - b) * ((1 - a) * low_left + a * low_right) + b * ((1 - a) * up_left + a * up_right)
    found = np.stack([by_u, by_v, -(by_u * u + by_v * v + 2 * value)], -1)
    return np.where(seen[:, None], found / safe[:, None] ** 3, 0.0)


def by_matrices(
    images: np.ndarray, matrices: np.ndarray, points: np.ndarray, slopes: np.ndarray
) -> np.ndarray:
    """(v, 3, 4) sums over points (n, 3), or (v, n, 3), of slopes (n,) times that by matrices."""
    points = np.broadcast_to(points, (len(images), *points.shape[-2:]))
    found = np.zeros((len(images), 3, 4))
    for view, (image, matrix) in enumerate(zip(images, matrices, strict=True)):
        ends = np.concatenate([points[view], np.ones((points.shape[1], 1))], -1)
        found[view] = (slopes[:, None] * slopes_by_pixel(image, ends @ matrix.T)).T @ ends
    return found
