"""Smooth criteria of a volume with their slopes: what methods that look at sharpness minimize.

They are callables as :func:`legsim.reconstruction.image_gradient.image_gradient` takes them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array

_INNER = slice(1, -1)


@dataclass(frozen=True, slots=True, eq=False)
class GradientEntropy:
    """Entropy -sum(p ln p), in nats, of the gradient's magnitudes, and its slopes.

    As :func:`legsim.evaluation.similarity.gradient_entropy`, but with a floor that makes it smooth:
    s = sqrt(g_x^2 + g_y^2 + g_z^2 + floor^2), g being differences over two voxels in 1/m, p = s /
    sum(s) over the mask without the grid's border. dE/ds = -(ln p + E) / sum(s).

    >>> entropy, slopes = GradientEntropy(np.ones((8, 9, 10), bool))(volume.attenuation)
    """

    mask: NDArray[np.bool_]
    """(z, y, x) voxels that count"""
    floor: float = 3.0
    """1/m: differences below it hardly count; about the noise of a volume"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "mask", np.asarray(self.mask, bool))
        if self.mask.ndim != 3 or not self.mask[(_INNER,) * 3].any():
            raise LegsimError(
                f"the mask of shape {self.mask.shape} has no voxel within the border of its grid"
            )
        if not self.floor > 0:
            raise LegsimError(f"floor is {self.floor:g} 1/m; it must be positive")

    def __call__(self, volume: Float32Array) -> tuple[float, Float32Array]:
        """(E, dE/dV (z, y, x)) of attenuation (z, y, x) in 1/m.

        Raises:
            LegsimError: the volume is not the mask's grid.
        """
        if volume.shape != self.mask.shape:
            raise LegsimError(f"the volume is {volume.shape}, the mask {self.mask.shape}")
        inside = self.mask[(_INNER,) * 3]
        steps = _steps(volume)
        sizes = np.sqrt((steps[:, inside].astype(float) ** 2).sum(0) + self.floor**2)
        total, logs = float(sizes.sum()), np.log(sizes)
        entropy = float(np.log(total) - (sizes * logs).sum() / total)
        weights = np.zeros(inside.shape, np.float32)
        weights[inside] = (np.log(total) - logs - entropy) / (total * sizes)
        return entropy, _adjoint(weights * steps, volume.shape)


def _steps(volume: Float32Array) -> Float32Array:
    """(3, z - 2, y - 2, x - 2) differences between the neighbors along z, y and x."""
    found = [volume[_beside(k, 1)] - volume[_beside(k, -1)] for k in range(3)]
    return np.stack(found)


def _adjoint(steps: Float32Array, shape: tuple[int, ...]) -> Float32Array:
    """Slopes (z, y, x) of the voxels from those of their differences."""
    slopes = np.zeros(shape, np.float32)
    for k, step in enumerate(steps):
        slopes[_beside(k, 1)] += step
        slopes[_beside(k, -1)] -= step
    return slopes


def _beside(axis: int, side: int) -> tuple[slice, ...]:
    """The inner voxels' neighbors on one side along an axis."""
    beside = slice(2, None) if side > 0 else slice(None, -2)
    return tuple(beside if k == axis else _INNER for k in range(3))
