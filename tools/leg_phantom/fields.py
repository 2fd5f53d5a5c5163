"""Implicit surfaces for building the leg: functions of x, y, z (m) that are negative inside, near a
distance in m, and their meshes.

Arrays of coordinates broadcast: grids are passed as three sparse axes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator, RegularGridInterpolator
from scipy.spatial import KDTree
from skimage import measure

Array = NDArray[np.float64]
Field = Callable[[Array, Array, Array], Array]


def smooth_union(a: Array, b: Array, width: float) -> Array:
    """Union with a fillet of about ``width`` (polynomial smooth minimum, Quilez)."""
    h = np.clip(0.5 + 0.5 * (b - a) / width, 0, 1)
    return b + (a - b) * h - width * h * (1 - h)


def smooth_intersection(a: Array, b: Array, width: float) -> Array:
    """Intersection with an edge rounded by about ``width``."""
    return -smooth_union(-a, -b, width)


def ellipsoid(center: Sequence[float], radii: Sequence[float]) -> Field:
    """Ellipsoid along the axes; first-order distance, exact on the surface."""

    def field(x: Array, y: Array, z: Array) -> Array:
        q = [(p - c) / r for p, c, r in zip((x, y, z), center, radii, strict=True)]
        norm = np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2)
        slope = np.sqrt(sum((a / r) ** 2 for a, r in zip(q, radii, strict=True)))
        return np.asarray(norm * (norm - 1) / np.maximum(slope, 1e-9))

    return field


def cone(
    start: Sequence[float], end: Sequence[float], start_radius: float, end_radius: float
) -> Field:
    """Round-ended cone from ``start`` to ``end``."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    axis = b - a

    def field(x: Array, y: Array, z: Array) -> Array:
        t = np.clip(
            ((x - a[0]) * axis[0] + (y - a[1]) * axis[1] + (z - a[2]) * axis[2]) / (axis @ axis),
            0,
            1,
        )
        distance = np.sqrt(
            (x - a[0] - t * axis[0]) ** 2
            + (y - a[1] - t * axis[1]) ** 2
            + (z - a[2] - t * axis[2]) ** 2
        )
        return np.asarray(distance - (start_radius + t * (end_radius - start_radius)))

    return field


def loft(rows: Sequence[Sequence[float]], *, apex_angle: float = 0.0) -> Field:
    """Tube along y through elliptical sections; rows are (y, center x, center z, radius x, radius
    z[, three-sidedness]).

    ``apex_angle`` (rad, from +x towards +z) turns the edge of three-sided sections. The ends are
    flat with rounded rims.
    """
    table = np.array([[*row, 0.0][:6] for row in rows])
    table = table[np.argsort(table[:, 0])]
    section = PchipInterpolator(table[:, 0], table[:, 1:], axis=0)
    low, high = table[0, 0], table[-1, 0]

    def field(x: Array, y: Array, z: Array) -> Array:
        cx, cz, rx, rz, edge = np.moveaxis(section(np.clip(y, low, high)), -1, 0)
        u, v = (x - cx) / rx, (z - cz) / rz
        norm = np.sqrt(u**2 + v**2) + 1e-12
        slope = np.sqrt((u / rx) ** 2 + (v / rz) ** 2) / norm
        limit = (
            1 + edge * np.cos(3 * (np.arctan2(v, u) - apex_angle)) if np.any(table[:, 5]) else 1.0
        )
        side = (norm - limit) / np.maximum(slope, 1e-3)
        rim = 0.25 * np.minimum(table[0, 3:5].min(), table[-1, 3:5].min())
        return smooth_intersection(
            np.asarray(side), np.asarray(np.maximum(low - y, y - high) + 0 * side), rim
        )

    return field


@dataclass(frozen=True)
class Outline:
    """Closed curve in a plane, as a signed distance (negative inside) that is tabulated once."""

    table: RegularGridInterpolator

    @classmethod
    def through(
        cls,
        points: Sequence[Sequence[float]] | Array,
        *,
        step: float = 0.0004,
        margin: float = 0.05,
    ) -> "Outline":
        """Smooth closed curve through ``points`` (n, 2), listed anticlockwise or clockwise."""
        knots = np.vstack([np.asarray(points, float), np.asarray(points, float)[:1]])
        chord = np.concatenate(
            [[0], np.cumsum(np.sqrt(np.linalg.norm(np.diff(knots, axis=0), axis=1)))]
        )
        curve = np.asarray(
            CubicSpline(chord, knots, bc_type="periodic")(np.linspace(0, chord[-1], 3000)[:-1])
        )
        axes = [
            np.arange(lo - margin, hi + margin, 2 * step)
            for lo, hi in zip(curve.min(0), curve.max(0), strict=True)
        ]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
        distance = np.reshape(KDTree(curve).query(grid.reshape(-1, 2))[0], grid.shape[:2])
        inside = measure.points_in_poly(grid.reshape(-1, 2), curve).reshape(grid.shape[:2])
        return cls(
            RegularGridInterpolator(
                axes, np.where(inside, -distance, distance), bounds_error=False, fill_value=margin
            )
        )

    def __call__(self, a: Array, b: Array) -> Array:
        """Distance at plane coordinates ``a``, ``b``."""
        a, b = np.broadcast_arrays(a, b)
        return self.table(np.stack([a, b], -1))


def rounded_slab(profile: Array, across: Array, radius: float | Array) -> Array:
    """A profile extruded between two planes (``across`` is the distance to them) with edges of
    ``radius``.
    """
    a, b = profile + radius, across + radius
    return (
        np.sqrt(np.maximum(a, 0) ** 2 + np.maximum(b, 0) ** 2)
        + np.minimum(np.maximum(a, b), 0)
        - radius
    )


def normalized(values: Array, axes: Sequence[Array]) -> Array:
    """``values`` divided by their slope: offsets of the result are true thicknesses to first
    order.
    """
    slope = np.sqrt(sum(g**2 for g in np.gradient(values, *axes)))
    return values / np.clip(slope, 0.3, 3.0)


def graded_axis(
    low: float, high: float, fine: Sequence[tuple[float, float]], step: float, coarse_step: float
) -> Array:
    """Grid positions from ``low`` to ``high``: spacing ``step`` within the ``fine`` ranges, growing
    smoothly to ``coarse_step``.
    """
    points = [low]
    while points[-1] < high:
        distance = (
            min(max(lo - points[-1], points[-1] - hi, 0.0) for lo, hi in fine) if fine else 1.0
        )
        points.append(points[-1] + min(coarse_step, step + 0.25 * distance))
    return np.array(points)


def mesh_of(values: Array, axes: Sequence[Array], name: str) -> trimesh.Trimesh:
    """The surface values = 0 on a rectilinear grid, closed and outward; only the largest piece is
    kept.

    Raises:
        ValueError: the surface touches the border of the grid or is empty.
    """
    border = min(
        values[0].min(),
        values[-1].min(),
        values[:, 0].min(),
        values[:, -1].min(),
        values[..., 0].min(),
        values[..., -1].min(),
    )
    if border <= 0 or values.min() >= 0:
        raise ValueError(
            f"{name}: the grid cuts the surface (border {border:.4g}) or misses it (lowest "
            f"{values.min():.4g})"
        )
    vertices, faces, _, _ = measure.marching_cubes(
        values.astype(np.float32), 1e-9, allow_degenerate=False
    )
    positions = np.stack(
        [np.interp(vertices[:, k], np.arange(len(axis)), axis) for k, axis in enumerate(axes)], -1
    )
    return largest_piece(trimesh.Trimesh(positions, faces, process=False), name)


def largest_piece(mesh: trimesh.Trimesh, name: str) -> trimesh.Trimesh:
    """Drops crumbs that a tapering sheet leaves; a hollow inside one body is dropped too.

    Raises:
        ValueError: more than crumbs would go: the grid is too coarse for a thin sheet.
    """
    label = trimesh.graph.connected_component_labels(
        mesh.face_adjacency, node_count=len(mesh.faces)
    )
    if label.max() == 0:
        return mesh
    counts = np.bincount(label)
    if counts.max() < 0.9 * counts.sum():
        raise ValueError(
            f"{name}: falls into {len(counts)} pieces, the largest with {counts.max()} of "
            f"{counts.sum()} triangles"
        )
    keep = np.asarray(mesh.faces)[label == np.argmax(counts)]
    used, renumbered = np.unique(keep, return_inverse=True)
    return trimesh.Trimesh(
        np.asarray(mesh.vertices)[used], renumbered.reshape(-1, 3), process=False
    )
