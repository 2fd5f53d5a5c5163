"""Filtered back-projection of cone-beam scans (Feldkamp, Davis and Kress 1984), static or
motion-compensated, in absolute units.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from legsim.core.values import Float32Array
from legsim.deformation.models import Motion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction import (
    _backprojection_plan,
    backprojection,
    detector_alignment,
    filtering,
)
from legsim.reconstruction._backprojection_plan import BackprojectionPlan, Kernel
from legsim.reconstruction.ramp_filter import FilterOptions

# m: half of the cube over which a motion's rigid part is taken in a grid of a few voxels
_LEAST_HALF = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class FdkOptions:
    """How to reconstruct."""

    filter: FilterOptions = field(default_factory=FilterOptions)
    kernel: Kernel | None = None
    """of the back-projection: "voxels" is the plain reference, "columns" the fast one for CPUs;
    None takes the fastest that is right
    """
    slab_bytes: int = 1 << 28
    """memory of the part of the volume that is computed at once"""


def plan(
    geometry: ConeBeamGeometry,
    grid: VolumeGrid,
    device: Device,
    *,
    motion: Motion | None = None,
    options: FdkOptions | None = None,
) -> BackprojectionPlan:
    """What :func:`reconstruct` will do and the device memory that it takes; nothing is computed.

    Raises:
        LegsimError: as :func:`reconstruct`, or the device has too little memory.
    """
    options = options if options is not None else FdkOptions()
    aligned = detector_alignment.align(geometry).geometry
    return _decided(aligned, grid, device, motion, options)


def _decided(
    geometry: ConeBeamGeometry,
    grid: VolumeGrid,
    device: Device,
    motion: Motion | None,
    options: FdkOptions,
) -> BackprojectionPlan:
    return _backprojection_plan.plan(
        geometry, grid, device, motion=motion, kernel=options.kernel, slab_bytes=options.slab_bytes
    )


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

    Works for any 3x4 matrices. Each voxel is looked up in view i where ``motion`` carries it to at
    times[i]. The motion may be rigid (P(i) M(i)), moving least squares of three followed points, or
    displacements on a coarse grid. Cosine and redundancy weights are those of the path that the
    source takes about the object, which the motion's rigid part bends: see
    :func:`seen_from_the_object`. Voxels that a view does not see get nothing from it. ``progress``
    counts parts of the work.

    Raises:
        LegsimError: no axis of rotation fits the sources, or the motion has another number of
            views.
    """
    attenuation = np.empty(grid.shape_zyx, np.float32)
    for start, slab in reconstruct_slabs(
        projections, grid, device, motion=motion, options=options, progress=progress
    ):
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
    """As :func:`reconstruct`, but yields (first slice, attenuation (n, y, x)) slab by slab: for
    volumes larger than the memory.

    Hand the slabs to :func:`legsim.geometry.image_files.volume_writer` to have them on disk.
    """
    options = options if options is not None else FdkOptions()
    detector = detector_alignment.align(projections.geometry)
    decided = _decided(detector.geometry, grid, device, motion, options)
    weights_geometry = object_geometry(detector.geometry, grid, motion)
    mirrored = np.array(decided.mirrored)
    halves = _halves(progress)
    batches = filtering.filtered_views(
        replace(detector.apply(projections), geometry=weights_geometry),
        options.filter,
        halves[0],
        added=detector.added,
        finish=lambda images, views: backprojection.arranged(images, mirrored[views]),
    )
    yield from backprojection.slabs(
        batches, detector.geometry, grid, device, decided, motion=motion, progress=halves[1]
    )


def object_geometry(
    geometry: ConeBeamGeometry, grid: VolumeGrid, motion: Motion | None
) -> ConeBeamGeometry:
    """The scan as it was for an object that holds still: P(i) M(i), M being the motion's rigid part
    over the inner half of the grid.

    Weights that belong to this path count what the object's lines were really measured with; those
    of the scanner's own path leave per cents of error that vary slowly across the volume
    (docs/reconstruction.md).
    """
    if motion is None:
        return geometry
    half = np.maximum(0.25 * np.array(grid.shape_zyx[::-1]) * grid.spacing_xyz, _LEAST_HALF)
    corners = np.stack(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0]), -1).reshape(-1, 3)
    return geometry.moved(motion.rigid_part(grid.center + half * corners))


def _halves(
    progress: Callable[[int, int], None] | None,
) -> tuple[Callable[[int, int], None] | None, Callable[[int, int], None] | None]:
    """Progress of filtering and of back-projection, which takes about three times as long, as parts
    of one count to 400.
    """
    if progress is None:
        return None, None
    return lambda done, total: progress(100 * done // total, 400), lambda done, total: progress(
        100 + 300 * done // total, 400
    )
