"""Closed meshes without what lies behind a plane."""

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
