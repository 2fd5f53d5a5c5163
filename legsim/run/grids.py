"""The grid of a scan's volumes: that of another volume, numbers, or the field of view."""

import math
from dataclasses import dataclass
from pathlib import Path

from legsim.core import memory
from legsim.core.errors import LegsimError
from legsim.geometry import image_files
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import VolumeGrid
from legsim.reconstruction import field_of_view

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class WantedGrid:
    """What a user says of the grid; None: nothing."""

    like: Path | None = None
    """a volume whose grid to take"""
    shape_zyx: tuple[int, int, int] | None = None
    spacing_mm: Triple | None = None
    center_mm: Triple | None = None
    where: str = ""
    """the settings that say it, for messages; empty: options of a command line"""

    def of(self, geometry: ConeBeamGeometry) -> tuple[VolumeGrid, tuple[str, ...]]:
        """(the grid, notes on what was not said).

        Raises:
            LegsimError: a volume and numbers are given, or a shape without a spacing.
        """
        if self.like is not None:
            if self.shape_zyx or self.spacing_mm or self.center_mm:
                raise LegsimError(
                    f"{self._place()}{self._name('like')} already says the grid; leave out "
                    f"{self._name('shape_zyx')}, {self._name('spacing_mm')} and "
                    f"{self._name('center_mm')}"
                )
            return image_files.read_header(self.like).grid(), ()
        spacing = None if self.spacing_mm is None else _in_meters(self.spacing_mm)
        if self.shape_zyx is None:
            return self._field(geometry, spacing)
        if spacing is None:
            raise LegsimError(
                f"{self._place()}{self._name('shape_zyx')} without {self._name('spacing_mm')}; "
                "give both, or neither for the field of view"
            )
        if self.center_mm is not None:
            return VolumeGrid(self.shape_zyx, spacing, _in_meters(self.center_mm)), ()
        x, y, z = (float(c) for c in geometry.rotation_center())
        return VolumeGrid(self.shape_zyx, spacing, (x, y, z)), ()

    def _field(
        self, geometry: ConeBeamGeometry, spacing: Triple | None
    ) -> tuple[VolumeGrid, tuple[str, ...]]:
        seen = field_of_view.grid_of(geometry, spacing)
        if self.center_mm is not None:
            seen = VolumeGrid(seen.shape_zyx, seen.spacing_xyz, _in_meters(self.center_mm))
        return seen, (_in_words(geometry, seen),)

    def _place(self) -> str:
        return f"{self.where}: " if self.where else ""

    def _name(self, key: str) -> str:
        return key if self.where else f"--{key.replace('_', '-')}"


def _in_meters(lengths_mm: Triple) -> Triple:
    x, y, z = lengths_mm
    return 1e-3 * x, 1e-3 * y, 1e-3 * z


def _in_words(geometry: ConeBeamGeometry, grid: VolumeGrid) -> str:
    nz, ny, nx = grid.shape_zyx
    x, y, z = (1e3 * n * s for n, s in zip((nx, ny, nz), grid.spacing_xyz, strict=True))
    spacing = " x ".join(f"{1e3 * s:.4g}" for s in sorted(set(grid.spacing_xyz)))
    pixel = 1e3 * field_of_view.pixel_at_isocenter(geometry)
    return (
        f"grid: the field of view, {x:.0f} x {y:.0f} x {z:.0f} mm (x, y, z), in voxels of "
        f"{spacing} mm (a pixel at the isocenter: {pixel:.4g} mm), "
        f"{memory.in_words(4 * math.prod(grid.shape_zyx))}"
    )
