"""Voxel-driven back-projection with any 3x4 matrix a view, static or along a motion, on an OpenCL device, slab by slab.

A voxel that a view's detector does not see gets nothing from it: beyond the outermost pixel centers an image fades to zero
within one pixel. Two kernels of one source (kernels/backproject.cl) share the layout of images and volume: "voxels" places every
voxel by itself and is the reference; "columns" works along whole lines of voxels and is several times faster on CPUs.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy import ndimage

from legsim import mls, transforms
from legsim.arrays import Float32Array, FloatArray
from legsim.errors import LegsimError
from legsim.geometry import ConeBeamGeometry, VolumeGrid
from legsim.motions import ControlPointMotion, FieldMotion
from legsim.opencl import Device
from legsim.signals import RigidMotion

Motion = RigidMotion | ControlPointMotion | FieldMotion
Kernel = Literal["columns", "voxels"]

_LEAD, _TRAIL, _PAD, _SPACING = 24, 40, 8, 8
_MOST_ROWS_PER_VOXEL, _MOST_SLOPE = 2.5, 0.5
# pixels by which a moved line may leave the chords of eight voxels, at the grid's corners, edges, faces and middle
_MOST_BEND = 0.25
_SLAB_BYTES = 1 << 28
_NODE_BYTES = 1 << 26
_VIEWS_AT_ONCE = 32
# for each axis along which columns may run: the axes across, the one that comes faster in the host's order first
_ACROSS = {0: (1, 2), 1: (0, 2), 2: (0, 1)}


@dataclass(frozen=True, slots=True)
class BackprojectionPlan:
    """How a volume will be computed and what it takes, decided before anything is allocated."""

    kernel: Kernel
    column_axis: int
    """world axis (0 x, 1 y, 2 z) that columns of voxels run along"""
    curve: int
    """what a column projects to: 0 a detector column, 1 a straight line, 2 a curve"""
    mirrored: tuple[bool, ...]
    """views whose rows run against the column axis"""
    slab: int
    """slices along z that are computed together"""
    batch: int
    """views that are back-projected together"""
    image_bytes: int
    """device memory for all filtered views"""
    slab_bytes: int
    """device memory for a slab, twice, and for what places its voxels"""

    @property
    def device_bytes(self) -> int:
        """Device memory in all (on a CPU that is host memory)."""
        return self.image_bytes + self.slab_bytes


def plan(
    geometry: ConeBeamGeometry,
    grid: VolumeGrid,
    device: Device,
    *,
    motion: Motion | None = None,
    kernel: Kernel | None = None,
    slab_bytes: int = _SLAB_BYTES,
) -> BackprojectionPlan:
    """Chooses kernel, column axis, slabs and batches; ``kernel`` None takes the fastest that is right here.

    "columns" needs every voxel in front of the source, at most 2.5 detector rows between neighboring voxels along one of the world's axes,
    and lines along it that turn less than 27 degrees off the detector's columns in every view and, where a motion bends them, stay
    within a quarter of a pixel of chords of eight voxels.

    Raises:
        LegsimError: ``kernel`` "columns" was asked for where it does not work, the motion has another number of views, or the device's
            memory does not hold the views.
    """
    if motion is not None and len(motion.times) != len(geometry):
        raise LegsimError(f"the motion has {len(motion.times)} transforms for {len(geometry)} views; expected one a view")
    axis, mirrored, curve = _column_axis(geometry, grid, motion)
    if kernel == "columns" and curve is None:
        raise LegsimError(
            "the column kernel does not work for this geometry and grid; leave the choice of the kernel open, or take 'voxels'"
        )
    chosen: Kernel = kernel or ("columns" if curve is not None and device.is_cpu else "voxels")
    rows, columns = geometry.shape_vu
    image_bytes = 4 * len(geometry) * (columns + 2 * _PAD) * _stride(rows)
    nz, ny, nx = grid.shape_zyx
    per_slice = 4 * (ny + _SPACING) * (nx + _SPACING)
    slab = int(np.clip(slab_bytes // per_slice, 1, nz))
    node_bytes = 12 * (slab // _SPACING + 2) * (ny // _SPACING + 2) * (nx // _SPACING + 2)
    batch = int(np.clip(_NODE_BYTES // node_bytes, 1, _VIEWS_AT_ONCE))
    if curve is None:
        curve = 2 if isinstance(motion, ControlPointMotion | FieldMotion) else 1
    found = BackprojectionPlan(chosen, axis, curve, mirrored, slab, batch, image_bytes, 2 * slab * per_slice + batch * node_bytes)
    if found.device_bytes > device.candidate.memory_bytes:
        raise LegsimError(
            f"{len(geometry)} views of {columns} x {rows} pixels and a slab need {found.device_bytes / 2**30:.1f} GiB, "
            f"but {device.label} has {device.candidate.memory_bytes / 2**30:.1f} GiB; take fewer views or bin the pixels"
        )
    return found


def _stride(rows: int) -> int:
    return _LEAD + -(-(rows + 1) // 8) * 8


def _column_axis(geometry: ConeBeamGeometry, grid: VolumeGrid, motion: Motion | None) -> tuple[int, tuple[bool, ...], int | None]:
    """(axis, mirrored views, curve), from how a lattice of points and their neighbors one voxel on project; curve None: no axis will do."""
    lattice = np.stack(np.meshgrid(*(axis[np.unique([0, len(axis) // 2, len(axis) - 1])] for axis in grid.axes())), -1).reshape(-1, 3)

    def seen(offset: FloatArray) -> tuple[FloatArray, FloatArray]:
        return geometry.project(_carried(lattice + offset, motion, len(geometry)))

    steps = np.diag(grid.spacing_xyz)
    at, depths = seen(np.zeros(3))
    axis, slope, change, further = 1, np.inf, np.zeros_like(at), depths
    for candidate in (1, 0, 2):
        beyond, depths_beyond = seen(steps[candidate])
        rows = (beyond - at)[..., 1] * np.sign(np.median((beyond - at)[..., 1], axis=1))[:, None]
        steepest = float(np.abs((beyond - at)[..., 0]).max() / max(rows.min(), 1e-12))
        if steepest < 0.5 * slope:
            axis, slope, change, further = candidate, steepest, beyond - at, depths_beyond
    mirrored = tuple(bool(m) for m in np.median(change[..., 1], axis=1) < 0)
    if depths.min() <= 0 or further.min() <= 0 or slope >= _MOST_SLOPE or np.abs(change[..., 1]).max() > _MOST_ROWS_PER_VOXEL:
        return axis, mirrored, None
    if isinstance(motion, ControlPointMotion | FieldMotion):
        halves = (seen(0.5 * _SPACING * steps[k])[0] + seen(-0.5 * _SPACING * steps[k])[0] for k in range(3))
        return axis, mirrored, 2 if max(np.abs(0.5 * half - at).max() for half in halves) < _MOST_BEND else None
    count = grid.shape_zyx[2 - axis]
    straight = np.abs(change[..., 0]).max() * count < 1e-3 and np.abs(further / depths - 1).max() * count * max(geometry.shape_vu) < 1e-3
    return axis, mirrored, 0 if straight else 1


def _carried(points: FloatArray, motion: Motion | None, views: int) -> FloatArray:
    """(v, p, 3) where points (p, 3) are in each view."""
    if motion is None:
        return np.broadcast_to(points, (views, *points.shape))
    if isinstance(motion, RigidMotion):
        return transforms.apply(motion.moved_from_reference, points)
    if isinstance(motion, ControlPointMotion):
        return np.stack([mls.displaced(points, motion.reference, moved) for moved in motion.moved])
    index = ((points - motion.grid.origin) / motion.grid.spacing_xyz).T
    fields = np.empty((views, 3, len(points)))
    for field, out in zip(motion.displacements, fields, strict=True):
        for part, target in zip(field.T, out, strict=True):  # axes x, y, z after the transposition, as those of index
            ndimage.map_coordinates(part, index, target, order=1, mode="nearest")
    return points + fields.transpose(0, 2, 1)


def arranged(images: Float32Array, mirrored: np.ndarray) -> Float32Array:
    """(n, columns + 2 pad, stride): images (n, rows, columns) as the kernels read them, rows fastest, zeros around."""
    count, rows, columns = images.shape
    out = np.zeros((count, columns + 2 * _PAD, _stride(rows)), np.float32)
    for k, image in enumerate(images):
        out[k, _PAD : _PAD + columns, _LEAD : _LEAD + rows] = (image[::-1] if mirrored[k] else image).T
    return out


def slabs(
    batches: Iterable[tuple[slice, Float32Array]],
    geometry: ConeBeamGeometry,
    grid: VolumeGrid,
    device: Device,
    decided: BackprojectionPlan,
    *,
    motion: Motion | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[tuple[int, Float32Array]]:
    """Yields (first slice, sums (n, y, x) of image(u, v) / depth^2 over the views), slab by slab along z.

    ``batches`` yields (views, images (n, columns + 2 pad, stride)) as :func:`arranged` makes them. ``progress`` counts batches of views
    over all slabs.
    """
    views, (rows, columns) = len(geometry), geometry.shape_vu
    size = (columns + 2 * _PAD) * _stride(rows)
    images = device.zeros(views * size)
    for where, batch in batches:
        device.write(images, batch, where.start * size)
    placement = _Placement(geometry, grid, device, decided, motion)
    nz = grid.shape_zyx[0]
    starts = range(0, nz, decided.slab)
    groups = [slice(k, min(k + decided.batch, views)) for k in range(0, views, decided.batch)]
    for index, start in enumerate(starts):
        slab = _Slab(placement, start, min(start + decided.slab, nz))
        for number, group in enumerate(groups):
            slab.add(images, group)
            if progress is not None:
                progress(index * len(groups) + number + 1, len(starts) * len(groups))
        yield start, slab.result()


class _Placement:
    """Where voxels fall in the views, in the form that the kernels take."""

    def __init__(
        self, geometry: ConeBeamGeometry, grid: VolumeGrid, device: Device, decided: BackprojectionPlan, motion: Motion | None
    ) -> None:
        self.grid, self.device, self.decided = grid, device, decided
        self.rows, self.columns = geometry.shape_vu
        self.axes = (decided.column_axis, *_ACROSS[decided.column_axis])
        flip = np.array([[1.0, 0, 0], [0, -1, self.rows - 1], [0, 0, 1]])
        maps = np.where(np.array(decided.mirrored)[:, None, None], flip @ geometry.matrices, geometry.matrices)
        self.anchor = np.array(grid.center)
        self.field: Float32Array | None = None
        rest: FloatArray | Float32Array = np.zeros(1)
        if isinstance(motion, ControlPointMotion):
            numbers = mls.three_points(motion, maps, anchor=self.anchor)
            self.motion, rest, self.tables = 1, numbers.rest, np.asarray(numbers.views, float)
        elif isinstance(motion, FieldMotion):
            spacing = np.array(motion.grid.spacing_xyz)
            rest = np.concatenate([1 / spacing, (self.anchor - motion.grid.origin) / spacing, motion.grid.shape_zyx[::-1]])
            self.motion, self.field, self.tables = 2, motion.displacements, maps @ transforms.translation(self.anchor)
        else:
            self.motion, self.tables = 0, maps if motion is None else maps @ motion.moved_from_reference
        self.rest = device.upload(np.asarray(rest, np.float32))
        self.nothing = device.zeros(8)

    def world_from_index(self, first_slice: int) -> FloatArray:
        """(4, 4) from (c, b, a, 1) of the slab to world."""
        matrix = np.zeros((4, 4))
        for column, axis in enumerate(self.axes):
            matrix[axis, column] = self.grid.spacing_xyz[axis]
        matrix[:3, 3], matrix[3, 3] = self.grid.origin, 1.0
        matrix[2, 3] += first_slice * self.grid.spacing_xyz[2]
        return matrix

    def kernel(self, name: str) -> Any:
        """One of backproject.cl, specialized."""
        files = ("mls.cl", "backproject.cl") if self.motion == 1 else ("backproject.cl",)
        count = self.grid.shape_zyx[2 - self.axes[0]] if self.axes[0] != 2 else self.decided.slab
        return self.device.kernel(
            name,
            *files,
            MOTION=self.motion,
            CURVE=self.decided.curve,
            COLUMNS=self.columns,
            ROWS=self.rows,
            STRIDE=_stride(self.rows),
            LEAD=_LEAD,
            TRAIL=_TRAIL,
            PAD=_PAD,
            NODES=-(-count // _SPACING) + 1,
        )


class _Slab:
    """Consecutive slices of the volume on the device."""

    def __init__(self, placement: _Placement, start: int, stop: int) -> None:
        self.placement, self.device = placement, placement.device
        counts = (*placement.grid.shape_zyx[:0:-1], stop - start)
        self.counts = [counts[axis] for axis in placement.axes]
        self.shape = (stop - start, *placement.grid.shape_zyx[1:])
        longest = placement.decided.slab if placement.axes[0] == 2 else self.counts[0]
        self.stride = -(-longest // _SPACING) * _SPACING
        self.volume = self.device.zeros(self.stride * self.counts[1] * self.counts[2])
        self.world_from_index = placement.world_from_index(start)
        steps = self.world_from_index.T[:, :3].copy()
        steps[3] -= placement.anchor
        self.steps = self.device.upload(steps.astype(np.float32))

    def add(self, images: Any, views: slice) -> None:
        """Back-projects some of the ``images`` and waits for the end."""
        placement, span = self.placement, (np.int32(views.start), np.int32(views.stop - views.start))
        table = placement.tables[views]
        if placement.motion == 0:
            table = table @ self.world_from_index
        place = self.device.upload(table.reshape(len(table), -1).astype(np.float32))
        field = placement.nothing if placement.field is None else self.device.upload(placement.field[views])
        across = (self.counts[1], self.counts[2])
        if placement.decided.kernel == "voxels":
            run = placement.kernel("backproject_voxels")
            run(
                *(self.device.queue, (self.counts[0], *across), None, images, place, self.steps, placement.rest, field),
                *(*span, self.volume, np.int32(self.stride)),
            )
        else:
            nodes = placement.nothing if placement.motion == 0 else self._traced(place, field, span[1])
            run = placement.kernel("backproject_columns")
            run(
                self.device.queue, across, (1, 1), images, place, nodes, *span, self.volume, np.int32(self.counts[0]), np.int32(self.stride)
            )
        self.device.queue.finish()

    def _traced(self, place: Any, field: Any, count: np.int32) -> Any:
        """Buffer (views, 3, a, b, c) of pixel and inverse depth at every eighth voxel."""
        shape = (self.stride // _SPACING + 1, *((n - 1) // _SPACING + 2 for n in self.counts[1:]))
        # the columns kernel reads whole vectors, past the end of the last line
        nodes = self.device.zeros(3 * int(count) * int(np.prod(shape)) + _SPACING)
        run = self.placement.kernel("trace_nodes")
        run(self.device.queue, shape, None, place, self.steps, self.placement.rest, field, count, nodes)
        return nodes

    def result(self) -> Float32Array:
        """The slab (z, y, x)."""
        target = self.device.zeros(int(np.prod(self.shape)))
        stride_of = (1, self.shape[2], self.shape[1] * self.shape[2])
        along_c, across_b, across_a = (stride_of[axis] for axis in self.placement.axes)
        fastest_c = along_c == 1
        size = (self.counts[0], self.counts[1]) if fastest_c else (self.counts[1], self.counts[0])
        run = self.placement.kernel("arrange_volume")
        run(
            *(self.device.queue, (*size, self.counts[2]), None, self.volume, target, np.int32(self.stride), np.int32(self.counts[1])),
            *(np.int32(fastest_c), np.int32(along_c), np.int32(across_b), np.int64(across_a)),
        )
        return self.device.download(target, np.empty(self.shape, np.float32))
