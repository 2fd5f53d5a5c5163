"""How soft tissue follows the bones of a leg: one smooth map of space a leg, the same for skin, fat and muscle.

Because all soft surfaces ride on one map that keeps orientation (tested over the range of flexion), what is nested and free of
self-intersection in the straight leg stays so, and any material point's way is known.

The map turns points about the knee by a share of the flexion. The share depends on the direction from the knee axis: 0 toward the
thigh, 1 toward the shank, changing over a wide wedge behind the knee (its tissue is compressed: a narrow transition would fold) and
over the kneecap in front. Shares of a motion are dual quaternion blends (Kavan et al., ACM Trans. Graph. 27 (2008) 105). To keep volume
where a wedge is compressed or opened, distances from the axis grow or shrink with (1 + d angle'/d angle)^-e.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from legsim import transforms
from legsim.arrays import FloatArray

# share of the flexion that tissue takes, by direction in degrees from the shank: negative behind the knee, positive in front
_DIRECTIONS = np.array([-180.0, -164, -140, -90, -40, -16, 0, 38, 60, 94, 118, 140, 160, 180])
_SHARES = np.array([0.0, 0.004, 0.115, 0.5, 0.885, 0.996, 1, 1, 0.965, 0.80, 0.50, 0.20, 0.03, 0])
_SMOOTHING_DEG = 7.0
_EXPONENT_BEHIND, _EXPONENT_FRONT = 0.28, 0.28
_CORE, _RIM = 0.008, 0.030
"""m from the knee axis within which, and from which on, direction does not and does alone decide the share"""
_VOLUME_NEAR, _VOLUME_FAR = 0.075, 0.130
"""m from the knee axis up to which volume is kept fully, and from which on distances from the axis stay"""
_ANKLE_HALF_HEIGHT = 0.045


def _tables() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions in rad, shares and their slope: the rows above, interpolated and smoothed on the circle."""
    degrees = np.arange(-180.0, 180.5, 0.5)
    shares = np.interp(degrees, _DIRECTIONS, _SHARES)
    offsets = np.arange(-60, 61) * 0.5
    kernel = np.exp(-0.5 * (offsets / _SMOOTHING_DEG) ** 2)
    padded = np.concatenate([np.zeros(60), shares, np.zeros(60)])
    smooth = np.convolve(padded, kernel / kernel.sum(), mode="valid")
    return np.radians(degrees), smooth, np.gradient(smooth, np.radians(0.5))


_ANGLES, _SHARE_TABLE, _SLOPE_TABLE = _tables()


def smooth_step(t: ArrayLike) -> FloatArray:
    """0 below 0, 1 above 1, twice differentiable between (6 t^5 - 15 t^4 + 10 t^3)."""
    t = np.clip(np.asarray(t, float), 0, 1)
    return t * t * t * (t * (6 * t - 15) + 10)


@dataclass(frozen=True, slots=True)
class LegAxes:
    """Where the joints of a straight leg are, in the frame of its femur, and how large its knee is."""

    knee: tuple[float, float, float]
    """m"""
    ankle: tuple[float, float, float]
    """m"""
    size: float
    """of the knee against the template's: all lengths of the map are multiplied by it"""


@dataclass(frozen=True, slots=True, eq=False)
class SoftWeights:
    """What the map needs to know of each point; it depends on the straight leg only."""

    axes: LegAxes
    knee_share: FloatArray
    """(p,) 0 moves with the femur, 1 with the tibia"""
    knee_slope: FloatArray
    """(p,) d share / d direction, 1/rad, positive where flexion opens the wedge, faded out where volume is not kept"""
    ankle_share: FloatArray
    """(p,) 0 moves with the tibia, 1 with the foot"""

    @classmethod
    def at(cls, points: FloatArray, axes: LegAxes) -> "SoftWeights":
        """Weights of points (p, 3) in the frame of the femur of the straight leg."""
        x, y = points[:, 0] - axes.knee[0], points[:, 1] - axes.knee[1]
        radius = np.hypot(x, y) / axes.size
        direction = np.arctan2(x, -y)
        polar = np.interp(direction, _ANGLES, _SHARE_TABLE)
        share = polar + (smooth_step(0.5 - y / axes.size / 0.06) - polar) * (1 - smooth_step((radius - _CORE) / (_RIM - _CORE)))
        keeps = smooth_step((_VOLUME_FAR - radius) / (_VOLUME_FAR - _VOLUME_NEAR)) * smooth_step(radius / _RIM)
        slope = -np.interp(direction, _ANGLES, _SLOPE_TABLE) * keeps
        ankle = smooth_step(0.5 - (points[:, 1] - axes.ankle[1]) / axes.size / (2 * _ANKLE_HALF_HEIGHT))
        share, ankle = np.where(share < 1e-6, 0.0, np.where(share > 1 - 1e-6, 1.0, share)), np.where(ankle < 1e-6, 0.0, ankle)
        return cls(axes, share, slope, ankle)


def deform(points: FloatArray, weights: SoftWeights, femur: FloatArray, tibia: FloatArray, foot: FloatArray) -> FloatArray:
    """Points (p, 3) of the straight leg, in its femur's frame, to where soft tissue carries them.

    ``femur``, ``tibia``, ``foot`` (4, 4) say how each bone moved: current_from_straight, all in and from the frame of ``points``.
    """
    femur_inverse, tibia_inverse = transforms.inverse(femur), transforms.inverse(tibia)
    knee, ankle = femur_inverse @ tibia, tibia_inverse @ foot
    out = np.array(points, float)
    lower = weights.ankle_share > 0
    if lower.any():
        out[lower] = _blended(out[lower], weights.ankle_share[lower], ankle)
    bends = weights.knee_share > 0
    middle = bends & (weights.knee_share < 1)
    out[bends & ~middle] = transforms.apply(knee, out[bends & ~middle])
    bulged = _keeping_volume(out[middle], weights.knee_slope[middle], weights.axes, flexion_of(knee))
    out[middle] = _blended(bulged, weights.knee_share[middle], knee)
    return transforms.apply(femur, out)


def flexion_of(knee: FloatArray) -> float:
    """Flexion in rad of a knee whose tibia turned by ``knee`` (4, 4): the twist about z, negative sense."""
    w, _, _, z = transforms.quaternion_from_rotation(knee[:3, :3])
    return float(-2 * np.arctan2(z, w))


def _keeping_volume(points: FloatArray, slope: FloatArray, axes: LegAxes, flexion: float) -> FloatArray:
    """Points moved from or toward the knee axis by what compression or opening of their wedge asks for."""
    opening = np.maximum(1 + flexion * slope, 0.08)
    factor = opening ** -np.where(points[:, 0] < axes.knee[0], _EXPONENT_BEHIND, _EXPONENT_FRONT)
    moved = points.copy()
    moved[:, :2] = axes.knee[:2] + (points[:, :2] - axes.knee[:2]) * factor[:, None]
    return moved


def _blended(points: FloatArray, share: FloatArray, motion: FloatArray) -> FloatArray:
    """Points (p, 3) moved by a share (p,) of a rigid ``motion`` (4, 4): dual quaternion linear blending with the identity."""
    real = transforms.quaternion_from_rotation(motion[:3, :3])
    dual = 0.5 * _product(np.concatenate([[0.0], motion[:3, 3]]), real)
    blend_real = share[:, None] * real
    blend_real[:, 0] += 1 - share
    norm = np.linalg.norm(blend_real, axis=-1, keepdims=True)
    blend_real /= norm
    blend_dual = share[:, None] * dual / norm
    w, v = blend_real[:, :1], blend_real[:, 1:]
    dw, dv = blend_dual[:, :1], blend_dual[:, 1:]
    shift = 2 * (w * dv - dw * v + np.cross(v, dv))
    return points + 2 * np.cross(v, np.cross(v, points) + w * points) + shift


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Hamilton product of two quaternions wxyz."""
    return np.concatenate([[a[0] * b[0] - a[1:] @ b[1:]], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])])
