"""Phantom and grid to labels: the part in which each voxel center lies, exactly.

Labels give the regions of the evaluation and true volumes.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen_owned
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device
from legsim.phantom.meshes import Phantom
from legsim.phantom.raster import MeshRaster, TileKernel

_MOST_PARTS = 65534


def labels(
    phantom: Phantom, grid: VolumeGrid, device: Device, *, posed: Sequence[FloatArray] | None = None
) -> np.ndarray:
    """Labels each voxel center by the last part that contains it.

    The label is the part's index + 1, 0 outside all: (z, y, x) uint8, or uint16 from 255 parts on.

    Args:
        posed: world vertices of every part, (p, 3) m each; None for the phantom at rest.

    Raises:
        LegsimError: a part is not closed, or posed vertices do not fit.
    """
    return _labels(_raster(phantom, device, posed), len(phantom.parts), grid)


def _raster(phantom: Phantom, device: Device, posed: Sequence[FloatArray] | None) -> MeshRaster:
    if len(phantom.parts) > _MOST_PARTS:
        raise LegsimError(
            f"a phantom of {len(phantom.parts)} parts cannot be labeled; the limit is {_MOST_PARTS}"
        )
    raster = MeshRaster(phantom, device)
    raster.move(posed)
    return raster


def _labels(raster: MeshRaster, parts: int, grid: VolumeGrid) -> np.ndarray:
    """Labels (z, y, x) of a raster's meshes on a grid."""
    device = raster.device
    raster.place(_voxels_from_world(grid))
    nz, ny, nx = grid.shape_zyx
    name, dtype = ("uchar", np.uint8) if parts < 255 else ("ushort", np.uint16)
    kernel = TileKernel(raster, "label", "voxelize.cl", LABEL=name)
    target = device.zeros(nx * ny * nz, dtype)
    kernel.run(raster.sort((ny, nx)), (np.int32(nz),), target)
    return frozen_owned(device.download(target, np.empty(grid.shape_zyx, dtype)))


def attenuation(
    phantom: Phantom,
    grid: VolumeGrid,
    device: Device,
    *,
    posed: Sequence[FloatArray] | None = None,
    points: int = 1,
) -> Volume:
    """Computes the true volume: each voxel has the mean attenuation of ``points``^3 points.

    They are spread evenly through the voxel; one is its center. Other arguments and errors are as
    in :func:`labels`.
    """
    table = np.array([0.0, *(part.attenuation for part in phantom.parts)], np.float32)
    table /= points**3
    away = (np.arange(points) + 0.5) / points - 0.5
    total = np.zeros(grid.shape_zyx, np.float32)
    raster = _raster(phantom, device, posed)
    for shares in product(away, repeat=3):
        x, y, z = np.array(grid.center) + np.array(grid.spacing_xyz) * shares
        shifted = replace(grid, center=(x, y, z))
        total += table[_labels(raster, len(phantom.parts), shifted)]
    return Volume(grid, total)


def _voxels_from_world(grid: VolumeGrid) -> FloatArray:
    """Matrix (4, 4): world (x, y, z, 1) to (x index, y index, z in voxels from the middle, 1)."""
    spacing = np.array(grid.spacing_xyz)
    start = np.array([*grid.origin[:2], grid.center[2]])
    rows = np.zeros((4, 4))
    rows[:3, :3], rows[:3, 3], rows[3, 3] = np.diag(1 / spacing), -start / spacing, 1.0
    return rows
