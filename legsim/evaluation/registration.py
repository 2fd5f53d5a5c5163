"""Rigid registration of a volume to its reference, and its own measured error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from legsim.core import transforms
from legsim.core.values import Float32Array, FloatArray
from legsim.evaluation import resampling
from legsim.evaluation.regions import Box, Region, bounding_box, within
from legsim.evaluation.scaling import value_range
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device, open_device

if TYPE_CHECKING:
    import SimpleITK as sitk
else:
    sitk = lazy_loader.load("SimpleITK")


_REGISTRATION_SAMPLES = 20_000

_WORK_UNITS = 16

_LEVELS, _FEWEST_VOXELS = 3, 8
"""of the pyramid, and voxels along each axis of its coarsest level"""

_REACH = 0.03
"""m around the regions that is read: farther than any registration shifts"""

_WINDOW = 7
"""voxels around the regions that are compared: more than any window of SSIM reaches"""

_KNOWN_SHIFT_MM, _KNOWN_TURN_DEG = (0.6, -0.5, 0.6), (0.5, 0.6, -0.6)


@dataclass(frozen=True, slots=True)
class Registration:
    """The rigid transform from the reference to the volume, and whether it was used."""

    translation_mm: float
    """length of the shift at the grid's center"""
    rotation_deg: float
    applied: bool
    correlation_before: float
    correlation_after: float
    stopped: str
    """the optimizer's stop message"""


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """What is registered: the reference where it is compared, and the volume around that."""

    fixed: Float32Array
    """(z, y, x) in the box"""
    mask: NDArray[np.bool_]
    """(z, y, x) in the box: what counts"""
    moving: Float32Array
    """(z, y, x) on the whole grid"""
    grid: VolumeGrid
    """of ``moving``"""
    box: Box
    """of the grid"""


def register(pair: Compared, device: Device) -> tuple[Registration, Float32Array]:
    """Rigidly registers the volume to the reference.

    SimpleITK with correlation, a 4-2-1 pyramid and seeded samples inside the mask. Returns the
    registration and the volume (z, y, x) to compare in the box: resampled by cubic B-splines where
    that raises the correlation inside the mask, else as it was, so that interpolation never makes
    an aligned volume worse. NaN where the resampled volume would need values outside the grid.
    """
    transform, stopped = _rigid_transform(pair)
    matrix = _matrix(transform)
    resampled = resampling.resample(pair.moving, _shift(matrix, pair.grid), pair.box, device)
    unmoved = pair.moving[pair.box]
    covered = pair.mask & np.isfinite(resampled)
    before, after = (_correlation(a, pair.fixed, covered) for a in (unmoved, resampled))
    center_mm = 1e3 * np.array(pair.grid.center)
    shift = np.linalg.norm(np.array(transform.TransformPoint(center_mm.tolist())) - center_mm)
    angle = float(np.degrees(transforms.rotation_angle(matrix[:3, :3])))
    registration = Registration(float(shift), angle, after > before, before, after, stopped)
    return registration, resampled if after > before else unmoved


@dataclass(frozen=True, slots=True)
class RegistrationError:
    """Error of the registration for a known motion."""

    translation_mm: float
    """at the middle of the regions"""
    rotation_deg: float


def registration_error(
    reference: Volume, regions: Sequence[Region], device: Device | None = None
) -> RegistrationError:
    """Measures the registration's own error.

    The reference is moved by a known millimeter and degree, registered back, and the two are
    compared. ``device=None`` opens the fastest.
    """
    union = np.logical_or.reduce([region.mask for region in regions])
    wide, box = boxes(union, reference.grid)
    grid, inner = reference.grid.cropped(wide), within(box, wide)
    inside = reference.attenuation[box][union[box]]
    scale = value_range(reference.attenuation, inside, "reference-leg", "reference")
    values = scale.scaled(reference.attenuation[wide])
    known = sitk.Euler3DTransform()
    known.SetCenter((1e3 * np.array(grid.center)).tolist())
    known.SetRotation(*np.radians(_KNOWN_TURN_DEG).tolist())
    known.SetTranslation(_KNOWN_SHIFT_MM)
    everywhere = within(wide, wide)
    moved = resampling.resample(
        values, _shift(_matrix(known), grid), everywhere, device or open_device()
    )
    found, _ = _rigid_transform(Compared(values[inner], union[box], moved, grid, inner))
    # moved(p) = reference(known p), and the registration looks for moved(found p) = reference(p)
    missed = _matrix(known) @ _matrix(found)
    center = np.append(1e3 * np.array(grid.center), 1.0)
    shift = float(np.linalg.norm((missed @ center - center)[:3]))
    return RegistrationError(shift, float(np.degrees(transforms.rotation_angle(missed[:3, :3]))))


def boxes(mask: NDArray[np.bool_], grid: VolumeGrid) -> tuple[Box, Box]:
    """The box of all voxels that a registration may read, and that of what is compared.

    Voxels farther away have no effect, but take most of the time.
    """
    wide = [max(_WINDOW, int(np.ceil(_REACH / s))) for s in grid.spacing_xyz[::-1]]
    return bounding_box(mask, wide), bounding_box(mask, [_WINDOW] * 3)


def _matrix(transform: sitk.Euler3DTransform) -> FloatArray:
    """Matrix 4x4, mm."""
    turn = np.array(transform.GetMatrix()).reshape(3, 3)
    return transforms.rigid(turn, np.array(transform.TransformPoint((0.0, 0.0, 0.0))))


def _shift(matrix_mm: FloatArray, grid: VolumeGrid) -> FloatArray:
    """Shift (3, 4) in voxels by a 4x4 matrix, as a function of the voxel's (x, y, z, 1)."""
    spacing = np.array(grid.spacing_xyz)
    turned = matrix_mm[:3, :3] - np.eye(3)
    constant = (turned @ grid.origin + 1e-3 * matrix_mm[:3, 3]) / spacing
    return np.column_stack([turned * spacing / spacing[:, None], constant])


def _rigid_transform(pair: Compared) -> tuple[sitk.Euler3DTransform, str]:
    """Transform from points (mm) of the reference to those of the volume; the last stop message.

    Volumes are halved here: SimpleITK's own pyramid smooths whole volumes, which took most of the
    time.
    """
    transform = sitk.Euler3DTransform()
    transform.SetCenter((1e3 * np.array(pair.grid.center)).tolist())
    levels = [pair]
    while len(levels) < _LEVELS and min(levels[-1].fixed.shape) >= 2 * _FEWEST_VOXELS:
        levels.append(_halved(levels[-1]))
    stopped = ""
    for depth, level in reversed(list(enumerate(levels))):
        # coarse levels only lead the next one near; the first step halves from level to level
        first, last = 0.25 * 2**depth, 1e-4 if depth == 0 else 1e-2
        stopped = _improve(transform, level, first, last)
    return transform, stopped


def _improve(transform: sitk.Euler3DTransform, pair: Compared, first: float, last: float) -> str:
    """Optimizes ``transform`` in place by steps of ``first`` to ``last`` mm; the stop message."""
    method = sitk.ImageRegistrationMethod()
    # sums over samples are made unit by unit: a fixed number of units gives the same digits on any
    # number of cores
    method.SetNumberOfWorkUnits(_WORK_UNITS)
    method.SetMetricAsCorrelation()
    grid = pair.grid.cropped(pair.box)
    method.SetMetricFixedMask(_image(pair.mask.view(np.uint8), grid))
    method.SetInterpolator(sitk.sitkLinear)
    # gradients at the samples only, not of whole images: half the time
    method.MetricUseFixedImageGradientFilterOff()
    method.MetricUseMovingImageGradientFilterOff()
    method.SetMetricSamplingStrategy(method.RANDOM)
    wanted = _REGISTRATION_SAMPLES / max(1, np.count_nonzero(pair.mask))
    method.SetMetricSamplingPercentage(min(1.0, wanted), seed=42)
    method.SetOptimizerAsRegularStepGradientDescent(first, last, 100, 0.5, 1e-8)
    method.SetOptimizerScalesFromPhysicalShift()
    method.SetInitialTransform(transform, inPlace=True)
    method.Execute(_image(pair.fixed, grid), _image(_known(pair.moving), pair.grid))
    return method.GetOptimizerStopConditionDescription()


def _known(values: Float32Array) -> Float32Array:
    """The values with 0, the scale's lower end, for those that are not numbers."""
    return values if np.isfinite(values).all() else np.nan_to_num(values, posinf=0.0, neginf=0.0)


def _halved(pair: Compared) -> Compared:
    """The same at half the resolution: means of 2x2x2 voxels, and a mask of those that touch it."""
    # the box begins at an even voxel, so that both volumes are halved alike
    box = tuple(slice(b.start + b.start % 2, b.stop) for b in pair.box)
    inner = within((box[0], box[1], box[2]), pair.box)
    fixed, moving = _mean_of_pairs(pair.fixed[inner]), _mean_of_pairs(pair.moving)
    mask = _mean_of_pairs(pair.mask[inner].astype(np.float32)) > 0
    z, y, x = (slice(b.start // 2, b.start // 2 + n) for b, n in zip(box, fixed.shape, strict=True))
    grid = pair.grid
    kept = tuple(slice(0, 2 * n) for n in moving.shape)
    covered = grid.cropped((kept[0], kept[1], kept[2]))
    dx, dy, dz = grid.spacing_xyz
    nz, ny, nx = moving.shape
    halved = VolumeGrid((nz, ny, nx), (2 * dx, 2 * dy, 2 * dz), covered.center)
    return Compared(fixed, mask, moving, halved, (z, y, x))


def _mean_of_pairs(values: Float32Array) -> Float32Array:
    """Means of 2x2x2 voxels; a last odd one is left out."""
    for axis in range(3):
        even, odd = ([slice(None)] * 3 for _ in range(2))
        stop = values.shape[axis] // 2 * 2
        even[axis], odd[axis] = slice(0, stop, 2), slice(1, stop, 2)
        values = values[tuple(even)] + values[tuple(odd)]
    return values * np.float32(0.125)


def _image(array: NDArray, grid: VolumeGrid) -> sitk.Image:
    image = sitk.GetImageFromArray(array)
    image.SetSpacing([1e3 * s for s in grid.spacing_xyz])
    image.SetOrigin((1e3 * grid.origin).tolist())
    return image


def _correlation(a: Float32Array, b: Float32Array, mask: NDArray[np.bool_]) -> float:
    """Pearson's correlation inside the mask, from sums by slice, which stay in the cache."""
    sums = np.zeros((len(mask), 6))
    for k, inside in enumerate(mask):
        # the middle of the scale is taken off, so that float64 loses nothing in the squares
        x, y = a[k][inside].astype(np.float64) - 0.5, b[k][inside].astype(np.float64) - 0.5
        # sums, not BLAS products, whose last digits depend on the number of threads
        sums[k] = len(x), x.sum(), y.sum(), (x * x).sum(), (y * y).sum(), (x * y).sum()
    count, x, y, xx, yy, xy = sums.sum(0)
    return float((xy - x * y / count) / np.sqrt((xx - x * x / count) * (yy - y * y / count)))
