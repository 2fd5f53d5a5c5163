"""Triangle surfaces closed, repaired and turned outward, shell by shell.

All of it sorts: time and memory grow with the triangles, millions of which are usual.
"""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from legsim.core.values import FloatArray
from legsim.phantom import winding

_GRAIN = 1e-6
"""of a surface's length: greatest distance of copies of a vertex

Text formats and single precision may round them apart.
"""

_WIDEST_HOLE = 0.25
"""of a surface's length: a hole that is larger is no small one, and not closed"""

_SAMPLES = 200

_LOW = np.int64(0xFFFFFFFF)
"""bits of the higher vertex in an edge's key"""


def closed(vertices: FloatArray, triangles: np.ndarray) -> tuple[FloatArray, np.ndarray]:
    """Merges vertices where that closes the surface.

    First the identical ones that STL, and normals or colors in OBJ and GLB, double; then those that
    text formats rounded apart. Otherwise the surface comes back with identical vertices merged.
    """
    if is_closed(triangles):
        return vertices, triangles
    vertices, triangles = _merged(vertices, triangles, _alike(vertices))
    if not is_closed(triangles):
        rounded = _merged_to_grain(vertices, triangles)
        if is_closed(rounded[1]):
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


def is_closed(triangles: np.ndarray) -> bool:
    """Whether every directed edge has its opposite as often, so that no ray enters without leaving.

    Edges, signed by direction, are summed as 64-bit hashes.
    """
    keys, forward = _edge_keys(triangles)
    mixed = _mixed(keys.astype(np.uint64))
    # an edge from a vertex to itself counts in both directions
    degenerate = (keys >> 32) == (keys & _LOW)
    there, back = (mixed[c].sum(dtype=np.uint64) for c in (forward | degenerate, ~forward))
    return bool(there == back)


def unpaired(triangles: np.ndarray, *, signed: bool = True) -> np.ndarray:
    """Edges (n, 2) that occur more often in one direction than in the other.

    Unsigned: edges that an odd number of triangles share.
    """
    keys, forward = _edge_keys(triangles)
    ordered = np.sort(keys << 1 | forward)
    if signed:  # an edge from a vertex to itself has no direction
        ordered = ordered[(ordered >> 33) != (ordered >> 1 & _LOW)]
    starts = _starts(ordered >> 1)
    counts = np.diff([*starts, len(ordered)])
    odd = counts % 2 == 1
    if signed and len(starts):
        odd = 2 * np.add.reduceat(ordered & 1, starts) != counts
    chosen = ordered[starts[odd]] >> 1
    return np.stack([chosen >> 32, chosen & _LOW], axis=-1)


def shells(triangles: np.ndarray) -> np.ndarray:
    """(t,) number of the connected shell of each triangle; shells share no edge."""
    keys, _ = _edge_keys(triangles)
    order = np.argsort(keys)
    same = np.flatnonzero(np.diff(keys[order]) == 0)
    return _connected(order[same] // 3, order[same + 1] // 3, len(triangles))


def volume(vertices: FloatArray, triangles: np.ndarray) -> float:
    """Volume in m^3 of a closed surface, negative where it faces inward."""
    return float(_volumes(vertices, triangles).sum())


def enclosed(vertices: FloatArray, triangles: np.ndarray, numbers: np.ndarray) -> float:
    """Sum of the volumes of all shells (t,), whichever way they face."""
    return float(np.abs(np.bincount(numbers, _volumes(vertices, triangles))).sum())


def _volumes(vertices: FloatArray, triangles: np.ndarray) -> FloatArray:
    """(t,) signed, between each triangle and the middle of all vertices."""
    centered = vertices - vertices.mean(axis=0)
    a, b, c = (centered[triangles[:, k]] for k in range(3))
    return np.einsum("ti,ti->t", a, np.cross(b, c)) / 6


def inverted_shells(
    vertices: FloatArray, triangles: np.ndarray, numbers: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """(alone, overlapping): triangles' numbers of each shell that faces inward but is no hollow.

    The surface as a whole faces outward. A hollow lies inside another shell; an overlapping one
    only in part, or it has part of another in it.

    Args:
        vertices: (p, 3).
        triangles: (t, 3).
        numbers: (t,) of each triangle's shell, of :func:`shells`.
    """
    inward = np.flatnonzero(np.bincount(numbers, _volumes(vertices, triangles)) < 0)
    if not len(inward):
        return [], []
    groups = _groups(numbers)
    samples = _Samples.of(vertices, [_samples(triangles[group]) for group in groups])
    most = np.zeros(len(groups))
    for k, group in enumerate(groups):
        inside = samples.inside(vertices, triangles[group])
        # only the shells met: an array of all per shell would make the time quadratic
        met, hits = np.unique(samples.owners[inside], return_counts=True)
        met, hits = met[met != k], hits[met != k]
        most[met] = np.maximum(most[met], hits / samples.counts[met])
    alone, overlapping = [], []
    for k in inward[most[inward] < 1]:
        others = samples.owners[samples.inside(vertices, triangles[groups[k]])] != k
        (overlapping if most[k] or others.any() else alone).append(groups[k])
    return alone, overlapping


def covered_shells(
    vertices: FloatArray, triangles: np.ndarray, numbers: np.ndarray
) -> list[np.ndarray]:
    """Triangles' numbers of each outward shell that lies wholly where others fill already.

    It changes nothing: what it encloses is within the part with or without it. Arguments are as of
    :func:`inverted_shells`.
    """
    outward = np.bincount(numbers, _volumes(vertices, triangles)) > 0
    if outward.sum() < 2:
        return []
    groups, chosen = _groups(numbers), np.flatnonzero(outward)
    for most in (_SAMPLES, len(vertices)):  # one spike may stick out
        samples = _Samples.of(vertices, [_samples(triangles[groups[k]], most) for k in chosen])
        filled = np.zeros(len(samples.points), int)
        for k, group in enumerate(groups):
            inside = samples.inside(vertices, triangles[group])
            filled[inside[chosen[samples.owners[inside]] != k]] += 1 if outward[k] else -1
        chosen = chosen[np.bincount(samples.owners, filled >= 1) == samples.counts]
        if not len(chosen):
            break
    return [groups[k] for k in chosen]


def _groups(numbers: np.ndarray) -> list[np.ndarray]:
    """Triangles' numbers of each shell."""
    order = np.argsort(numbers, kind="stable")
    return np.split(order, np.cumsum(np.bincount(numbers))[:-1])


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """Some points of each shell, by their x."""

    points: FloatArray
    """(n, 3)"""
    owners: np.ndarray
    """(n,) number of each one's shell"""
    counts: np.ndarray
    """of each shell"""

    @classmethod
    def of(cls, vertices: FloatArray, samples: list[np.ndarray]) -> "_Samples":
        points, counts = vertices[np.concatenate(samples)], np.array([len(one) for one in samples])
        order = np.argsort(points[:, 0])
        return cls(points[order], np.repeat(np.arange(len(samples)), counts)[order], counts)

    def inside(self, vertices: FloatArray, triangles: np.ndarray) -> np.ndarray:
        """Numbers of the points that one shell encloses; only those in its box are looked at."""
        corners = vertices[triangles].reshape(-1, 3)
        low, high = corners.min(axis=0), corners.max(axis=0)
        first, end = np.searchsorted(self.points[:, 0], [low[0], high[0]])
        near = self.points[first:end]
        boxed = first + np.flatnonzero(((near >= low) & (near <= high)).all(axis=1))
        if not len(boxed):
            return boxed
        return boxed[winding.numbers(vertices, triangles, self.points[boxed]) != 0]


def _samples(triangles: np.ndarray, most: int = _SAMPLES) -> np.ndarray:
    """Some of the vertices of triangles, evenly among their numbers."""
    used = np.unique(triangles)
    return used[np.linspace(0, len(used) - 1, min(most, len(used))).astype(int)]


def _edge_keys(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(int64 key (3 t,) of each edge, whichever way it runs; whether it runs to the higher vertex).

    The edges of a triangle follow each other.
    """
    begins, ends = triangles.ravel().astype(np.int64), triangles[:, [1, 2, 0]].ravel()
    return np.minimum(begins, ends) << 32 | np.maximum(begins, ends), begins < ends


def _mixed(keys: np.ndarray) -> np.ndarray:
    """Hashes of uint64."""
    mixed = keys * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    return mixed ^ (mixed >> np.uint64(32))


def _starts(ordered: np.ndarray) -> np.ndarray:
    """Where each run of equal values begins."""
    return np.flatnonzero(np.diff(ordered, prepend=ordered[:1] - 1))


def _connected(one: np.ndarray, other: np.ndarray, count: int) -> np.ndarray:
    """(count,) numbers of what the links between ``one`` and ``other`` connect."""
    links = coo_array((np.ones(len(one), np.int8), (one, other)), shape=(count, count))
    return connected_components(links, directed=False)[1]


def _merged_to_grain(vertices: FloatArray, triangles: np.ndarray) -> tuple[FloatArray, np.ndarray]:
    """Merges vertices that a chain of steps of at most the grain connects."""
    first, numbers = _alike(vertices)
    apart = vertices[first]
    grain = _GRAIN * float(np.ptp(apart, axis=0).max())
    near = KDTree(apart).query_pairs(grain, output_type="ndarray")
    clusters = _connected(near[:, 0], near[:, 1], len(apart))
    merged = _numbered(clusters)
    return _merged(vertices, triangles, (first[merged[0]], merged[1][numbers]))


def _alike(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(first (n,), number (p,)) of equal rows (p, k) of 8 bytes a value, in order of appearance."""
    rows = rows + 0  # there is one 0
    hashed = np.zeros(len(rows), np.uint64)
    for column in np.ascontiguousarray(rows.T).view(np.uint64):
        hashed = _mixed(hashed ^ column)
    first, numbers = _numbered(hashed)
    if (rows == rows[first][numbers]).all():
        return first, numbers
    return _numbered(np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1))


def _numbered(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(first (n,), number (p,)) of equal values (p,), in order of appearance."""
    _, first, numbers = np.unique(values, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return np.sort(first), rank[numbers]


def _merged(
    vertices: FloatArray, triangles: np.ndarray, alike: tuple[np.ndarray, np.ndarray]
) -> tuple[FloatArray, np.ndarray]:
    """Merges the vertices with equal numbers, of :func:`_alike`.

    Triangles that lose a corner by it are dropped.
    """
    first, numbers = alike
    merged = numbers[triangles]
    kept = (
        (merged[:, 0] != merged[:, 1])
        & (merged[:, 1] != merged[:, 2])
        & (merged[:, 2] != merged[:, 0])
    )
    return vertices[first], merged[kept]


def _without_doubles(triangles: np.ndarray) -> tuple[np.ndarray, int]:
    """Keeps one of the triangles with the same corners; returns how many were left out."""
    first, _ = _alike(np.sort(triangles.astype(np.int64), axis=1))
    return triangles[first], len(triangles) - len(first)


def _without_flaps(triangles: np.ndarray) -> tuple[np.ndarray, int]:
    """Leaves out, time and again, triangles between an edge of three or more and an open one."""
    count = len(triangles)
    while len(triangles):
        keys, _ = _edge_keys(triangles)
        ordered = np.sort(keys)
        starts = _starts(ordered)
        shared = np.diff([*starts, len(ordered)])
        if shared.max() <= 2:
            break
        sharing = shared[np.searchsorted(ordered[starts], keys)].reshape(-1, 3)
        flaps = (sharing > 2).any(1) & (sharing == 1).any(1)
        if not flaps.any():
            break
        triangles = triangles[~flaps]
    return triangles, count - len(triangles)


def _oriented_alike(triangles: np.ndarray) -> tuple[np.ndarray, int]:
    """Turns triangles so that neighbors agree; and how many.

    The fewer ones of a shell are turned. Each triangle stands twice in a graph, as it is and
    turned, linked with those of its neighbors that agree: a shell becomes two components, of which
    one is chosen. Where they are one, as on a Moebius strip, nothing is turned.
    """
    if is_closed(triangles):
        return triangles, 0
    count = len(triangles)
    keys, forward = _edge_keys(triangles)
    order = np.argsort(keys)
    starts = _starts(keys[order])
    pairs = starts[np.diff([*starts, len(order)]) == 2]
    one, other = order[pairs], order[pairs + 1]
    across = np.where(forward[one] == forward[other], count, 0)  # those of one direction disagree
    one, other = one // 3, other // 3
    whole = _connected(
        np.concatenate([one, one + count]),
        np.concatenate([other + across, other + count - across]),
        2 * count,
    )
    as_it_is, turned = whole[:count], whole[count:]
    shell, second = np.minimum(as_it_is, turned), as_it_is > turned
    more = np.bincount(shell, second) > 0.5 * np.bincount(shell)
    flipped = second != more[shell]
    result = np.where(flipped[:, None], triangles[:, ::-1], triangles)
    return result, int(flipped.sum())


def _without_holes(
    vertices: FloatArray, triangles: np.ndarray
) -> tuple[FloatArray, np.ndarray, int]:
    """Closes holes up to a quarter of the length by triangles about their middle; and how many."""
    following: dict[int, list[int]] = defaultdict(list)
    for a, b in _without_opposite(triangles).tolist():
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


def _without_opposite(triangles: np.ndarray) -> np.ndarray:
    """Directed edges (n, 2) whose opposite no triangle has, in the order of the triangles."""
    keys, forward = _edge_keys(triangles)
    ordered = np.sort(keys << 1 | forward)
    starts = _starts(ordered >> 1)
    ends = np.append(starts[1:], len(ordered)) - 1
    one_way = ordered[starts[ordered[starts] == ordered[ends]]] >> 1
    chosen = np.flatnonzero(np.isin(keys, one_way))
    return np.stack([triangles.ravel()[chosen], triangles[:, [1, 2, 0]].ravel()[chosen]], -1)


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
