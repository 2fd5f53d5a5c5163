"""Motions of space during a scan: rigid, of followed points, or displacements on a grid."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray, frozen, frozen_owned, increasing_times
from legsim.deformation import moving_least_squares
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import VolumeGrid

_ON_A_LINE = 1e-6
"""spread of points across a line over that along it, of which rounding leaves nothing"""

_NODES = 8e-3
"""m between the nodes of a motion that is known as samples alone"""


@dataclass(frozen=True, slots=True, eq=False)
class Motion(ABC):
    """How space moves against a reference time, view by view, in world."""

    times: FloatArray
    """(v,) s"""

    straight: ClassVar[bool] = False
    """whether every line stays a line"""

    def __post_init__(self) -> None:
        name = f"{type(self).__name__}.times"
        object.__setattr__(self, "times", increasing_times(name, self.times))

    def _span(self) -> str:
        """Count and duration in one phrase."""
        return f"{len(self.times)} views over {np.ptp(self.times):.4g} s"

    @abstractmethod
    def arrays(self) -> dict[str, np.ndarray]:
        """What makes up the motion beside its times, by the names that files give it."""

    @abstractmethod
    def _views(self, points: FloatArray) -> Iterator[FloatArray]:
        """Yields points (p, 3) where each view has them."""

    def carry(self, points: ArrayLike) -> FloatArray:
        """(v, p, 3) m where points (p, 3), in world at the reference time, are at each time."""
        return np.stack(list(self._views(np.asarray(points, float))))

    def rigid_part(self, points: ArrayLike) -> FloatArray:
        """(v, 4, 4) rigid transforms nearest to this motion at points (p, 3), by least squares."""
        return np.stack([transforms.best_rigid(points, moved) for moved in self.carry(points)])

    def on_grid(self, grid: VolumeGrid) -> FieldMotion:
        """The same motion as displacements at the nodes of ``grid``."""
        return self._sampled(grid, grid.positions())

    def placed(self, at: ArrayLike, nodes: VolumeGrid) -> Motion:
        """The same motion of an object that lies elsewhere at the reference time.

        A volume reconstructed along it is the one along this motion, read at A x for every voxel
        x, but without interpolation.

        Args:
            at: (4, 4) m, a rigid transform A; the result carries from x what this motion carries
                from A x.
            nodes: coarse grid over the volume, for motions that are only known as samples.
        """
        return self._sampled(nodes, transforms.apply(at, nodes.positions()))

    def _sampled(self, grid: VolumeGrid, read_at: FloatArray) -> FieldMotion:
        """Displacements of the nodes to where this motion carries the points (n, 3)."""
        nodes = grid.positions()
        fields = np.empty((len(self.times), len(nodes), 3), np.float32)
        for field, moved in zip(fields, self._views(read_at), strict=True):
            field[:] = moved - nodes
        return FieldMotion(
            self.times, grid, frozen_owned(fields.reshape(len(fields), *grid.shape_zyx, 3))
        )


@dataclass(frozen=True, slots=True, eq=False)
class RigidMotion(Motion):
    """One rigid transform per view: everything moves alike."""

    moved_from_reference: FloatArray
    """(v, 4, 4): carries a point at the reference time to where it is at times[v]"""

    straight: ClassVar[bool] = True

    def __post_init__(self) -> None:
        Motion.__post_init__(self)
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

    def __repr__(self) -> str:
        cosines = 0.5 * (np.trace(self.moved_from_reference[:, :3, :3], axis1=1, axis2=2) - 1)
        turned = np.degrees(np.arccos(np.clip(cosines, -1, 1)).max(initial=0))
        return f"RigidMotion({self._span()}, turned by up to {turned:.3g} deg)"

    @classmethod
    def identity(cls, times: FloatArray) -> RigidMotion:
        """Nothing moves."""
        return cls(times, np.broadcast_to(np.eye(4), (len(times), 4, 4)))

    @classmethod
    def from_poses(cls, times: FloatArray, world_from_body: FloatArray) -> RigidMotion:
        """Motion of a body against its first pose: M(i) = S(i) S(0)^-1."""
        return cls(times, world_from_body @ transforms.inverse(world_from_body[0]))

    def arrays(self) -> dict[str, np.ndarray]:
        return {"moved_from_reference": self.moved_from_reference}

    def placed(self, at: ArrayLike, nodes: VolumeGrid | None = None) -> RigidMotion:
        """The matrices times ``at``; ``nodes`` are not needed."""
        return RigidMotion(self.times, self.moved_from_reference @ np.asarray(at, float))

    def _views(self, points: FloatArray) -> Iterator[FloatArray]:
        return (transforms.apply(matrix, points) for matrix in self.moved_from_reference)

    def rigid_part(self, points: ArrayLike) -> FloatArray:
        """(v, 4, 4) its own matrices, whatever the points."""
        return self.moved_from_reference


@dataclass(frozen=True, slots=True, eq=False)
class ControlPointMotion(Motion):
    """A few points followed through the scan; between them space moves by moving least squares."""

    reference: FloatArray
    """(m, 3) m in world at the reference time: where the reconstruction holds them"""
    moved: FloatArray
    """(v, m, 3) m in world at each view"""

    def __post_init__(self) -> None:
        Motion.__post_init__(self)
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

    def __repr__(self) -> str:
        shift = 1e3 * np.linalg.norm(self.moved - self.reference, axis=-1).max(initial=0)
        points = f"{len(self.reference)} points moved by up to {shift:.3g} mm"
        return f"ControlPointMotion({self._span()}, {points})"

    def arrays(self) -> dict[str, np.ndarray]:
        return {"reference": self.reference, "moved": self.moved}

    def placed(self, at: ArrayLike, nodes: VolumeGrid) -> Motion:
        """The same points, which rest elsewhere; samples where they lie on a line.

        Points on a line do not tell a turn about it.
        """
        if moving_least_squares.straightness(self.reference[None])[0] < _ON_A_LINE:
            return Motion.placed(self, at, nodes)
        reference = transforms.apply(transforms.inverse(at), self.reference)
        return ControlPointMotion(self.times, reference, self.moved)

    def _views(self, points: FloatArray) -> Iterator[FloatArray]:
        return (
            moving_least_squares.warp_points(points, self.reference, moved) for moved in self.moved
        )


@dataclass(frozen=True, slots=True, eq=False)
class FieldMotion(Motion):
    """Displacements on a coarse grid, one field per view: linear between nodes, constant beyond."""

    grid: VolumeGrid
    """nodes, in world; may be much coarser than the volume, and should cover it"""
    displacements: Float32Array
    """(v, z, y, x, 3) m, x, y, z in world: where the point that rests at a node is at times[v],
    less the node
    """

    def __post_init__(self) -> None:
        Motion.__post_init__(self)
        shape = (len(self.times), *self.grid.shape_zyx, 3)
        object.__setattr__(
            self,
            "displacements",
            frozen("FieldMotion.displacements", self.displacements, shape, np.float32),
        )
        if not np.isfinite(self.displacements).all():
            raise LegsimError("FieldMotion.displacements holds a value that is not a finite number")

    def __repr__(self) -> str:
        nz, ny, nx = self.grid.shape_zyx
        sizes = "x".join(f"{1e3 * s:.4g}" for s in self.grid.spacing_xyz)
        return f"FieldMotion({self._span()}, {nx}x{ny}x{nz} nodes (x, y, z) {sizes} mm apart)"

    def arrays(self) -> dict[str, np.ndarray]:
        return {
            "displacements": self.displacements,
            "grid_spacing_xyz": np.array(self.grid.spacing_xyz),
            "grid_center": np.array(self.grid.center),
        }

    def placed(self, at: ArrayLike, nodes: VolumeGrid | None = None) -> FieldMotion:
        """Samples at its own nodes; ``nodes`` are not needed."""
        return self._sampled(self.grid, transforms.apply(at, self.grid.positions()))

    def _views(self, points: FloatArray) -> Iterator[FloatArray]:
        index_zyx = ((points - self.grid.origin) / self.grid.spacing_xyz).T[::-1]
        for field in self.displacements:
            yield points + np.stack([_between(field[..., k], index_zyx) for k in range(3)], -1)


def _between(nodes: FloatArray, index_zyx: FloatArray) -> FloatArray:
    """(p,) linear between nodes (z, y, x), and as on the border beyond it."""
    return np.asarray(
        ndimage.map_coordinates(np.asarray(nodes, float), index_zyx, order=1, mode="nearest"), float
    )


def placed(motion: Motion | None, times: FloatArray, at: ArrayLike, grid: VolumeGrid) -> Motion:
    """The motion of an object that lies elsewhere in a volume on ``grid``: :meth:`Motion.placed`.

    None is an object at rest at the ``times`` (v,) s.
    """
    if motion is None:
        motion = RigidMotion.identity(times)
    return motion.placed(at, grid.coarse(_NODES))


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
            "the knee, or follow sensors that drift less"
        )
    return resting, moved
