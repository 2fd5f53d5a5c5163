"""Voxel-driven back-projection with any 3x4 matrix a view, on an OpenCL device, slab by slab.

A voxel that a view's detector does not see gets nothing from it: beyond the outermost pixel centers an image fades to zero
within one pixel.
"""

from collections.abc import Callable, Iterable

import numpy as np
import pyopencl as cl

from legsim.arrays import Float32Array, FloatArray
from legsim.geometry import VolumeGrid
from legsim.opencl import Device

_SLAB_BYTES = 1 << 28


def index_matrices(matrices: FloatArray, grid: VolumeGrid, first_slice: int) -> Float32Array:
    """(v, 12): voxel indices of the slab that starts at slice ``first_slice`` to pixels of an image with a border of one pixel."""
    world_from_index = np.diag([*grid.spacing_xyz, 1.0])
    world_from_index[:3, 3] = grid.origin
    world_from_index[2, 3] += first_slice * grid.spacing_xyz[2]
    border = np.array([[1.0, 0, 1], [0, 1, 1], [0, 0, 1]])
    return (border @ matrices @ world_from_index).reshape(-1, 12).astype(np.float32)


def backproject(
    batches: Iterable[tuple[slice, Float32Array]],
    matrices: FloatArray,
    grid: VolumeGrid,
    device: Device,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Float32Array:
    """Sums image(u, v) / depth^2 over views into (z, y, x).

    ``batches`` yields (views, images (n, rows, columns)); ``matrices`` (v, 3, 4) map world metres to (u w, v w, depth w in m).
    ``progress`` counts slices.
    """
    images = _upload_bordered(batches, len(matrices), device)
    nz, ny, nx = grid.shape_zyx
    volume = np.empty(grid.shape_zyx, np.float32)
    thickness = max(1, min(nz, _SLAB_BYTES // (4 * ny * nx)))
    buffer, rows, columns = images
    kernel = cl.Kernel(device.program("backproject.cl", ROWS=rows, COLUMNS=columns), "backproject_voxels")
    for start in range(0, nz, thickness):
        stop = min(start + thickness, nz)
        slab = device.zeros((stop - start) * ny * nx)
        table = device.upload(index_matrices(matrices, grid, start))
        kernel(device.queue, (nx, ny, stop - start), None, buffer, table, np.int32(len(matrices)), slab, np.int32(nx), np.int32(ny))
        device.download(slab, volume[start:stop])
        if progress is not None:
            progress(stop, nz)
    return volume


def _upload_bordered(batches: Iterable[tuple[slice, Float32Array]], views: int, device: Device) -> tuple[cl.Buffer, int, int]:
    buffer: cl.Buffer | None = None
    rows = columns = 0
    for where, images in batches:
        bordered = np.pad(images, ((0, 0), (1, 1), (1, 1)))
        if buffer is None:
            rows, columns = images.shape[1:]
            buffer = device.zeros(views * bordered[0].size + 2 * (columns + 2))
        cl.enqueue_copy(device.queue, buffer, bordered, dst_offset=4 * where.start * bordered[0].size)
    assert buffer is not None, "no view to back-project"
    return buffer, rows, columns
