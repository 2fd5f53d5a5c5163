"""What back-projection will do and what memory it takes, decided before anything is allocated."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.memory import in_words
from legsim.core.values import FloatArray
from legsim.deformation.models import FieldMotion, Motion
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import Device
from legsim.reconstruction.corrected_scan import check_views

Kernel = Literal["columns", "voxels", "textures"]
"""of the back-projection: "voxels" is the plain reference, "columns" the fast one for CPUs,
"textures" is "voxels" with images read by texture units"""

LEAD, TRAIL, PAD, SPACING = 24, 40, 8, 8
"""rows of zeros below and above a detector column, columns of zeros beside the detector, voxels
worked on at once (backproject.cl)
"""

_MOST_ROWS_PER_VOXEL, _MOST_SLOPE = 2.5, 0.5

# pixels by which a line may leave the chords of eight voxels: at the grid's corners, edges, faces
# and middle, along a field anywhere
_MOST_BEND = 0.25

# pixels by which a line may leave a detector column where it is taken for one
_STRAIGHT = 1e-4

_SLAB_BYTES = 1 << 28

_NODE_BYTES = 1 << 26

_VIEWS_AT_ONCE = 32


@dataclass(frozen=True, slots=True)
class BackprojectionPlan:
    """How a volume will be computed and what it takes, decided before anything is allocated."""

    kernel: Kernel
    column_axis: int
    """world axis (0 x, 1 y, 2 z) that columns of voxels run along"""
    curve: int
    """what a column projects to: 0 a detector column, 1 a straight line, 2 a curve"""
    mirrored: tuple[bool, ...] = field(repr=False)
    """views whose rows run against the column axis"""
    slab: int
    """slices along z that are computed together"""
    batch: int
    """views that are back-projected together"""
    image_bytes: int
    """device memory for all filtered views"""
    slab_bytes: int
    """device memory for a slab, twice, and for what places its voxels"""

    @property
    def device_bytes(self) -> int:
        """Device memory in all (on a CPU that is host memory)."""
        return self.image_bytes + self.slab_bytes


def plan(
    geometry: ConeBeamGeometry,
    grid: VolumeGrid,
    device: Device,
    *,
    motion: Motion | None = None,
    kernel: Kernel | None = None,
    slab_bytes: int = _SLAB_BYTES,
) -> BackprojectionPlan:
    """Chooses kernel, column axis, slabs and batches; ``kernel`` None takes the fastest possible.

    That is "columns" on CPUs, "textures" on devices that use them, "voxels" on others.

    "columns" needs every voxel in front of the source, at most 2.5 detector rows between
    neighboring voxels along one of the world's axes, and lines along it that turn less than 27
    degrees off the detector's columns in every view. What it interpolates between every eighth
    voxel must be within a quarter of a pixel of the voxels.

    Raises:
        LegsimError: ``kernel`` "columns" was asked for where it does not work, the motion has
            another number of views, or the device's memory does not hold the views.
    """
    check_views(geometry, motion)
    axis, mirrored, curve = _column_axis(geometry, grid, motion)
    if kernel == "columns" and curve is None:
        raise LegsimError(
            "the column kernel does not work for this geometry and grid; leave the choice of the "
            "kernel open, or take 'voxels'"
        )
    rows, columns = geometry.shape_vu
    view_bytes = 4 * (columns + 2 * PAD) * stride(rows)
    if kernel == "textures" and (why := _no_textures(device, rows, columns)):
        raise LegsimError(
            f"the kernel 'textures' does not work on {device.label}: {why}; leave the choice of "
            "the kernel open, or take 'voxels'"
        )
    chosen = kernel or _fastest(device, rows, columns, in_columns=curve is not None)
    nz, ny, nx = grid.shape_zyx
    per_slice = 4 * (ny + SPACING) * (nx + SPACING)
    slab = int(np.clip(slab_bytes // per_slice, 1, nz))
    node_bytes = 12 * (slab // SPACING + 2) * (ny // SPACING + 2) * (nx // SPACING + 2)
    batch = int(np.clip(_NODE_BYTES // node_bytes, 1, _VIEWS_AT_ONCE))
    if chosen == "textures":
        batch = min(batch, device.image_limits.layers, device.image_limits.bytes // view_bytes)
    if curve is None:
        curve = 1 if _straight(motion) else 2
    found = BackprojectionPlan(
        chosen,
        axis,
        curve,
        mirrored,
        slab,
        batch,
        len(geometry) * view_bytes,
        2 * slab * per_slice + batch * node_bytes,
    )
    if found.device_bytes > device.candidate.memory_bytes:
        raise LegsimError(
            f"{len(geometry)} views of {columns} x {rows} pixels and a slab need "
            f"{in_words(found.device_bytes)}, "
            f"but {device.label} has {in_words(device.candidate.memory_bytes)}; take fewer "
            "views or bin the pixels"
        )
    return found


def _fastest(device: Device, rows: int, columns: int, *, in_columns: bool) -> Kernel:
    if device.uses_textures and not _no_textures(device, rows, columns):
        return "textures"
    return "columns" if in_columns and device.is_cpu else "voxels"


def _no_textures(device: Device, rows: int, columns: int) -> str:
    """Why images of that size cannot be read by texture units, empty where they can."""
    if device.texture_fault:
        return device.texture_fault
    limits, width, height = device.image_limits, stride(rows), columns + 2 * PAD
    if width > limits.width or height > limits.height:
        return (
            f"views of {columns} x {rows} pixels take images of {width} x {height} with their "
            f"borders, and its largest are {limits.width} x {limits.height}"
        )
    if 4 * width * height > limits.bytes:
        return (
            f"a view takes {in_words(4 * width * height)}, and it allows {in_words(limits.bytes)}"
        )
    return ""


def _straight(motion: Motion | None) -> bool:
    return motion is None or motion.straight


def stride(rows: int) -> int:
    """Elements between the columns of an image of that many rows as the kernels read it."""
    return LEAD + -(-(rows + 1) // 8) * 8


def _column_axis(
    geometry: ConeBeamGeometry, grid: VolumeGrid, motion: Motion | None
) -> tuple[int, tuple[bool, ...], int | None]:
    """(axis, mirrored views, curve) of a lattice of projected points; curve None: no axis fits."""
    lattice = np.stack(
        np.meshgrid(*(axis[np.unique([0, len(axis) // 2, len(axis) - 1])] for axis in grid.axes())),
        -1,
    ).reshape(-1, 3)

    def seen(offset: FloatArray) -> tuple[FloatArray, FloatArray]:
        points = lattice + offset
        with np.errstate(
            divide="ignore", invalid="ignore"
        ):  # points beside the source; their depths show it
            return geometry.project(points if motion is None else motion.carry(points))

    def seen_at_rest(offset: FloatArray) -> tuple[FloatArray, FloatArray]:
        return geometry.project(lattice + offset)

    steps = np.diag(grid.spacing_xyz)
    at, depths = seen(np.zeros(3))
    if (
        min(
            depths.min(),
            *(seen(side * SPACING * np.array(grid.spacing_xyz))[1].min() for side in (-1, 1)),
        )
        <= 0
    ):
        return 1, (False,) * len(geometry), None
    axis, slope, change, further = 1, np.inf, np.zeros_like(at), depths
    for candidate in (1, 0, 2):
        beyond, depths_beyond = seen(steps[candidate])
        rows = (beyond - at)[..., 1] * np.sign(np.median((beyond - at)[..., 1], axis=1))[:, None]
        steepest = float(np.abs((beyond - at)[..., 0]).max() / max(rows.min(), 1e-12))
        if steepest < 0.5 * slope:
            axis, slope, change, further = candidate, steepest, beyond - at, depths_beyond
    mirrored = tuple(bool(m) for m in np.median(change[..., 1], axis=1) < 0)
    if slope >= _MOST_SLOPE or np.abs(change[..., 1]).max() > _MOST_ROWS_PER_VOXEL:
        return axis, mirrored, None
    bend = _bend(seen, steps, axis)
    if isinstance(motion, FieldMotion):
        bend = max(bend, _bend(seen_at_rest, steps, axis) + _field_bend(geometry, grid, motion))
    if not bend < _MOST_BEND:
        return axis, mirrored, None
    if not _straight(motion):
        return axis, mirrored, 2
    count = grid.shape_zyx[2 - axis]
    straight = (
        np.abs(change[..., 0]).max() * count < _STRAIGHT
        and np.abs(further / depths - 1).max() * count * max(geometry.shape_vu) < _STRAIGHT
    )
    return axis, mirrored, 0 if straight else 1


def _bend(
    seen: Callable[[FloatArray], tuple[FloatArray, FloatArray]], steps: FloatArray, axis: int
) -> float:
    """Pixels between points of a lattice and the chords of eight voxels that they halve.

    ``seen`` gives pixels and depths of the lattice moved by an offset (3,).
    """
    at, depths = seen(np.zeros(3))
    bend = 0.0
    for k in range(3):
        (ahead, depths_ahead), (back, depths_back) = (
            seen(0.5 * SPACING * steps[k]),
            seen(-0.5 * SPACING * steps[k]),
        )
        # along columns the kernel goes straight from pixel to pixel, across them from homogeneous
        # pixel to homogeneous pixel
        share = (
            np.full_like(depths, 0.5) if k == axis else depths_ahead / (depths_ahead + depths_back)
        )
        bend = max(
            bend, float(np.abs(share[..., None] * ahead + (1 - share[..., None]) * back - at).max())
        )
    return bend


def _field_bend(geometry: ConeBeamGeometry, grid: VolumeGrid, motion: FieldMotion) -> float:
    """Pixels by which displacements leave the chords of eight voxels, at most, in any view.

    A field is linear between nodes that are s apart, with kinks of second differences d there. A
    chord of length h leaves it by at most d h / 4 s where h <= s, for then it holds one kink, and
    by d (h^2 + s^2) / 8 s^2 where it holds several. What the three axes leave out adds up.
    """
    off = np.zeros(len(geometry))
    places = motion.grid.axes()[::-1]
    ends = [(axis[0], axis[-1]) for axis in grid.axes()[::-1]]
    about = [_with_neighbors(p, *end) for p, end in zip(places, ends, strict=True)]
    for k in range(3):
        ratio = SPACING * grid.spacing_xyz[2 - k] / motion.grid.spacing_xyz[2 - k]
        share = ratio / 4 if ratio <= 1 else (ratio**2 + 1) / 8
        first, last = (
            np.searchsorted(places[k], ends[k][0], "right"),
            np.searchsorted(places[k], ends[k][1]),
        )
        nodes = [slice(int(first), int(last)) if j == k else about[j] for j in range(3)]
        off += share * _largest_kinks(motion, k, nodes)
    corners = np.stack(np.meshgrid(*(axis[[0, -1]] for axis in grid.axes())), -1).reshape(-1, 3)
    pixels, depths = geometry.project(corners)
    rows = (
        geometry.matrices[:, None, :2, :3] - pixels[..., None] * geometry.matrices[:, None, 2:, :3]
    )
    per_meter = np.linalg.norm(rows, axis=-1).max(-1) / depths
    return float((off * per_meter.max(1)).max())


def _with_neighbors(places: FloatArray, low: float, high: float) -> slice:
    """Nodes at ``places`` that decide values between two ends."""
    first = int(np.searchsorted(places, low, "right")) - 1
    return slice(max(first, 0), max(int(np.searchsorted(places, high, "left")), 0) + 1)


def _largest_kinks(motion: FieldMotion, k: int, nodes: list[slice]) -> FloatArray:
    """(v,) m: largest second difference of displacements along axis k of (z, y, x), at ``nodes``.

    Beyond its border a field is constant.
    """
    count = motion.grid.shape_zyx[k]
    along = np.clip(np.arange(nodes[k].start - 1, nodes[k].stop + 1), 0, count - 1)
    kept = (along, *(nodes[j] for j in range(3) if j != k))
    largest = np.zeros(len(motion.times))
    for view, displaced in enumerate(np.moveaxis(motion.displacements, k + 1, 1)):
        near = displaced[kept]
        kinks = near[2:] + near[:-2]
        kinks -= 2 * near[1:-1]
        largest[view] = np.sqrt(np.einsum("...k,...k", kinks, kinks).max(initial=0.0))
    return largest
