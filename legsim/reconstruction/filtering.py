"""Filtering before back-projection: truncation correction, weights and ramp filter.

All weights come from the geometry of the projections. Filtering is row by row, in batches of
float32 FFTs on all cores.
"""

import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from legsim.core.values import Float32Array
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.reconstruction.ramp_filter import FilterOptions, filter_response
from legsim.reconstruction.source_path import fan_angles, source_arc
from legsim.reconstruction.truncation import extended_rows
from legsim.reconstruction.weights import RayWeights, _rays, redundancy_weights, warn_if_incomplete

_BATCH_ELEMENTS = 2_000_000


@dataclass(frozen=True, slots=True, eq=False)
class FilterPlan:
    """Everything about filtering that depends on the geometry alone."""

    geometry: ConeBeamGeometry
    added: tuple[int, int]
    """columns without a measurement before the first that has one, and after the last"""
    unmeasured: NDArray[np.intp] | None
    """(v, rows, 2) the same of each row, where they differ"""
    reach: int
    """columns added on either side for the truncation correction"""
    water_pixels: float | None
    length: int
    response: Float32Array
    shares: Float32Array
    """(v, columns + 2 reach): redundancy weight x increment x radius"""
    rays: RayWeights
    first_rays: Float32Array
    """(rows, columns + 2 reach) those of the first view, which serve all views of a circular
    scan
    """

    def ray_weights(self, view: int) -> Float32Array:
        """(rows, columns + 2 reach) :class:`RayWeights` of one view."""
        return (
            self.first_rays
            if self.rays.alike(view, 0)
            else self.rays.of(view, self.geometry.shape_vu, self.reach)
        )


def plan_filter(
    geometry: ConeBeamGeometry,
    options: FilterOptions,
    added: tuple[int, int] = (0, 0),
    unmeasured: NDArray[np.intp] | None = None,
) -> FilterPlan:
    """Computes weights and filter of a scan.

    The first and last ``added`` columns hold no measurement, nor do those that ``unmeasured`` (v,
    rows, 2) counts from either end of a row (:mod:`legsim.reconstruction.detector_alignment`).

    Warns where the scan is shorter than a complete short scan.

    Raises:
        LegsimError: the sources do not run on an arc.
    """
    arc = source_arc(geometry, one_sided=any(added))
    columns = geometry.shape_vu[1]
    reach = columns // 2 if options.water_attenuation is not None else 0
    u = np.arange(-reach, columns + reach, dtype=float)
    fans = fan_angles(geometry, arc, u)
    weighted = options.redundancy == "parker"
    edges = fan_angles(geometry, arc, np.array([added[0] - 0.5, columns - added[1] - 0.5]))
    if weighted:
        warn_if_incomplete(arc, edges, one_sided=any(added))
    shares = (
        redundancy_weights(arc, fans, edges if any(added) else None)
        if weighted
        else np.full(fans.shape, 0.5)
    )
    length, response = filter_response(columns + reach, options.window)
    rays = _rays(geometry, arc)
    pixel_at_axis = float(np.mean(arc.radii / rays.row_factors[:, geometry.shape_vu[0] // 2]))
    water = (
        options.water_attenuation * pixel_at_axis if options.water_attenuation is not None else None
    )
    weights = (shares * (arc.increments * arc.radii)[:, None]).astype(np.float32)
    return FilterPlan(
        geometry,
        added,
        unmeasured,
        reach,
        water,
        length,
        response,
        weights,
        rays,
        rays.of(0, geometry.shape_vu, reach),
    )


def filtered_views(
    projections: Projections,
    options: FilterOptions,
    progress: Callable[[int, int], None] | None = None,
    *,
    added: tuple[int, int] = (0, 0),
    unmeasured: NDArray[np.intp] | None = None,
    finish: Callable[[Float32Array, slice], Float32Array] = lambda filtered, _: filtered,
) -> Iterator[tuple[slice, Float32Array]]:
    """Yields (views, filtered (n, rows, columns)) in order.

    Back-projected with 1 / depth^2 (m) they add up to attenuation in 1/m.

    Two batches per core are under way at once. ``finish`` is applied to (filtered, views) by the
    thread that filtered them.
    """
    plan = plan_filter(projections.geometry, options, added, unmeasured)
    views, rows, _ = projections.line_integrals.shape
    size = max(1, _BATCH_ELEMENTS // (rows * plan.length))
    slices = [slice(k, min(k + size, views)) for k in range(0, views, size)]
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    )

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
    rows = _extended(images, plan, views) if plan.reach and plan.water_pixels else images.copy()
    for k, view in enumerate(range(views.start, views.stop)):
        rows[k] *= plan.ray_weights(view)
        rows[k] *= plan.shares[view]
    spectrum = np.asarray(fft.rfft(rows, plan.length, axis=-1, overwrite_x=True))
    spectrum *= plan.response
    filtered = np.asarray(fft.irfft(spectrum, plan.length, axis=-1, overwrite_x=True), np.float32)
    return np.ascontiguousarray(filtered[..., plan.reach : plan.reach + columns])


def _extended(images: Float32Array, plan: FilterPlan, views: slice) -> Float32Array:
    """(n, rows, columns + 2 reach): what was measured continued into the columns that were not."""
    assert plan.water_pixels is not None
    if plan.unmeasured is None:
        return _continued(images, plan.added, plan.reach, plan.water_pixels)
    gaps = plan.unmeasured[views].reshape(-1, 2)
    rows = images.reshape(len(gaps), -1)
    wide = np.zeros((len(gaps), rows.shape[1] + 2 * plan.reach), np.float32)
    for gap in np.unique(gaps, axis=0):
        if gap.sum() < rows.shape[1]:
            alike = (gaps == gap).all(1)
            wide[alike] = _continued(
                rows[alike], (int(gap[0]), int(gap[1])), plan.reach, plan.water_pixels
            )
    return wide.reshape(*images.shape[:-1], -1)


def _continued(
    rows: Float32Array, unmeasured: tuple[int, int], reach: int, water_pixels: float
) -> Float32Array:
    """Rows (..., columns + 2 reach) continued also into their unmeasured columns at either end."""
    before, after = unmeasured
    measured = rows[..., before : rows.shape[-1] - after]
    wide = extended_rows(measured, reach + max(before, after), water_pixels)
    return wide[..., max(after - before, 0) : wide.shape[-1] - max(before - after, 0)]
