"""Volumes read between their voxels: cubic B-spline interpolation on the device.

It follows ITK's ``BSplineInterpolateImageFunction`` of order 3: coefficients by the inverse filter
(M. Unser, "Splines: a perfect fit for signal and image processing", IEEE Signal Processing Magazine
16, 1999), mirrored at the borders, and no value more than half a voxel outside the grid. Single
precision, slab by slab.
"""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from legsim.core.values import Float32Array, FloatArray
from legsim.evaluation.regions import Box
from legsim.opencl.device import Device

_SOURCE = "compare_volumes.cl"

_SLAB_BYTES = 1 << 26
"""of one slab's values; the device holds five of them"""

_REACH = 14
"""voxels beyond a box that decide its values: 2 of coefficients, 12 of the inverse filter"""


def resample(values: Float32Array, shift: FloatArray, box: Box, device: Device) -> Float32Array:
    """Reads ``values`` (z, y, x) at the voxels of ``box``, each moved by a shift.

    Args:
        values: finite.
        shift: (3, 4); the shift along x, y, z in voxels as a function of the voxel's (x, y, z, 1).
        box: where to read.
        device: that computes.

    Returns:
        (z, y, x) of the box; NaN where the moved voxel lies more than half a voxel outside.
    """
    start, stop = (np.array([getattr(part, end) for part in box]) for end in ("start", "stop"))
    result = np.empty(tuple(stop - start), np.float32)
    slices = max(1, _SLAB_BYTES // result[0].nbytes)
    kernel = device.kernel("resample", _SOURCE)
    for first in range(0, len(result), slices):
        last = min(first + slices, len(result))
        low, high = start.copy(), stop.copy()
        low[0], high[0] = start[0] + first, start[0] + last
        source = _needed(shift, values.shape, low, high)
        part = values[tuple(slice(*ends) for ends in zip(*source, strict=True))]
        target = device.zeros(result[first:last].size)
        kernel(
            device.queue,
            result[first:last].shape[::-1],
            None,
            _coefficients(part, device),
            *(_int4(zyx) for zyx in (source[0], part.shape, values.shape, low)),
            *shift.astype(np.float32),
            target,
        )
        device.download(target, result[first:last])
    return result


def _int4(zyx: Sequence[int] | np.ndarray) -> np.ndarray:
    return np.array([*zyx[::-1], 0], np.int32)


def _needed(
    shift: FloatArray, shape_zyx: tuple[int, ...], low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """First and last (excluded) voxel (z, y, x) that decides the voxels from ``low`` to ``high``.

    Cut where the volume ends; at least one voxel.
    """
    corners = np.array([(x, y, z) for z, y, x in product(*zip(low, high - 1, strict=True))], float)
    read = (corners + corners @ shift[:, :3].T + shift[:, 3])[:, ::-1]
    counts = np.array(shape_zyx)
    first = np.clip(np.floor(read.min(0)).astype(int) - _REACH, 0, counts - 1)
    return first, np.clip(np.ceil(read.max(0)).astype(int) + _REACH + 1, first + 1, counts)


def _coefficients(values: Float32Array, device: Device) -> Any:
    """Buffer of the B-spline coefficients of ``values`` (z, y, x), mirrored at their borders."""
    kernel = device.kernel("spline_coefficients", _SOURCE)
    source = device.upload(values)
    target, spare = device.zeros(values.size), device.zeros(values.size)
    for along in range(3):
        kernel(device.queue, values.shape[::-1], None, source, np.int32(along), target)
        source, target, spare = target, spare, target
    return source
