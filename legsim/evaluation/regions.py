"""Regions of the volume in which methods are scored: whole leg, shank and thigh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np
from numpy.typing import NDArray

from legsim.core.errors import LegsimError
from legsim.core.values import frozen_owned
from legsim.geometry.volume import VolumeGrid

if TYPE_CHECKING:
    import SimpleITK as sitk
else:
    sitk = lazy_loader.load("SimpleITK")


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """A named part of the grid in which the metrics are averaged."""

    name: str
    mask: NDArray[np.bool_]
    """(z, y, x); not copied, and made read-only"""

    def __repr__(self) -> str:
        return f"Region({self.name}: {int(self.mask.sum())} voxels)"

    def __post_init__(self) -> None:
        object.__setattr__(self, "mask", np.asarray(self.mask))
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
    inside = labels > 0
    radius = [max(1, round(margin / s)) for s in grid.spacing_xyz]
    leg = np.zeros(inside.shape, bool)
    if inside.any():
        box = bounding_box(inside, radius[::-1])
        image = sitk.GetImageFromArray(inside[box].view(np.uint8))
        leg[box] = sitk.GetArrayFromImage(sitk.BinaryDilate(image, radius, sitk.sitkBall))
    leg &= seen
    low = (grid.axes()[1] < knee_height)[None, :, None]
    return Region("leg", leg), Region("shank", leg & low), Region("thigh", leg & ~low)


def cylinder(grid: VolumeGrid, radius: float) -> NDArray[np.bool_]:
    """Masks (z, y, x) the vertical cylinder of ``radius`` (m) about the grid's center."""
    x, _, z = grid.axes()
    disc = (x[None, :] - grid.center[0]) ** 2 + (z[:, None] - grid.center[2]) ** 2 <= radius**2
    return np.broadcast_to(disc[:, None, :], grid.shape_zyx)


Box = tuple[slice, slice, slice]
"""(z, y, x) of a part of a grid"""


def bounding_box(mask: NDArray[np.bool_], margin_zyx: Sequence[int]) -> Box:
    """Bounding box of the voxels in ``mask`` and so many more on each side, within the grid."""
    bounds = []
    for axis, margin in enumerate(margin_zyx):
        filled = np.flatnonzero(mask.any(tuple(a for a in range(3) if a != axis)))
        stop = min(mask.shape[axis], int(filled[-1]) + margin + 1)
        bounds.append(slice(max(0, int(filled[0]) - margin), stop))
    return bounds[0], bounds[1], bounds[2]


def within(inner: Box, outer: Box) -> Box:
    """The box ``inner`` as counted from the start of ``outer``."""
    z, y, x = (
        slice(i.start - o.start, i.stop - o.start) for i, o in zip(inner, outer, strict=True)
    )
    return z, y, x
