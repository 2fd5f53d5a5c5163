"""The system matrix A of iterative reconstruction: a voxel-driven projector and its adjoint.

Both follow the same motions as filtered back-projection. Voxels should be no larger than a pixel
seen at the isocenter, or A's images have gaps between them.
"""

import math
import warnings

import numpy as np

from legsim.core.values import Float32Array
from legsim.deformation.models import Motion
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device, open_device
from legsim.reconstruction import _backprojection_plan, backprojection
from legsim.reconstruction.field_of_view import pixel_at_isocenter


class LargeVoxelWarning(UserWarning):
    """Voxels larger than a pixel at the isocenter, whose images have gaps between them."""


class SystemMatrix:
    """A: volumes (z, y, x) in 1/m to line integrals (v, rows, columns), and its adjoint.

    A voxel adds attenuation x volume / (area of a pixel's cone at the voxel, across the ray) to the
    four pixels around it, by linear weights. A motion's change of volume is not counted; a rigid
    one has none.
    """

    def __init__(
        self,
        geometry: ConeBeamGeometry,
        grid: VolumeGrid,
        device: Device,
        motion: Motion | None = None,
    ) -> None:
        self.geometry, self.grid, self.device, self._motion = geometry, grid, device, motion
        self._plan = _backprojection_plan.plan(
            geometry, grid, device, motion=motion, kernel="voxels"
        )
        # a pixel's cone has the area depth^2 cos / |det| across a ray that leaves the principal ray
        # by the angle of that cosine
        rows, columns = geometry.shape_vu
        v, u = np.mgrid[:rows, :columns]
        per_view = np.abs(np.linalg.det(geometry.matrices[:, :, :3])) * np.prod(grid.spacing_xyz)
        lengths = (
            np.linalg.norm(geometry[k : k + 1].ray_directions(u, v)[0], axis=-1)
            for k in range(len(geometry))
        )
        self._scale = np.stack(
            [(p * length).astype(np.float32) for p, length in zip(per_view, lengths, strict=True)]
        )

    def forward(self, volume: Float32Array) -> Float32Array:
        """A f."""
        return self._scale * backprojection.forward_splat(
            volume, self.geometry, self.grid, self.device, self._plan, self._motion
        )

    def adjoint(self, images: Float32Array) -> Float32Array:
        """A^T p."""
        arranged = backprojection.arranged(self._scale * images, np.array(self._plan.mirrored))
        batches = [(slice(0, len(images)), arranged)]
        slabs = backprojection.slabs(
            batches, self.geometry, self.grid, self.device, self._plan, motion=self._motion
        )
        return np.concatenate([slab for _, slab in slabs])


def warn_of_large_voxels(geometry: ConeBeamGeometry, grid: VolumeGrid) -> None:
    """Warns (:class:`LargeVoxelWarning`) where voxels exceed a pixel at the isocenter."""
    # of pixels that are lower than wide the height counts
    pixel = pixel_at_isocenter(geometry) * min(1.0, geometry.row_pitch() / geometry.pixel_pitch)
    if max(grid.spacing_xyz) > 1.01 * pixel:
        warnings.warn(
            f"voxels of {1e3 * max(grid.spacing_xyz):.4g} mm are larger than a pixel at the "
            f"isocenter ({1e3 * pixel:.4g} mm): their images leave gaps between them, which shows "
            "as a pattern in the volume; take smaller voxels, or average pixels first",
            LargeVoxelWarning,
            stacklevel=3,
        )


def needed_bytes(
    geometry: ConeBeamGeometry,
    grid: VolumeGrid,
    *,
    images: int,
    volumes: int,
    motion: Motion | None = None,
    device: Device | None = None,
) -> int:
    """Memory of steps that hold so many copies of all images and of the volume at most, beside
    projections and volume, the device's included.

    Raises:
        LegsimError: the motion has another number of views, or the device has too little memory.
    """
    device = device if device is not None else open_device()
    decided = _backprojection_plan.plan(geometry, grid, device, motion=motion, kernel="voxels")
    of_images = 4 * len(geometry) * math.prod(geometry.shape_vu)
    return decided.device_bytes + images * of_images + volumes * 4 * math.prod(grid.shape_zyx)


def dot(first: Float32Array, second: Float32Array) -> float:
    """Scalar product, in double precision."""
    return float(sum(np.vdot(a.astype(np.float64), b) for a, b in zip(first, second, strict=True)))


def energy(array: Float32Array) -> float:
    """Sum of squares, in double precision."""
    return float(sum(np.vdot(part, part) for part in array.astype(np.float64)))
