"""Regions of the volume in which methods are scored: whole leg, shank and thigh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, frozen_owned
from legsim.geometry.volume import VolumeGrid

if TYPE_CHECKING:
    import SimpleITK as sitk
else:
    sitk = lazy_loader.load("SimpleITK")


SSIM_WINDOW = 7

SCALING_PERCENTILES = (0.5, 99.5)
"""percentiles of the values inside the regions, which become 0 and 1"""

_REACH = 0.03
"""m around the regions that is used: farther than any registration shifts"""


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """A named part of the grid in which the metrics are averaged."""

    name: str
    mask: NDArray[np.bool_]
    """(z, y, x); not copied, and made read-only"""

    def __repr__(self) -> str:
        return f"Region({self.name}: {int(self.mask.sum())} voxels)"

    def __post_init__(self) -> None:
        if self.mask.ndim != 3 or self.mask.dtype != np.bool_:
            raise LegsimError(
                f"region {self.name!r} is {self.mask.dtype} of shape {self.mask.shape}; expected "
                "bool (z, y, x)"
            )
        frozen_owned(self.mask)


def leg_regions(
    labels: NDArray[np.integer],
    grid: VolumeGrid,
    knee_height: float,
    seen: NDArray[np.bool_],
    margin: float = 0.005,
) -> tuple[Region, ...]:
    """Regions whole leg, shank and thigh: the leg plus ``margin`` (m) of air.

    The air makes the skin's edge count.

    Args:
        labels: (z, y, x), above 0 inside the leg (the phantom's truth at the reference pose).
        grid: where the voxels are.
        knee_height: world y that separates shank (below) from thigh (above).
        seen: (z, y, x), voxels that every view sees; others are left out, because no method can
            know them.
        margin: thickness of the air layer.
    """
    inside = sitk.GetImageFromArray((labels > 0).astype(np.uint8))
    radius = [max(1, round(margin / s)) for s in grid.spacing_xyz]
    leg = (
        sitk.GetArrayFromImage(sitk.BinaryDilate(inside, radius, sitk.sitkBall)).astype(bool) & seen
    )
    low = (grid.axes()[1] < knee_height)[None, :, None]
    return Region("leg", leg), Region("shank", leg & low), Region("thigh", leg & ~low)


def cylinder(grid: VolumeGrid, radius: float) -> NDArray[np.bool_]:
    """Masks (z, y, x) the vertical cylinder of ``radius`` (m) about the grid's center."""
    x, _, z = grid.axes()
    disc = (x[None, :] - grid.center[0]) ** 2 + (z[:, None] - grid.center[2]) ** 2 <= radius**2
    return np.broadcast_to(disc[:, None, :], grid.shape_zyx)


def bounding_box(mask: NDArray[np.bool_], grid: VolumeGrid) -> tuple[slice, slice, slice]:
    """Bounding box of the voxels within :data:`_REACH` of those in ``mask``.

    Voxels farther away have no effect, but take most of the time.
    """
    bounds = []
    for axis, spacing in enumerate(grid.spacing_xyz[::-1]):
        filled = np.flatnonzero(mask.any(tuple(a for a in range(3) if a != axis)))
        margin = max(SSIM_WINDOW, int(np.ceil(_REACH / spacing)))
        bounds.append(
            slice(
                max(0, int(filled[0]) - margin), min(mask.shape[axis], int(filled[-1]) + margin + 1)
            )
        )
    return bounds[0], bounds[1], bounds[2]


def normalized(attenuation: Float32Array, mask: NDArray[np.bool_], name: str) -> Float32Array:
    """Scales values so that their :data:`SCALING_PERCENTILES` inside ``mask`` are 0 and 1."""
    inside = attenuation[mask]
    if not np.isfinite(inside).all():
        raise LegsimError(
            f"the {name} holds values that are not numbers inside the regions; it cannot be "
            "compared"
        )
    low, high = (float(p) for p in np.percentile(inside, SCALING_PERCENTILES))
    if high <= low:
        raise LegsimError(
            f"the {name} is {low:g} everywhere inside the regions; there is nothing to compare"
        )
    return (attenuation - np.float32(low)) * np.float32(1.0 / (high - low))
