"""Where points go under any kind of motion: a rigid one, moving least squares of followed points, a displacement field, or none."""

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from legsim import mls, transforms
from legsim.arrays import FloatArray, frozen_owned
from legsim.errors import LegsimError
from legsim.geometry import VolumeGrid
from legsim.motions import ControlPointMotion, FieldMotion
from legsim.signals import RigidMotion

Motion = RigidMotion | ControlPointMotion | FieldMotion


def carried(points: ArrayLike, motion: Motion) -> FloatArray:
    """(v, p, 3) where ``motion`` says that points (p, 3), in world at rest, are at each of its times."""
    points = np.asarray(points, float)
    if isinstance(motion, RigidMotion):
        return transforms.apply(motion.moved_from_reference, points)
    if isinstance(motion, ControlPointMotion):
        return np.stack([mls.displaced(points, motion.reference, moved) for moved in motion.moved])
    index = ((points - motion.grid.origin) / motion.grid.spacing_xyz).T[::-1]
    fields = (np.stack([_between(field[..., axis], index) for axis in range(3)], -1) for field in motion.displacements)
    return points + np.stack(list(fields))


def rigid_part(motion: Motion, points: ArrayLike) -> FloatArray:
    """(v, 4, 4) the rigid motion that carries points (p, 3) most nearly as ``motion`` does; a rigid one's own matrices."""
    if isinstance(motion, RigidMotion):
        return motion.moved_from_reference
    return np.stack([transforms.best_rigid(points, moved) for moved in carried(points, motion)])


def _between(nodes: FloatArray, index_zyx: FloatArray) -> FloatArray:
    """(p,) linear between nodes (z, y, x), and as on the border beyond it."""
    return np.asarray(ndimage.map_coordinates(np.asarray(nodes, float), index_zyx, order=1, mode="nearest"), float)


def sampled(motion: ControlPointMotion, grid: VolumeGrid) -> FieldMotion:
    """The same motion as displacements at the nodes of ``grid``: for any number of control points on the device."""
    nodes = node_positions(grid)
    fields = np.empty((len(motion.times), len(nodes), 3), np.float32)
    for field, moved in zip(fields, motion.moved, strict=True):
        field[:] = mls.displaced(nodes, motion.reference, moved) - nodes
    return FieldMotion(motion.times, grid, frozen_owned(fields.reshape(len(fields), *grid.shape_zyx, 3)))


def node_positions(grid: VolumeGrid) -> FloatArray:
    """(n, 3) world positions of a grid's points in the order of its arrays: x fastest."""
    x, y, z = grid.axes()
    return np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], -1).reshape(-1, 3)


def nodes_over(grid: VolumeGrid, spacing: float) -> VolumeGrid:
    """A coarse grid of ``spacing`` (m) that covers all of ``grid``.

    Raises:
        LegsimError: the spacing is not positive.
    """
    if not spacing > 0:
        raise LegsimError(f"nodes of a displacement field need a positive spacing in m; got {spacing:g}")
    counts = [int(np.ceil(n * s / spacing)) + 1 for n, s in zip(grid.shape_zyx[::-1], grid.spacing_xyz, strict=True)]
    return VolumeGrid((counts[2], counts[1], counts[0]), (spacing, spacing, spacing), grid.center)
