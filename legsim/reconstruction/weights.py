"""How often a scan measures each ray, and what share of the angle each view stands for.

Everything follows from the sources, which run nearly on a circle. Where the scanned object moved,
give them as seen from it.
"""

import warnings
from dataclasses import dataclass

import numpy as np

from legsim.core.values import Float32Array, FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.reconstruction.source_path import SourceArc

_LEAST_TURNING = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class RayWeights:
    """Weights of rays: cosine to the line source-axis, over how fast rays turn per pixel.

    With a ray d(u, v) = B (u, v, 1), B inverting the matrix's left part, w the direction from
    source to axis and e the one across w and the axis a, Feldkamp's formula filters x = (d . e) /
    (d . w) and back-projects with 1 / L^2, L being the depth along w. On any flat detector x is
    projective in u, for which the ramp of x is that of u times 1 / (dx/du): the two distances in
    its kernel are (u - u') sqrt(x'(u) x'(u')). Together with depth^2 = L^2 / (d . w)^2 of the
    kernels' weight that leaves 1 / (d . w)^2 (dx/du) = 1 / |a . (dB/du x d)|, which is the same in
    a whole row. It is the focal length in pixels where the detector faces the axis.
    """

    numerators: FloatArray
    """(v, 3): dot(ray (u, v, 1), direction to the axis)"""
    squares: FloatArray
    """(v, 3, 3): quadratic form of (u, v, 1) that gives the squared length of the ray"""
    row_factors: FloatArray
    """(v, rows): 1 / |a . (dB/du x d)|"""

    def alike(self, view: int, other: int) -> bool:
        """Whether two views have the same weights."""
        return all(
            np.allclose(a[view], a[other], rtol=1e-9, atol=1e-12)
            for a in (self.numerators, self.squares, self.row_factors)
        )

    def of(self, view: int, shape_vu: tuple[int, int], reach: int) -> Float32Array:
        """(rows, columns + 2 reach) of one view."""
        factors = self.row_factors[view].astype(np.float32)[:, None]
        return _ray_weights(shape_vu, reach, self.numerators[view], self.squares[view], factors)


def _ray_weights(
    shape_vu: tuple[int, int],
    reach: int,
    numerator: FloatArray,
    square: FloatArray,
    factors: Float32Array,
) -> Float32Array:
    u, v = (
        np.arange(-reach, shape_vu[1] + reach, dtype=np.float32),
        np.arange(shape_vu[0], dtype=np.float32)[:, None],
    )
    n, g = numerator.astype(np.float32), square.astype(np.float32)
    lengths = (2 * g[0, 1] * v) * u
    lengths += (g[0, 0] * u + 2 * g[0, 2]) * u
    lengths += (g[1, 1] * v + 2 * g[1, 2]) * v + g[2, 2]
    np.sqrt(lengths, out=lengths)
    weights = (n[0] * factors) * u
    weights += (n[1] * v + n[2]) * factors
    return np.divide(weights, lengths, out=lengths)


def _rays(geometry: ConeBeamGeometry, arc: SourceArc) -> RayWeights:
    back = np.linalg.inv(geometry.matrices[:, :, :3])
    per_row = np.cross(back[:, :, 0], back[:, :, 1]) @ arc.axis
    turning = np.abs(
        (np.cross(back[:, :, 0], back[:, :, 2]) @ arc.axis)[:, None]
        + per_row[:, None] * np.arange(geometry.shape_vu[0])
    )
    # a row whose rays run along the axis measures no line across it; it must not drown the others
    factors = 1 / np.maximum(turning, _LEAST_TURNING * np.median(turning))
    return RayWeights(
        np.einsum("vji,vj->vi", back, arc.inward(geometry)),
        np.einsum("vji,vjk->vik", back, back),
        factors,
    )


_GAP, _GAP_ONE_SIDED = (np.radians(5.0), 4.0), (np.radians(3.0), 1.9)
"""rad, and steps between views: a wider gap is no coarse or uneven scan but a missing part of
one

The second is for a turn whose outer lines are measured once.
"""


class ShortScanWarning(UserWarning):
    """Some rays are not measured at all: the views span too little, or leave a part out."""


def redundancy_weights(
    arc: SourceArc, fans: FloatArray, edges: FloatArray | None = None
) -> FloatArray:
    """Shares (v, n) of rays at fan angles (v, n); those of one line's measurements sum to 1.

    A line seen from angle b under fan angle g is seen again from b + pi + 2 g under -g. The share
    is sin^2(pi/2 x) with x = s d / (s d + s' d'). Here d and d' are the distances of the two views
    from the nearer end of the covered range, 0 where the second view is outside it; they are alike
    in a full turn. s and s' are alike too, unless ``edges`` (v, 2), the fan angles at the outer
    edges of a detector that stands to one side, are given: see :func:`_one_sided`.

    In a short scan this is Parker's weight with Silver's virtual fan (Parker 1982; Silver 2000), in
    an overscan it stays continuous, and lines that are measured once get 1. In a full turn it is
    1/2, or the weight of Wang (Med Phys 29, 2002) for a detector to one side.
    """
    own, other = (np.ones(fans.shape),) * 2 if arc.full_turn else _from_ends(arc, fans)
    side = 0.5 if edges is None else _one_sided(fans, edges)
    once = other == 0
    total = np.where(once, 1.0, side * own + (1 - side) * other)
    return np.sin(0.5 * np.pi * np.where(once, 1.0, side * own / total)) ** 2


def _from_ends(arc: SourceArc, fans: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rad (v, n) from a ray's view, and from the opposite one, to the nearer end of the range."""
    angles = np.broadcast_to(arc.angles[:, None], fans.shape)
    opposite = np.mod(angles + np.pi + 2 * fans, 2 * np.pi)
    own = np.minimum(angles, arc.coverage - angles)
    return own, np.maximum(np.minimum(opposite, arc.coverage - opposite), 0.0)


def _one_sided(fans: FloatArray, edges: FloatArray) -> FloatArray:
    """From 0 on the side of the fan that is cut short to 1 on the other, linear where both see.

    It is (1 + g / t) / 2 for fan angles g from -t to t, t being the short side of all views.
    """
    towards_long = fans if _long_side(edges) > 0 else -fans
    return 0.5 + 0.5 * np.clip(towards_long / max(short_side(edges), 1e-6), -1.0, 1.0)


def short_side(edges: FloatArray) -> float:
    """Rad from the axis to the nearer edge (v, 2) of a detector, the least of all views."""
    return float(-edges.min(1).max() if _long_side(edges) > 0 else edges.max(1).min())


def _long_side(edges: FloatArray) -> int:
    """1 or -1: the sign of fan angles on the longer side of edges (v, 2), in most views."""
    return 1 if np.median(edges.max(1)) > np.median(-edges.min(1)) else -1


def warn_if_incomplete(arc: SourceArc, edges: FloatArray, *, one_sided: bool = False) -> None:
    """Warns (:class:`ShortScanWarning`) of lines that a scan does not measure; with the numbers.

    ``edges`` (v, 2) are the fan angles at the outer edges of the detector. The span may be below
    half a turn plus the fan, views may be missing in between, or the detector may stand to one side
    of the axis in less than a full turn.
    """
    fan = 2 * (short_side(edges) if one_sided else float(np.abs(edges).max()))
    if not arc.full_turn and arc.span < np.pi + fan:
        _warn(
            f"short scan: the sources span {np.degrees(arc.span):.1f} deg "
            f"({np.degrees(arc.coverage):.1f} deg with half a step at "
            f"either end), but a complete one needs {180 + np.degrees(fan):.1f} deg (180 + fan of "
            f"{np.degrees(fan):.1f}); "
            "lines that were not measured are missing from the volume"
        )
    steps = np.diff(np.sort(arc.angles))
    # views from one place, such as those of a second turn, say nothing of the step
    apart = steps[steps > 1e-6 * arc.span]
    usual = float(np.median(apart))
    widest = float(max(steps.max(), 2 * np.pi - arc.span if arc.full_turn else 0.0))
    least, least_steps = _GAP_ONE_SIDED if one_sided and arc.full_turn else _GAP
    if widest > max(least_steps * usual, least):
        _warn(
            f"the sources leave {np.degrees(widest):.1f} deg out between two views, the step is "
            f"{np.degrees(usual):.2f} deg; "
            "lines that were not measured there are taken from the views at either end"
        )
    if one_sided and not arc.full_turn:
        radius = float(np.mean(arc.radii)) * np.sin(short_side(edges))
        _warn(
            "the detector stands to one side of the axis and the sources span "
            f"{np.degrees(arc.span):.1f} deg, which is no full turn: lines that pass the axis at "
            f"{1e3 * radius:.0f} mm or more are missing from views that the near edge cuts off; "
            "what lies there is estimated, and shades what lies within"
        )


def _warn(message: str) -> None:
    warnings.warn(message, ShortScanWarning, stacklevel=4)
