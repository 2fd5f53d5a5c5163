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
from legsim.evaluation.regions import Region, bounding_box, normalized
from legsim.geometry.volume import Volume, VolumeGrid

if TYPE_CHECKING:
    import SimpleITK as sitk
else:
    sitk = lazy_loader.load("SimpleITK")


_REGISTRATION_SAMPLES = 20_000

_WORK_UNITS = 16

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


def register(
    moving: Float32Array, fixed: Float32Array, grid: VolumeGrid, mask: NDArray[np.bool_]
) -> tuple[Registration, Float32Array]:
    """Rigidly registers ``moving`` to ``fixed``.

    SimpleITK with correlation, a 4-2-1 pyramid and seeded samples inside ``mask``. Returns the
    registration and the volume to compare: resampled by cubic B-splines where that raises the
    correlation inside the mask, else ``moving`` as it was, so that interpolation never makes an
    aligned volume worse. NaN where the resampled volume would need values outside the grid.
    """
    fixed_image, moving_image, mask_image = (
        _image(a, grid) for a in (fixed, moving, mask.astype(np.uint8))
    )
    transform, stopped = _rigid_transform(
        fixed_image, moving_image, mask_image, float(mask.mean()), grid
    )
    resampled = sitk.GetArrayFromImage(
        sitk.Resample(
            moving_image, fixed_image, transform, sitk.sitkBSpline3, np.nan, sitk.sitkFloat32
        )
    )
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
    """Error of the registration for a known motion."""

    translation_mm: float
    """at the middle of the regions"""
    rotation_deg: float


def registration_error(reference: Volume, regions: Sequence[Region]) -> RegistrationError:
    """Measures the registration's own error.

    The reference is moved by a known millimeter and degree, registered back, and the two are
    compared.
    """
    union = np.logical_or.reduce([region.mask for region in regions])
    box = bounding_box(union, reference.grid)
    grid, mask = reference.grid.cropped(box), union[box]
    fixed = normalized(reference.attenuation[box], mask, "reference")
    known = sitk.Euler3DTransform()
    known.SetCenter((1e3 * np.array(grid.center)).tolist())
    known.SetRotation(*np.radians(_KNOWN_TURN_DEG).tolist())
    known.SetTranslation(_KNOWN_SHIFT_MM)
    image = _image(fixed, grid)
    moved = sitk.GetArrayFromImage(
        sitk.Resample(image, image, known, sitk.sitkBSpline3, 0.0, sitk.sitkFloat32)
    )
    found, _ = _rigid_transform(
        image, _image(moved, grid), _image(mask.astype(np.uint8), grid), float(mask.mean()), grid
    )
    # moved(p) = reference(known p), and the registration looks for moved(found p) = reference(p)
    missed = _matrix(known) @ _matrix(found)
    center = np.append(1e3 * np.array(grid.center), 1.0)
    shift = float(np.linalg.norm((missed @ center - center)[:3]))
    return RegistrationError(shift, float(np.degrees(transforms.rotation_angle(missed[:3, :3]))))


def _matrix(transform: sitk.Euler3DTransform) -> FloatArray:
    """Matrix 4x4, mm."""
    turn = np.array(transform.GetMatrix()).reshape(3, 3)
    return transforms.rigid(turn, np.array(transform.TransformPoint((0.0, 0.0, 0.0))))


def _rigid_transform(
    fixed: sitk.Image, moving: sitk.Image, mask: sitk.Image, filled: float, grid: VolumeGrid
) -> tuple[sitk.Euler3DTransform, str]:
    method = sitk.ImageRegistrationMethod()
    # sums over samples are made unit by unit: a fixed number of units gives the same digits on any
    # number of cores
    method.SetNumberOfWorkUnits(_WORK_UNITS)
    method.SetMetricAsCorrelation()
    method.SetMetricFixedMask(mask)
    method.SetInterpolator(sitk.sitkLinear)
    # gradients at the samples only, not of whole images: half the time
    method.MetricUseFixedImageGradientFilterOff()
    method.MetricUseMovingImageGradientFilterOff()
    method.SetMetricSamplingStrategy(method.RANDOM)
    levels = (4, 2, 1)
    wanted = [
        _REGISTRATION_SAMPLES * level**3 / np.prod(grid.shape_zyx) / filled for level in levels
    ]
    method.SetMetricSamplingPercentagePerLevel([float(min(1.0, w)) for w in wanted], seed=42)
    method.SetOptimizerAsRegularStepGradientDescent(1.0, 1e-4, 100, 0.5, 1e-8)
    method.SetOptimizerScalesFromPhysicalShift()
    method.SetShrinkFactorsPerLevel(list(levels))
    method.SetSmoothingSigmasPerLevel(
        [level / 2 * 1e3 * min(grid.spacing_xyz) if level > 1 else 0.0 for level in levels]
    )
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
    # sums, not BLAS products, whose last digits depend on the number of threads
    return float(np.sum(x * y) / np.sqrt(np.sum(x * x) * np.sum(y * y)))
