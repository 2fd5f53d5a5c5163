"""Filtered back-projection of cone-beam scans (Feldkamp, Davis and Kress 1984), static or motion-compensated, in absolute units."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from legsim import backprojection, backprojection_plan, filtering
from legsim.arrays import Float32Array
from legsim.backprojection_plan import BackprojectionPlan, Kernel, Motion
from legsim.filtering import FilterOptions
from legsim.geometry import ConeBeamGeometry, Projections, Volume, VolumeGrid
from legsim.opencl import Device
from legsim.redundancy import ShortScanWarning as ShortScanWarning


@dataclass(frozen=True, slots=True, kw_only=True)
class FdkOptions:
    """How to reconstruct."""

    filter: FilterOptions = field(default_factory=FilterOptions)
    kernel: Kernel | None = None
    """of the back-projection: "voxels" is the plain reference, "columns" the fast one for CPUs; None takes the fastest that is right"""
    slab_bytes: int = 1 << 28
    """memory of the part of the volume that is computed at once"""


def plan(
    geometry: ConeBeamGeometry, grid: VolumeGrid, device: Device, *, motion: Motion | None = None, options: FdkOptions | None = None
) -> BackprojectionPlan:
    """What :func:`reconstruct` will do and the device memory that it takes; nothing is computed.

    Raises:
        LegsimError: as :func:`reconstruct`, or the device has too little memory.
    """
    options = options if options is not None else FdkOptions()
    return backprojection_plan.plan(geometry, grid, device, motion=motion, kernel=options.kernel, slab_bytes=options.slab_bytes)


def reconstruct(
    projections: Projections,
    grid: VolumeGrid,
    device: Device,
    *,
    motion: Motion | None = None,
    options: FdkOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Volume:
    """Linear attenuation (1/m) on ``grid``, of the object as it was at the motion's reference time.

    Works for any 3x4 matrices. Cosine and redundancy weights belong to the nominal scan, that is to ``projections.geometry``; ``motion``
    enters the back-projection alone: each voxel is looked up in view i where the motion carries it to at times[i]. It may be rigid (P(i)
    M(i)), moving least squares of three followed points, or displacements on a coarse grid. Voxels that a view does not see get
    nothing from it. ``progress`` counts parts of the work.

    Raises:
        LegsimError: no axis of rotation fits the sources, or the motion has another number of views.
    """
    attenuation = np.empty(grid.shape_zyx, np.float32)
    for start, slab in reconstruct_slabs(projections, grid, device, motion=motion, options=options, progress=progress):
        attenuation[start : start + len(slab)] = slab
    return Volume(grid, attenuation)


def reconstruct_slabs(
    projections: Projections,
    grid: VolumeGrid,
    device: Device,
    *,
    motion: Motion | None = None,
    options: FdkOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[tuple[int, Float32Array]]:
    """As :func:`reconstruct`, but yields (first slice, attenuation (n, y, x)) slab by slab: for volumes larger than the memory.

    Hand the slabs to :func:`legsim.images.volume_writer` to have them on disk.
    """
    options = options if options is not None else FdkOptions()
    decided = plan(projections.geometry, grid, device, motion=motion, options=options)
    mirrored = np.array(decided.mirrored)
    halves = _halves(progress)
    batches = filtering.filtered_views(
        projections, options.filter, halves[0], finish=lambda images, views: backprojection.arranged(images, mirrored[views])
    )
    yield from backprojection.slabs(batches, projections.geometry, grid, device, decided, motion=motion, progress=halves[1])


def _halves(progress: Callable[[int, int], None] | None) -> tuple[Callable[[int, int], None] | None, Callable[[int, int], None] | None]:
    """Progress of filtering and of back-projection, which takes about three times as long, as parts of one count to 400."""
    if progress is None:
        return None, None
    return lambda done, total: progress(100 * done // total, 400), lambda done, total: progress(100 + 300 * done // total, 400)
