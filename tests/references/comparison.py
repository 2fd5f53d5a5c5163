"""Slow and plain: registration, resampling and SSIM as SimpleITK and scikit-image have them.

SSIM is in float64, voxel by voxel of whole windows.
"""

import numpy as np
import SimpleITK as sitk
from scipy.ndimage import maximum_filter
from skimage.metrics import structural_similarity

from legsim.geometry.volume import VolumeGrid

SAMPLES, WORK_UNITS = 20_000, 16


def image(array: np.ndarray, grid: VolumeGrid) -> sitk.Image:
    """In mm."""
    made = sitk.GetImageFromArray(array)
    made.SetSpacing([1e3 * s for s in grid.spacing_xyz])
    made.SetOrigin((1e3 * grid.origin).tolist())
    return made


def register(
    fixed: np.ndarray, moving: np.ndarray, mask: np.ndarray, grid: VolumeGrid
) -> sitk.Euler3DTransform:
    """SimpleITK's own pyramid of smoothed whole volumes, at 4, 2 and 1 voxels."""
    method = sitk.ImageRegistrationMethod()
    method.SetNumberOfWorkUnits(WORK_UNITS)
    method.SetMetricAsCorrelation()
    method.SetMetricFixedMask(image(mask.astype(np.uint8), grid))
    method.SetInterpolator(sitk.sitkLinear)
    method.MetricUseFixedImageGradientFilterOff()
    method.MetricUseMovingImageGradientFilterOff()
    method.SetMetricSamplingStrategy(method.RANDOM)
    levels = (4, 2, 1)
    wanted = [min(1.0, SAMPLES * level**3 / np.count_nonzero(mask)) for level in levels]
    method.SetMetricSamplingPercentagePerLevel(wanted, seed=42)
    method.SetOptimizerAsRegularStepGradientDescent(1.0, 1e-4, 100, 0.5, 1e-8)
    method.SetOptimizerScalesFromPhysicalShift()
    method.SetShrinkFactorsPerLevel(list(levels))
    method.SetSmoothingSigmasPerLevel(
        [level / 2 * 1e3 * min(grid.spacing_xyz) if level > 1 else 0.0 for level in levels]
    )
    method.SmoothingSigmasAreSpecifiedInPhysicalUnitsOn()
    transform = sitk.Euler3DTransform()
    transform.SetCenter((1e3 * np.array(grid.center)).tolist())
    method.SetInitialTransform(transform, inPlace=True)
    method.Execute(image(fixed, grid), image(moving, grid))
    return transform


def resample(moving: np.ndarray, transform: sitk.Transform, grid: VolumeGrid) -> np.ndarray:
    """Cubic B-splines; NaN outside."""
    given = image(moving, grid)
    return sitk.GetArrayFromImage(
        sitk.Resample(given, given, transform, sitk.sitkBSpline3, np.nan, sitk.sitkFloat32)
    )


def ssim(moving: np.ndarray, fixed: np.ndarray, window: str = "uniform") -> np.ndarray:
    """scikit-image's, in the precision of the arguments, in slabs; NaN where a window has NaN."""
    unknown = ~np.isfinite(moving)
    moving = np.where(unknown, moving.dtype.type(0), moving)
    options = {"win_size": 7}
    if window == "gaussian":
        options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    reach = 3 if window == "uniform" else 5
    result = np.full(fixed.shape, np.nan, fixed.dtype)
    for start in range(reach, len(fixed) - reach, 32):
        stop = min(start + 32, len(fixed) - reach)
        part = slice(start - reach, stop + reach)
        full = structural_similarity(
            moving[part], fixed[part], data_range=1.0, full=True, **options
        )
        result[start:stop] = full[1][reach : reach + stop - start]
    inner = np.zeros(fixed.shape, bool)
    inner[reach:-reach, reach:-reach, reach:-reach] = True
    result[~inner | (maximum_filter(unknown.view(np.uint8), 2 * reach + 1) > 0)] = np.nan
    return result


def plain_ssim(moving: np.ndarray, fixed: np.ndarray, window: str = "uniform") -> np.ndarray:
    """Wang et al.'s formula in float64 from whole windows; without the voxels that have none."""
    reach = 3 if window == "uniform" else 5
    away = np.arange(-reach, reach + 1)
    line = np.ones(len(away)) if window == "uniform" else np.exp(-(away**2) / (2 * 1.5**2))
    weights = line[:, None, None] * line[:, None] * line
    weights /= weights.sum()
    unbiased = weights.size / (weights.size - 1) if window == "uniform" else 1.0
    p, q = (
        np.lib.stride_tricks.sliding_window_view(v.astype(np.float64), weights.shape)
        for v in (moving, fixed)
    )

    def mean(values: np.ndarray) -> np.ndarray:
        return (values * weights).sum((-3, -2, -1))

    mp, mq = mean(p), mean(q)
    dp, dq = p - mp[..., None, None, None], q - mq[..., None, None, None]
    vp, vq, cross = (unbiased * mean(v) for v in (dp * dp, dq * dq, dp * dq))
    c1, c2 = 0.01**2, 0.03**2
    return (2 * mp * mq + c1) * (2 * cross + c2) / ((mp**2 + mq**2 + c1) * (vp + vq + c2))
