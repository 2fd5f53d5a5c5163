"""The path of the source as the object saw it: axis, angles, arc and fan angles."""

from dataclasses import dataclass

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen
from legsim.geometry.cone_beam import ConeBeamGeometry

MOST_LEFT_OUT, MOST_LEFT_OUT_ONE_SIDED = np.radians(5.0), np.radians(20.0)
"""rad: a turn that leaves out no more than this beyond a usual step is a full one

The second is for a detector to one side of the axis, whose outer lines are measured once: only the
views beside a gap can stand for them. A detector in front of the axis sees all lines of a wider gap
from the opposite side, and the weights of an overscan take them from there.
"""


_STRAIGHT = 1e-3
"""extent of sources across a line over that along it, below which they have no circle: an arc of
half a degree, or the errors of a calibration
"""

_MOST_ALONG = 0.5
"""of the circle's radius: sources farther along its axis from their middle are no circle"""


@dataclass(frozen=True, slots=True, eq=False)
class SourceArc:
    """The circle that fits the sources best, and where on it each view's source stands."""

    center: FloatArray
    """(3,) m, center of the circle"""
    axis: FloatArray
    """(3,) unit vector; angles grow anticlockwise about it"""
    angles: FloatArray
    """(v,) rad, position inside the covered range: 0 is half a step before the first view"""
    increments: FloatArray
    """(v,) rad, the angle each view stands for"""
    radii: FloatArray
    """(v,) m, distance of each source from the axis"""
    span: float
    """rad between the first and the last view along the arc"""
    full_turn: bool
    """the views close a full turn, but for small gaps: every ray is measured twice"""

    def __post_init__(self) -> None:
        for name in ("center", "axis", "angles", "increments", "radii"):
            values = np.asarray(getattr(self, name), float)
            object.__setattr__(self, name, frozen(f"SourceArc.{name}", values, values.shape))

    def inward(self, geometry: ConeBeamGeometry) -> FloatArray:
        """(v, 3) unit vectors from each source straight to the axis."""
        outward = geometry.sources() - self.center
        outward -= (outward @ self.axis)[:, None] * self.axis
        return -outward / np.linalg.norm(outward, axis=-1, keepdims=True)

    @property
    def coverage(self) -> float:
        """rad that all views stand for together: the span and half a step beyond either end."""
        return float(self.increments.sum())


def source_arc(geometry: ConeBeamGeometry, *, one_sided: bool = False) -> SourceArc:
    """Fits axis and circle to the source positions and measures the angles along it.

    ``one_sided``: the detector stands to one side of the axis (:data:`MOST_LEFT_OUT_ONE_SIDED`).

    Raises:
        LegsimError: fewer than three views, or sources on a straight line: there is no axis; or
            sources far off the plane of a circle.
    """
    sources = geometry.sources()
    center, axis, first, second = _fitted_circle(sources)
    offsets = sources - center
    radius, heights = np.linalg.norm(offsets, axis=-1).mean(), np.abs(offsets @ axis)
    if heights.max() > _MOST_ALONG * radius:
        raise LegsimError(
            f"view {int(heights.argmax())}: its source is {1e3 * heights.max():.0f} mm off the "
            "plane of the circle that fits the sources (a helix?); filtered back-projection is for "
            "circles; reconstruct by cgls, which takes any path"
        )
    along_first, along_second = offsets @ first, offsets @ second
    turn = 2 * np.pi
    absolute = np.mod(np.arctan2(along_second, along_first), turn)
    order = np.argsort(absolute, kind="stable")
    gaps = np.diff(absolute[order], append=absolute[order[0]] + turn)
    widest = int(np.argmax(gaps))
    others = np.delete(gaps, widest)
    left_out = gaps[widest] - np.median(others)
    most = MOST_LEFT_OUT_ONE_SIDED if one_sided else MOST_LEFT_OUT
    full_turn = bool(gaps[widest] <= 1.5 * others.max() or left_out <= most + 1e-6)
    steps = np.roll(gaps, -widest - 1)[:-1]
    apart = steps[
        steps > 1e-6 * steps.sum()
    ]  # of views from one place the end's half step is that to the next place
    ends = (gaps[widest], gaps[widest]) if full_turn else (apart[0], apart[-1])
    before, after = np.concatenate([[ends[0]], steps]), np.concatenate([steps, [ends[1]]])
    increments, angles = np.empty_like(absolute), np.empty_like(absolute)
    sequence = np.roll(order, -widest - 1)
    increments[sequence] = 0.5 * (before + after)
    angles[sequence] = 0.5 * ends[0] + np.concatenate([[0.0], np.cumsum(steps)])
    return SourceArc(
        center,
        axis,
        angles,
        increments,
        np.hypot(along_first, along_second),
        float(steps.sum()),
        full_turn,
    )


def _fitted_circle(sources: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(center, axis, first, second): Kasa's algebraic circle; first x second = axis."""
    middle = sources.mean(0)
    _, sizes, directions = np.linalg.svd(sources - middle, full_matrices=True)
    if len(sources) < 3 or sizes[1] <= _STRAIGHT * sizes[0]:
        raise LegsimError(
            f"the geometry's {len(sources)} source positions lie on one line, so there is no axis "
            "of rotation; "
            "filtered back-projection needs at least three views along an arc; cgls takes any"
        )
    first, second = directions[0], directions[1]
    x, y = (sources - middle) @ first, (sources - middle) @ second
    solution = np.linalg.lstsq(
        np.stack([2 * x, 2 * y, np.ones_like(x)], -1), x**2 + y**2, rcond=None
    )[0]
    return (
        middle + solution[0] * first + solution[1] * second,
        np.cross(first, second),
        first,
        second,
    )


def fan_angles(geometry: ConeBeamGeometry, arc: SourceArc, columns: FloatArray) -> FloatArray:
    """(v, n) rad about the axis from the line source-axis to the ray of each column (n,).

    Rays are those of the middle row.
    """
    rays = geometry.ray_directions(columns, np.full(len(columns), (geometry.shape_vu[0] - 1) / 2))
    inward = arc.inward(geometry)
    sideways = np.cross(arc.axis, inward)
    return np.arctan2(
        np.einsum("vnj,vj->vn", rays, sideways), np.einsum("vnj,vj->vn", rays, inward)
    )
