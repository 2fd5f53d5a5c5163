"""Structural similarity (SSIM) of two volumes at every voxel, on the device.

Wang, Bovik, Sheikh, Simoncelli ("Image quality assessment: from error visibility to structural
similarity", IEEE Trans Image Process 13, 2004), of values with the range 1, in two windows:
"uniform", a cube of 7 voxels whose variances are unbiased (over n - 1), which is scikit-image's
default; and "gaussian", of the standard deviation 1.5 voxels, cut off beyond 5 voxels, with
variances over n, as Wang et al. have it. Single precision, slab by slab.
"""

from typing import Any, Literal

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray
from legsim.opencl.device import Device, open_device

Window = Literal["uniform", "gaussian"]

WINDOWS: dict[Window, str] = {
    "uniform": "windows of 7 voxels",
    "gaussian": "Gaussian windows of 1.5 voxels",
}
"""each in words"""

_REACH: dict[Window, int] = {"uniform": 3, "gaussian": 5}

_SLAB_BYTES = 1 << 24
"""of one volume's slab; ten of them are held"""


def reach(window: Window) -> int:
    """Voxels from a window's center to its border."""
    return _REACH[window]


def weights(window: Window) -> FloatArray:
    """(2 reach + 1,) weights of the voxels along an axis, of sum 1."""
    away = np.arange(-reach(window), reach(window) + 1)
    shape = np.ones(len(away)) if window == "uniform" else np.exp(-0.5 * (away / 1.5) ** 2)
    return shape / shape.sum()


def ssim_map(
    moving: Float32Array,
    fixed: Float32Array,
    *,
    window: Window = "uniform",
    device: Device | None = None,
) -> Float32Array:
    """SSIM (z, y, x) at every voxel whose window lies inside the grid and holds no NaN.

    NaN elsewhere. ``device=None`` opens the fastest.

    Raises:
        LegsimError: the grid is smaller than a window, or no device works.
    """
    border, depth = reach(window), fixed.shape[0]
    if min(fixed.shape) < 2 * border + 1:
        raise LegsimError(
            f"SSIM needs at least {2 * border + 1} voxels along each axis; the grid has "
            f"{fixed.shape}"
        )
    opened = device or open_device()
    result = np.full(fixed.shape, np.nan, np.float32)
    slices = max(1, _SLAB_BYTES // (4 * fixed.shape[1] * fixed.shape[2]))
    slices = min(slices, depth - 2 * border)
    spare = [opened.zeros(5 * (slices + 2 * border) * fixed[0].size) for _ in range(2)]
    inner = slice(border, -border)
    for start in range(border, depth - border, slices):
        stop = min(start + slices, depth - border)
        padded = slice(start - border, stop + border)
        found = _of_slab(moving[padded], fixed[padded], window, opened, spare)
        result[start:stop, inner, inner] = found[:, inner, inner]
    return result


def _of_slab(
    moving: Float32Array, fixed: Float32Array, window: Window, device: Device, spare: list[Any]
) -> Float32Array:
    """SSIM of the slices that have ``reach`` others on either side; valid as far from the sides.

    ``spare``: two buffers of five times the slab's size at least.
    """
    border, (depth, rows, columns) = reach(window), fixed.shape
    taps = device.upload(weights(window).astype(np.float32))
    nx, ny = np.int32(columns), np.int32(rows)
    inner_x, inner_y = columns - 2 * border, rows - 2 * border
    count = (2 * border + 1) ** 3
    unbiased = np.float32(count / (count - 1) if window == "uniform" else 1.0)
    result = np.empty((depth - 2 * border, rows, columns), np.float32)
    found, (along_x, along_y) = device.zeros(result.size), spare
    pair = device.upload(moving), device.upload(fixed)
    for name, shape, arguments in (
        ("moments_along_x", (inner_x, rows, depth), (*pair, taps, along_x)),
        ("moments_along_y", (inner_x, inner_y, depth), (along_x, nx, taps, along_y)),
        ("ssim", (inner_x, inner_y, len(result)), (along_y, nx, ny, taps, unbiased, found)),
    ):
        kernel = device.kernel(name, "compare_volumes.cl", REACH=border)
        kernel(device.queue, shape, None, *arguments)
    return device.download(found, result)
