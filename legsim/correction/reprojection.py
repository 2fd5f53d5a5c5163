"""A scan of what was reconstructed: images of a volume along a motion that is then known exactly.

Whatever a criterion pulls such a scan by, away from the motion that it was made with, is the
criterion's own error for an object and a geometry like these: artifacts of the short scan and the
cone, and the sampling.
"""

import numpy as np
from scipy import ndimage

from legsim.core.values import Float32Array, FloatArray
from legsim.deformation.models import RigidMotion
from legsim.geometry.cone_beam import Projections
from legsim.opencl.device import Device
from legsim.reconstruction.cgls import SystemMatrix
from legsim.reconstruction.fdk import fdk
from legsim.reconstruction.field_of_view import grid_of, pixel_at_isocenter

_FACTOR = 2
"""pixels along each side of a block that is projected as one, and voxels of its size"""

_AIR = 4.0
"""1/m below which a volume is taken to be empty: streaks in air, not the leg"""


def reprojected(projections: Projections, motion: FloatArray, device: Device) -> Projections:
    """Reconstructs along M(i) (v, 4, 4) what all views see, and projects that along it again.

    In blocks of pixels of twice the size, interpolated by cubic splines: half as fine as the images
    that come in.
    """
    geometry, along = projections.geometry, RigidMotion(projections.geometry.times, motion)
    voxel = _FACTOR * pixel_at_isocenter(geometry)
    grid = grid_of(geometry, (voxel, voxel, voxel))
    volume = fdk(projections, grid, motion=along, device=device).attenuation
    kept = np.where(volume > _AIR, volume, 0.0).astype(np.float32)
    system = SystemMatrix(geometry.coarser(_FACTOR), grid, device, along)
    return Projections(geometry, _finer(system.forward(kept), geometry.shape_vu))


def _finer(images: Float32Array, shape_vu: tuple[int, int]) -> Float32Array:
    """(v, *shape_vu): images of blocks of pixels, between their centers."""
    finer = np.empty((len(images), *shape_vu), np.float32)
    offset = [-0.5 * (_FACTOR - 1) / _FACTOR] * 2
    for fine, image in zip(finer, images, strict=True):
        ndimage.affine_transform(
            image, [1 / _FACTOR] * 2, offset, output=fine, output_shape=shape_vu, mode="nearest"
        )
    return finer
