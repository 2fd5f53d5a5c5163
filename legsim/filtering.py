"""What happens to each projection before back-projection: truncation correction, cosine and redundancy weights, ramp filter.

All weights come from the geometry of the projections. Filtering is row by row, in batches of float32 FFTs on all cores.
"""

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from typing import Literal, get_args

import numpy as np
from scipy import fft

from legsim.arrays import Float32Array, FloatArray
from legsim.errors import LegsimError
from legsim.geometry import ConeBeamGeometry, Projections
from legsim.redundancy import SourceArc, fan_angles, redundancy_weights, source_arc, warn_if_incomplete

Window = Literal["ram-lak", "shepp-logan", "hann"]
_BATCH_ELEMENTS = 2_000_000
_EDGE_COLUMNS = 16
"""columns at either edge of the detector that tell value and slope of a cut-off object"""
_LEAST_TURNING = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterOptions:
    """How projections are filtered."""

    window: Window = "shepp-logan"
    """apodization of the ramp: ram-lak (none), shepp-logan (as the paper) or hann (smoothest)"""
    water_attenuation: float | None = 20.0
    """1/m, of the cylinder that continues a cut-off object; None leaves projections cut off. About 20 is tissue at 60 to 70 keV."""
    parker: bool = True
    """redundancy weights; without them every view counts half, as in a full turn"""

    def __post_init__(self) -> None:
        if self.window not in get_args(Window):
            raise LegsimError(f"filter window {self.window!r} is unknown; there are: {', '.join(get_args(Window))}")
        if self.water_attenuation is not None and not self.water_attenuation > 0:
            raise LegsimError(f"water_attenuation is {self.water_attenuation}; expected a positive number in 1/m, or None to switch it off")


def ramp_kernel(count: int) -> FloatArray:
    """Ram-Lak ramp at -count + 1 … count - 1 pixels, pixel pitch 1, from its band-limited inverse transform (Kak and Slaney, 3.3)."""
    k = np.abs(np.arange(-count + 1, count))
    kernel = np.where(k % 2 == 1, -1.0 / (np.pi * np.maximum(k, 1)) ** 2, 0.0)
    kernel[count - 1] = 0.25
    return kernel


def shepp_logan_kernel(count: int) -> FloatArray:
    """Shepp and Logan's filter (1974) at -count + 1 … count - 1 pixels, pixel pitch 1: -2 / (pi^2 (4 k^2 - 1))."""
    k = np.arange(-count + 1, count, dtype=float)
    return -2.0 / (np.pi**2 * (4.0 * k**2 - 1.0))


def filter_response(reach: int, window: Window) -> tuple[int, Float32Array]:
    """(n, real response (n // 2 + 1,)) for linear convolution over ``reach`` samples: a kernel in space, transformed.

    The length n avoids wrapping; building the kernel in space keeps the level that a ramp sampled in frequency loses at 0.
    """
    length: int = fft.next_fast_len(2 * reach - 1, True)  # type: ignore[assignment, arg-type]
    kernel = shepp_logan_kernel(reach) if window == "shepp-logan" else ramp_kernel(reach)
    wrapped = np.zeros(length)
    wrapped[np.arange(-reach + 1, reach)] = kernel
    response = np.real(np.asarray(fft.rfft(wrapped)))
    if window == "hann":
        response = response * (0.5 + 0.5 * np.cos(2 * np.pi * fft.rfftfreq(length)))
    return length, response.astype(np.float32)


def extended_rows(rows: Float32Array, reach: int, water_pixels: float) -> Float32Array:
    """Rows (..., n) continued on both sides by ``reach`` columns each as if a water cylinder were cut off.

    The method is that of Hsieh et al. (Med Phys 31, 2004). The cylinder's chord 2 a sqrt(r^2 - (x - x0)^2), a being ``water_pixels``
    (attenuation times the width of a pixel at the axis), meets the edge with the value and slope of a line through the outermost
    columns. It ends in zero by itself; a cosine sees to it that it is zero at ``reach`` even when it is wider. Edges at or below zero
    continue as zero.
    """
    taper = np.cos(0.5 * np.pi * np.linspace(0.0, 1.0, reach + 1)[1:] ** 2).astype(np.float32)
    left = _cylinder(rows[..., :_EDGE_COLUMNS], reach, water_pixels) * taper
    right = _cylinder(rows[..., : -_EDGE_COLUMNS - 1 : -1], reach, water_pixels) * taper
    return np.concatenate([left[..., ::-1], rows, right], -1)


def _cylinder(edge: Float32Array, reach: int, water_pixels: float) -> Float32Array:
    """Continuation (..., reach) beyond edge (..., m), whose first column is the outermost."""
    m = edge.shape[-1]
    k = np.arange(m)
    centered = k - k.mean()
    slope = edge @ (centered / max((centered**2).sum(), 1.0)).astype(np.float32)
    value = np.maximum(edge.mean(-1) - slope * np.float32(k.mean()), 0.0)
    half = (value / np.float32(2 * water_pixels))[..., None]
    # the chord's slope is -2 a (x - x0) / sqrt(...), so the axis lies (half chord) x (slope) / 2 a inwards; here slope points inwards
    inward = half * (slope / np.float32(2 * water_pixels))[..., None]
    beyond = np.arange(1, reach + 1, dtype=np.float32)
    squared = half**2 - beyond * (2 * inward + beyond)
    return np.float32(2 * water_pixels) * np.sqrt(np.maximum(squared, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class RayWeights:
    """The cosine of the angle between each ray and the line from source to axis, over how fast rays turn from pixel to pixel.

    With a ray d(u, v) = B (u, v, 1), B inverting the matrix's left part, w the direction from source to axis and e the one across w and
    the axis a, Feldkamp's formula filters x = (d . e) / (d . w) and back-projects with 1 / L^2, L being the depth along w. On any flat
    detector x is projective in u, for which the ramp of x is that of u times 1 / (dx/du): the two distances in its kernel are
    (u - u') sqrt(x'(u) x'(u')). Together with depth^2 = L^2 / (d . w)^2 of the kernels' weight that leaves 1 / (d . w)^2 (dx/du) =
    1 / |a . (dB/du x d)|, which is the same in a whole row. It is the focal length in pixels where the detector faces the axis.
    """

    numerators: FloatArray
    """(v, 3): dot(ray (u, v, 1), direction to the axis)"""
    squares: FloatArray
    """(v, 3, 3): quadratic form of (u, v, 1) that gives the squared length of the ray"""
    row_factors: FloatArray
    """(v, rows): 1 / |a . (dB/du x d)|"""

    def alike(self, view: int, other: int) -> bool:
        """Whether two views have the same weights."""
        return all(np.allclose(a[view], a[other], rtol=1e-9, atol=1e-12) for a in (self.numerators, self.squares, self.row_factors))

    def of(self, view: int, shape_vu: tuple[int, int], reach: int) -> Float32Array:
        """(rows, columns + 2 reach) of one view."""
        factors = self.row_factors[view].astype(np.float32)[:, None]
        return _ray_weights(shape_vu, reach, self.numerators[view], self.squares[view], factors)


def _ray_weights(shape_vu: tuple[int, int], reach: int, numerator: FloatArray, square: FloatArray, factors: Float32Array) -> Float32Array:
    u, v = np.arange(-reach, shape_vu[1] + reach, dtype=np.float32), np.arange(shape_vu[0], dtype=np.float32)[:, None]
    n, g = numerator.astype(np.float32), square.astype(np.float32)
    lengths = (2 * g[0, 1] * v) * u
    lengths += (g[0, 0] * u + 2 * g[0, 2]) * u
    lengths += (g[1, 1] * v + 2 * g[1, 2]) * v + g[2, 2]
    np.sqrt(lengths, out=lengths)
    weights = (n[0] * factors) * u
    weights += (n[1] * v + n[2]) * factors
    return np.divide(weights, lengths, out=lengths)


@dataclass(frozen=True, slots=True, eq=False)
class FilterPlan:
    """Everything about filtering that depends on the geometry alone."""

    geometry: ConeBeamGeometry
    reach: int
    """columns added on either side for the truncation correction"""
    water_pixels: float | None
    length: int
    response: Float32Array
    shares: Float32Array
    """(v, columns + 2 reach): redundancy weight x increment x radius"""
    rays: RayWeights
    first_rays: Float32Array
    """(rows, columns + 2 reach) those of the first view, which serve all views of a circular scan"""

    def ray_weights(self, view: int) -> Float32Array:
        """(rows, columns + 2 reach) :class:`RayWeights` of a view."""
        return self.first_rays if self.rays.alike(view, 0) else self.rays.of(view, self.geometry.shape_vu, self.reach)


def plan_filter(geometry: ConeBeamGeometry, options: FilterOptions, added: tuple[int, int] = (0, 0)) -> FilterPlan:
    """Weights and filter for a scan whose first and last ``added`` columns were not measured (:mod:`legsim.displaced`).

    Warns where it is shorter than a complete short scan.

    Raises:
        LegsimError: the sources do not run on an arc.
    """
    arc = source_arc(geometry)
    columns = geometry.shape_vu[1]
    reach = columns // 2 if options.water_attenuation is not None and columns >= 2 * _EDGE_COLUMNS else 0
    u = np.arange(-reach, columns + reach, dtype=float)
    fans = fan_angles(geometry, arc, u)
    if options.parker:
        warn_if_incomplete(arc, fan_angles(geometry, arc, np.array([-0.5, columns - 0.5])))
    edges = fan_angles(geometry, arc, np.array([added[0] - 0.5, columns - added[1] - 0.5])) if any(added) else None
    shares = redundancy_weights(arc, fans, edges) if options.parker else np.full(fans.shape, 0.5)
    length, response = filter_response(columns + reach, options.window)
    rays = _rays(geometry, arc)
    pixel_at_axis = float(np.mean(arc.radii / rays.row_factors[:, geometry.shape_vu[0] // 2]))
    water = options.water_attenuation * pixel_at_axis if options.water_attenuation is not None else None
    weights = (shares * (arc.increments * arc.radii)[:, None]).astype(np.float32)
    return FilterPlan(geometry, reach, water, length, response, weights, rays, rays.of(0, geometry.shape_vu, reach))


def _rays(geometry: ConeBeamGeometry, arc: SourceArc) -> RayWeights:
    back = np.linalg.inv(geometry.matrices[:, :, :3])
    outward = geometry.sources() - arc.center
    outward -= (outward @ arc.axis)[:, None] * arc.axis
    inward = -outward / np.linalg.norm(outward, axis=-1, keepdims=True)
    per_row = np.cross(back[:, :, 0], back[:, :, 1]) @ arc.axis
    turning = np.abs((np.cross(back[:, :, 0], back[:, :, 2]) @ arc.axis)[:, None] + per_row[:, None] * np.arange(geometry.shape_vu[0]))
    # a row whose rays run along the axis tells nothing of the lines across it; it must not drown the others
    factors = 1 / np.maximum(turning, _LEAST_TURNING * np.median(turning))
    return RayWeights(np.einsum("vji,vj->vi", back, inward), np.einsum("vji,vjk->vik", back, back), factors)


def filtered_views(
    projections: Projections,
    options: FilterOptions,
    progress: Callable[[int, int], None] | None = None,
    *,
    added: tuple[int, int] = (0, 0),
    finish: Callable[[Float32Array, slice], Float32Array] = lambda filtered, _: filtered,
) -> Iterator[tuple[slice, Float32Array]]:
    """Yields (views, filtered (n, rows, columns)) in order; back-projected with 1 / depth^2 (m) they add up to attenuation in 1/m.

    Two batches per core are under way at once. ``finish`` is applied to (filtered, views) by the thread that filtered them.
    """
    plan = plan_filter(projections.geometry, options, added)
    views, rows, _ = projections.line_integrals.shape
    size = max(1, _BATCH_ELEMENTS // (rows * plan.length))
    slices = [slice(k, min(k + size, views)) for k in range(0, views, size)]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)

    def filtered(where: slice) -> Float32Array:
        return finish(filter_batch(plan, projections.line_integrals[where], where), where)

    with ThreadPoolExecutor(cores) as pool:
        waiting = iter(slices)
        pending = deque((s, pool.submit(filtered, s)) for s in islice(waiting, 2 * cores))
        while pending:
            done, future = pending.popleft()
            batch = future.result()
            pending.extend((s, pool.submit(filtered, s)) for s in islice(waiting, 1))
            yield done, batch
            if progress is not None:
                progress(done.stop, views)


def filter_batch(plan: FilterPlan, images: Float32Array, views: slice) -> Float32Array:
    """Filters images (n, rows, columns) of the given views."""
    columns = images.shape[-1]
    rows = extended_rows(images, plan.reach, plan.water_pixels) if plan.reach and plan.water_pixels else images.copy()
    for k, view in enumerate(range(views.start, views.stop)):
        rows[k] *= plan.ray_weights(view)
        rows[k] *= plan.shares[view]
    spectrum = np.asarray(fft.rfft(rows, plan.length, axis=-1, overwrite_x=True))
    spectrum *= plan.response
    filtered = np.asarray(fft.irfft(spectrum, plan.length, axis=-1, overwrite_x=True))
    return np.ascontiguousarray(filtered[..., plan.reach : plan.reach + columns])
