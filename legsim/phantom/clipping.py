"""Closed meshes without what lies behind a plane, and whether a point lies inside of one."""

import numpy as np

from legsim.core.values import FloatArray


def in_front(
    vertices: FloatArray, triangles: np.ndarray, depths: FloatArray, nearest: float
) -> tuple[FloatArray, np.ndarray]:
    """The part of a closed mesh at depths of ``nearest`` or more, closed by a cap in that plane.

    The cap is a fan from one point of the cut to all of its edges, wherever they run. It may cover
    itself, in both directions; what it winds around is right all the same, since the edges of a cut
    through a closed mesh are closed too.

    Args:
        vertices: (p, 3) m.
        triangles: (t, 3).
        depths: (p,) m of the vertices along any direction.
        nearest: depth of the plane, m.

    Returns:
        ``vertices`` with those of the cut behind them, and the triangles; none where all is behind.
    """
    ahead = depths >= nearest
    count = ahead[triangles].sum(axis=1)
    cut = triangles[(count == 1) | (count == 2)]
    if not len(cut):
        return vertices, triangles[count == 3]
    # the corner that is alone on its side first, in the same sense
    alone = np.where(ahead[cut].sum(axis=1) == 1, ahead[cut].T, ~ahead[cut].T).T.argmax(axis=1)
    a, b, c = (cut[np.arange(len(cut)), (alone + k) % 3] for k in range(3))
    edges = np.sort(np.stack([np.stack([a, b], 1), np.stack([a, c], 1)]), axis=2)
    unique, inverse = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
    low, high = unique.T
    share = ((nearest - depths[low]) / (depths[high] - depths[low]))[:, None]
    points = (1 - share) * vertices[low] + share * vertices[high]
    ab, ac = len(vertices) + inverse.reshape(2, -1)
    tip = ahead[a]
    tips = np.stack([a, ab, ac], 1)[tip]
    stumps = np.concatenate([np.stack([b, c, ac], 1)[~tip], np.stack([b, ac, ab], 1)[~tip]])
    apex = np.full(len(cut), len(vertices))
    # each edge of the cut in the other direction than its triangle has it
    cap = np.where(tip[:, None], np.stack([ac, ab, apex], 1), np.stack([ab, ac, apex], 1))
    cap = cap[(cap[:, :2] != apex[:, None]).all(axis=1)]
    kept = np.concatenate([triangles[count == 3], tips, stumps, cap])
    return np.concatenate([vertices, points]), kept.astype(triangles.dtype)


def winds_around(vertices: FloatArray, triangles: np.ndarray, point: FloatArray) -> bool:
    """Whether a closed mesh winds around a point, by the solid angle that it fills from there.

    Angles of triangles are those of Van Oosterom and Strackee (IEEE Trans Biomed Eng 30, 1983).
    """
    a, b, c = np.moveaxis((vertices - point)[triangles], 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    volume = (a * np.cross(b, c)).sum(1)
    below = la * lb * lc + (a * b).sum(1) * lc + (a * c).sum(1) * lb + (b * c).sum(1) * la
    turns = np.arctan2(volume, below).sum() / (2 * np.pi)
    return bool(abs(turns) > 0.5)
