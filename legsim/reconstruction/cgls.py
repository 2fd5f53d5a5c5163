"""Iterative reconstruction by conjugate gradients: CGLS (Hestenes and Stiefel 1952).

It minimizes |A f - p|^2 with a voxel-driven projector A and its exact adjoint. Both follow the same
motions as filtered back-projection. For scans that FDK does not suit: few views, gaps, wide cones.
Early iterations are the smooth ones; stopping is the regularization. Voxels should be no larger
than a pixel seen at the isocenter, or A's images have gaps between them.
"""

import math
import warnings
from collections.abc import Callable, Iterator

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array
from legsim.deformation.models import Motion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device, open_device
from legsim.reconstruction import _backprojection_plan, backprojection
from legsim.reconstruction.corrected_scan import CorrectedScan, images_and_motion
from legsim.reconstruction.field_of_view import pixel_at_isocenter

_MOST_ITERATIONS = 60

_LEAST_DROP, _LEAST_DROP_NONNEGATIVE = 5e-3, 1e-3
"""of the images' norm: a step that lowers the misfit by less is the last one"""

_DISCREPANCY = 1.01
"""misfit over noise at which the steps end"""


class LargeVoxelWarning(UserWarning):
    """Voxels larger than a pixel at the isocenter, whose images have gaps between them."""


_IMAGES, _VOLUMES = 6, 5
"""copies of all images and of the volume that the steps hold at most"""


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
        self.geometry, self.grid, self._device, self._motion = geometry, grid, device, motion
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
            volume, self.geometry, self.grid, self._device, self._plan, self._motion
        )

    def adjoint(self, images: Float32Array) -> Float32Array:
        """A^T p."""
        arranged = backprojection.arranged(self._scale * images, np.array(self._plan.mirrored))
        batches = [(slice(0, len(images)), arranged)]
        slabs = backprojection.slabs(
            batches, self.geometry, self.grid, self._device, self._plan, motion=self._motion
        )
        return np.concatenate([slab for _, slab in slabs])


def cgls(
    projections: Projections | CorrectedScan,
    grid: VolumeGrid,
    *,
    motion: Motion | None = None,
    iterations: int | None = None,
    noise: float | None = None,
    nonnegative: bool = False,
    start: Volume | None = None,
    device: Device | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Volume:
    """Reconstructs linear attenuation (1/m) on ``grid`` by steps of conjugate gradients.

    Everything that absorbs must lie inside the grid. A step costs one projection and one
    back-projection, whether or not values are kept at 0 or above.

    Later steps fit noise, and what voxels cannot show. With ``noise`` the steps end at the first
    volume that explains the images to within it (the discrepancy principle of Morozov). With
    neither ``noise`` nor ``iterations`` they end with the first one that lowers the misfit by less
    than 0.5 % of the images' norm (0.1 % for the smaller steps to nonnegative values).

    Args:
        projections: line integrals (v, rows, columns); or a correction, whose motion is followed.
        grid: where to reconstruct, m in world.
        motion: what to follow, as in :func:`legsim.reconstruction.fdk.fdk`.
        iterations: steps at most, at least 1; without ``noise`` exactly so many. None: at most 60.
        noise: standard deviation of the line integrals, the same in all pixels.
        nonnegative: no value below 0: :func:`_nonnegative_steps` instead of CGLS.
        start: volume on the same grid to start from, such as an FDK volume; None: zero.
        device: None opens the fastest one.
        progress: called with (steps done, steps in all).

    Raises:
        LegsimError: ``start`` lies on another grid, ``iterations`` or ``noise`` is not positive,
            the motion has another number of views, a correction comes with a second motion, or no
            device works.

    Example:
        >>> geometry = ConeBeamGeometry.circular(
        ...     times=np.arange(20) / 30,
        ...     angles=np.radians(np.linspace(0, 180, 20)),
        ...     source_isocenter=0.78,
        ...     source_detector=1.198,
        ...     shape_vu=(16, 16),
        ...     pixel_pitch=4e-3,
        ... )
        >>> projections = Projections(geometry, np.ones((20, 16, 16), np.float32))
        >>> grid = VolumeGrid.cubic(12, 2e-3, (0.0, 0.0, 0.0))
        >>> volume = cgls(projections, grid, iterations=3, nonnegative=True)
        >>> bool(volume.attenuation.min() >= 0)
        True
    """
    if iterations is not None and iterations < 1:
        raise LegsimError(f"{iterations} iterations were asked for; give at least 1")
    if noise is not None and not noise > 0:
        raise LegsimError(f"noise of {noise:g} was given; it must be positive")
    if start is not None and start.grid != grid:
        raise LegsimError(
            "the volume to start from lies on another grid; reconstruct it on the same one"
        )
    images, motion = images_and_motion(projections, motion)
    device = device if device is not None else open_device()
    warn_of_large_voxels(images.geometry, grid)
    system = SystemMatrix(images.geometry, grid, device, motion)
    found = np.zeros(grid.shape_zyx, np.float32)
    if start is not None:
        found += np.maximum(start.attenuation, 0) if nonnegative else start.attenuation
    residual = (
        images.line_integrals.copy()
        if start is None
        else images.line_integrals - system.forward(found)
    )
    most = _MOST_ITERATIONS if iterations is None else iterations
    take = _nonnegative_steps if nonnegative else _conjugate_steps
    least_drop = _LEAST_DROP_NONNEGATIVE if nonnegative else _LEAST_DROP
    whole, before = math.sqrt(_energy(images.line_integrals)), math.sqrt(_energy(residual))
    for step in take(system, found, residual, most):
        if progress is not None:
            progress(step + 1, most)
        now = math.sqrt(_energy(residual))
        if noise is not None:
            done = now <= _DISCREPANCY * noise * math.sqrt(residual.size)
        else:
            done = iterations is None and before - now < least_drop * whole
        if done:
            break
        before = now
    if progress is not None:
        progress(most, most)
    return Volume(grid, found)


def warn_of_large_voxels(geometry: ConeBeamGeometry, grid: VolumeGrid) -> None:
    """Warns (:class:`LargeVoxelWarning`) where voxels exceed a pixel at the isocenter."""
    pixel = pixel_at_isocenter(geometry)
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
    motion: Motion | None = None,
    device: Device | None = None,
) -> int:
    """Memory that :func:`cgls` takes at most beside projections and volume, the device's included.

    Raises:
        LegsimError: the motion has another number of views, or the device has too little memory.
    """
    device = device if device is not None else open_device()
    decided = _backprojection_plan.plan(geometry, grid, device, motion=motion, kernel="voxels")
    images, volumes = (
        4 * len(geometry) * math.prod(geometry.shape_vu),
        4 * math.prod(grid.shape_zyx),
    )
    # residual, scale, images seen and their copies; gradient, direction and a sum in float64
    return decided.device_bytes + _IMAGES * images + _VOLUMES * volumes


def _conjugate_steps(
    system: SystemMatrix, found: Float32Array, residual: Float32Array, iterations: int
) -> Iterator[int]:
    """Takes steps of CGLS, in place; yields the number of each; ends where the gradient is 0."""
    gradient = system.adjoint(residual)
    direction, energy = gradient.copy(), _energy(gradient)
    for step in range(iterations):
        if energy == 0:
            return
        seen = system.forward(direction)
        length = np.float32(energy / _energy(seen))
        found += length * direction
        residual -= length * seen
        gradient = system.adjoint(residual)
        before, energy = energy, _energy(gradient)
        direction *= np.float32(energy / before)
        direction += gradient
        yield step


def _nonnegative_steps(
    system: SystemMatrix, found: Float32Array, residual: Float32Array, iterations: int
) -> Iterator[int]:
    """Takes steps towards the least |A f - p|^2 over f >= 0, in place; yields their numbers.

    Gradient projection with step lengths of Barzilai and Borwein and an exact line search: GPSR-BB,
    monotone variant, without its sparsity term (Figueiredo, Nowak and Wright, IEEE J Sel Top Signal
    Process 1, 2007, section III). The residual never grows. Ends early at the minimum.
    """
    gradient = system.adjoint(residual)
    length = _steepest_length(system, np.where((found > 0) | (gradient > 0), gradient, 0))
    for step in range(iterations):
        change = np.maximum(found + length * gradient, 0) - found
        size = _energy(change)
        if size == 0:
            return
        seen = system.forward(change)
        curvature = _energy(seen)
        share = np.float32(np.clip(_dot(gradient, change) / curvature, 0, 1)) if curvature else 1.0
        # of two nonnegative values, so that rounding leaves none below 0
        np.maximum(found + share * change, 0, out=found)
        residual -= share * seen
        gradient = system.adjoint(residual)
        length = np.float32(size / curvature) if curvature else length
        yield step


def _steepest_length(system: SystemMatrix, gradient: Float32Array) -> np.float32:
    """Length of the exact step along the gradient; 0 where that is zero."""
    energy = _energy(gradient)
    return np.float32(energy / _energy(system.forward(gradient)) if energy else 0.0)


def _dot(first: Float32Array, second: Float32Array) -> float:
    """Scalar product, in double precision."""
    return float(sum(np.vdot(a.astype(np.float64), b) for a, b in zip(first, second, strict=True)))


def _energy(array: Float32Array) -> float:
    """Sum of squares, in double precision."""
    return float(sum(np.vdot(part, part) for part in array.astype(np.float64)))
