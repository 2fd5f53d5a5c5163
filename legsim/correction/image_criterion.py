"""Sharpness of one rigid part of a leg along a motion, with its derivatives.

The projections are filtered once. A box below (or above) the knee is back-projected along the
motion, and the entropy of its gradient taken near the leg. Blurred images, a box that is turned
against the detector, and the entropy's floor keep the criterion smooth: with voxels along the
detector's axes linear interpolation roughens it below a tenth of a millimeter.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray
from legsim.deformation.models import RigidMotion
from legsim.evaluation.image_criteria import GradientEntropy
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction.field_of_view import pixel_at_isocenter
from legsim.reconstruction.image_gradient import FilteredScan, filtered_scan
from legsim.reconstruction.ramp_filter import FilterOptions, Window

_TURN = (0.31, 0.52, 0.17)
"""rad, of the box against the detector: no axis of either is near one of the other"""

_BOX = (0.110, 0.075, 0.110)
"""m along x, y and z before it is turned"""

_BESIDE_KNEE = 0.045
"""m from the knee to the middle of the box"""

_BLUR, _BLUR_PX = (0.64e-3, 0.48e-3), (0.8, 0.6)
"""m at the isocenter, and px, across and along the detector's rows: the greater one is the standard
deviation"""

_PIXEL = 0.8e-3
"""m at the isocenter: finer pixels are averaged to about this"""

_LEG = 8.0
"""1/m: smoothed attenuation of a leg; tissue has 20, streaks less"""

_SMOOTH, _AROUND = 2.5e-3, 5e-3
"""m: smoothing before the leg is told from air, and how far from it voxels still count"""

_MARGIN = 4.0
"""px from the detector's edge within which a voxel must be seen by every view"""

_FEWEST = 3000
"""voxels that a criterion needs"""


@dataclass(frozen=True, slots=True)
class FocusScale:
    """How finely a criterion looks."""

    voxel: float
    """m"""
    window: Window


COARSE, FINE = FocusScale(2.5e-3, "hann"), FocusScale(1.6e-3, "shepp-logan")


@dataclass(frozen=True, slots=True, eq=False)
class Focus:
    """The criterion of one scan's box; a call gives its value and derivatives by M(i)."""

    filtered: FilteredScan
    """as seen from the box"""
    grid: VolumeGrid
    """of the box, in its own frame"""
    world_from_box: FloatArray
    """(4, 4)"""
    criterion: GradientEntropy
    matrices: FloatArray
    """(v, 3, 4) of the scanner"""
    middle: FloatArray
    """(3,) m in world, of the voxels that count"""
    scale: FocusScale

    def __call__(self, motion: FloatArray) -> tuple[float, FloatArray]:
        """Entropy (nats) along M(i) (v, 4, 4), and its derivatives (v, 4, 4), last row 0.

        Views' depths are counted in those of the box's middle at rest: to first order FDK's weights
        follow the path, too, so that a step along a ray changes magnification and no brightness.
        """
        depths = self._depths(motion)
        stretch = self._depths(np.eye(4)) / depths
        inside = transforms.inverse(self.world_from_box) @ motion @ self.world_from_box
        followed = RigidMotion(self.filtered.geometry.times, stretch[:, None, None] * inside)
        volume = self.filtered.volume(self.grid, followed)
        value, slopes = self.criterion(volume.attenuation)
        found = self.filtered.gradient(self.grid, slopes, followed)
        by_motion = found.by_motion
        assert by_motion is not None
        back = np.linalg.inv(self.world_from_box).T
        by_motion = stretch[:, None, None] * (back @ by_motion @ self.world_from_box.T)
        by_stretch = (found.by_matrices * (self.matrices @ self.world_from_box)).sum((1, 2))
        by_depth = -by_stretch / depths
        ends = np.append(self.middle, 1.0)
        by_motion += by_depth[:, None, None] * self.matrices[:, 2, :, None] * ends
        by_motion[:, 3] = 0.0
        return value, by_motion

    def _depths(self, motion: FloatArray) -> FloatArray:
        moved = motion @ np.append(self.middle, 1.0)
        return (self.matrices[:, 2] * moved).sum(-1)

    def of(self, projections: Projections) -> "Focus":
        """The same criterion of other images with the same geometry."""
        filtered = _filtered(
            projections, self.grid, self.world_from_box, self.scale, self.filtered.device
        )
        return replace(self, filtered=filtered)


def focus(
    projections: Projections,
    motion: FloatArray,
    scale: FocusScale,
    device: Device,
    *,
    below: bool = True,
) -> Focus:
    """Sets up the criterion of the part of the leg below (or above) the knee.

    ``motion`` (v, 4, 4) only finds where the leg is. The knee is taken to be at the rotation
    center. Pixels finer than 0.8 mm at the isocenter are to be averaged first (:func:`binned`).

    Raises:
        LegsimError: hardly any voxel near a leg is seen by every view.
    """
    geometry = projections.geometry
    middle = geometry.rotation_center() - [0, _BESIDE_KNEE if below else -_BESIDE_KNEE, 0]
    frame = transforms.rigid(transforms.rotation_from_vector(_TURN), middle)
    size, (nx, ny, nz) = scale.voxel, (round(side / scale.voxel) for side in _BOX)
    grid = VolumeGrid((nz, ny, nx), (size, size, size), (0.0, 0.0, 0.0))
    filtered = _filtered(projections, grid, frame, scale, device)
    inside = RigidMotion(geometry.times, transforms.inverse(frame) @ motion @ frame)
    volume = filtered.volume(grid, inside).attenuation
    points = transforms.apply(frame, grid.positions())
    mask = near_leg(volume, scale.voxel) & _seen(geometry, motion, points).reshape(volume.shape)
    if mask.sum() * (scale.voxel / COARSE.voxel) ** 3 < _FEWEST:
        raise LegsimError(
            f"only {int(mask.sum())} voxels of {1e3 * scale.voxel:g} mm "
            f"{'below' if below else 'above'} the rotation center are near a leg and seen by every "
            "view; methods that look at sharpness need a knee in the isocenter"
        )
    at = points.reshape(*volume.shape, 3)[mask].mean(0)
    return Focus(filtered, grid, frame, GradientEntropy(mask), geometry.matrices, at, scale)


def binned(projections: Projections) -> Projections:
    """Pixels of about 0.8 mm at the isocenter, or as they are where they are larger."""
    factor = max(1, round(_PIXEL / pixel_at_isocenter(projections.geometry)))
    return projections if factor == 1 else projections.coarser(factor)


def _filtered(
    projections: Projections,
    grid: VolumeGrid,
    world_from_box: FloatArray,
    scale: FocusScale,
    device: Device,
) -> FilteredScan:
    geometry = projections.geometry
    pixel = pixel_at_isocenter(geometry)
    rows = geometry.row_pitch() / geometry.pixel_pitch
    sigmas = (
        0.0,
        max(_BLUR_PX[0], _BLUR[0] / (pixel * rows)),
        max(_BLUR_PX[1], _BLUR[1] / pixel),
    )

    def blurred(images: Float32Array) -> Float32Array:
        return ndimage.gaussian_filter(images, sigmas, mode="nearest")

    x, y, z = world_from_box[:3, 3]
    around = VolumeGrid(grid.shape_zyx, grid.spacing_xyz, (x, y, z))
    filtered = filtered_scan(
        projections,
        around,
        options=FilterOptions(window=scale.window),
        finish=blurred,
        device=device,
    )
    return filtered.under(geometry.moved(world_from_box))


def near_leg(volume: Float32Array, voxel: float) -> NDArray[np.bool_]:
    """Voxels of ``voxel`` (m) in a leg, whose values are in 1/m, or a little beside it."""
    smooth = ndimage.gaussian_filter(volume, _SMOOTH / voxel)
    leg = ndimage.binary_opening(smooth > _LEG, iterations=2)
    return ndimage.binary_dilation(leg, iterations=max(1, round(_AROUND / voxel)))


def _seen(geometry: ConeBeamGeometry, motion: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
    """(p,) points that every eighth view has well within its detector."""
    few = geometry.moved(motion)[::8]
    seen = np.ones(len(points), bool)
    for view in range(len(few)):
        pixels = few[view : view + 1].project(points)[0][0]
        last = np.array(geometry.shape_vu[::-1]) - 1 - _MARGIN
        seen &= ((pixels > _MARGIN) & (pixels < last)).all(-1)
    return seen
