"""Filtered back-projection of cone-beam scans (Feldkamp, Davis and Kress 1984), static or motion-compensated, in absolute units."""

from collections.abc import Callable
from dataclasses import dataclass, field

from legsim import filtering
from legsim.backprojection import backproject
from legsim.errors import LegsimError
from legsim.filtering import FilterOptions
from legsim.geometry import Projections, Volume, VolumeGrid
from legsim.opencl import Device
from legsim.redundancy import ShortScanWarning as ShortScanWarning
from legsim.signals import RigidMotion


@dataclass(frozen=True, slots=True, kw_only=True)
class FdkOptions:
    """How to reconstruct."""

    filter: FilterOptions = field(default_factory=FilterOptions)


def reconstruct(
    projections: Projections,
    grid: VolumeGrid,
    device: Device,
    *,
    motion: RigidMotion | None = None,
    options: FdkOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Volume:
    """Linear attenuation (1/m) on ``grid``, of the object as it was at the motion's reference time.

    Works for any 3x4 matrices. Cosine and redundancy weights belong to the nominal scan, that is to ``projections.geometry``; ``motion``
    (one transform a view) enters the back-projection alone, as P(i) M(i). Voxels that a view does not see get nothing from it.
    ``progress`` counts views filtered, then slices back-projected.

    Raises:
        LegsimError: no axis of rotation fits the sources, or the motion has another number of views.
    """
    options = options if options is not None else FdkOptions()
    matrices = projections.geometry.matrices
    if motion is not None:
        if len(motion.times) != len(matrices):
            raise LegsimError(f"the motion has {len(motion.times)} transforms for {len(matrices)} views; expected one a view")
        matrices = matrices @ motion.moved_from_reference
    views, slices = len(matrices), grid.shape_zyx[0]
    counted = (lambda done, _: progress(done, views + slices)) if progress is not None else None
    placed = (lambda done, _: progress(views + done, views + slices)) if progress is not None else None
    batches = filtering.filtered_views(projections, options.filter, counted)
    return Volume(grid, backproject(batches, matrices, grid, device, progress=placed))
