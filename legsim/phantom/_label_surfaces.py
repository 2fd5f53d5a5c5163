"""Closed smooth meshes of masks and distance fields on a grid."""

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree
from skimage import measure

from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.phantom import surfaces

_SIGMA = 1.3
"""voxels: less leaves stairs, more rounds off what is a few voxels thick"""

PADDING = 8
"""voxels around a mask: beyond the reach of the smoothing"""

_AT_ONCE = 1 << 18
"""voxels whose distances are sought in one go"""

_LEAST = 0.02
"""least distance of the smoothed field from its level at a voxel's center: no triangle degenerates
where the surface would pass exactly through one
"""


def smoothed(mask: np.ndarray) -> np.ndarray:
    """Field of a mask (k, j, i), above 0 inside, with :data:`PADDING` voxels more on each end.

    The mask is smoothed by (1 + w) G_s - w G_(s sqrt 2), w = 1 + sqrt 2. A Gaussian G_s alone moves
    a curved border inward by a multiple of s times its curvature; these weights cancel that. Then
    every voxel's center is kept on its side, so that the surface is within half a voxel of the
    mask's border along each axis, has the mask's topology, and nothing thin is lost.
    """
    padded = np.pad(mask, PADDING)
    once = ndimage.gaussian_filter(padded.astype(np.float32), _SIGMA)
    weight = np.float32(1 + np.sqrt(2))
    field = (1 + weight) * once - weight * ndimage.gaussian_filter(once, _SIGMA) - np.float32(0.5)
    return np.where(padded, np.maximum(field, _LEAST), np.minimum(field, -_LEAST))


def of_smoothed(field: np.ndarray, world_from_index: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Closed surface of :func:`smoothed`: vertices (p, 3) m in world, triangles (t, 3).

    ``world_from_index`` is that of the mask.
    """
    return _level(field, world_from_index, -PADDING)


def of_field(field: FloatArray, world_from_index: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Closed surface where a field (k, j, i) is 0, positive inside.

    What reaches the grid's border ends at that of its voxels, as far as the field is clipped there.
    """
    low = -float(np.abs(field).max())
    padded = np.pad(np.where(np.abs(field) < 1e-9, -1e-9, field), 1, constant_values=low)
    return _level(padded, world_from_index, -1)


def _level(
    field: FloatArray, world_from_index: FloatArray, first: int
) -> tuple[FloatArray, np.ndarray]:
    """Marching cubes (Lewiner et al. 2003), oriented outward, in world."""
    points, triangles, _, _ = measure.marching_cubes(field, 0.0)
    vertices = transforms.apply(world_from_index, points[:, ::-1].astype(float) + first)
    # marching cubes orients by the order (k, j, i); the map to world may mirror
    if surfaces.volume(vertices, triangles) < 0:
        triangles = triangles[:, ::-1]
    return vertices, triangles.astype(np.int32)


def rough_distance(mask: np.ndarray, steps: FloatArray) -> FloatArray:
    """Distance (k, j, i) in m of voxel centers from a mask's surface, positive inside.

    It is right to half a voxel: the surface of :func:`smoothed` separates each center from the
    nearest one of the other kind, and its vertices are at most a voxel from centers of both kinds.
    Where the mask reaches the grid's border there is no surface.

    Args:
        mask: (k, j, i).
        steps: (3,) m between voxels along k, j, i.
    """
    distance = np.empty(mask.shape)
    for chosen, sign in ((mask, 1), (~mask, -1)):
        if chosen.all():  # there is no surface
            return np.full(mask.shape, sign * np.inf)
        far = ndimage.distance_transform_edt(chosen, sampling=steps)
        distance[chosen] = sign * (far[chosen] - steps.max() / 2)
    return distance


def exact_distance(
    mask: np.ndarray, where: np.ndarray, surface: KDTree, world_from_index: FloatArray
) -> FloatArray:
    """Distances (n,) in m, positive inside, of the voxel centers that are chosen by ``where``.

    The surface is known by its points, at most a voxel apart.
    """
    places = np.flatnonzero(where)
    found = np.empty(len(places))
    for first in range(0, len(places), _AT_ONCE):  # coordinates of many voxels take much memory
        part = slice(first, first + _AT_ONCE)
        indices = np.stack(np.unravel_index(places[part], where.shape)[::-1], axis=-1)
        points = transforms.apply(world_from_index, indices.astype(float))
        found[part] = surface.query(points)[0]
    return np.where(mask[where], found, -found)
