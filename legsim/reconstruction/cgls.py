"""Iterative reconstruction by conjugate gradients: CGLS (Hestenes and Stiefel 1952).

It minimizes |A f - p|^2 with the projector A of :mod:`legsim.reconstruction.system_matrix` and its
exact adjoint. For scans that FDK does not suit: few views, gaps, wide cones. Early iterations are
the smooth ones; stopping is the regularization.
"""

import math
from collections.abc import Callable, Iterator

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array
from legsim.deformation.models import Motion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device, open_device
from legsim.reconstruction import proximal_steps, system_matrix
from legsim.reconstruction.corrected_scan import CorrectedScan, images_and_motion
from legsim.reconstruction.proximal_steps import Nonnegative
from legsim.reconstruction.system_matrix import SystemMatrix, energy

_MOST_ITERATIONS = 60

_LEAST_DROP, _LEAST_DROP_NONNEGATIVE = 5e-3, 1e-3
"""of the images' norm: a step that lowers the misfit by less is the last one"""

_DISCREPANCY = 1.01
"""misfit over noise at which the steps end"""


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
        nonnegative: no value below 0: :mod:`legsim.reconstruction.proximal_steps`, not CGLS.
        start: volume on the same grid to start from, such as an FDK volume; None: zero.
        device: None opens the fastest one.
        progress: called with (steps done, steps in all).

    Raises:
        LegsimError: ``start`` lies on another grid or is not finite, ``iterations`` or ``noise`` is
            not positive, the motion has another number of views, a correction comes with a second
            motion, or no device works.

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
    if noise is not None and not 0 < noise < math.inf:
        raise LegsimError(f"noise of {noise:g} was given; it must be positive and finite")
    if start is not None and not start.grid.alike(grid):
        raise LegsimError(
            "the volume to start from lies on another grid; reconstruct it on the same one"
        )
    if start is not None and not np.isfinite(start.attenuation).all():
        raise LegsimError(
            "the volume to start from holds values that are not finite numbers; replace them by 0"
        )
    images, motion = images_and_motion(projections, motion)
    device = device if device is not None else open_device()
    system_matrix.warn_of_large_voxels(images.geometry, grid)
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
    least_drop = _LEAST_DROP_NONNEGATIVE if nonnegative else _LEAST_DROP
    whole, before = math.sqrt(energy(images.line_integrals)), math.sqrt(energy(residual))
    if nonnegative:
        steps = proximal_steps.steps(system, found, residual, most, Nonnegative())
    else:
        steps = _conjugate_steps(system, found, residual, most)
    for step, _ in enumerate(steps):
        if progress is not None:
            progress(step + 1, most)
        now = math.sqrt(energy(residual))
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
    # residual, scale, images seen and their copies; gradient, direction and a sum in float64
    return system_matrix.needed_bytes(
        geometry, grid, images=6, volumes=5, motion=motion, device=device
    )


def _conjugate_steps(
    system: SystemMatrix, found: Float32Array, residual: Float32Array, iterations: int
) -> Iterator[None]:
    """Takes steps of CGLS, in place; ends where the gradient is 0."""
    gradient = system.adjoint(residual)
    direction, size = gradient.copy(), energy(gradient)
    for _ in range(iterations):
        if size == 0:
            return
        seen = system.forward(direction)
        length = np.float32(size / energy(seen))
        found += length * direction
        residual -= length * seen
        gradient = system.adjoint(residual)
        before, size = size, energy(gradient)
        direction *= np.float32(size / before)
        direction += gradient
        yield
