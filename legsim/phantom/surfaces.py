"""Triangle surfaces closed, repaired and turned outward, shell by shell."""

from collections import defaultdict, deque

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from legsim.core.values import FloatArray

_GRAIN = 1e-6
"""of a surface's length: greatest distance of copies of a vertex

Text formats and single precision may round them apart.
"""

_WIDEST_HOLE = 0.25
"""of a surface's length: a hole that is larger is no small one, and not closed"""

_SAMPLES = 200


def closed(vertices: FloatArray, triangles: np.ndarray) -> tuple[FloatArray, np.ndarray]:
    """Merges vertices where that closes the surface.

    First the identical ones that STL, and normals or colors in OBJ and GLB, double; then those that
    text formats rounded apart. Otherwise the surface comes back with identical vertices merged.
    """
    if len(unpaired(triangles)) == 0:
        return vertices, triangles
    vertices, triangles = _merged(vertices, triangles, vertices)
    if len(unpaired(triangles)):
        rounded = _merged_to_grain(vertices, triangles)
        if len(unpaired(rounded[1])) == 0:
            return rounded
    return vertices, triangles


def repaired(
    vertices: FloatArray, triangles: np.ndarray
) -> tuple[FloatArray, np.ndarray, list[str]]:
    """Merges doubled vertices and triangles, orients neighbors alike and closes small holes.

    Returns what was done, a phrase each. What is still open afterwards has holes wider than a
    quarter of its length, or edges of more than two triangles.
    """
    done = []
    before = len(vertices), len(triangles)
    vertices, triangles = _merged_to_grain(vertices, triangles)
    if len(vertices) < before[0]:
        done.append(f"{before[0] - len(vertices)} doubled vertices merged")
    triangles, doubled = _without_doubles(triangles)
    triangles, flaps = _without_flaps(triangles)
    if doubled:
        done.append(f"{doubled} doubled triangles left out")
    if flaps:
        done.append(f"{flaps} triangles at edges of three or more left out")
    triangles, turned = _oriented_alike(triangles)
    if turned:
        done.append(f"{turned} triangles turned to agree with their neighbors")
    vertices, triangles, holes = _without_holes(vertices, triangles)
    if holes:
        done.append(f"{holes} holes closed")
    return vertices, triangles, done


def shells(triangles: np.ndarray) -> np.ndarray:
    """(t,) number of the connected shell of each triangle; shells share no edge."""
    edges = np.sort(_edges(triangles), axis=1)
    _, inverse = np.unique(edges, axis=0, return_inverse=True)
    owners = np.repeat(np.arange(len(triangles)), 3)
    shape = (len(triangles), int(inverse.max()) + 1)
    incidence = coo_array((np.ones(len(owners), np.int8), (owners, inverse.reshape(-1))), shape)
    return connected_components((incidence @ incidence.T), directed=False)[1]


def volume(vertices: FloatArray, triangles: np.ndarray) -> float:
    """Volume, negative where the surface faces inward."""
    a, b, c = np.moveaxis((vertices - vertices.mean(axis=0))[triangles], 1, 0)
    return float(np.einsum("ti,ti->", a, np.cross(b, c)) / 6)


def enclosed(vertices: FloatArray, triangles: np.ndarray) -> float:
    """Sum of the volumes of all shells, whichever way they face."""
    a, b, c = np.moveaxis((vertices - vertices.mean(axis=0))[triangles], 1, 0)
    parts = np.einsum("ti,ti->t", a, np.cross(b, c)) / 6
    return float(np.abs(np.bincount(shells(triangles), parts)).sum())


def inverted_shells(
    vertices: FloatArray, triangles: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """(alone, overlapping): triangles' numbers of each shell that faces inward but is no hollow.

    The surface as a whole faces outward. A hollow lies inside another shell; an overlapping one
    only in part, or it has part of another in it.
    """
    numbers = shells(triangles)
    groups = [np.flatnonzero(numbers == k) for k in range(numbers.max() + 1)]
    alone, overlapping = [], []
    for k, group in enumerate(groups):
        if volume(vertices, triangles[group]) >= 0:
            continue
        others = [g for j, g in enumerate(groups) if j != k]
        inside = [_fraction_inside(vertices, triangles, group, other) for other in others]
        if max(inside, default=0.0) == 1:
            continue
        holds = [_fraction_inside(vertices, triangles, other, group) for other in others]
        (overlapping if any([*inside, *holds]) else alone).append(group)
    return alone, overlapping


def _fraction_inside(
    vertices: FloatArray, triangles: np.ndarray, group: np.ndarray, other: np.ndarray
) -> float:
    """Fraction of some vertices of one group of triangles that lie inside another group."""
    used = np.unique(triangles[group])
    points = vertices[used[np.linspace(0, len(used) - 1, min(_SAMPLES, len(used))).astype(int)]]
    corners = vertices[triangles[other]]
    low, high = corners.min((0, 1)), corners.max((0, 1))
    boxed = points[((points > low) & (points < high)).all(axis=1)]
    return sum(abs(winding(corners, point)) > 0.5 for point in boxed) / len(points)


def winding(corners: FloatArray, point: FloatArray) -> float:
    """Winding number of triangles (t, 3, 3) around the point.

    It is the solid angle over 4 pi (Van Oosterom and Strackee 1983).
    """
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
    ab, bc, ca = (np.einsum("ti,ti->t", p, q) for p, q in ((a, b), (b, c), (c, a)))
    return float(
        np.arctan2(
            np.einsum("ti,ti->t", a, np.cross(b, c)), la * lb * lc + ab * lc + bc * la + ca * lb
        ).sum()
        / (2 * np.pi)
    )


def unpaired(triangles: np.ndarray, *, signed: bool = True) -> np.ndarray:
    """Edges (n, 2) that occur more often in one direction than in the other.

    Unsigned: edges that an odd number of triangles share.
    """
    begins, ends = triangles.ravel(), triangles[:, [1, 2, 0]].ravel()
    edges, inverse = np.unique(
        np.minimum(begins, ends).astype(np.int64) << 32 | np.maximum(begins, ends),
        return_inverse=True,
    )
    balance = np.bincount(
        inverse, weights=np.sign(ends - begins) if signed else None, minlength=len(edges)
    )
    chosen = edges[balance != 0] if signed else edges[balance % 2 == 1]
    return np.stack([chosen >> 32, chosen & 0xFFFFFFFF], axis=-1)


def _edges(triangles: np.ndarray) -> np.ndarray:
    """(3 t, 2) directed edges, those of a triangle one after another."""
    return np.stack([triangles, triangles[:, [1, 2, 0]]], -1).reshape(-1, 2)


def _merged_to_grain(vertices: FloatArray, triangles: np.ndarray) -> tuple[FloatArray, np.ndarray]:
    grain = _GRAIN * float(np.ptp(vertices, axis=0).max())
    return _merged(vertices, triangles, _clusters(vertices, grain))


def _clusters(points: FloatArray, distance: float) -> np.ndarray:
    """Labels points (p, 3) by cluster: (p, 1) numbers.

    Points connected by a chain of steps of at most ``distance`` share a number.
    """
    near = KDTree(points).query_pairs(distance, output_type="ndarray")
    linked = coo_array((np.ones(len(near), np.int8), near.T), shape=(len(points), len(points)))
    return connected_components(linked, directed=False)[1][:, None]


def _merged(
    vertices: FloatArray, triangles: np.ndarray, keys: np.ndarray
) -> tuple[FloatArray, np.ndarray]:
    """Merges the vertices with equal ``keys``.

    Triangles that lose a corner by it are dropped.
    """
    _, first, inverse = np.unique(keys + 0.0, axis=0, return_index=True, return_inverse=True)
    merged = inverse.reshape(-1)[triangles]
    kept = (
        (merged[:, 0] != merged[:, 1])
        & (merged[:, 1] != merged[:, 2])
        & (merged[:, 2] != merged[:, 0])
    )
    return vertices[first], merged[kept]


def _without_doubles(triangles: np.ndarray) -> tuple[np.ndarray, int]:
    """Keeps one of the triangles with the same corners; returns how many were left out."""
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    return triangles[np.sort(first)], len(triangles) - len(first)


def _without_flaps(triangles: np.ndarray) -> tuple[np.ndarray, int]:
    """Leaves out, time and again, triangles between an edge of three or more and an open one."""
    count = len(triangles)
    while len(triangles):
        edges = np.sort(_edges(triangles), axis=1)
        _, inverse, shared = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
        sharing = shared[inverse.reshape(-1)].reshape(-1, 3)
        flaps = (sharing > 2).any(1) & (sharing == 1).any(1)
        if not flaps.any():
            break
        triangles = triangles[~flaps]
    return triangles, count - len(triangles)


def _oriented_alike(triangles: np.ndarray) -> tuple[np.ndarray, int]:
    """Turns triangles so that neighbors agree, from the first of each shell; and how many.

    The fewer ones of a shell are those that count as turned.
    """
    owners: dict[tuple[int, int], list[tuple[int, bool]]] = defaultdict(list)
    for k, (a, b) in enumerate(_edges(triangles).tolist()):
        owners[min(a, b), max(a, b)].append((k // 3, a < b))
    neighbors: list[list[tuple[int, bool]]] = [[] for _ in triangles]
    for pair in owners.values():
        if len(pair) == 2:
            (one, forth), (two, back) = pair
            neighbors[one].append((two, forth == back))
            neighbors[two].append((one, forth == back))
    turned = np.full(len(triangles), -1, np.int8)
    for seed in range(len(triangles)):
        if turned[seed] < 0:
            _spread(seed, neighbors, turned)
    flipped = turned == 1
    result = np.where(flipped[:, None], triangles[:, ::-1], triangles)
    return result, int(flipped.sum())


def _spread(seed: int, neighbors: list[list[tuple[int, bool]]], turned: np.ndarray) -> None:
    """Marks in ``turned`` which triangles of the seed's shell to turn: the fewer ones."""
    turned[seed], reached, waiting = 0, [seed], deque([seed])
    while waiting:
        here = waiting.popleft()
        for other, disagree in neighbors[here]:
            if turned[other] < 0:
                turned[other] = turned[here] ^ disagree
                reached.append(other)
                waiting.append(other)
    if turned[reached].mean() > 0.5:
        turned[reached] ^= 1


def _without_holes(
    vertices: FloatArray, triangles: np.ndarray
) -> tuple[FloatArray, np.ndarray, int]:
    """Closes holes up to a quarter of the length by triangles about their middle; and how many."""
    edges = _edges(triangles)
    present = set(map(tuple, edges.tolist()))
    following: dict[int, list[int]] = defaultdict(list)
    for a, b in edges.tolist():
        if (b, a) not in present:
            following[b].append(a)
    widest = _WIDEST_HOLE * float(np.ptp(vertices, axis=0).max())
    added_points: list[FloatArray] = []
    added: list[tuple[int, int, int]] = []
    holes = 0
    for loop in _loops(following):
        corners = vertices[loop]
        if np.ptp(corners, axis=0).max() > widest:
            continue
        holes += 1
        if len(loop) == 3:
            added.append((loop[0], loop[1], loop[2]))
            continue
        middle = len(vertices) + len(added_points)
        added_points.append(corners.mean(axis=0))
        added += [(a, b, middle) for a, b in zip(loop, [*loop[1:], loop[0]], strict=True)]
    if not holes:
        return vertices, triangles, 0
    points = np.concatenate([vertices, np.reshape(added_points, (-1, 3))])
    return points, np.concatenate([triangles, np.array(added)]), holes


def _loops(following: dict[int, list[int]]) -> list[list[int]]:
    """Closed walks along directed edges, none of which passes a vertex twice."""
    loops = []
    for start in list(following):
        while following[start]:
            walk, place = [start], {start: 0}
            while following[walk[-1]]:
                step = following[walk[-1]].pop()
                if step in place:
                    loop = walk[place[step] :]
                    loops.append(loop)
                    for vertex in loop[1:]:
                        del place[vertex]
                    walk = walk[: place[step] + 1]
                else:
                    place[step] = len(walk)
                    walk.append(step)
    return [loop for loop in loops if len(loop) > 2]
