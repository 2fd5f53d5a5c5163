"""The grid that holds what a scan sees, in voxels of a pixel's size at the isocenter."""

import numpy as np

from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import VolumeGrid
from legsim.reconstruction import detector_alignment
from legsim.reconstruction.source_path import SourceArc, fan_angles, source_arc


def pixel_at_isocenter(geometry: ConeBeamGeometry) -> float:
    """Width (m) of a pixel scaled to the isocenter; the mean of all views."""
    center = geometry.rotation_center()
    distances = np.linalg.norm(geometry.sources() - center, axis=-1)
    return float(np.mean(distances / geometry.focal_lengths()))


def grid_of(
    geometry: ConeBeamGeometry, spacing_xyz: tuple[float, float, float] | None = None
) -> VolumeGrid:
    """The box around the cylinder that all views see across their columns and rows.

    Its axis is that of rotation. A detector that stands to one side sees a cylinder of its longer
    side in a full turn. ``spacing_xyz`` (m): None is a pixel at the isocenter.

    Raises:
        LegsimError: no axis of rotation fits the sources, or a detector does not reach the axis.
    """
    seen = detector_alignment.align(geometry).geometry
    arc = source_arc(seen)
    fans = np.abs(fan_angles(seen, arc, np.array([-0.5, seen.shape_vu[1] - 0.5])))
    radius = float((arc.radii[:, None] * np.sin(fans)).min())
    ends = _row_ends(seen, arc)
    low, high = float(ends.min(1).max()), float(ends.max(1).min())
    center = arc.center + 0.5 * (low + high) * arc.axis
    along = np.abs(arc.axis)
    half = radius * np.sqrt(np.maximum(1 - along**2, 0)) + 0.5 * max(high - low, 0.0) * along
    pixel = pixel_at_isocenter(geometry)
    spacing = (pixel, pixel, pixel) if spacing_xyz is None else spacing_xyz
    nx, ny, nz = (
        max(1, int(np.ceil(2 * h / s - 1e-3))) for h, s in zip(half, spacing, strict=True)
    )
    return VolumeGrid((nz, ny, nx), spacing, (center[0], center[1], center[2]))


def _row_ends(geometry: ConeBeamGeometry, arc: SourceArc) -> FloatArray:
    """(v, 2) m along the axis from the circle's center: where the outer rows meet the axis."""
    rows, columns = geometry.shape_vu
    rays = geometry.ray_directions(np.full(2, 0.5 * (columns - 1)), np.array([-0.5, rows - 0.5]))
    heights = (geometry.sources() - arc.center) @ arc.axis
    slopes = (rays @ arc.axis) / np.einsum("vnj,vj->vn", rays, arc.inward(geometry))
    return heights[:, None] + arc.radii[:, None] * slopes
