"""Images for texture units, and whether a device reads them right, checked by numbers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np

from legsim.opencl.discovery import Candidate, build_program, reason

if TYPE_CHECKING:
    import pyopencl as cl
else:
    cl = lazy_loader.load("pyopencl")

MOST_OFF = 1 / 256
"""pixels: texture units of GPUs know places in a pixel to 8 bits; who rounds is off by half of this
at most, who cuts off by all of it
"""

_ROUNDING = 2e-4
"""pixels: places of the probe in float32"""

_SHAPE, _COUNT = (3, 48, 1024), 1 << 15
"""of the probe: layers, height and width, and reads"""


@dataclass(frozen=True, slots=True)
class TextureReads:
    """What the probe of a device's texture units found."""

    fault: str
    """why images must not be read through them, empty where they may"""
    off: float
    """pixels by which places were off, at most; NaN where nothing was read"""


@dataclass(frozen=True, slots=True)
class ImageLimits:
    """The largest array of images that a device takes."""

    width: int
    height: int
    layers: int
    bytes: int
    """of all layers together"""


def limits(candidate: Candidate) -> ImageLimits:
    """What the device says of itself."""
    handle = candidate.handle
    return ImageLimits(
        handle.image2d_max_width,
        handle.image2d_max_height,
        handle.image_max_array_size,
        handle.max_mem_alloc_size,
    )


def image_array(context: cl.Context, shape: tuple[int, int, int]) -> cl.Image:
    """An array of single-channel float32 images (layers, height, width); its content is unset."""
    one = cl.ImageFormat(cl.channel_order.R, cl.channel_type.FLOAT)
    flags, across = cl.mem_flags.READ_ONLY, shape[::-1]
    return cl.create_image(context, flags, one, shape=across, is_array=True)


@cache
def check(candidate: Candidate) -> TextureReads:
    """Reads known images between their pixels; once per device and process."""
    if not candidate.handle.image_support:
        return TextureReads("the device reads no images", np.nan)
    try:
        off = _largest_error(candidate.handle)
    except (cl.Error, RuntimeError, OSError) as error:
        return TextureReads(reason(error), np.nan)
    # so that NaN is a fault, too
    if not off <= MOST_OFF + _ROUNDING:
        return TextureReads(
            f"its texture units returned wrong numbers (off by {off:.2g} of a pixel)", off
        )
    return TextureReads("", off)


def _largest_error(handle: cl.Device) -> float:
    """Pixels by which the device's places are off, at most.

    Values of neighbors differ by 1.5 to 2.5 along both axes and by 10 between layers, so that an
    error of a place, or of the layer, is one of the value.
    """
    context = cl.Context([handle])
    queue = cl.CommandQueue(context)
    source = resources.files("legsim.opencl").joinpath("kernels", "textures.cl").read_text("utf-8")
    kernel = cl.Kernel(build_program(context, source, []), "read_points")
    rng, (layers, height, width) = np.random.default_rng(0), _SHAPE
    zigzag = np.arange(height)[:, None] % 2 + np.arange(width) % 2
    values = 2.0 * zigzag + 10.0 * np.arange(layers)[:, None, None] + 0.5 * rng.random(_SHAPE)
    values = values.astype(np.float32)
    points = (rng.random((_COUNT, 3)) * (width - 1, height - 1, layers)).astype(np.float32)
    points[:, 2] = np.floor(points[:, 2])
    images = image_array(context, _SHAPE)
    cl.enqueue_copy(queue, images, values, origin=(0, 0, 0), region=(width, height, layers))
    flags, found = cl.mem_flags, np.empty(_COUNT, np.float32)
    given = cl.Buffer(context, flags.READ_ONLY | flags.COPY_HOST_PTR, hostbuf=points)
    target = cl.Buffer(context, flags.WRITE_ONLY, found.nbytes)
    kernel(queue, (_COUNT,), None, images, given, target)
    cl.enqueue_copy(queue, found, target)
    expected, slope = _between(values.astype(float), points.astype(float))
    return float(np.max(np.abs(found - expected) / slope))


def _between(values: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values (n,) at points (n, 3) x, y, layer; and the sum of their steepest slopes along x and y
    in their cell.
    """
    x, y, layer = points.T
    i = np.minimum(np.floor(x).astype(int), values.shape[2] - 2)
    j = np.minimum(np.floor(y).astype(int), values.shape[1] - 2)
    a, b, k = x - i, y - j, layer.astype(int)
    low_left, low_right = values[k, j, i], values[k, j, i + 1]
    high_left, high_right = values[k, j + 1, i], values[k, j + 1, i + 1]
    between = (1 - b) * ((1 - a) * low_left + a * low_right) + b * (
        (1 - a) * high_left + a * high_right
    )
    along_x = np.maximum(np.abs(low_right - low_left), np.abs(high_right - high_left))
    along_y = np.maximum(np.abs(high_left - low_left), np.abs(high_right - low_right))
    return between, along_x + along_y
