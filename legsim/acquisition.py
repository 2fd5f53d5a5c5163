"""The scan itself: when the views are taken, where the C-arm stands, what it sees of the moving and of the resting phantom."""

from collections.abc import Callable

import numpy as np

from legsim import projector
from legsim.arrays import FloatArray
from legsim.config import GridConfig, ScanConfig
from legsim.errors import LegsimError
from legsim.geometry import ConeBeamGeometry, Projections, VolumeGrid
from legsim.leg_phantom import LegPhantom
from legsim.opencl import Device
from legsim.signals import SegmentPoses


def view_times(scan: ScanConfig, recorded: FloatArray) -> FloatArray:
    """Times (v,) s of the views: from ``scan.start_s``, or so that the scan sits in the middle of the recording.

    Raises:
        LegsimError: the recording is shorter than the scan, or the scan runs over one of its ends.
    """
    first, last = float(recorded[0]), float(recorded[-1])
    length = (scan.views - 1) / scan.rate_hz
    if length > last - first:
        raise LegsimError(
            f"the recording lasts {last - first:.2f} s, the scan {length:.2f} s ({scan.views} views at {scan.rate_hz:g} Hz); "
            "use a longer recording, or fewer views (--set scan.views=...) or a higher rate (--set scan.rate_hz=...)"
        )
    start = first + 0.5 * (last - first - length) if scan.start_s is None else scan.start_s
    if start < first or start + length > last:
        raise LegsimError(
            f"the scan would run from {start:.2f} to {start + length:.2f} s, the recording from {first:.2f} to {last:.2f} s; "
            f"set scan.start_s between {first:.2f} and {last - length:.2f}"
        )
    return start + np.arange(scan.views) / scan.rate_hz


def c_arm(scan: ScanConfig, times: FloatArray, isocenter: FloatArray) -> ConeBeamGeometry:
    """The circular scan of the configuration about the vertical through ``isocenter`` (3,) m."""
    return ConeBeamGeometry.circular(
        times=times,
        angles=np.radians(scan.first_angle_deg + scan.increment_deg * np.arange(scan.views)),
        source_isocenter=1e-3 * scan.source_isocenter_mm,
        source_detector=1e-3 * scan.source_detector_mm,
        shape_vu=(scan.rows, scan.columns),
        pixel_pitch=1e-3 * scan.pixel_mm,
        isocenter=isocenter,
    )


def volume_grid(grid: GridConfig, isocenter: FloatArray) -> VolumeGrid:
    """The cube to reconstruct, around ``isocenter`` (3,) m."""
    return VolumeGrid.cubic(grid.voxels, 1e-3 * grid.voxel_mm, [float(c) for c in isocenter])


def field_of_view(scan: ScanConfig) -> float:
    """Radius (m) of the cylinder about the axis that every view sees whole."""
    half_fan = np.arctan(0.5 * scan.columns * scan.pixel_mm / scan.source_detector_mm)
    return float(1e-3 * scan.source_isocenter_mm * np.sin(half_fan))


def expose(
    phantom: LegPhantom, poses: SegmentPoses, geometry: ConeBeamGeometry, device: Device, progress: Callable[[int, int], None] | None = None
) -> Projections:
    """Projections of the phantom as ``poses`` have it at every view."""

    def posed(view: int) -> tuple[FloatArray, ...]:
        return phantom.posed(poses.world_from_segment[view], poses.segment_names)

    return projector.project(phantom.phantom, geometry, device, posed=posed, progress=progress)
