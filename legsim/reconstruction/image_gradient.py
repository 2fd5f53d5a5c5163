"""How a criterion of a back-projected volume changes with geometry and motion: exact derivatives.

A voxel at x adds image(u, v) / w^2 to the volume, with (u w, v w, w) = h = P M x. For a criterion E
of the volume with slopes q(x) = dE/dV(x), and s_u, s_v the derivatives of the bilinear image,

    dE/dh = q / w^3 (s_u, s_v, -(s_u u + s_v v + 2 image))

Summed over the voxels times x it is the derivative by the matrix, times the weights of a node that
by the node's displacement (Thies et al., arXiv 2401.09283, without their approximation of the
weight 1 / w^2, which is differentiated here too). One pass over the voxels gives all views.

What does not change with the matrices here: the filtered images, with their cosine, redundancy and
angular weights. FDK recomputes those for the path that it follows, which differs to second order in
a motion of millimeters.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray
from legsim.deformation.models import FieldMotion, Motion, RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import Volume, VolumeGrid
from legsim.opencl.device import Device, open_device
from legsim.reconstruction import (
    _backprojection_plan,
    backprojection,
    cut_off_edges,
    detector_alignment,
    fdk,
    filtering,
)
from legsim.reconstruction.backprojection import VolumeSlab, VoxelMap
from legsim.reconstruction.corrected_scan import check_views, images_and_motion
from legsim.reconstruction.ramp_filter import FilterOptions

Criterion = Callable[[Float32Array], tuple[float, Float32Array]]
"""from a volume (z, y, x) in 1/m to (E, dE/dV (z, y, x))"""

_BLOCK = 8
"""voxels along each side of what one work-item sums, at most"""

_MOMENT_BYTES = 1 << 26
"""device memory of sums that are on their way to the host"""


@dataclass(frozen=True, slots=True, eq=False)
class ImageGradient:
    """A criterion and its derivatives by what decides where voxels fall in the views."""

    value: float
    """E"""
    by_matrices: FloatArray
    """(v, 3, 4) dE/dP(i), by the entries of the geometry's matrices as they are (third row of unit
    normal); per pixel and m as their rows and columns are
    """
    by_motion: FloatArray | None
    """(v, 4, 4) dE/dM(i), by the entries of a rigid motion's matrices, last row 0; None along a
    field
    """
    by_displacements: FloatArray | None
    """(v, z, y, x, 3) 1/m, by a field's displacements at its nodes; None along a rigid motion"""
    motion: Motion
    """the motion at which these are"""

    def by_twists(self) -> FloatArray:
        """(v, 6) dE/dt(i) of M(i) -> exp(t(i)) M(i): rotation (rad), then shift (m), in world.

        Raises:
            LegsimError: the motion is a field.
        """
        if self.by_motion is None or not isinstance(self.motion, RigidMotion):
            raise LegsimError("a field has no twists; take by_displacements")
        left = self.by_motion @ np.swapaxes(self.motion.moved_from_reference, -1, -2)
        turn = [left[:, j, i] - left[:, i, j] for i, j in ((1, 2), (2, 0), (0, 1))]
        return np.stack([*turn, *left[:, :3, 3].T], -1)


@dataclass(frozen=True, slots=True, eq=False)
class FilteredScan:
    """Projections that were filtered once, on a device: to be back-projected along any motion."""

    geometry: ConeBeamGeometry
    """of the detector that FDK works on (:mod:`legsim.reconstruction.detector_alignment`)"""
    device: Device
    from_scanner: FloatArray
    """(v, 3, 3) homographies from the scanner's pixels to those of ``geometry``"""
    _images: Any
    """device buffer as :func:`legsim.reconstruction.backprojection.arranged` makes it"""

    def under(self, geometry: ConeBeamGeometry) -> "FilteredScan":
        """The same filtered images under other matrices of the scanner, and as many views."""
        aligned = replace(self.geometry, matrices=self.from_scanner @ geometry.matrices)
        return replace(self, geometry=aligned)

    def volume(self, grid: VolumeGrid, motion: Motion | None = None) -> Volume:
        """Back-projects onto a grid along a motion, as FDK does with the kernel "voxels"."""
        placement = self._placement(grid, motion)
        slab_count, parts = placement.decided.slab, []
        for start in range(0, grid.shape_zyx[0], slab_count):
            slab = VolumeSlab(placement, start, min(start + slab_count, grid.shape_zyx[0]))
            for views in self._groups(placement):
                slab.add(self._images, views.start, views)
            parts.append(slab.result())
        return Volume(grid, np.concatenate(parts))

    def gradient(
        self, grid: VolumeGrid, slopes: Float32Array, motion: Motion | None = None
    ) -> ImageGradient:
        """Derivatives of a criterion with these ``slopes`` (z, y, x) dE/dV; its value stays 0.

        Raises:
            LegsimError: slopes of another shape, a motion of other views, or one that is neither
                rigid nor a field.
        """
        if np.shape(slopes) != grid.shape_zyx:
            raise LegsimError(
                f"slopes have shape {np.shape(slopes)} for a volume of {grid.shape_zyx}; give "
                "dE/dV of each voxel"
            )
        if not np.isfinite(slopes).all():
            raise LegsimError("slopes hold a value that is no finite number; check the criterion")
        motion = RigidMotion.identity(self.geometry.times) if motion is None else motion
        if not isinstance(motion, RigidMotion | FieldMotion):
            raise LegsimError(
                f"the gradient along a {type(motion).__name__} is not known; take its on_grid "
                "of a coarse grid, whose displacements depend on the points"
            )
        placement = self._placement(grid, motion)
        slab = VolumeSlab(placement, 0, grid.shape_zyx[0])
        blocks = _Blocks.of(slab, motion)
        found = self._summed(slab, blocks, np.asarray(slopes, np.float32))
        by_scanner = np.swapaxes(self.from_scanner, -1, -2)
        if isinstance(motion, RigidMotion):
            by_product, matrices = found[0], motion.moved_from_reference
            by_motion = np.zeros_like(matrices)
            by_motion[:] = np.swapaxes(self.geometry.matrices, -1, -2) @ by_product
            by_motion[:, 3] = 0.0
            by_matrices = by_product @ np.swapaxes(matrices, -1, -2)
            return ImageGradient(0.0, by_scanner @ by_matrices, by_motion, None, motion)
        by_matrices, at_nodes = found
        by_matrices[:, :, :3] += np.einsum("vhzyx,vzyxd->vhd", at_nodes, motion.displacements)
        by_nodes = np.einsum("vhzyx,vhd->vzyxd", at_nodes, self.geometry.matrices[:, :, :3])
        return ImageGradient(0.0, by_scanner @ by_matrices, None, by_nodes, motion)

    def _placement(self, grid: VolumeGrid, motion: Motion | None) -> VoxelMap:
        views = len(self.geometry)
        check_views(self.geometry, motion)
        decided = _backprojection_plan.plan(self.geometry, grid, self.device, kernel="voxels")
        # the images lie as they are, whichever way a grid's columns run
        upright = replace(decided, mirrored=(False,) * views)
        return VoxelMap(self.geometry, grid, self.device, upright, motion)

    def _groups(self, placement: VoxelMap) -> Iterator[slice]:
        views, batch = len(self.geometry), placement.decided.batch
        return (slice(k, min(k + batch, views)) for k in range(0, views, batch))

    def _summed(
        self, slab: VolumeSlab, blocks: "_Blocks", slopes: Float32Array
    ) -> tuple[FloatArray, FloatArray]:
        """dE by the matrices (v, 3, 4) of points at rest, and by the nodes (v, 3, z, y, x) in h."""
        placement, views = slab.placement, len(self.geometry)
        used = blocks.with_slopes(slopes, placement.axes)
        count = 8 if blocks.cells is not None else 5
        values = self.device.upload(slopes)
        by_matrices = np.zeros((views, 3, 4))
        by_nodes = np.zeros((views, 3, *blocks.node_counts))
        for group in self._groups(placement):
            width = group.stop - group.start
            size = max(1, _MOMENT_BYTES // (12 * count * width))
            for first in range(0, len(used), size):
                part = used[first : first + size]
                moments = self._moments(slab, values, blocks.ranges[part], group, count)
                by_matrices[group] += blocks.by_matrices(moments, part)
                if blocks.cells is not None:
                    blocks.add_to_nodes(by_nodes[group], moments, part)
        return by_matrices @ slab.world_from_index.T, by_nodes

    def _moments(
        self, slab: VolumeSlab, slopes: Any, ranges: np.ndarray, views: slice, count: int
    ) -> FloatArray:
        """(blocks, count, 3, views) of the kernel."""
        placement, device = slab.placement, self.device
        place, field = slab.placed(views)
        width = views.stop - views.start
        found = np.empty((len(ranges), count, 3, width), np.float32)
        sums = device.zeros(found.size)
        run = placement.kernel("image_gradient", "image_gradient.cl", MOMENTS=count)
        run(
            *(device.queue, (width, len(ranges)), None, self._images),
            *(place, slab.steps, placement.rest, field, np.int32(views.start), slopes),
            *(np.array([*slab.steps_zyx, 0], np.int64), device.upload(ranges), sums),
        )
        return device.download(sums, found).astype(float)


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Small boxes of voxels; each lies within one cell of a field's nodes."""

    ranges: np.ndarray
    """(n, 6) int32: first voxel and end along c, b, a"""
    axes: tuple[int, int, int]
    """world axes of c, b, a"""
    node_counts: tuple[int, int, int]
    """(z, y, x) nodes of the field; (1, 1, 1) along a rigid motion"""
    cells: tuple[tuple[np.ndarray, FloatArray, FloatArray], ...] | None
    """for c, b, a of each voxel: lower node, share of the upper one, its change per voxel"""

    @classmethod
    def of(cls, slab: VolumeSlab, motion: Motion) -> "_Blocks":
        axes, nodes = slab.placement.axes, None
        cells, keys = None, [np.zeros(count, int) for count in slab.counts]
        if isinstance(motion, FieldMotion):
            nodes = motion.grid
            cells = tuple(_cells(slab.placement.grid, nodes, axis) for axis in axes)
            # a cell that reaches the field's border ends there: beyond it nothing changes
            keys = [
                3 * low + np.sign(share - 0.5).astype(int) * (change == 0) + 1
                for low, share, change in cells
            ]
        pieces = [_pieces(key) for key in keys]
        c, b, a = np.meshgrid(*(np.arange(len(p)) for p in pieces), indexing="ij")
        ranges = np.concatenate(
            [p[k.ravel()] for p, k in zip(pieces, (c, b, a), strict=True)], -1
        ).astype(np.int32)
        return cls(ranges, axes, (1, 1, 1) if nodes is None else nodes.shape_zyx, cells)

    def with_slopes(self, slopes: Float32Array, axes: tuple[int, int, int]) -> np.ndarray:
        """Numbers of the blocks that hold a slope."""
        # running counts of voxels with a slope, in the order c, b, a
        some = np.transpose(slopes != 0, [2 - axis for axis in axes])
        total = np.zeros(np.array(some.shape) + 1, np.int64)
        total[1:, 1:, 1:] = some.cumsum(0, dtype=np.int64).cumsum(1).cumsum(2)
        inside = np.zeros(len(self.ranges), np.int64)
        for corner in np.ndindex(2, 2, 2):
            at = tuple(self.ranges[:, 2 * k + corner[k]] for k in range(3))
            inside += (-1) ** (3 - sum(corner)) * total[at]
        return np.flatnonzero(inside)

    def by_matrices(self, moments: FloatArray, part: np.ndarray) -> FloatArray:
        """(v, 3, 4): sums of dE/dh times (c, b, a, 1) over some blocks."""
        plain = moments[:, 0]
        columns = [
            (moments[:, 1 << k] + self.ranges[part, 2 * k, None, None] * plain).sum(0)
            for k in range(3)
        ]
        return np.moveaxis(np.stack([*columns, plain.sum(0)]), -1, 0).swapaxes(1, 2)

    def add_to_nodes(self, by_nodes: FloatArray, moments: FloatArray, part: np.ndarray) -> None:
        """Adds dE/dh times a node's weight to ``by_nodes`` (v, 3, z, y, x)."""
        cells = self.cells or ()
        firsts = [self.ranges[part, 2 * k] for k in range(3)]
        lows = [low[first] for (low, _, _), first in zip(cells, firsts, strict=True)]
        # weight of the lower and the upper node: constant, and per voxel
        linear = []
        for (_, share, change), first in zip(cells, firsts, strict=True):
            upper = np.stack([share[first], change[first]])
            linear.append([np.array([[1.0], [0.0]]) - upper, upper])
        target = np.zeros((*by_nodes.shape[2:], *by_nodes.shape[1::-1]))
        for corner in np.ndindex(2, 2, 2):
            weighted = np.zeros(moments[:, 0].shape)
            for power in np.ndindex(2, 2, 2):
                weight = np.prod([linear[k][corner[k]][power[k]] for k in range(3)], axis=0)
                index = power[0] + 2 * power[1] + 4 * power[2]
                weighted += weight[:, None, None] * moments[:, index]
            node = [0, 0, 0]
            for k, axis in enumerate(self.axes):
                last = self.node_counts[2 - axis] - 1
                node[2 - axis] = np.minimum(lows[k] + corner[k], last)
            np.add.at(target, tuple(node), weighted)
        by_nodes += np.transpose(target, (4, 3, 0, 1, 2))


def _cells(
    grid: VolumeGrid, nodes: VolumeGrid, axis: int
) -> tuple[np.ndarray, FloatArray, FloatArray]:
    """Lower node of each voxel along an axis, the upper one's share, and its change per voxel."""
    count = nodes.shape_zyx[2 - axis]
    at = (grid.axes()[axis] - nodes.origin[axis]) / nodes.spacing_xyz[axis]
    within = np.clip(at, 0.0, count - 1)
    low = np.minimum(np.floor(within), max(count - 2, 0)).astype(int)
    step = grid.spacing_xyz[axis] / nodes.spacing_xyz[axis]
    return low, within - low, np.where((at >= 0) & (at <= count - 1) & (count > 1), step, 0.0)


def _pieces(key: np.ndarray) -> np.ndarray:
    """(n, 2) first and end of runs of one key, of at most so many voxels as a block has."""
    ends = [0, *(np.flatnonzero(np.diff(key)) + 1), len(key)]
    bounds = [k for a, b in pairwise(ends) for k in range(a, b, _BLOCK)]
    return np.array(list(pairwise([*bounds, len(key)])))


def filtered_scan(
    projections: Projections,
    grid: VolumeGrid,
    *,
    motion: Motion | None = None,
    options: FilterOptions | None = None,
    finish: Callable[[Float32Array], Float32Array] = lambda filtered: filtered,
    device: Device | None = None,
) -> FilteredScan:
    """Filters projections once, with FDK's weights for a motion.

    Args:
        projections: line integrals (v, rows, columns).
        grid: about where the volume will be, m in world; with ``motion`` it decides the weights.
        motion: whose path the weights are of; others may be followed later.
        options: filter and weights.
        finish: applied to filtered images (n, rows, columns), such as a blur.
        device: None opens the fastest one.

    Raises:
        LegsimError: as :func:`legsim.reconstruction.fdk.fdk`.
    """
    options = options if options is not None else FilterOptions()
    device = device if device is not None else open_device()
    projections, motion = images_and_motion(projections, motion)
    given = projections.geometry
    detector = detector_alignment.align(given, fdk.object_geometry(given, grid, motion))
    cut_off_edges.check_cut_off(detector, projections)
    weights_geometry = fdk.object_geometry(detector.geometry, grid, motion)
    upright = np.zeros(len(projections.geometry), bool)
    batches = filtering.filtered_views(
        replace(detector.apply(projections), geometry=weights_geometry),
        options,
        added=detector.added,
        unmeasured=detector.unmeasured(given.shape_vu),
        finish=lambda filtered, views: backprojection.arranged(finish(filtered), upright[views]),
    )
    filtered = None
    for views, batch in batches:
        if filtered is None:
            filtered = device.zeros(len(upright) * batch[0].size)
        device.write(filtered, batch, views.start * batch[0].size)
    return FilteredScan(detector.geometry, device, detector.from_scanner, filtered)


def image_gradient(
    scan: Projections | FilteredScan,
    grid: VolumeGrid,
    criterion: Criterion,
    *,
    motion: Motion | None = None,
    device: Device | None = None,
) -> ImageGradient:
    """Value of a criterion of the back-projected volume, and its derivatives, in two passes.

    They are those of the back-projection as it is computed: bilinear images that fade to zero
    within one pixel, and 1 / w^2. Filtered images and their weights (cosine, redundancy, share of
    the arc) stay. The chain rule leads on: for P(i, theta) it is the sum of ``by_matrices`` times
    dP(i)/dtheta, for a rigid M(i, theta) that of ``by_motion`` times dM(i)/dtheta or of
    ``by_twists()`` times the twists, for bones, control points or an articulated leg that of
    ``by_displacements`` times the changes of the nodes of ``motion.on_grid(nodes)``. Moving least
    squares of points themselves are not differentiated.

    Args:
        scan: projections, which are filtered with FDK's default options for ``motion``; or what
            :func:`filtered_scan` made of them, once for many gradients.
        grid: of the volume that the criterion sees, m in world: a box is enough.
        criterion: from a volume (z, y, x) in 1/m to (E, dE/dV), such as
            :class:`legsim.evaluation.image_criteria.GradientEntropy`.
        motion: None (at rest), rigid, or displacements on a coarse grid.
        device: None opens the fastest one.

    Raises:
        LegsimError: a motion of other views, of points (take its on_grid), or slopes of another
            shape than the volume's.

    Example:
        >>> geometry = ConeBeamGeometry.circular(
        ...     times=np.arange(60) / 30,
        ...     angles=np.radians(np.linspace(0, 354, 60)),
        ...     source_isocenter=0.78,
        ...     source_detector=1.198,
        ...     shape_vu=(16, 32),
        ...     pixel_pitch=4e-3,
        ... )
        >>> v, u = np.mgrid[:16, :32]
        >>> blob = np.exp(-((u - 15.5) ** 2 + (v - 7.5) ** 2) / 20)
        >>> projections = Projections(geometry, np.tile(blob, (60, 1, 1)))
        >>> grid = VolumeGrid.cubic(12, 3e-3, (0.0, 0.0, 0.0))
        >>> found = image_gradient(projections, grid, lambda v: (float((v**2).sum()), 2 * v))
        >>> found.by_matrices.shape, found.by_twists().shape
        ((60, 3, 4), (60, 6))
        >>> shifted = np.array([[1.0], [0], [0]]) * geometry.matrices[:, 2:]  # dP by a shift in u
        >>> per_pixel = (found.by_matrices * shifted).sum()
    """
    if not isinstance(scan, FilteredScan):
        scan = filtered_scan(scan, grid, motion=motion, device=device)
    value, slopes = criterion(scan.volume(grid, motion).attenuation)
    return replace(scan.gradient(grid, slopes, motion), value=float(value))
