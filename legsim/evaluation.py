"""How close a volume is to the motion-free one: scaled to 0..1, registered, SSIM and RMSE by region; and how sharp it is by itself.

The protocol is Maier et al.'s ("Rigid and non-rigid motion compensation in weight-bearing cone-beam CT of the knee using (noisy)
inertial measurements", Section 3.1): every volume is scaled to 0..1 and registered to the motion-free reference before SSIM
(Wang et al. 2004: uniform window of 7 voxels, data range 1) and RMSE are taken. Where the paper is silent: a volume is scaled by
its 0.5 and 99.5 percentiles inside the union of the regions (air and cortical bone), because a few voxels of streaks would else
set the scale of all others; a registration is applied only where it raises the correlation; and what it brings in from outside the
grid counts nowhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from skimage.metrics import structural_similarity

from legsim import transforms
from legsim.arrays import Float32Array, FloatArray, frozen_owned
from legsim.errors import LegsimError
from legsim.geometry import Volume, VolumeGrid

if TYPE_CHECKING:
    import SimpleITK as sitk
else:
    sitk = lazy_loader.load("SimpleITK")

SSIM_WINDOW = 7
SCALING_PERCENTILES = (0.5, 99.5)
"""of the values inside the regions, which become 0 and 1"""
PROTOCOL = 4
"""raised with every change of what is compared and how, so that no older number is taken for one of today"""
_SLAB = 32
_REGISTRATION_SAMPLES = 20_000
_WORK_UNITS = 16
_KNOWN_SHIFT_MM, _KNOWN_TURN_DEG = (0.6, -0.5, 0.6), (0.5, 0.6, -0.6)
_REACH = 0.03
"""m around the regions that is looked at: farther than any registration shifts"""


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """A named part of the grid in which the metrics are averaged."""

    name: str
    mask: NDArray[np.bool_]
    """(z, y, x); taken over, not copied, and can no more be written"""

    def __post_init__(self) -> None:
        if self.mask.ndim != 3 or self.mask.dtype != np.bool_:
            raise LegsimError(f"region {self.name!r} is {self.mask.dtype} of shape {self.mask.shape}; expected bool (z, y, x)")
        frozen_owned(self.mask)


@dataclass(frozen=True, slots=True)
class RegionMetrics:
    """Agreement with the reference inside one region."""

    region: str
    ssim: float
    rmse: float
    """of volumes scaled to 0..1"""
    gradient_entropy: float
    """nats, of the registered volume alone; needs no reference, but compares only within one region of one grid"""
    voxels: int
    """that were compared: those of the region that the registered volume still covers"""


@dataclass(frozen=True, slots=True)
class Registration:
    """The rigid transform that was found from the reference to the volume, and whether it was used."""

    translation_mm: float
    """length of the shift at the grid's center"""
    rotation_deg: float
    applied: bool
    correlation_before: float
    correlation_after: float
    stopped: str
    """the optimizer's own words"""


@dataclass(frozen=True, slots=True)
class Metrics:
    """All regions of one volume against its reference."""

    regions: tuple[RegionMetrics, ...]
    registration: Registration | None
    """None where the volume is the reference itself or registration was not asked for"""

    def of(self, region: str) -> RegionMetrics:
        """Metrics of the region of that name."""
        for metrics in self.regions:
            if metrics.region == region:
                return metrics
        raise LegsimError(f"no region named {region!r}; there are: {', '.join(m.region for m in self.regions)}")


def leg_regions(
    labels: NDArray[np.integer], grid: VolumeGrid, knee_height: float, seen: NDArray[np.bool_], margin: float = 0.005
) -> tuple[Region, ...]:
    """Whole leg, shank and thigh: where the leg is, plus ``margin`` (m) of air so that the skin's edge counts.

    Args:
        labels: (z, y, x), above 0 inside the leg (the phantom's truth at the reference pose).
        grid: where the voxels are.
        knee_height: world y that parts shank (below) from thigh (above).
        seen: (z, y, x), what every view sees; voxels beyond are left out, because no method can know them.
        margin: thickness of the air layer.
    """
    inside = sitk.GetImageFromArray((labels > 0).astype(np.uint8))
    radius = [max(1, round(margin / s)) for s in grid.spacing_xyz]
    leg = sitk.GetArrayFromImage(sitk.BinaryDilate(inside, radius, sitk.sitkBall)).astype(bool) & seen
    low = (grid.axes()[1] < knee_height)[None, :, None]
    return Region("leg", leg), Region("shank", leg & low), Region("thigh", leg & ~low)


def cylinder(grid: VolumeGrid, radius: float) -> NDArray[np.bool_]:
    """Mask (z, y, x) of the vertical cylinder of ``radius`` (m) about the grid's center."""
    x, _, z = grid.axes()
    disc = (x[None, :] - grid.center[0]) ** 2 + (z[:, None] - grid.center[2]) ** 2 <= radius**2
    return np.broadcast_to(disc[:, None, :], grid.shape_zyx)


def evaluate(volume: Volume, reference: Volume, regions: Sequence[Region], *, register: bool = True) -> Metrics:
    """Metrics of ``volume`` against ``reference`` in every region.

    Raises:
        LegsimError: the grids differ, a region is empty, or a volume holds NaN or nothing but one value.
    """
    if volume.grid != reference.grid:
        raise LegsimError(
            f"volume and reference lie on different grids: {volume.grid} and {reference.grid}; reconstruct both --like the same file"
        )
    for region in regions:
        if region.mask.shape != reference.grid.shape_zyx or not region.mask.any():
            raise LegsimError(f"region {region.name!r} holds no voxel of the {reference.grid.shape_zyx} grid")
    union = np.logical_or.reduce([region.mask for region in regions])
    box = _box(union, reference.grid)
    regions = [Region(region.name, region.mask[box]) for region in regions]
    union, grid = union[box], reference.grid.cropped(box)
    fixed, moving = scaled(reference.attenuation[box], union, "reference"), scaled(volume.attenuation[box], union, "volume")
    registration = None
    if register and not np.array_equal(fixed, moving):
        registration, moving = registered(moving, fixed, grid, union)
    similarity = ssim_map(moving, fixed)
    return Metrics(tuple(_in_region(region, moving, fixed, similarity) for region in regions), registration)


def _box(mask: NDArray[np.bool_], grid: VolumeGrid) -> tuple[slice, slice, slice]:
    """Of the voxels within :data:`_REACH` of those in ``mask``: what lies farther away decides nothing, but takes most of the time."""
    bounds = []
    for axis, spacing in enumerate(grid.spacing_xyz[::-1]):
        filled = np.flatnonzero(mask.any(tuple(a for a in range(3) if a != axis)))
        margin = max(SSIM_WINDOW, int(np.ceil(_REACH / spacing)))
        bounds.append(slice(max(0, int(filled[0]) - margin), min(mask.shape[axis], int(filled[-1]) + margin + 1)))
    return bounds[0], bounds[1], bounds[2]


def _in_region(region: Region, moving: Float32Array, fixed: Float32Array, similarity: Float32Array) -> RegionMetrics:
    covered = region.mask & np.isfinite(moving)
    difference = moving[covered].astype(np.float64) - fixed[covered]
    seen = similarity[covered]
    seen = seen[np.isfinite(seen)]
    if not seen.size:
        raise LegsimError(f"region {region.name!r} has no voxel at least {SSIM_WINDOW // 2} voxels inside the grid, where SSIM is defined")
    ssim, rmse = float(seen.mean(dtype=np.float64)), float(np.sqrt(np.mean(difference**2)))
    return RegionMetrics(region.name, ssim, rmse, gradient_entropy(moving, covered), int(covered.sum()))


def gradient_entropy(volume: Float32Array, mask: NDArray[np.bool_]) -> float:
    """Entropy -sum(p ln p), in nats, of the gradient's magnitude so normalized that its p sum to 1 inside ``mask`` (z, y, x).

    Low where few voxels hold all edges: blur and streaks raise it, scale and offset of the values do not change it. The criterion is
    McGee et al.'s ("Image metric-based correction (autocorrection) of motion effects: analysis of image metrics", J Magn Reson Imaging
    11, 2000), with the magnitude of the gradient by central differences along all three axes, per voxel. Its greatest value is the
    logarithm of the number of voxels; 0 where one voxel has all of the gradient, or none has any. Voxels that are NaN, have a NaN beside
    them or lie at the grid's border are left out.
    """
    squared = np.zeros([n - 2 for n in volume.shape], np.float32)
    inner = slice(1, -1)
    for axis in range(3):
        ahead, behind = ([inner] * 3 for _ in range(2))
        ahead[axis], behind[axis] = slice(2, None), slice(None, -2)
        squared += (volume[tuple(ahead)] - volume[tuple(behind)]) ** 2
    known = mask & np.isfinite(volume)
    steps = np.sqrt(squared[known[inner, inner, inner]], dtype=np.float64)
    steps = steps[np.isfinite(steps) & (steps > 0)]
    p = steps / steps.sum()
    return float((p * -np.log(p)).sum())


def scaled(attenuation: Float32Array, mask: NDArray[np.bool_], name: str) -> Float32Array:
    """Values so scaled that their :data:`SCALING_PERCENTILES` inside ``mask`` are 0 and 1."""
    inside = attenuation[mask]
    if not np.isfinite(inside).all():
        raise LegsimError(f"the {name} holds values that are not numbers inside the regions; it cannot be compared")
    low, high = (float(p) for p in np.percentile(inside, SCALING_PERCENTILES))
    if high <= low:
        raise LegsimError(f"the {name} is {low:g} everywhere inside the regions; there is nothing to compare")
    return (attenuation - np.float32(low)) * np.float32(1.0 / (high - low))


def ssim_map(moving: Float32Array, fixed: Float32Array) -> Float32Array:
    """SSIM (z, y, x) at every voxel whose window lies inside the grid and holds no NaN, NaN elsewhere; in slabs to bound memory."""
    reach, depth = SSIM_WINDOW // 2, fixed.shape[0]
    if min(fixed.shape) < SSIM_WINDOW:
        raise LegsimError(f"SSIM needs at least {SSIM_WINDOW} voxels along each axis; the grid has {fixed.shape}")
    unknown = ~np.isfinite(moving)
    moving = np.where(unknown, np.float32(0), moving)
    result = np.full(fixed.shape, np.nan, np.float32)
    for start in range(reach, depth - reach, _SLAB):
        stop = min(start + _SLAB, depth - reach)
        padded = slice(start - reach, stop + reach)
        full = np.asarray(structural_similarity(moving[padded], fixed[padded], data_range=1.0, win_size=SSIM_WINDOW, full=True)[1])
        inner = slice(reach, -reach)
        result[start:stop, inner, inner] = full[reach : reach + stop - start, inner, inner]
    if unknown.any():
        result[maximum_filter(unknown.view(np.uint8), SSIM_WINDOW) > 0] = np.nan
    return result


def registered(moving: Float32Array, fixed: Float32Array, grid: VolumeGrid, mask: NDArray[np.bool_]) -> tuple[Registration, Float32Array]:
    """Rigidly registers ``moving`` to ``fixed`` (SimpleITK, correlation, 4-2-1 pyramid, seeded samples inside ``mask``).

    Returns the registration and the volume to compare: resampled by cubic B-splines where that raises the correlation
    inside the mask, else ``moving`` as it was, so that interpolation never makes a volume that needs no moving worse. NaN where the
    resampled volume would have to be known outside the grid.
    """
    fixed_image, moving_image, mask_image = (_image(a, grid) for a in (fixed, moving, mask.astype(np.uint8)))
    transform, stopped = _rigid_transform(fixed_image, moving_image, mask_image, float(mask.mean()), grid)
    resampled = sitk.GetArrayFromImage(sitk.Resample(moving_image, fixed_image, transform, sitk.sitkBSpline3, np.nan, sitk.sitkFloat32))
    covered = mask & np.isfinite(resampled)
    before, after = _correlation(moving, fixed, covered), _correlation(resampled, fixed, covered)
    matrix = _matrix(transform)[:3, :3]
    center_mm = 1e3 * np.array(grid.center)
    shift = np.linalg.norm(np.array(transform.TransformPoint(center_mm.tolist())) - center_mm)
    angle = float(np.degrees(transforms.rotation_angle(matrix)))
    registration = Registration(float(shift), angle, after > before, before, after, stopped)
    return registration, resampled if after > before else moving


@dataclass(frozen=True, slots=True)
class RegistrationError:
    """By how much registration misses a motion that is known."""

    translation_mm: float
    """at the middle of the regions"""
    rotation_deg: float


def registration_error(reference: Volume, regions: Sequence[Region]) -> RegistrationError:
    """The registration's own error: the reference is moved by a known millimeter and degree, registered back, and the two compared."""
    union = np.logical_or.reduce([region.mask for region in regions])
    box = _box(union, reference.grid)
    grid, mask = reference.grid.cropped(box), union[box]
    fixed = scaled(reference.attenuation[box], mask, "reference")
    known = sitk.Euler3DTransform()
    known.SetCenter((1e3 * np.array(grid.center)).tolist())
    known.SetRotation(*np.radians(_KNOWN_TURN_DEG).tolist())
    known.SetTranslation(_KNOWN_SHIFT_MM)
    image = _image(fixed, grid)
    moved = sitk.GetArrayFromImage(sitk.Resample(image, image, known, sitk.sitkBSpline3, 0.0, sitk.sitkFloat32))
    found, _ = _rigid_transform(image, _image(moved, grid), _image(mask.astype(np.uint8), grid), float(mask.mean()), grid)
    # moved(p) = reference(known p), and the registration looks for moved(found p) = reference(p)
    missed = _matrix(known) @ _matrix(found)
    center = np.append(1e3 * np.array(grid.center), 1.0)
    shift = float(np.linalg.norm((missed @ center - center)[:3]))
    return RegistrationError(shift, float(np.degrees(transforms.rotation_angle(missed[:3, :3]))))


def _matrix(transform: sitk.Euler3DTransform) -> FloatArray:
    """4x4, mm."""
    turn = np.array(transform.GetMatrix()).reshape(3, 3)
    return transforms.rigid(turn, np.array(transform.TransformPoint((0.0, 0.0, 0.0))))


def _rigid_transform(
    fixed: sitk.Image, moving: sitk.Image, mask: sitk.Image, filled: float, grid: VolumeGrid
) -> tuple[sitk.Euler3DTransform, str]:
    method = sitk.ImageRegistrationMethod()
    # sums over samples are made unit by unit: a fixed number of units gives the same digits on any number of cores
    method.SetNumberOfWorkUnits(_WORK_UNITS)
    method.SetMetricAsCorrelation()
    method.SetMetricFixedMask(mask)
    method.SetInterpolator(sitk.sitkLinear)
    # gradients at the samples alone, not of whole images: half of the time
    method.MetricUseFixedImageGradientFilterOff()
    method.MetricUseMovingImageGradientFilterOff()
    method.SetMetricSamplingStrategy(method.RANDOM)
    levels = (4, 2, 1)
    wanted = [_REGISTRATION_SAMPLES * level**3 / np.prod(grid.shape_zyx) / filled for level in levels]
    method.SetMetricSamplingPercentagePerLevel([float(min(1.0, w)) for w in wanted], seed=42)
    method.SetOptimizerAsRegularStepGradientDescent(1.0, 1e-4, 100, 0.5, 1e-8)
    method.SetOptimizerScalesFromPhysicalShift()
    method.SetShrinkFactorsPerLevel(list(levels))
    method.SetSmoothingSigmasPerLevel([level / 2 * 1e3 * min(grid.spacing_xyz) if level > 1 else 0.0 for level in levels])
    method.SmoothingSigmasAreSpecifiedInPhysicalUnitsOn()
    start = sitk.Euler3DTransform()
    start.SetCenter((1e3 * np.array(grid.center)).tolist())
    method.SetInitialTransform(start, inPlace=True)
    method.Execute(fixed, moving)
    return start, method.GetOptimizerStopConditionDescription()


def _image(array: NDArray, grid: VolumeGrid) -> sitk.Image:
    image = sitk.GetImageFromArray(array)
    image.SetSpacing([1e3 * s for s in grid.spacing_xyz])
    image.SetOrigin((1e3 * grid.origin).tolist())
    return image


def _correlation(a: Float32Array, b: Float32Array, mask: NDArray[np.bool_]) -> float:
    x, y = a[mask].astype(np.float64), b[mask].astype(np.float64)
    x -= x.mean()
    y -= y.mean()
    # sums, not BLAS products, whose last digits hang on the number of threads
    return float(np.sum(x * y) / np.sqrt(np.sum(x * x) * np.sum(y * y)))
