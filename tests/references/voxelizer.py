"""Slow and plain: the winding number of each part around each voxel center, from solid angles in
float64.
"""

import numpy as np

from legsim.geometry.volume import VolumeGrid
from legsim.phantom.meshes import Phantom


def labels(phantom: Phantom, grid: VolumeGrid) -> np.ndarray:
    """(z, y, x) index + 1 of the last part with a winding number other than 0."""
    x, y, z = grid.axes()
    zz, yy, xx = np.meshgrid(z, y, x, indexing="ij")
    points = np.stack([xx, yy, zz], -1).reshape(-1, 3)
    found = np.zeros(len(points), int)
    for number, part in enumerate(phantom.parts):
        windings = [_winding(part.vertices[part.triangles] - point) for point in points]
        found[np.rint(windings) != 0] = number + 1
    return found.reshape(grid.shape_zyx)


def _winding(corners: np.ndarray) -> float:
    """Sum of the triangles' solid angles over 4 pi (Van Oosterom and Strackee 1983)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    la, lb, lc = (np.linalg.norm(p, axis=1) for p in (a, b, c))
    numerator = np.einsum("ti,ti->t", a, np.cross(b, c))
    dots = [np.einsum("ti,ti->t", p, q) for p, q in ((a, b), (b, c), (c, a))]
    return np.arctan2(
        numerator, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    ).sum() / (2 * np.pi)
