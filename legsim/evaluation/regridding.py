"""A volume on another grid, and which of its voxels are known there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from legsim.core.errors import LegsimError
from legsim.evaluation.regions import Region
from legsim.geometry.volume import Volume, VolumeGrid

_LEAST_KNOWN = 0.5
"""share of a region that the volume must cover"""


@dataclass(frozen=True, slots=True, eq=False)
class Resampled:
    """A volume brought onto a grid."""

    volume: Volume
    """0 where nothing is known"""
    known: NDArray[np.bool_]
    """(z, y, x) voxels whose place lies in the volume that was resampled"""

    def clipped(self, region: Region) -> Region:
        """The part of a region that is known.

        Raises:
            LegsimError: it is less than half of it.
        """
        mask = region.mask & self.known
        share = mask.sum() / max(1, region.mask.sum())
        if share < _LEAST_KNOWN:
            raise LegsimError(
                f"the volume covers {100 * share:.0f} % of region {region.name!r} only; do both "
                "volumes stand in the same place?"
            )
        return Region(region.name, mask)


def onto(volume: Volume, grid: VolumeGrid) -> Resampled:
    """Resamples a volume onto a grid by trilinear interpolation.

    Voxels finer than those of the grid are averaged first (a Gaussian of half the ratio), so that
    detail which the grid cannot hold does not become noise.

    Raises:
        LegsimError: the volume is smaller than a voxel of the grid.
    """
    own, wanted = np.array(volume.grid.spacing_xyz[::-1]), np.array(grid.spacing_xyz[::-1])
    coarser = np.maximum(wanted / own, 1.0)
    if (coarser > volume.grid.shape_zyx).any():
        raise LegsimError(
            "a voxel of the reference is larger than the whole volume, whose voxels are of "
            f"{volume.grid!r}; correct the spacing in its header (mm)"
        )
    values = np.asarray(volume.attenuation)
    if (coarser > 1.001).any():
        values = ndimage.gaussian_filter(values, 0.5 * np.sqrt(coarser**2 - 1), mode="nearest")
    shift = (grid.origin - volume.grid.origin)[::-1] / own
    resampled = ndimage.affine_transform(
        values, wanted / own, shift, grid.shape_zyx, order=1, mode="constant", output=np.float32
    )
    known = np.ones(grid.shape_zyx, bool)
    for axis, (count, size) in enumerate(zip(grid.shape_zyx, values.shape, strict=True)):
        at = shift[axis] + wanted[axis] / own[axis] * np.arange(count)
        inside = (at >= -1e-3) & (at <= size - 1 + 1e-3)
        known &= inside.reshape([-1 if k == axis else 1 for k in range(3)])
    return Resampled(Volume(grid, resampled), known)
