"""Iterative reconstruction with total variation: pieces of constant attenuation from few views.

It minimizes a / V x 1/2 |A f - p|^2 + w TV(f) over f >= 0. V is the number of views, a the area of
a pixel seen at the isocenter (m^2), TV(f) the integral of |grad f| (m), w a weight in m, and A that
of :mod:`legsim.reconstruction.system_matrix`. So the weight means the same for any detector, number
of views and grid: about a ball of radius r loses 2 w / r^2 (1/m) of its contrast.
"""

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array
from legsim.deformation.models import Motion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device, open_device
from legsim.reconstruction import proximal_steps, system_matrix
from legsim.reconstruction.corrected_scan import CorrectedScan, images_and_motion
from legsim.reconstruction.field_of_view import pixel_at_isocenter
from legsim.reconstruction.system_matrix import SystemMatrix, energy

_MOST_ITERATIONS = 100

_LEAST_DROP, _OVER = 1e-4, 5
"""of the images' norm, and steps: the end is where so many steps together lower the objective's
root by less
"""

_DEVIATIONS = 3.0
"""standard deviations of the contrast that noise gives a ball, of which the weight takes the double
"""

_MODEL_ERROR = 0.04
"""of the images' root mean square: how far A's images of a sampled object are from its line
integrals
"""

_BEHIND = 0.1
"""of the largest line integral: pixels above it are behind the object, and show noise"""

_INNER_STEPS = 20


class TotalVariation:
    """``scale`` x the sum over voxels of |D f| (1/m^2), a penalty of :mod:`proximal_steps`.

    D f holds forward differences over the spacing along x, y and z, 0 past the last voxel. The
    proximal map is found by fast gradient projection of its dual (Beck and Teboulle, IEEE Trans
    Image Process 18, 2009), from the dual of the map before: asked again, it is nearer.
    """

    def __init__(self, grid: VolumeGrid, scale: float, device: Device) -> None:
        self.scale, self._grid, self._device = scale, grid, device
        count = math.prod(grid.shape_zyx)
        self._per_spacing = np.array([*(1 / s for s in grid.spacing_xyz), 0], np.float32)
        self._volume, self._nearest = device.zeros(count), device.zeros(count)
        self._dual, self._ahead = device.zeros(3 * count), device.zeros(3 * count)
        self._sums = device.zeros(math.prod(grid.shape_zyx[:2]))

    def value(self, volume: Float32Array) -> float:
        nz, ny, nx = self._grid.shape_zyx
        self._device.write(self._volume, volume, 0)
        buffers = (self._volume, self._sums, self._per_spacing)
        self._run("variation", (ny, nz), *buffers, np.int32(nx))
        sums = self._device.download(self._sums, np.empty((nz, ny), np.float32))
        return self.scale * float(sums.sum(dtype=np.float64))

    def nearest(self, volume: Float32Array, length: float) -> Float32Array:
        scale = np.float32(length * self.scale)
        if scale == 0:
            return np.maximum(volume, 0)
        shape = self._grid.shape_zyx
        spacing, places = self._per_spacing, (shape[2], shape[1], shape[0])
        rate = np.float32(1 / (4 * scale * np.sum(spacing**2)))  # |D|^2 <= 4 sum of spacing^-2
        self._device.write(self._volume, volume, 0)
        inertia = 1.0
        for _ in range(_INNER_STEPS):
            before, inertia = inertia, 0.5 * (1 + math.sqrt(1 + 4 * inertia**2))
            momentum = np.float32((before - 1) / inertia)
            shifted = (self._volume, self._ahead, self._nearest, spacing, scale)
            self._run("from_dual", places, *shifted)
            climbed = (self._nearest, self._dual, self._ahead, spacing, rate, momentum)
            self._run("climb_dual", places, *climbed)
        self._run("from_dual", places, self._volume, self._dual, self._nearest, spacing, scale)
        return self._device.download(self._nearest, np.empty(shape, np.float32))

    def _run(self, name: str, size: tuple[int, ...], *arguments: Any) -> None:
        kernel = self._device.kernel(name, "total_variation.cl")
        kernel(self._device.queue, size, None, *arguments)


def tv(
    projections: Projections | CorrectedScan,
    grid: VolumeGrid,
    *,
    motion: Motion | None = None,
    weight: float | None = None,
    noise: float | None = None,
    iterations: int | None = None,
    device: Device | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Volume:
    """Reconstructs linear attenuation (1/m), 0 or above, on ``grid`` with little total variation.

    For few views of an object of few materials. Everything that absorbs must lie inside the grid. A
    step costs one projection, one back-projection and some passes over the volume; the objective
    never grows.

    Args:
        projections: line integrals (v, rows, columns); or a correction, whose motion is followed.
        grid: where to reconstruct, m in world.
        motion: what to follow, as in :func:`legsim.reconstruction.fdk.fdk`.
        weight: m; 0 gives the least-squares volume without negative values. None:
            :func:`default_weight`.
        noise: standard deviation of the line integrals, for the default weight.
        iterations: steps to take. None: until five steps together lower the root of the objective
            by less than 1e-4 of the images' norm, 100 at most.
        device: None opens the fastest one.
        progress: called with (steps done, steps in all).

    Raises:
        LegsimError: ``weight`` or ``noise`` is negative or both are given, ``iterations`` is below
            1, the motion has another number of views, a correction comes with a second motion, or
            no device works.

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
        >>> volume = tv(projections, grid, iterations=3)
        >>> bool(volume.attenuation.min() >= 0)
        True
    """
    if iterations is not None and iterations < 1:
        raise LegsimError(f"{iterations} iterations were asked for; give at least 1")
    if weight is not None and noise is not None:
        raise LegsimError("weight and noise both say how smooth the volume is; give one")
    if weight is not None and not 0 <= weight < math.inf:
        raise LegsimError(f"a weight of {weight:g} m was given; it must be 0 or above, and finite")
    images, motion = images_and_motion(projections, motion)
    device = device if device is not None else open_device()
    system_matrix.warn_of_large_voxels(images.geometry, grid)
    weight = default_weight(images, noise) if weight is None else weight
    system = SystemMatrix(images.geometry, grid, device, motion)
    penalty = TotalVariation(grid, _scale(images.geometry, grid, weight), device)
    found, residual = np.zeros(grid.shape_zyx, np.float32), images.line_integrals.copy()
    most = _MOST_ITERATIONS if iterations is None else iterations
    whole = math.sqrt(energy(residual))
    roots = deque([whole], maxlen=_OVER + 1)
    for step, objective in enumerate(
        proximal_steps.steps(system, found, residual, most, penalty), start=1
    ):
        if progress is not None:
            progress(step, most)
        roots.append(math.sqrt(2 * objective))
        slow = len(roots) > _OVER and roots[0] - roots[-1] < _LEAST_DROP * whole
        if iterations is None and slow:
            break
    if progress is not None:
        progress(most, most)
    return Volume(grid, found)


def default_weight(projections: Projections, noise: float | None = None) -> float:
    """The weight (m) at which any ball loses six times the contrast that noise gives it.

    Noise s (standard deviation of each line integral) gives a ball of radius r, matched to its
    shadows in V views of pixels of area a at the isocenter, a contrast of s sqrt(a / (2 pi V)) /
    r^2. The weight, which takes 2 w / r^2, is 3 s sqrt(a / (2 pi V)), for balls of all sizes.
    s is ``noise``, or that of :func:`noise_of`; 4 % of the images' root mean square are added in
    squares for what A's voxels cannot show.

    Raises:
        LegsimError: ``noise`` is negative.
    """
    if noise is not None and not 0 <= noise < math.inf:
        raise LegsimError(f"noise of {noise:g} was given; it must be 0 or above, and finite")
    images = projections.line_integrals
    size = math.sqrt(energy(images) / images.size)
    error = math.hypot(noise_of(projections) if noise is None else noise, _MODEL_ERROR * size)
    area = _pixel_area(projections.geometry)
    return _DEVIATIONS * error * math.sqrt(area / (2 * math.pi * len(images)))


def noise_of(projections: Projections) -> float:
    """Standard deviation of the line integrals' noise, from the images alone.

    The median of second differences along the rows, behind the object: edges, which are few, do not
    count, and smooth shadows have none. Noise that neighboring pixels share is missed.
    """
    images = projections.line_integrals
    if images.shape[2] < 3:
        return 0.0
    behind = images[:, :, 1:-1] > _BEHIND * images.max()
    bends = images[:, :, 2:] - 2 * images[:, :, 1:-1] + images[:, :, :-2]
    seen = np.abs(bends[behind])
    # 0.6745: median of the magnitude of a normal variable; 1 + 4 + 1: variance of the differences
    return float(np.median(seen)) / (0.6745 * math.sqrt(6)) if len(seen) else 0.0


def needed_bytes(
    geometry: ConeBeamGeometry,
    grid: VolumeGrid,
    *,
    motion: Motion | None = None,
    device: Device | None = None,
) -> int:
    """Memory that :func:`tv` takes at most beside projections and volume, the device's included.

    Raises:
        LegsimError: the motion has another number of views, or the device has too little memory.
    """
    # nearest, change, gradient, their sums and one in float64; on the device volume, nearest and
    # two dual fields of three values
    return system_matrix.needed_bytes(
        geometry, grid, images=6, volumes=6 + 8, motion=motion, device=device
    )


def _pixel_area(geometry: ConeBeamGeometry) -> float:
    """m^2 of a pixel scaled to the isocenter."""
    return pixel_at_isocenter(geometry) ** 2 * geometry.row_pitch() / geometry.pixel_pitch


def _scale(geometry: ConeBeamGeometry, grid: VolumeGrid, weight: float) -> float:
    """Factor of the sum over voxels beside 1/2 |A f - p|^2."""
    return weight * len(geometry) / _pixel_area(geometry) * math.prod(grid.spacing_xyz)
