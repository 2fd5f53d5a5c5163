"""Plain float64 back-projection and analytic ellipsoid projections: what the kernels and FDK are
held against.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import VolumeGrid


def backproject(images: np.ndarray, matrices: np.ndarray, grid: VolumeGrid) -> np.ndarray:
    """(z, y, x) sums of bilinear image(u, v) / depth^2; images fade to zero within one pixel beyond
    their outermost pixel centers.
    """
    return backproject_moved(images, matrices, grid, lambda points, _: points)


def backproject_moved(
    images: np.ndarray,
    matrices: np.ndarray,
    grid: VolumeGrid,
    moved: Callable[[np.ndarray, int], np.ndarray],
) -> np.ndarray:
    """As :func:`backproject`, each voxel looked up at moved(points (n, 3), view)."""
    z, y, x = np.meshgrid(*grid.axes()[::-1], indexing="ij")
    points = np.stack([x, y, z], -1).reshape(-1, 3)
    volume = np.zeros(len(points))
    for view, (image, matrix) in enumerate(zip(images, matrices, strict=True)):
        volume += back_projected_at(image, moved(points, view) @ matrix[:, :3].T + matrix[:, 3])
    return volume.reshape(grid.shape_zyx)


def back_projected_at(image: np.ndarray, homogeneous: np.ndarray) -> np.ndarray:
    """image(u, v) / depth^2 at (u depth, v depth, depth) in the last axis, nothing behind the
    source.
    """
    depth = homogeneous[..., 2]
    seen = depth > 1e-6
    safe = np.where(seen, depth, 1.0)
    rows, columns = image.shape
    u, v = homogeneous[..., 0] / safe, homogeneous[..., 1] / safe
    seen &= (u > -1) & (u < columns) & (v > -1) & (v < rows)
    u, v = np.where(seen, u, 0.0), np.where(seen, v, 0.0)
    i, j = np.floor(u).astype(int), np.floor(v).astype(int)
    a, b = u - i, v - j
    p = np.pad(image.astype(float), 1)
    value = (1 - b) * ((1 - a) * p[j + 1, i + 1] + a * p[j + 1, i + 2]) + b * (
        (1 - a) * p[j + 2, i + 1] + a * p[j + 2, i + 2]
    )
    return np.where(seen, value / safe**2, 0.0)


def steepest(
    images: np.ndarray,
    matrices: np.ndarray,
    grid: VolumeGrid,
    moved: Callable[[np.ndarray, int], np.ndarray] = lambda points, _: points,
) -> np.ndarray:
    """(z, y, x) by how much a voxel of :func:`backproject_moved` can change per pixel by which all
    views are read beside its places, along u and v, but still between the same four pixels.
    """
    z, y, x = np.meshgrid(*grid.axes()[::-1], indexing="ij")
    points = np.stack([x, y, z], -1).reshape(-1, 3)
    total = np.zeros(len(points))
    for view, (image, matrix) in enumerate(zip(images, matrices, strict=True)):
        h = moved(points, view) @ matrix[:, :3].T + matrix[:, 3]
        rows, columns = image.shape
        i, j = np.floor(h[:, 0] / h[:, 2]).astype(int), np.floor(h[:, 1] / h[:, 2]).astype(int)
        i, j = np.clip(i, -1, columns - 1) + 1, np.clip(j, -1, rows - 1) + 1
        p = np.pad(image.astype(float), 1)
        along_u, along_v = np.abs(np.diff(p, axis=1)), np.abs(np.diff(p, axis=0))
        found = np.maximum(along_u[j, i], along_u[j + 1, i])
        total += (found + np.maximum(along_v[j, i], along_v[j, i + 1])) / h[:, 2] ** 2
    return total.reshape(grid.shape_zyx)


@dataclass(frozen=True)
class Ellipsoid:
    """Adds ``attenuation`` (1/m) inside, axes along world."""

    center: tuple[float, float, float]
    radii: tuple[float, float, float]
    attenuation: float


def project(geometry: ConeBeamGeometry, ellipsoids: list[Ellipsoid]) -> Projections:
    """Exact line integrals of a sum of ellipsoids."""
    rows, columns = geometry.shape_vu
    v, u = np.mgrid[:rows, :columns]
    sources = geometry.sources()
    images = np.zeros((len(geometry), rows, columns), np.float32)
    for k in range(len(geometry)):
        rays = geometry[k : k + 1].ray_directions(u, v)[0]
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        for e in ellipsoids:
            start, ray = (sources[k] - e.center) / e.radii, rays / np.array(e.radii)
            a, b, c = (ray**2).sum(-1), ray @ start, start @ start - 1
            images[k] += e.attenuation * 2 * np.sqrt(np.maximum(b * b - a * c, 0)) / a
    return Projections(geometry, images)
