"""Iterative reconstruction by conjugate gradients (CGLS, Hestenes and Stiefel 1952), static or
motion-compensated.

It minimizes |A f - p|^2 with a voxel-driven projector A and its exact adjoint, which follow the
same motions as filtered back-projection. For scans that FDK does not suit: few views, gaps, wide
cones. Early iterations are the smooth ones; stopping is the regularization. Voxels should be no
larger than a pixel seen at the isocenter, or A's images have gaps between them.
"""

from collections.abc import Callable

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array
from legsim.deformation.models import Motion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction import _backprojection_plan, backprojection


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


def reconstruct(
    projections: Projections,
    grid: VolumeGrid,
    device: Device,
    *,
    motion: Motion | None = None,
    iterations: int = 15,
    start: Volume | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Volume:
    """Linear attenuation (1/m) on ``grid`` after so many steps of CGLS, from zero or from ``start``
    (such as an FDK volume).

    Everything that absorbs must lie inside the grid. ``progress`` counts steps.

    Raises:
        LegsimError: ``start`` lies on another grid, ``iterations`` is no positive number, or the
            motion has another number of views.
    """
    if iterations < 1:
        raise LegsimError(f"{iterations} iterations were asked for; give at least 1")
    if start is not None and start.grid != grid:
        raise LegsimError(
            "the volume to start from lies on another grid; reconstruct it on the same one"
        )
    system = SystemMatrix(projections.geometry, grid, device, motion)
    found = np.zeros(grid.shape_zyx, np.float32)
    if start is not None:
        found += start.attenuation
    residual = (
        projections.line_integrals.copy()
        if start is None
        else projections.line_integrals - system.forward(found)
    )
    gradient = system.adjoint(residual)
    direction, energy = gradient.copy(), _energy(gradient)
    for step in range(iterations):
        if energy == 0:
            break
        seen = system.forward(direction)
        length = np.float32(energy / _energy(seen))
        found += length * direction
        residual -= length * seen
        gradient = system.adjoint(residual)
        before, energy = energy, _energy(gradient)
        direction *= np.float32(energy / before)
        direction += gradient
        if progress is not None:
            progress(step + 1, iterations)
    return Volume(grid, found)


def _energy(array: Float32Array) -> float:
    """Sum of squares, in double precision."""
    return float(sum(np.vdot(part, part) for part in array.astype(np.float64)))
