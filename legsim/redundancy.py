"""How often a scan measures each ray, and what share of the angle each view stands for.

Everything here is told by the sources, which run nearly on a circle. Where the scanned object moved, they are to be given as seen from it.
"""

import warnings
from dataclasses import dataclass

import numpy as np

from legsim.arrays import FloatArray, frozen
from legsim.errors import LegsimError
from legsim.geometry import ConeBeamGeometry

_GAP, _GAP_STEPS = np.radians(5.0), 4.0
"""rad, and steps between views: a wider gap is no coarse or uneven scan but a missing part of one"""


class ShortScanWarning(UserWarning):
    """The views span less than half a turn plus the fan, or leave a part of it out: some rays are not measured at all."""


@dataclass(frozen=True, slots=True, eq=False)
class SourceArc:
    """The circle that fits the sources best, and where on it they stand, whatever the order of the views."""

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
    """the views close a full turn: every ray is measured twice"""

    def __post_init__(self) -> None:
        for name in ("center", "axis", "angles", "increments", "radii"):
            values = np.asarray(getattr(self, name), float)
            object.__setattr__(self, name, frozen(f"SourceArc.{name}", values, values.shape))

    @property
    def coverage(self) -> float:
        """rad that all views stand for together: the span and half a step beyond either end."""
        return float(self.increments.sum())


def source_arc(geometry: ConeBeamGeometry) -> SourceArc:
    """Fits axis and circle to the source positions and measures the angles along it.

    Raises:
        LegsimError: fewer than three views, or sources on a straight line: there is no axis.
    """
    sources = geometry.sources()
    center, axis, first, second = _fitted_circle(sources)
    offsets = sources - center
    along_first, along_second = offsets @ first, offsets @ second
    turn = 2 * np.pi
    absolute = np.mod(np.arctan2(along_second, along_first), turn)
    order = np.argsort(absolute, kind="stable")
    gaps = np.diff(absolute[order], append=absolute[order[0]] + turn)
    widest = int(np.argmax(gaps))
    others = np.delete(gaps, widest)
    full_turn = bool(gaps[widest] <= 1.5 * max(np.median(others), others.max()))
    steps = np.roll(gaps, -widest - 1)[:-1]
    apart = steps[steps > 1e-6 * steps.sum()]  # of views from one place the end's half step is that to the next place
    ends = (gaps[widest], gaps[widest]) if full_turn else (apart[0], apart[-1])
    before, after = np.concatenate([[ends[0]], steps]), np.concatenate([steps, [ends[1]]])
    increments, angles = np.empty_like(absolute), np.empty_like(absolute)
    sequence = np.roll(order, -widest - 1)
    increments[sequence] = 0.5 * (before + after)
    angles[sequence] = 0.5 * ends[0] + np.concatenate([[0.0], np.cumsum(steps)])
    return SourceArc(center, axis, angles, increments, np.hypot(along_first, along_second), float(steps.sum()), full_turn)


def _fitted_circle(sources: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(center, axis, first, second): Kasa's algebraic circle in the plane of least squares; first x second = axis."""
    middle = sources.mean(0)
    _, sizes, directions = np.linalg.svd(sources - middle, full_matrices=True)
    if len(sources) < 3 or sizes[1] <= 1e-6 * sizes[0]:
        raise LegsimError(
            f"the geometry's {len(sources)} source positions lie on one line, so there is no axis of rotation; "
            "filtered back-projection needs at least three views along an arc"
        )
    first, second = directions[0], directions[1]
    x, y = (sources - middle) @ first, (sources - middle) @ second
    solution = np.linalg.lstsq(np.stack([2 * x, 2 * y, np.ones_like(x)], -1), x**2 + y**2, rcond=None)[0]
    return middle + solution[0] * first + solution[1] * second, np.cross(first, second), first, second


def fan_angles(geometry: ConeBeamGeometry, arc: SourceArc, columns: FloatArray) -> FloatArray:
    """(v, n) rad: angle about the axis between the line from source to axis and the ray through each column (n,), in the middle row."""
    rays = geometry.ray_directions(columns, np.full(len(columns), (geometry.shape_vu[0] - 1) / 2))
    outward = geometry.sources() - arc.center
    outward -= (outward @ arc.axis)[:, None] * arc.axis
    inward = -outward / np.linalg.norm(outward, axis=-1, keepdims=True)
    sideways = np.cross(arc.axis, inward)
    return np.arctan2(np.einsum("vnj,vj->vn", rays, sideways), np.einsum("vnj,vj->vn", rays, inward))


def redundancy_weights(arc: SourceArc, fans: FloatArray, edges: FloatArray | None = None) -> FloatArray:
    """Shares (v, n) for rays at fan angles (v, n): the shares of all measurements of one line add up to 1.

    A line seen from angle b under fan angle g is seen again from b + pi + 2 g. The share is sin^2(pi/2 x) with x = d / (d + d'), where
    d and d' are the distances of the two views from the nearer end of the covered range, 0 where the second view is outside it. In
    a short scan this is Parker's weight with Silver's virtual fan (Parker 1982; Silver 2000), in an overscan it stays continuous, and below
    the minimum the lines that are measured once get 1. In a full turn it is 1/2, unless ``edges`` (v, 2), the fan angles at the outer
    edges of a detector that stands to one side, are given: see :func:`_one_sided`.
    """
    if arc.full_turn:
        return np.full(fans.shape, 0.5) if edges is None else _one_sided(fans, edges)
    angles = np.broadcast_to(arc.angles[:, None], fans.shape)
    opposite = np.mod(angles + np.pi + 2 * fans, 2 * np.pi)
    own = np.minimum(angles, arc.coverage - angles)
    other = np.maximum(np.minimum(opposite, arc.coverage - opposite), 0.0)
    return np.sin(0.5 * np.pi * own / (own + other)) ** 2


def _one_sided(fans: FloatArray, edges: FloatArray) -> FloatArray:
    """Shares in a full turn of which one side of the fan is cut short (Wang, Med Phys 29, 2002): 0 there, 1 on the other.

    Fan angle g is seen again at -g, and (1 + sin(pi/2 g / t)) / 2 for g from -t to t, t being the short side of all views, adds up to 1.
    """
    widest = edges.max() > -edges.min()
    short = -edges.min(1).max() if widest else edges.max(1).min()
    towards_long = fans if widest else -fans
    return 0.5 + 0.5 * np.sin(0.5 * np.pi * np.clip(towards_long / max(short, 1e-6), -1.0, 1.0))


def warn_if_incomplete(arc: SourceArc, fans: FloatArray) -> None:
    """Warns (:class:`ShortScanWarning`) with the numbers where the span is below half a turn plus the fan (v, n), or views are missing."""
    fan = 2 * float(np.abs(fans).max())
    if not arc.full_turn and arc.span < np.pi + fan:
        warnings.warn(
            f"short scan: the sources span {np.degrees(arc.span):.1f} deg ({np.degrees(arc.coverage):.1f} deg with half a step at "
            f"either end), but a complete one needs {180 + np.degrees(fan):.1f} deg (180 + fan of {np.degrees(fan):.1f}); "
            "lines that were not measured are missing from the volume",
            ShortScanWarning,
            stacklevel=3,
        )
    steps = np.diff(np.sort(arc.angles))
    widest = float(steps.max())
    if widest > max(_GAP_STEPS * float(np.median(steps)), _GAP):
        warnings.warn(
            f"the sources leave {np.degrees(widest):.1f} deg out between two views, the step is {np.degrees(np.median(steps)):.2f} deg; "
            "lines that were not measured there are taken from the views at either end",
            ShortScanWarning,
            stacklevel=3,
        )
