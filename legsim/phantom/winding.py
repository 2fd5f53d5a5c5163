"""How often closed meshes wind around points, by the triangles that rays from there cross.

Rays run along x. Seen along them, a triangle covers a point or not by its directed edges: each edge
is cut by the line of the point's z at the same place for all triangles that share it, so that
entries and exits of a closed mesh pair up, and an edge or vertex that a ray meets counts once. Rays
find their triangles in a grid of cells across y and z: the cost grows with the triangles and with
the points, not with both.
"""

from dataclasses import dataclass

import numpy as np

from legsim.core.values import FloatArray

_MOST_CELLS = 1024
"""cells along each axis"""

_ENTRIES = 4
"""of triangles in cells, for each triangle: with more of them cells are made larger"""

_AT_ONCE = 1 << 20
"""pairs of a point and a triangle that are compared in one go"""


def numbers(vertices: FloatArray, triangles: np.ndarray, points: FloatArray) -> np.ndarray:
    """Winding numbers (n,) of a closed mesh around points (n, 3): 1 inside, if it faces outward.

    What happens on a surface itself is open.
    """
    rays, chosen = _Cells.of(vertices, triangles).pairs(points)
    turns = np.zeros(len(points))
    for first in range(0, len(rays), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        signs = _signs(vertices[triangles[chosen[part]]] - points[rays[part], None])
        turns += np.bincount(rays[part], signs, minlength=len(points))
    return turns.round().astype(int)


def _signs(corners: FloatArray) -> np.ndarray:
    """(m,) by which triangles (m, 3, 3) are crossed by the ray along x from 0: 1, -1, or 0."""
    ends = np.roll(corners, -1, axis=1)
    rising = (corners[..., 2] <= 0) & (ends[..., 2] > 0)
    falling = (corners[..., 2] > 0) & (ends[..., 2] <= 0)
    low = np.where(rising[..., None], corners, ends)
    high = np.where(rising[..., None], ends, corners)
    crossed = rising | falling
    height = np.where(crossed, high[..., 2] - low[..., 2], 1.0)
    y = low[..., 1] - low[..., 2] / height * (high[..., 1] - low[..., 1])
    turns = ((y > 0) & rising).sum(axis=1) - ((y > 0) & falling).sum(axis=1)
    a, b, c = np.moveaxis(corners, 1, 0)
    normals = np.cross(b - a, c - a)
    # x > 0 where the plane meets the ray, without a division; flat ones seen from the side cancel
    ahead = np.einsum("ti,ti->t", normals, a) * normals[:, 0] > 0
    return np.where(ahead, turns, 0)


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Triangles by the cells of a grid across y and z that their boxes touch."""

    low: FloatArray
    """(2,) least y and z"""
    size: FloatArray
    """(2,) of a cell"""
    count: int
    """cells along each axis"""
    starts: np.ndarray
    """(count^2 + 1,): where the triangles of each cell begin"""
    triangles: np.ndarray

    @classmethod
    def of(cls, vertices: FloatArray, triangles: np.ndarray) -> "_Cells":
        across = vertices[:, 1:][triangles]
        least, most = across.min(axis=1), across.max(axis=1)
        low = least.min(axis=0)
        extent = np.maximum(most.max(axis=0) - low, 1e-200)
        count = min(_MOST_CELLS, int(np.sqrt(len(triangles))) + 1)
        while True:
            size = extent / count
            begin = np.clip(((least - low) / size).astype(int), 0, count - 1)
            spans = np.clip(((most - low) / size).astype(int), 0, count - 1) - begin + 1
            if count == 1 or spans.prod(axis=1).sum() <= _ENTRIES * len(triangles):
                break
            count = (count + 1) // 2
        owner, place = _repeated(spans.prod(axis=1))
        cell = (begin[owner, 0] + place // spans[owner, 1]) * count
        cell += begin[owner, 1] + place % spans[owner, 1]
        order = np.argsort(cell, kind="stable")
        counts = np.bincount(cell, minlength=count**2)
        return cls(low, size, count, np.concatenate([[0], np.cumsum(counts)]), owner[order])

    def pairs(self, points: FloatArray) -> tuple[np.ndarray, np.ndarray]:
        """Numbers (m,) of points and (m,) of the triangles in their cells."""
        scaled = (points[:, 1:] - self.low) / self.size
        within = np.flatnonzero(((scaled >= 0) & (scaled <= self.count)).all(axis=1))
        cells = np.minimum(scaled[within].astype(int), self.count - 1)
        cell = cells[:, 0] * self.count + cells[:, 1]
        ray, place = _repeated(self.starts[cell + 1] - self.starts[cell])
        return within[ray], self.triangles[self.starts[cell][ray] + place]


def _repeated(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers 0, 0, ..., 1, 1, ..., as often as the counts say, and the place among equal ones."""
    number = np.repeat(np.arange(len(counts)), counts)
    first = np.cumsum(counts) - counts
    return number, np.arange(len(number)) - first[number]
