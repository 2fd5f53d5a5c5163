"""How space moves during a scan: a rigid motion, moving least squares of tracked points, or
displacements on a coarse grid.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray, frozen, frozen_owned, increasing_times
from legsim.deformation import moving_least_squares
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import VolumeGrid, node_positions


def _between(nodes: FloatArray, index_zyx: FloatArray) -> FloatArray:
    """(p,) linear between nodes (z, y, x), and as on the border beyond it."""
    return np.asarray(
        ndimage.map_coordinates(np.asarray(nodes, float), index_zyx, order=1, mode="nearest"), float
    )


@dataclass(frozen=True, slots=True, eq=False)
class ControlPointMotion:
    """A few points that were followed through the scan; in between, space moves by moving least
    squares.
    """

    times: FloatArray
    """(v,) s"""
    reference: FloatArray
    """(m, 3) m in world at the reference time: where the reconstruction holds them"""
    moved: FloatArray
    """(v, m, 3) m in world at each view"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("ControlPointMotion.times", self.times))
        object.__setattr__(
            self, "reference", frozen("ControlPointMotion.reference", self.reference, (None, 3))
        )
        shape = (len(self.times), len(self.reference), 3)
        object.__setattr__(self, "moved", frozen("ControlPointMotion.moved", self.moved, shape))
        if len(self.reference) < 1 or not (
            np.isfinite(self.reference).all() and np.isfinite(self.moved).all()
        ):
            raise LegsimError(
                "ControlPointMotion needs at least one control point, all coordinates finite"
            )


@dataclass(frozen=True, slots=True, eq=False)
class FieldMotion:
    """Displacements on a coarse grid, one field a view; linear between nodes, and as on its border
    beyond it.
    """

    times: FloatArray
    """(v,) s"""
    grid: VolumeGrid
    """nodes, in world; may be much coarser than the volume, and should cover it"""
    displacements: Float32Array
    """(v, z, y, x, 3) m, x, y, z in world: where the point that rests at a node is at times[v],
    less the node
    """

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("FieldMotion.times", self.times))
        shape = (len(self.times), *self.grid.shape_zyx, 3)
        object.__setattr__(
            self,
            "displacements",
            frozen("FieldMotion.displacements", self.displacements, shape, np.float32),
        )
        if not np.isfinite(self.displacements).all():
            raise LegsimError("FieldMotion.displacements holds a value that is not a finite number")


def sampled(motion: ControlPointMotion, grid: VolumeGrid) -> FieldMotion:
    """The same motion as displacements at the nodes of ``grid``: for any number of control points
    on the device.
    """
    nodes = node_positions(grid)
    fields = np.empty((len(motion.times), len(nodes), 3), np.float32)
    for field, moved in zip(fields, motion.moved, strict=True):
        field[:] = moving_least_squares.warp_points(nodes, motion.reference, moved) - nodes
    return FieldMotion(
        motion.times, grid, frozen_owned(fields.reshape(len(fields), *grid.shape_zyx, 3))
    )


def image_points(
    geometry: ConeBeamGeometry, motion: ControlPointMotion
) -> tuple[FloatArray, FloatArray]:
    """Control points at rest and moved in every view, both (v, m, 2) pixels (u, v).

    Raises:
        LegsimError: the motion is not given at the views, or a point comes behind the source.
    """
    if len(motion.times) != len(geometry):
        raise LegsimError(
            f"the control points have {len(motion.times)} times for {len(geometry)} views; follow "
            "them to the views' own times"
        )
    resting, depth = geometry.project(motion.reference)
    moved, depth_moved = geometry.project(motion.moved)
    if min(depth.min(), depth_moved.min()) <= 0:
        view = int(np.argmin(np.minimum(depth.min(-1), depth_moved.min(-1))))
        raise LegsimError(
            f"a control point lies behind the source in view {view}; draw the points nearer to "
            "the knee"
        )
    return resting, moved


@dataclass(frozen=True, slots=True, eq=False)
class RigidMotion:
    """How everything moved against a reference time, as one rigid transform a view, in world."""

    times: FloatArray
    """(v,) s"""
    moved_from_reference: FloatArray
    """(v, 4, 4): carries a point at the reference time to where it is at times[v]"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", increasing_times("RigidMotion.times", self.times))
        shape = (len(self.times), 4, 4)
        object.__setattr__(
            self,
            "moved_from_reference",
            frozen("RigidMotion.moved_from_reference", self.moved_from_reference, shape),
        )
        if not np.isfinite(self.moved_from_reference).all():
            bad = int(np.argwhere(~np.isfinite(self.moved_from_reference))[0, 0])
            raise LegsimError(
                "RigidMotion.moved_from_reference holds a value that is not a finite number in "
                f"view {bad}"
            )

    @classmethod
    def identity(cls, times: FloatArray) -> "RigidMotion":
        """Nothing moves."""
        return cls(times, np.broadcast_to(np.eye(4), (len(times), 4, 4)))

    @classmethod
    def from_poses(cls, times: FloatArray, world_from_body: FloatArray) -> "RigidMotion":
        """Motion of a body against its first pose: M(i) = S(i) S(0)^-1, the order that is right
        (not the published one).
        """
        return cls(times, world_from_body @ transforms.inverse(world_from_body[0]))


Motion = RigidMotion | ControlPointMotion | FieldMotion


def carried(points: ArrayLike, motion: Motion) -> FloatArray:
    """(v, p, 3) where ``motion`` says that points (p, 3), in world at rest, are at each of its
    times.
    """
    points = np.asarray(points, float)
    if isinstance(motion, RigidMotion):
        return transforms.apply(motion.moved_from_reference, points)
    if isinstance(motion, ControlPointMotion):
        return np.stack(
            [
                moving_least_squares.warp_points(points, motion.reference, moved)
                for moved in motion.moved
            ]
        )
    index = ((points - motion.grid.origin) / motion.grid.spacing_xyz).T[::-1]
    fields = (
        np.stack([_between(field[..., axis], index) for axis in range(3)], -1)
        for field in motion.displacements
    )
    return points + np.stack(list(fields))


def rigid_part(motion: Motion, points: ArrayLike) -> FloatArray:
    """(v, 4, 4) the rigid motion that carries points (p, 3) most nearly as ``motion`` does; a rigid
    one's own matrices.
    """
    if isinstance(motion, RigidMotion):
        return motion.moved_from_reference
    return np.stack([transforms.best_rigid(points, moved) for moved in carried(points, motion)])
