"""Slow and plain: rays cast against every triangle in float64, crossings sorted and swept."""

import numpy as np

from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.phantom.meshes import Phantom


def line_integrals(
    phantom: Phantom, geometry: ConeBeamGeometry, view: int, pixels_uv: FloatArray
) -> FloatArray:
    """(n,) line integrals of the rays through pixels (n, 2) of a view."""
    source = geometry.sources()[view]
    directions = geometry.ray_directions(pixels_uv[:, 0], pixels_uv[:, 1])[view]
    crossings: list[list[tuple[float, int, int]]] = [[] for _ in pixels_uv]
    for number, part in enumerate(phantom.parts):
        for ray, depth, sign in _crossings(part.vertices[part.triangles] - source, directions):
            crossings[ray].append((depth, number, sign))
    attenuations = [part.attenuation for part in phantom.parts]
    lengths = np.linalg.norm(directions, axis=1)
    return np.array([_sweep(c, attenuations) for c in crossings]) * lengths


def _crossings(corners: FloatArray, directions: FloatArray) -> list[tuple[int, float, int]]:
    """(ray, depth, sign) where rays from the origin cross triangles (t, 3, 3): signed volumes of
    Pluecker's test.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    found = []
    normals = [np.cross(b, c), np.cross(c, a), np.cross(a, b)]
    volumes = np.einsum("ti,ti->t", a, normals[0])
    for ray, direction in enumerate(directions):
        sides = np.stack([n @ direction for n in normals])
        hit = np.flatnonzero((sides > 0).all(0) | (sides < 0).all(0))
        for t in hit:
            found.append((ray, volumes[t] / sides[:, t].sum(), 1 if sides[0, t] > 0 else -1))
    return found


def _sweep(crossings: list[tuple[float, int, int]], attenuations: list[float]) -> float:
    windings = [0] * len(attenuations)
    total, before = 0.0, 0.0
    for depth, part, sign in sorted(crossings):
        inside = [k for k, w in enumerate(windings) if w != 0]
        total += (attenuations[inside[-1]] if inside else 0.0) * (depth - before)
        before, windings[part] = depth, windings[part] + sign
    assert not any(windings), "a ray of the reference leaked"
    return total
