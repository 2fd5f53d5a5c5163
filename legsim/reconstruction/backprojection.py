"""Voxel-driven back-projection with any 3x4 matrices, static or along a motion; and its adjoint.

It runs on an OpenCL device, slab by slab. A view adds nothing to a voxel that its detector does not
see: beyond the outermost pixel centers an image fades to zero within one pixel. Kernels of one
source (kernels/backproject.cl) share the layout of images and volume: "voxels" places every voxel
by itself and is the reference; "textures" does the same with images read by texture units of GPUs;
"columns" works along whole lines of voxels and is several times faster on CPUs.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray
from legsim.deformation import three_points
from legsim.deformation.models import ControlPointMotion, FieldMotion, Motion, RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction._backprojection_plan import (
    LEAD,
    PAD,
    SPACING,
    TRAIL,
    BackprojectionPlan,
    stride,
)

_VOXELS_EACH = 4
"""voxels of a work-item on devices other than CPUs"""

# for each axis along which columns may run: the axes across, the one that comes faster in the
# host's order first
_ACROSS = {0: (1, 2), 1: (0, 2), 2: (0, 1)}


def arranged(images: Float32Array, mirrored: np.ndarray) -> Float32Array:
    """(n, columns + 2 pad, stride): images (n, rows, columns), rows fastest, zeros around."""
    count, rows, columns = images.shape
    out = np.zeros((count, columns + 2 * PAD, stride(rows)), np.float32)
    for k, image in enumerate(images):
        out[k, PAD : PAD + columns, LEAD : LEAD + rows] = (image[::-1] if mirrored[k] else image).T
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
    """Yields (first slice, sums (n, y, x) of image(u, v) / depth^2 over the views) along z.

    ``batches`` yields (views, images (n, columns + 2 pad, stride)) as :func:`arranged` makes them.
    ``progress`` counts batches of views over all slabs.
    """
    views = len(geometry)
    images = ViewImages(geometry, device, decided)
    for where, batch in batches:
        images.write(where, batch)
    placement = VoxelMap(geometry, grid, device, decided, motion)
    nz = grid.shape_zyx[0]
    starts = range(0, nz, decided.slab)
    groups = [slice(k, min(k + decided.batch, views)) for k in range(0, views, decided.batch)]
    for index, start in enumerate(starts):
        slab = VolumeSlab(placement, start, min(start + decided.slab, nz))
        for number, group in enumerate(groups):
            slab.add(*images.of(group), group)
            if progress is not None:
                progress(index * len(groups) + number + 1, len(starts) * len(groups))
        yield start, slab.result()


class ViewImages:
    """Images of all views on the device: in one buffer, or in an array of textures per batch."""

    def __init__(
        self, geometry: ConeBeamGeometry, device: Device, decided: BackprojectionPlan
    ) -> None:
        views, (rows, columns) = len(geometry), geometry.shape_vu
        shape = (columns + 2 * PAD, stride(rows))
        self._device = device
        if decided.kernel == "textures":
            self._each, self._step = decided.batch, 1
            ends = range(self._each, views + self._each, self._each)
            counts = [min(self._each, views + self._each - end) for end in ends]
            self._parts = [device.image_array((count, *shape)) for count in counts]
        else:
            self._each, self._step = views, shape[0] * shape[1]
            self._parts = [device.zeros(views * self._step)]

    def write(self, where: slice, batch: Float32Array) -> None:
        """Uploads images of some views as :func:`arranged` makes them."""
        start = where.start
        while start < where.stop:
            part, first = divmod(start, self._each)
            stop = min(where.stop, (part + 1) * self._each)
            found = batch[start - where.start : stop - where.start]
            self._device.write(self._parts[part], found, first * self._step)
            start = stop

    def of(self, views: slice) -> tuple[Any, int]:
        """What holds the images of a batch, and the number in there of the first of them."""
        part, first = divmod(views.start, self._each)
        return self._parts[part], first


def forward_splat(
    volume: Float32Array,
    geometry: ConeBeamGeometry,
    grid: VolumeGrid,
    device: Device,
    decided: BackprojectionPlan,
    motion: Motion | None = None,
) -> Float32Array:
    """Applies the adjoint of :func:`slabs`: images (v, rows, columns) from voxels (z, y, x).

    A voxel adds value / depth^2 by the same weights.
    """
    views, (rows, columns) = len(geometry), geometry.shape_vu
    images = device.zeros(views * (columns + 2 * PAD) * stride(rows))
    placement = VoxelMap(geometry, grid, device, decided, motion)
    for start in range(0, grid.shape_zyx[0], decided.slab):
        slab = VolumeSlab(placement, start, min(start + decided.slab, grid.shape_zyx[0]))
        values = device.upload(volume[start : start + slab.shape[0]])
        for first in range(0, views, decided.batch):
            slab.spread(values, images, slice(first, min(first + decided.batch, views)))
    bordered = device.download(
        images, np.empty((views, columns + 2 * PAD, stride(rows)), np.float32)
    )
    found = bordered[:, PAD : PAD + columns, LEAD : LEAD + rows].transpose(0, 2, 1)
    return np.where(np.array(decided.mirrored)[:, None, None], found[:, ::-1], found)


@dataclass(frozen=True, slots=True, eq=False)
class _DeviceMotion:
    """What the kernels read of a motion."""

    kind: int
    """MOTION of backproject.cl: 0 matrices, 1 moving least squares, 2 displacements"""
    tables: FloatArray
    """(v, ...) numbers of each view"""
    rest: np.ndarray
    """numbers that all views share"""
    field: Float32Array | None = None
    """(v, z, y, x, 3) displacements"""


def _device_motion(motion: Motion | None, maps: FloatArray, anchor: FloatArray) -> _DeviceMotion:
    """A motion for views with matrices ``maps`` (v, 3, 4); ``anchor`` (3,) m is near the grid."""
    match motion:
        case None:
            return _DeviceMotion(0, maps, np.zeros(1))
        case RigidMotion():
            return _DeviceMotion(0, maps @ motion.moved_from_reference, np.zeros(1))
        case ControlPointMotion():
            numbers = three_points.three_points(motion, maps, anchor=anchor)
            return _DeviceMotion(1, np.asarray(numbers.views, float), numbers.rest)
        case FieldMotion():
            spacing, nodes = np.array(motion.grid.spacing_xyz), motion.grid
            rest = np.concatenate(
                [1 / spacing, (anchor - nodes.origin) / spacing, nodes.shape_zyx[::-1]]
            )
            tables = maps @ transforms.translation(anchor)
            return _DeviceMotion(2, tables, rest, motion.displacements)
    raise LegsimError(
        f"back-projection cannot follow a {type(motion).__name__}; sample it with on_grid first"
    )


class VoxelMap:
    """Where voxels fall in the views, in the form that the kernels take."""

    def __init__(
        self,
        geometry: ConeBeamGeometry,
        grid: VolumeGrid,
        device: Device,
        decided: BackprojectionPlan,
        motion: Motion | None,
    ) -> None:
        self.grid, self.device, self.decided = grid, device, decided
        self.rows, self.columns = geometry.shape_vu
        self.axes = (decided.column_axis, *_ACROSS[decided.column_axis])
        flip = np.array([[1.0, 0, 0], [0, -1, self.rows - 1], [0, 0, 1]])
        maps = np.where(
            np.array(decided.mirrored)[:, None, None], flip @ geometry.matrices, geometry.matrices
        )
        self.anchor = np.array(grid.center)
        followed = _device_motion(motion, maps, self.anchor)
        self.motion, self.tables, self.field = followed.kind, followed.tables, followed.field
        # several voxels of a work-item share a view's numbers, which on a GPU are much of what it
        # reads; CPUs have them in vectors of neighboring work-items
        self.each = 1 if device.is_cpu and decided.kernel != "textures" else _VOXELS_EACH
        self.rest = device.upload(np.asarray(followed.rest, np.float32))
        self.nothing = device.zeros(8)

    def world_from_index(self, first_slice: int) -> FloatArray:
        """(4, 4) from (c, b, a, 1) of the slab to world."""
        matrix = np.zeros((4, 4))
        for column, axis in enumerate(self.axes):
            matrix[axis, column] = self.grid.spacing_xyz[axis]
        matrix[:3, 3], matrix[3, 3] = self.grid.origin, 1.0
        matrix[2, 3] += first_slice * self.grid.spacing_xyz[2]
        return matrix

    def kernel(self, name: str, *more: str, **defines: int) -> Any:
        """One of backproject.cl, or of the files that come after it, specialized."""
        textures = self.decided.kernel == "textures"
        before = (
            *(("moving_least_squares.cl",) if self.motion == 1 else ()),
            *(("textures.cl",) if textures else ()),
        )
        count = self.grid.shape_zyx[2 - self.axes[0]] if self.axes[0] != 2 else self.decided.slab
        return self.device.kernel(
            name,
            *before,
            "backproject.cl",
            *more,
            MOTION=self.motion,
            TEXTURES=int(textures),
            EACH=self.each,
            CURVE=self.decided.curve,
            COLUMNS=self.columns,
            ROWS=self.rows,
            STRIDE=stride(self.rows),
            LEAD=LEAD,
            TRAIL=TRAIL,
            PAD=PAD,
            NODES=-(-count // SPACING) + 1,
            **defines,
        )


class VolumeSlab:
    """Consecutive slices of the volume on the device."""

    def __init__(self, placement: VoxelMap, start: int, stop: int) -> None:
        self.placement, self.device = placement, placement.device
        counts = (*placement.grid.shape_zyx[:0:-1], stop - start)
        self.counts = [counts[axis] for axis in placement.axes]
        self.shape = (stop - start, *placement.grid.shape_zyx[1:])
        longest = placement.decided.slab if placement.axes[0] == 2 else self.counts[0]
        self.stride = -(-longest // SPACING) * SPACING
        self._volume: Any = None
        self.world_from_index = placement.world_from_index(start)
        steps = self.world_from_index.T[:, :3].copy()
        steps[3] -= placement.anchor
        self.steps = self.device.upload(steps.astype(np.float32))

    @property
    def volume(self) -> Any:
        """Buffer (a, b, stride) of sums, made when it is first needed."""
        if self._volume is None:
            self._volume = self.device.zeros(self.stride * self.counts[1] * self.counts[2])
        return self._volume

    @property
    def steps_zyx(self) -> list[int]:
        """Elements between voxels along c, b, a in the host's order (z, y, x)."""
        of_axis = (1, self.shape[2], self.shape[1] * self.shape[2])
        return [of_axis[axis] for axis in self.placement.axes]

    def placed(self, views: slice) -> tuple[Any, Any]:
        """Buffers (place, field) of some views."""
        table = self.placement.tables[views]
        if self.placement.motion == 0:
            table = table @ self.world_from_index
        place = self.device.upload(table.reshape(len(table), -1).astype(np.float32))
        field = self.placement.field
        return place, self.placement.nothing if field is None else self.device.upload(field[views])

    def spread(self, values: Any, images: Any, views: slice) -> None:
        """Adds the slab's ``values`` (z, y, x) to some of the ``images`` and waits for the end."""
        place, field = self.placed(views)
        count, atomic = views.stop - views.start, not self.device.is_cpu
        run = self.placement.kernel("spread_volume", "forward_splat.cl", ATOMIC=int(atomic))
        run(
            *(
                self.device.queue,
                tuple(self.counts) if atomic else (count,),
                None,
                images,
                place,
                self.steps,
                self.placement.rest,
                field,
            ),
            *(np.int32(views.start), np.int32(count), values),
            *(np.array([*self.counts, 0], np.int32), np.array([*self.steps_zyx, 0], np.int64)),
        )
        self.device.queue.finish()

    def add(self, images: Any, first: int, views: slice) -> None:
        """Back-projects some views, whose images are the ``first`` in ``images`` and those that
        follow, and waits for the end.
        """
        placement = self.placement
        span = (np.int32(first), np.int32(views.stop - views.start))
        place, field = self.placed(views)
        across = (self.counts[1], self.counts[2])
        if placement.decided.kernel != "columns":
            run = placement.kernel("backproject_voxels")
            sizes = ((self.counts[0], *across), None)
            if placement.each > 1:
                ids = (-(-self.counts[0] // placement.each), *across)
                sizes = self.device.grouped(run, ids)
            run(
                *(self.device.queue, *sizes, images, place, self.steps, placement.rest, field),
                *(*span, self.volume, np.array([*self.counts, 0], np.int32)),
                np.int32(self.stride),
            )
        else:
            nodes = (
                placement.nothing if placement.motion == 0 else self._traced(place, field, span[1])
            )
            run = placement.kernel("backproject_columns")
            run(
                self.device.queue,
                across,
                (1, 1),
                images,
                place,
                nodes,
                *span,
                self.volume,
                np.int32(self.counts[0]),
                np.int32(self.stride),
            )
        self.device.queue.finish()

    def _traced(self, place: Any, field: Any, count: np.int32) -> Any:
        """Buffer (views, 3, a, b, c) of homogeneous pixels at about every eighth voxel."""
        shape = (self.stride // SPACING + 1, *((n - 1) // SPACING + 2 for n in self.counts[1:]))
        # the columns kernel reads whole vectors, past the end of the last line
        nodes = self.device.zeros(3 * int(count) * int(np.prod(shape)) + SPACING)
        run = self.placement.kernel("trace_nodes")
        counts = np.array([*self.counts, 0], np.int32)
        run(
            self.device.queue,
            shape,
            None,
            place,
            self.steps,
            self.placement.rest,
            field,
            count,
            counts,
            nodes,
        )
        return nodes

    def result(self) -> Float32Array:
        """The slab (z, y, x)."""
        target = self.device.zeros(int(np.prod(self.shape)))
        along_c, across_b, across_a = self.steps_zyx
        fastest_c = along_c == 1
        size = (self.counts[0], self.counts[1]) if fastest_c else (self.counts[1], self.counts[0])
        run = self.placement.kernel("arrange_volume")
        run(
            *(
                self.device.queue,
                (*size, self.counts[2]),
                None,
                self.volume,
                target,
                np.int32(self.stride),
                np.int32(self.counts[1]),
            ),
            *(np.int32(fastest_c), np.int32(along_c), np.int32(across_b), np.int64(across_a)),
        )
        return self.device.download(target, np.empty(self.shape, np.float32))
