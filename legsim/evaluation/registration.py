"""Rigid registration of a volume to its reference, and its own measured error.

It maximizes Pearson's correlation over seeded points inside a mask, both volumes read linearly, on
a pyramid of halved volumes: what SimpleITK's ``ImageRegistrationMethod`` does with its metric
"correlation", without smoothing whole volumes for it. Instead of gradient descent it takes
Gauss-Newton steps: the correlation is greatest where the least-squares fit of the reference by
gain x volume + offset is best.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from legsim.core import transforms
from legsim.core.values import Float32Array, FloatArray
from legsim.evaluation import resampling
from legsim.evaluation.regions import Box, Region, bounding_box, within
from legsim.evaluation.scaling import value_range
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device, open_device

_SAMPLES, _COARSE_SAMPLES = 50_000, 20_000
"""points at the finest and at other levels"""

_LEVELS, _FEWEST_VOXELS = 3, 8
"""of the pyramid, and voxels along each axis of its coarsest level"""

_MOST_STEPS, _MOST_HALVINGS = 30, 6

_SMALLEST_STEP, _COARSE_STEP = 2e-4, 2e-2
"""voxels at the grid's corner; a smaller step ends the search, at the finest and at other levels"""

_REACH = 0.03
"""m around the regions that is read: farther than any registration shifts"""

_NEGLIGIBLE = 0.02
"""voxels at the grid's corner; nothing is reconstructed again for less"""

_WINDOW = 7
"""voxels around the regions that are compared: more than any window of SSIM reaches"""

_KNOWN_SHIFT, _KNOWN_TURN = np.array([0.6e-3, -0.5e-3, 0.6e-3]), np.radians([0.5, 0.6, -0.6])


@dataclass(frozen=True, slots=True)
class Registration:
    """The rigid transform from the reference to the volume, and whether it was used."""

    translation_mm: float
    """length of the shift at the grid's center"""
    rotation_deg: float
    applied: bool
    correlation_before: float
    correlation_after: float
    stopped: str
    """how the search ended"""
    reconstructed: bool = False
    """whether the volume was reconstructed where it lies; else it was resampled"""


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """What is registered: the reference where it is compared, and the volume around that."""

    fixed: Float32Array
    """(z, y, x) in the box"""
    mask: NDArray[np.bool_]
    """(z, y, x) in the box: what counts"""
    moving: Float32Array
    """(z, y, x) on the whole grid"""
    grid: VolumeGrid
    """of ``moving``"""
    box: Box
    """of the grid"""


def register(
    pair: Compared,
    device: Device,
    reconstructed_at: Callable[[FloatArray], Float32Array] | None = None,
) -> tuple[Registration, Float32Array]:
    """Rigidly registers the volume to the reference.

    Args:
        pair: volume and reference.
        device: that resamples.
        reconstructed_at: reconstructs the volume (z, y, x) of the box, as :class:`Compared` holds
            it, with every voxel x where the given matrix (4, 4) m carries it. Unlike an
            interpolated one it keeps the noise and streaks that the reference has, too. None
            resamples by cubic B-splines.

    Returns:
        The registration and the volume (z, y, x) to compare in the box: moved where that raises
        the correlation inside the mask, else as it was, so that interpolation never makes an
        aligned volume worse. NaN where a resampled volume would need values outside the grid.
    """
    matrix, stopped = rigid_transform(pair)
    unmoved = pair.moving[pair.box]
    again = reconstructed_at is not None and _largest_shift(matrix, pair) > _NEGLIGIBLE
    if reconstructed_at is None:
        shift = shift_in_voxels(matrix, pair.grid)
        moved = resampling.resample(pair.moving, shift, pair.box, device)
    else:
        moved = reconstructed_at(matrix) if again else unmoved
    covered = pair.mask & np.isfinite(moved)
    before, after = (_correlation(a, pair.fixed, covered) for a in (unmoved, moved))
    center = np.array(pair.grid.center)
    registration = Registration(
        1e3 * float(np.linalg.norm(_moved(matrix, center) - center)),
        float(np.degrees(transforms.rotation_angle(matrix[:3, :3]))),
        after > before,
        before,
        after,
        stopped,
        again,
    )
    return registration, moved if after > before else unmoved


def _largest_shift(matrix: FloatArray, pair: Compared) -> float:
    """Voxels by which the corner of the grid moves that moves farthest."""
    nz, ny, nx = pair.grid.shape_zyx
    corners = np.array(list(product((0, nx - 1), (0, ny - 1), (0, nz - 1), (1,))))
    return float(np.linalg.norm(corners @ shift_in_voxels(matrix, pair.grid).T, axis=1).max())


@dataclass(frozen=True, slots=True)
class RegistrationError:
    """Error of the registration for a known motion."""

    translation_mm: float
    """at the middle of the regions"""
    rotation_deg: float


def registration_error(
    reference: Volume, regions: Sequence[Region], device: Device | None = None
) -> RegistrationError:
    """Measures the registration's own error.

    The reference is moved by a known millimeter and degree, registered back, and the two are
    compared. ``device=None`` opens the fastest.
    """
    union = np.logical_or.reduce([region.mask for region in regions])
    wide, box = boxes(union, reference.grid)
    grid, inner = reference.grid.cropped(wide), within(box, wide)
    inside = reference.attenuation[box][union[box]]
    scale = value_range(reference.attenuation, inside, "reference-leg", "reference")
    values = scale.scaled(reference.attenuation[wide])
    center = np.array(grid.center)
    known = _about(center, _KNOWN_TURN, _KNOWN_SHIFT)
    moved = resampling.resample(
        values, shift_in_voxels(known, grid), within(wide, wide), device or open_device()
    )
    found, _ = rigid_transform(Compared(values[inner], union[box], moved, grid, inner))
    # moved(p) = reference(known p), and the registration looks for moved(found p) = reference(p)
    missed = known @ found
    shift = 1e3 * float(np.linalg.norm(_moved(missed, center) - center))
    return RegistrationError(shift, float(np.degrees(transforms.rotation_angle(missed[:3, :3]))))


def boxes(mask: NDArray[np.bool_], grid: VolumeGrid) -> tuple[Box, Box]:
    """The box of all voxels that a registration may read, and that of what is compared.

    Voxels farther away have no effect, but take most of the time.
    """
    wide = [max(_WINDOW, int(np.ceil(_REACH / s))) for s in grid.spacing_xyz[::-1]]
    return bounding_box(mask, wide), bounding_box(mask, [_WINDOW] * 3)


def shift_in_voxels(matrix: FloatArray, grid: VolumeGrid) -> FloatArray:
    """Shift (3, 4) in voxels by a matrix (4, 4) m, as a function of the voxel's (x, y, z, 1)."""
    spacing = np.array(grid.spacing_xyz)
    turned = matrix[:3, :3] - np.eye(3)
    constant = (turned @ grid.origin + matrix[:3, 3]) / spacing
    return np.column_stack([turned * spacing / spacing[:, None], constant])


def rigid_transform(pair: Compared) -> tuple[FloatArray, str]:
    """Matrix (4, 4) m from points of the reference to those of the volume; how the search ended."""
    levels = [pair]
    while len(levels) < _LEVELS and min(levels[-1].fixed.shape) >= 2 * _FEWEST_VOXELS:
        levels.append(_halved(levels[-1]))
    matrix, stopped = np.eye(4), ""
    for level in reversed(levels):
        finest = level is pair
        matrix, stopped = _improved(
            matrix,
            level,
            _SAMPLES if finest else _COARSE_SAMPLES,
            _SMALLEST_STEP if finest else _COARSE_STEP,
        )
    return matrix, stopped


def _improved(
    matrix: FloatArray, pair: Compared, count: int, enough: float
) -> tuple[FloatArray, str]:
    """Climbs from ``matrix`` to the greatest correlation of one level; how it ended.

    ``count`` points are compared; a step of less than ``enough`` voxels is the last.
    """
    spacing = np.array(pair.grid.spacing_xyz)
    corner = 0.5 * float(np.linalg.norm(spacing * pair.grid.shape_zyx[::-1]))
    points = _points(pair, count)
    fixed = _read(pair.fixed, pair.grid.cropped(pair.box), points)
    known = np.isfinite(fixed)
    points, fixed = points[known], fixed[known]
    reached = _correlation_at(matrix, pair, points, fixed)
    for done in range(_MOST_STEPS):
        step = _newton_step(matrix, pair, points, fixed)
        for _ in range(_MOST_HALVINGS):
            tried = _about(_moved(matrix, pair.grid.center), *step) @ matrix
            found = _correlation_at(tried, pair, points, fixed)
            if found > reached:
                break
            step = 0.5 * step
        else:
            return matrix, f"no further step raises the correlation after {done} steps"
        matrix, reached = tried, found
        turn, shift = np.linalg.norm(step, axis=1)
        if shift + corner * turn < enough * spacing.min():
            return matrix, f"converged in {done + 1} steps"
    return matrix, f"did not converge in {_MOST_STEPS} steps"


def _points(pair: Compared, count: int) -> FloatArray:
    """(count, 3) m world: seeded points anywhere in the mask's voxels, on no grid."""
    rng = np.random.default_rng(42)
    inside = np.flatnonzero(pair.mask)
    voxels = np.unravel_index(inside[rng.integers(0, len(inside), count)], pair.mask.shape)
    index = np.stack(voxels[::-1], -1) + rng.uniform(-0.5, 0.5, (count, 3))
    grid = pair.grid.cropped(pair.box)
    return grid.origin + index * np.array(grid.spacing_xyz)


def _read(values: Float32Array, grid: VolumeGrid, points: FloatArray) -> FloatArray:
    """Values (n,) at points (n, 3) m world by linear interpolation.

    NaN outside the grid and beside values that are not finite.
    """
    index = (points - grid.origin) / np.array(grid.spacing_xyz)
    found = map_coordinates(values, index.T[::-1], np.float64, 1, cval=np.nan, prefilter=False)
    return np.where(np.isfinite(found), found, np.nan)


def _correlation_at(
    matrix: FloatArray, pair: Compared, points: FloatArray, fixed: FloatArray
) -> float:
    """Pearson's correlation at the points that the volume still covers; -1 where there are none."""
    moving = _read(pair.moving, pair.grid, transforms.apply(matrix, points))
    known = np.isfinite(moving)
    if np.count_nonzero(known) < 0.5 * len(points):
        return -1.0
    x, y = moving[known] - moving[known].mean(), fixed[known] - fixed[known].mean()
    size = np.sqrt(np.sum(x * x) * np.sum(y * y))
    # sums, not BLAS products, whose last digits depend on the number of threads
    return float(np.sum(x * y) / size) if size > 0 else -1.0


def _newton_step(
    matrix: FloatArray, pair: Compared, points: FloatArray, fixed: FloatArray
) -> FloatArray:
    """Turn (rad) and shift (m), (2, 3), of the volume's points about the grid's moved center.

    They solve ``fixed = gain (volume + slope . movement) + offset`` by least squares.
    """
    spacing = np.array(pair.grid.spacing_xyz)
    at = transforms.apply(matrix, points)
    slope = np.stack(
        [
            (_read(pair.moving, pair.grid, at + d) - _read(pair.moving, pair.grid, at - d)) / s
            for d, s in zip(0.5 * np.diag(spacing), spacing, strict=True)
        ],
        -1,
    )
    moving = _read(pair.moving, pair.grid, at)
    lever = at - _moved(matrix, pair.grid.center)
    arm = float(np.sqrt(np.mean(lever**2)))
    columns = np.column_stack(
        [np.cross(lever, slope) / arm, slope, moving, np.ones_like(moving), fixed]
    )
    columns = columns[np.isfinite(columns).all(-1)]
    # one product of two columns after the other: no digit depends on the number of threads
    products = np.array([[np.sum(a * b) for b in columns.T] for a in columns.T])
    solved = np.linalg.lstsq(products[:-1, :-1], products[:-1, -1], rcond=1e-12)[0]
    gain = solved[6]
    if gain <= 0:
        return np.zeros((2, 3))
    return np.stack([solved[:3] / arm, solved[3:6]]) / gain


def _moved(matrix: FloatArray, point: Sequence[float] | FloatArray) -> FloatArray:
    """The point (3,) where the matrix carries it."""
    return matrix[:3, :3] @ np.asarray(point, float) + matrix[:3, 3]


def _about(center: FloatArray, turn: FloatArray, shift: FloatArray) -> FloatArray:
    """Matrix (4, 4): a turn (3,) rad about a point, then a shift (3,) m."""
    rotation = transforms.rotation_from_vector(turn)
    return transforms.rigid(rotation, center - rotation @ center + shift)


def _halved(pair: Compared) -> Compared:
    """The same at half the resolution: means of 2x2x2 voxels, and a mask of those that touch it."""
    # the box begins at an even voxel, so that both volumes are halved alike
    box = tuple(slice(b.start + b.start % 2, b.stop) for b in pair.box)
    inner = within((box[0], box[1], box[2]), pair.box)
    fixed, moving = _mean_of_pairs(pair.fixed[inner]), _mean_of_pairs(pair.moving)
    mask = _mean_of_pairs(pair.mask[inner].astype(np.float32)) > 0
    z, y, x = (slice(b.start // 2, b.start // 2 + n) for b, n in zip(box, fixed.shape, strict=True))
    grid = pair.grid
    kept = tuple(slice(0, 2 * n) for n in moving.shape)
    covered = grid.cropped((kept[0], kept[1], kept[2]))
    dx, dy, dz = grid.spacing_xyz
    nz, ny, nx = moving.shape
    halved = VolumeGrid((nz, ny, nx), (2 * dx, 2 * dy, 2 * dz), covered.center)
    return Compared(fixed, mask, moving, halved, (z, y, x))


def _mean_of_pairs(values: Float32Array) -> Float32Array:
    """Means of 2x2x2 voxels; a last odd one is left out."""
    for axis in range(3):
        even, odd = ([slice(None)] * 3 for _ in range(2))
        stop = values.shape[axis] // 2 * 2
        even[axis], odd[axis] = slice(0, stop, 2), slice(1, stop, 2)
        values = values[tuple(even)] + values[tuple(odd)]
    return values * np.float32(0.125)


def _correlation(a: Float32Array, b: Float32Array, mask: NDArray[np.bool_]) -> float:
    """Pearson's correlation inside the mask, from sums by slice, which stay in the cache."""
    sums = np.zeros((len(mask), 6))
    for k, inside in enumerate(mask):
        # the middle of the scale is taken off, so that float64 loses nothing in the squares
        x, y = a[k][inside].astype(np.float64) - 0.5, b[k][inside].astype(np.float64) - 0.5
        # sums, not BLAS products, whose last digits depend on the number of threads
        sums[k] = len(x), x.sum(), y.sum(), (x * x).sum(), (y * y).sum(), (x * y).sum()
    count, x, y, xx, yy, xy = sums.sum(0)
    return float((xy - x * y / count) / np.sqrt((xx - x * x / count) * (yy - y * y / count)))
