"""What a scan geometry sees: field of view, angular range, magnification, truncated parts."""

from dataclasses import dataclass

import numpy as np

from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.phantom.meshes import Phantom

_LEAST_OFFSET = 0.1
"""of the detector's width: views that are off to one side by more, in the median, make a half
fan
"""

_LEAST_DEPTH = 0.1
"""of the source's distance to the isocenter: what is nearer to its plane has no meaningful place in
an image
"""


@dataclass(frozen=True, slots=True)
class CutOff:
    """How far a part reaches beyond the detector."""

    name: str
    views: int
    """number of views in which it does"""
    left: float
    """largest reach in m, scaled to the isocenter, beyond the first column

    The others likewise.
    """
    right: float
    below: float
    above: float


@dataclass(frozen=True, slots=True)
class GeometrySummary:
    """Distances in m, angles in rad; ranges are (least, largest) over the views."""

    views: int
    shape_vu: tuple[int, int]
    pixel_pitch: float
    row_pitch: float
    duration: float
    """s from first to last view"""
    isocenter: tuple[float, float, float]
    """point nearest to all principal rays"""
    axis: tuple[float, float, float]
    """normal of the plane of the sources; the vertical where they span no plane"""
    angular_range: float
    """from first to last view: rotation of the source about the axis"""
    largest_step: float
    fan_angle: float
    """full opening angle across the columns"""
    source_isocenter: tuple[float, float]
    source_detector: tuple[float, float]
    magnification: tuple[float, float]
    width: float
    """of the detector, scaled to the isocenter"""
    height: float
    field_radius: float
    """radius of the largest ball about the isocenter that every view sees across the columns"""
    cut_off: tuple[CutOff, ...]
    far_side: float
    """m from the isocenter to the farther edge of a detector that stands to one side; else 0"""

    def lines(self) -> tuple[str, ...]:
        """Formats the summary for people: mm and degrees."""
        rows, columns = self.shape_vu
        center = ", ".join(f"{1e3 * x:.1f}" for x in self.isocenter)
        # a component that is rounding alone has no sign
        axis = ", ".join(f"{round(x, 3) + 0.0:.3f}" for x in self.axis)
        needed = np.pi + self.fan_angle
        enough = "complete" if self.angular_range + self.largest_step >= needed else "incomplete"
        lines = [
            f"views              {self.views} in {self.duration:.3f} s",
            f"detector           {columns} columns x {rows} rows, pixels of "
            f"{_pixel_mm(self.pixel_pitch, self.row_pitch)} mm",
            f"isocenter          ({center}) mm",
            f"axis               ({axis})",
            f"angular range      {np.rad2deg(self.angular_range):.2f} deg in steps up to "
            f"{np.rad2deg(self.largest_step):.2f} deg",
            f"short scan         {enough}: a fan of {np.rad2deg(self.fan_angle):.2f} deg needs "
            f"{np.rad2deg(needed):.2f} deg",
            f"source-isocenter   {_range_mm(self.source_isocenter)}",
            f"source-detector    {_range_mm(self.source_detector)}",
            f"magnification      {_span(self.magnification, '.4f')}",
            f"field of view      {1e3 * self.width:.1f} mm wide, {1e3 * self.height:.1f} mm high "
            "at the isocenter",
            f"seen by all views  within {1e3 * self.field_radius:.1f} mm of the axis",
        ]
        if self.far_side > 0:
            lines.append(
                f"half fan           the detector reaches {1e3 * self.field_radius:.1f} mm to one "
                f"side of the axis and {1e3 * self.far_side:.1f} mm to the other: a full turn sees "
                "all within the second, a shorter one within the first"
            )
        return (*lines, *(_cut_line(part, self.views) for part in self.cut_off))


def summarize(geometry: ConeBeamGeometry, phantom: Phantom | None = None) -> GeometrySummary:
    """Summarizes a geometry, and which parts of a phantom at rest some view cuts off."""
    center = geometry.rotation_center()
    sources = geometry.sources()
    axis, turned = _turning(sources - center)
    distances = geometry.matrices[:, 2, :3] @ center + geometry.matrices[:, 2, 3]
    focal = geometry.focal_lengths()
    detector, row_pitch = focal * geometry.pixel_pitch, geometry.row_pitch()
    rows, columns = geometry.shape_vu
    steps = np.abs(np.diff(turned))
    edges = _edge_distances(geometry, center)
    return GeometrySummary(
        views=len(geometry),
        shape_vu=geometry.shape_vu,
        pixel_pitch=geometry.pixel_pitch,
        row_pitch=row_pitch,
        duration=float(geometry.times[-1] - geometry.times[0]),
        isocenter=(float(center[0]), float(center[1]), float(center[2])),
        axis=(float(axis[0]), float(axis[1]), float(axis[2])),
        angular_range=float(np.ptp(turned)),
        largest_step=float(steps.max()) if len(steps) else 0.0,
        fan_angle=float(_fan_angle(geometry)),
        source_isocenter=(float(distances.min()), float(distances.max())),
        source_detector=(float(detector.min()), float(detector.max())),
        magnification=(float((detector / distances).min()), float((detector / distances).max())),
        width=float((columns * distances / focal).min()),
        height=float((rows * row_pitch * distances / detector).min()),
        field_radius=float(edges.min()),
        cut_off=() if phantom is None else _cut_off(geometry, phantom, distances / detector),
        far_side=_far_side(edges),
    )


def _pixel_mm(between_columns: float, between_rows: float) -> str:
    """One size where pixels are square to the digits that are shown, else both."""
    return " x ".join(dict.fromkeys(f"{1e3 * m:.4g}" for m in (between_columns, between_rows)))


def _range_mm(span: tuple[float, float]) -> str:
    return _span((1e3 * span[0], 1e3 * span[1]), ".1f") + " mm"


def _span(span: tuple[float, float], form: str) -> str:
    low, high = (format(x, form) for x in span)
    return low if low == high else f"{low} to {high}"


def _cut_line(part: CutOff, views: int) -> str:
    sides = {"left": part.left, "right": part.right, "below": part.below, "above": part.above}
    reach = ", ".join(
        f"{1e3 * length:.1f} mm {side}" for side, length in sides.items() if length > 0
    )
    return (
        f"cut off            part {part.name!r} in {part.views} of {views} views: {reach} (at "
        "the isocenter)"
    )


def _turning(arms: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation axis (3,) of the sources, upwards, and the angle (v,) since the first view.

    The angle is continuous; of views in no order (steps over a quarter turn) it is sorted, from
    the widest gap on.
    """
    _, sizes, directions = np.linalg.svd(arms)
    planar = len(arms) > 2 and sizes[1] > 1e-6 * sizes[0]
    axis = directions[2] if planar else np.array([0.0, 1.0, 0.0])
    axis = axis if axis[np.argmax(np.abs(axis))] > 0 else -axis
    first = arms[0] - axis * (axis @ arms[0])
    angles = np.arctan2(arms @ np.cross(axis, first), arms @ first)
    turned = np.unwrap(angles)
    if np.abs(np.diff(turned)).max(initial=0.0) <= np.pi / 2:
        return axis, turned
    ordered = np.sort(np.mod(angles, 2 * np.pi))
    widest = int(np.argmax(np.diff(ordered, append=ordered[0] + 2 * np.pi)))
    return axis, np.unwrap(np.roll(ordered, -widest - 1))


def _column_planes(geometry: ConeBeamGeometry, u: float) -> FloatArray:
    """Planes (v, 4) through the source and the column at u, unit normal towards larger u."""
    planes = geometry.matrices[:, 0] - u * geometry.matrices[:, 2]
    return planes / np.linalg.norm(planes[:, :3], axis=1, keepdims=True)


def _edge_distances(geometry: ConeBeamGeometry, center: FloatArray) -> FloatArray:
    """Distances (v, 2) from the center to the outer edges of the first and the last column.

    Negative outside.
    """
    point = np.append(center, 1.0)
    columns = geometry.shape_vu[1]
    return np.stack(
        [_column_planes(geometry, -0.5) @ point, -_column_planes(geometry, columns - 0.5) @ point],
        axis=1,
    )


def _far_side(edges: FloatArray) -> float:
    """Least distance to the farther edge (v, 2), where most views are off to one side; else 0."""
    longer = float(np.median((edges[:, 1] - edges[:, 0]) / edges.sum(axis=1)))
    return float(edges[:, int(longer > 0)].min()) if abs(longer) > _LEAST_OFFSET else 0.0


def _fan_angle(geometry: ConeBeamGeometry) -> float:
    """Angle between the planes of the outer column edges, the widest of all views."""
    first, last = (
        _column_planes(geometry, -0.5)[:, :3],
        _column_planes(geometry, geometry.shape_vu[1] - 0.5)[:, :3],
    )
    return np.arccos(np.clip(np.einsum("vi,vi->v", first, last), -1, 1)).max()


def _cut_off(geometry: ConeBeamGeometry, phantom: Phantom, scale: FloatArray) -> tuple[CutOff, ...]:
    """Parts that some view cuts off; ``scale`` (v,) is m at the isocenter per m on the detector.

    What lies behind the source, or beside it, is in no image.
    """
    rows, columns = geometry.shape_vu
    detector = geometry.focal_lengths() * geometry.pixel_pitch
    pitch = np.array([geometry.pixel_pitch] * 2 + [geometry.row_pitch()] * 2)
    found = []
    for part in phantom.parts:
        reach = np.full((len(geometry), 4), -np.inf)
        for view in range(len(geometry)):
            with np.errstate(divide="ignore", invalid="ignore"):  # in the plane of the source
                pixels, depths = geometry[view : view + 1].project(part.vertices)
            front = depths[0] > _LEAST_DEPTH * detector[view] * scale[view]
            if not front.any():
                continue
            low, high = pixels[0, front].min(axis=0), pixels[0, front].max(axis=0)
            reach[view] = (
                -0.5 - low[0],
                high[0] - columns + 0.5,
                -0.5 - low[1],
                high[1] - rows + 0.5,
            )
        beyond = np.maximum(reach, 0.0) * pitch * scale[:, None]
        views = int((beyond > 0).any(axis=1).sum())
        if views:
            found.append(CutOff(part.name, views, *(float(x) for x in beyond.max(axis=0))))
    return tuple(found)
