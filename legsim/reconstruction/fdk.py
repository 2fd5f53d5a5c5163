"""Filtered back-projection (Feldkamp, Davis and Kress 1984), static or along a motion."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array
from legsim.deformation.models import Motion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device, open_device
from legsim.reconstruction import (
    _backprojection_plan,
    backprojection,
    cut_off_edges,
    detector_alignment,
    filtering,
)
from legsim.reconstruction._backprojection_plan import BackprojectionPlan, Kernel
from legsim.reconstruction.corrected_scan import CorrectedScan, check_views, images_and_motion
from legsim.reconstruction.ramp_filter import FilterOptions

# m: half of the cube over which a motion's rigid part is taken in a grid of a few voxels
_LEAST_HALF = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class FdkOptions(FilterOptions):
    """How to filter and back-project."""

    kernel: Kernel | None = None
    """of the back-projection: "voxels" is the plain reference, "columns" the fast one for CPUs,
    "textures" reads images through texture units, whose places in a pixel have 8 bits on GPUs; None
    takes the fastest that suits (docs/reconstruction.md)
    """
    slab_bytes: int = 1 << 28
    """memory of the part of the volume that is computed at once"""

    def __post_init__(self) -> None:
        FilterOptions.__post_init__(self)
        if self.kernel not in (None, *get_args(Kernel)):
            raise LegsimError(
                f"back-projection kernel {self.kernel!r} is unknown; there are: "
                f"{', '.join(get_args(Kernel))}, or None for the fastest that is right"
            )


def fdk(
    projections: Projections | CorrectedScan,
    grid: VolumeGrid,
    *,
    motion: Motion | None = None,
    options: FdkOptions | None = None,
    device: Device | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Volume:
    """Reconstructs linear attenuation (1/m) on ``grid``, static or along a motion.

    The volume shows the object as it was at the motion's reference time. Any 3x4 matrices will do.
    Each voxel is looked up in view i where the motion carries it to at times[i]. Cosine and
    redundancy weights are those of the source's path about the object, which the motion's rigid
    part bends: see :func:`object_geometry`. A view adds nothing to voxels that it does not see.

    Args:
        projections: line integrals (v, rows, columns); or a correction, whose motion is followed.
        grid: where to reconstruct, m in world.
        motion: what to follow: rigid (P(i) M(i)), moving least squares of three followed points, or
            displacements on a coarse grid. None: nothing moves.
        options: filter, weights and kernel.
        device: None opens the fastest one.
        progress: called with (parts of the work done, parts in all).

    Raises:
        LegsimError: no axis of rotation fits the sources, the motion has another number of views,
            a correction comes with a second motion, or no device works.

    Example:
        >>> from legsim.deformation import RigidMotion
        >>> times = np.arange(180) / 30
        >>> geometry = ConeBeamGeometry.circular(
        ...     times=times,
        ...     angles=np.radians(np.linspace(0, 360, 180, endpoint=False)),
        ...     source_isocenter=0.78,
        ...     source_detector=1.198,
        ...     shape_vu=(8, 32),
        ...     pixel_pitch=4e-3,
        ... )
        >>> projections = Projections(geometry, np.zeros((180, 8, 32), np.float32))
        >>> grid = VolumeGrid.cubic(16, 2e-3, (0.0, 0.0, 0.0))
        >>> fdk(projections, grid, motion=RigidMotion.identity(times)).attenuation.shape
        (16, 16, 16)
    """
    attenuation = np.empty(grid.shape_zyx, np.float32)
    for start, slab in fdk_slabs(
        projections, grid, motion=motion, options=options, device=device, progress=progress
    ):
        attenuation[start : start + len(slab)] = slab
    return Volume(grid, attenuation)


def fdk_slabs(
    projections: Projections | CorrectedScan,
    grid: VolumeGrid,
    *,
    motion: Motion | None = None,
    options: FdkOptions | None = None,
    device: Device | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[tuple[int, Float32Array]]:
    """Yields (first slice, attenuation (n, y, x) in 1/m) slab by slab; otherwise as :func:`fdk`.

    For volumes larger than the memory: :func:`legsim.geometry.image_files.volume_writer` takes the
    slabs to disk.
    """
    images, motion = images_and_motion(projections, motion)
    options = options if options is not None else FdkOptions()
    device = device if device is not None else open_device()
    detector = detector_alignment.align(
        images.geometry, object_geometry(images.geometry, grid, motion)
    )
    cut_off_edges.check_cut_off(detector, images)
    decided = _decided(detector.geometry, grid, device, motion, options)
    weights_geometry = object_geometry(detector.geometry, grid, motion)
    mirrored = np.array(decided.mirrored)
    filtering_progress, adding_progress = _halves(progress)
    batches = filtering.filtered_views(
        replace(detector.apply(images), geometry=weights_geometry),
        options,
        filtering_progress,
        added=detector.added,
        unmeasured=detector.unmeasured(images.geometry.shape_vu),
        finish=lambda filtered, views: backprojection.arranged(filtered, mirrored[views]),
    )
    yield from backprojection.slabs(
        batches, detector.geometry, grid, device, decided, motion=motion, progress=adding_progress
    )


def plan(
    geometry: ConeBeamGeometry,
    grid: VolumeGrid,
    *,
    motion: Motion | None = None,
    options: FdkOptions | None = None,
    device: Device | None = None,
) -> BackprojectionPlan:
    """Decides what :func:`fdk` will do and the device memory that it takes; computes nothing.

    Raises:
        LegsimError: as :func:`fdk`, or the device has too little memory.
    """
    options = options if options is not None else FdkOptions()
    device = device if device is not None else open_device()
    check_views(geometry, motion)
    aligned = detector_alignment.align(geometry, object_geometry(geometry, grid, motion))
    return _decided(aligned.geometry, grid, device, motion, options)


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


def object_geometry(
    geometry: ConeBeamGeometry, grid: VolumeGrid, motion: Motion | None
) -> ConeBeamGeometry:
    """The scan as an object at rest sees it: P(i) M(i), M being the motion's rigid part.

    The rigid part is taken over the inner half of the grid.

    Weights of this path count how often the object's lines were measured. Those of the scanner's
    own path leave errors of some percent that vary slowly across the volume
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
    """Splits a count to 400: filtering reports the first 100, back-projection the rest."""
    if progress is None:
        return None, None
    return lambda done, total: progress(100 * done // total, 400), lambda done, total: progress(
        100 + 300 * done // total, 400
    )
