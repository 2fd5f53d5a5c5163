"""Volumes and the grids they lie on."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import (
    Float32Array,
    FloatArray,
    frozen_owned,
    plain_numbers,
    whole_counts,
)


@dataclass(frozen=True, slots=True)
class VolumeGrid:
    """Voxel centers along the world axes."""

    shape_zyx: tuple[int, int, int]
    spacing_xyz: tuple[float, float, float]
    """m between voxel centers along world x, y, z"""
    center: tuple[float, float, float]
    """(x, y, z) m in world of the middle of the grid"""

    def __post_init__(self) -> None:
        counts = whole_counts("VolumeGrid.shape_zyx", self.shape_zyx)
        object.__setattr__(self, "shape_zyx", counts)
        object.__setattr__(self, "spacing_xyz", tuple(float(s) for s in self.spacing_xyz))
        object.__setattr__(self, "center", tuple(float(c) for c in self.center))
        if len(self.shape_zyx) != 3 or min(self.shape_zyx) < 1:
            raise LegsimError(
                f"VolumeGrid.shape_zyx is {self.shape_zyx}; expected three positive counts"
            )
        if len(self.spacing_xyz) != 3 or not all(
            np.isfinite(s) and s > 0 for s in self.spacing_xyz
        ):
            raise LegsimError(
                f"VolumeGrid.spacing_xyz is {self.spacing_xyz}; expected three positive lengths"
            )
        if len(self.center) != 3 or not np.isfinite(self.center).all():
            raise LegsimError(
                f"VolumeGrid.center is {self.center}; expected three finite coordinates"
            )

    def __repr__(self) -> str:
        center = ", ".join(f"{1e3 * c:.6g}" for c in self.center)
        return f"VolumeGrid({self._voxels()}, center ({center}) mm)"

    def _voxels(self) -> str:
        """Counts and sizes in one phrase."""
        nz, ny, nx = self.shape_zyx
        sizes = "x".join(f"{1e3 * s:.6g}" for s in self.spacing_xyz)
        return f"{nx}x{ny}x{nz} voxels (x, y, z) of {sizes} mm"

    @classmethod
    def cubic(cls, count: int, spacing: float, center: Sequence[float]) -> "VolumeGrid":
        """``count``^3 voxels of edge ``spacing`` (m) around ``center`` (m)."""
        return cls(
            (count, count, count), (spacing, spacing, spacing), (center[0], center[1], center[2])
        )

    @property
    def origin(self) -> FloatArray:
        """(3,) world position of voxel (0, 0, 0)'s center."""
        counts_xyz = np.array(self.shape_zyx[::-1])
        return np.array(self.center) - 0.5 * (counts_xyz - 1) * np.array(self.spacing_xyz)

    def axes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """World x (nx,), y (ny,) and z (nz,) of the voxel centers."""
        nz, ny, nx = self.shape_zyx
        x, y, z = (
            o + s * np.arange(n)
            for o, s, n in zip(self.origin, self.spacing_xyz, (nx, ny, nz), strict=True)
        )
        return x, y, z

    def positions(self) -> FloatArray:
        """(n, 3) world positions of the voxel centers in the order of the arrays: x fastest."""
        x, y, z = self.axes()
        return np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], -1).reshape(-1, 3)

    def alike(self, other: "VolumeGrid", tolerance: float = 1e-3) -> bool:
        """Whether all voxels of two grids are at the same places, to a share of a voxel.

        Files of another format hold positions with fewer digits.
        """
        if self.shape_zyx != other.shape_zyx:
            return False
        spacing, counts = np.array(self.spacing_xyz), np.array(self.shape_zyx[::-1])
        first = np.abs(self.origin - other.origin)
        last = np.abs(
            self.origin + (counts - 1) * spacing
            - other.origin - (counts - 1) * np.array(other.spacing_xyz)
        )  # fmt: skip
        return bool((np.maximum(first, last) <= tolerance * spacing).all())

    def coarse(self, spacing: float) -> "VolumeGrid":
        """A grid of ``spacing`` (m) about the same center that covers all of this one.

        Raises:
            LegsimError: the spacing is not positive.
        """
        if not spacing > 0:
            raise LegsimError(
                f"nodes of a displacement field need a positive spacing in m; got {spacing:g}"
            )
        nx, ny, nz = (
            int(np.ceil(n * s / spacing)) + 1
            for n, s in zip(self.shape_zyx[::-1], self.spacing_xyz, strict=True)
        )
        return VolumeGrid((nz, ny, nx), (spacing, spacing, spacing), self.center)

    def cropped(self, box_zyx: tuple[slice, slice, slice]) -> "VolumeGrid":
        """The grid of the voxels in ``box_zyx``, where they are."""
        starts, stops = np.transpose(
            [part.indices(n)[:2] for part, n in zip(box_zyx, self.shape_zyx, strict=True)]
        )
        nz, ny, nx = (stops - starts).tolist()
        x, y, z = (
            self.origin + np.array(self.spacing_xyz) * (starts + stops - 1)[::-1] / 2
        ).tolist()
        return VolumeGrid((nz, ny, nx), self.spacing_xyz, (x, y, z))


@dataclass(frozen=True, slots=True, eq=False)
class Volume:
    """Linear attenuation on a grid."""

    grid: VolumeGrid
    attenuation: Float32Array
    """(z, y, x) float32, 1/m; taken over as in :class:`Projections`"""

    def __post_init__(self) -> None:
        numbers = plain_numbers("Volume.attenuation", self.attenuation)
        values = np.ascontiguousarray(numbers, np.float32)
        if values.shape != self.grid.shape_zyx:
            raise LegsimError(
                f"Volume.attenuation has shape {values.shape}; the grid says "
                f"{self.grid.shape_zyx} (z, y, x)"
            )
        object.__setattr__(self, "attenuation", frozen_owned(values))

    def __repr__(self) -> str:
        return f"Volume({self.grid._voxels()}, attenuation in 1/m)"


@dataclass(frozen=True, slots=True, eq=False)
class NamedVolume:
    """A reconstruction under the name of its method."""

    name: str
    volume: Volume
