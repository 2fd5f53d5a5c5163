"""How soft tissue follows the bones of a leg: one smooth map of space per leg.

The map is the same for skin, fat and muscle. All soft surfaces ride on it, and it keeps orientation
(tested over the range of flexion). So what is nested and free of self-intersection in the straight
leg stays so, and the path of any material point is known.

The map turns points about the knee by a share of the flexion. This share depends on the direction
from the knee axis: 0 toward the thigh, 1 toward the shank, changing over a wide wedge behind the
knee (its tissue is compressed: a narrow transition would fold) and over the kneecap in front. A
share of a turn is a normalized blend of quaternions about the joint's center (Kavan and Zara,
Spherical blend skinning, I3D 2005), so nothing shrinks as it does under blended matrices. The
translation of the joint's center itself (the tibia rolls back on the condyles) has a share of its
own: the kneecap and the tissue in front of it follow the femur. To keep volume where a wedge is
compressed or opened, distances from the axis grow or shrink with (1 + d turn / d direction)^-e.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from legsim.core import transforms
from legsim.core.values import FloatArray

if TYPE_CHECKING:
    import trimesh
else:
    trimesh = lazy_loader.load("trimesh")


# by direction in degrees from the shank, negative behind the knee, positive in front: the share of
# the flexion that tissue takes, and the share of the translation that the tibia's origin makes
_DIRECTIONS = np.array([-180.0, -164, -140, -90, -40, -16, 0, 38, 62, 90, 110, 130, 150, 166, 180])

_SHARES = np.array(
    [0.0, 0.004, 0.115, 0.5, 0.885, 0.996, 1, 1, 0.95, 0.865, 0.79, 0.50, 0.15, 0.015, 0]
)

_SLIDES = np.array(
    [0.0, 0.004, 0.115, 0.5, 0.885, 0.996, 0.98, 0.5, 0.15, -0.04, -0.03, 0, 0, 0, 0]
)

_SMOOTHING_DEG = 7.0

_EXPONENT_BEHIND, _EXPONENT_FRONT = 0.20, 0.15

_CORE, _RIM = 0.004, 0.045
"""m from the knee axis: direction has no effect nearer, and decides the share alone beyond"""

_VOLUME_NEAR, _VOLUME_FAR = 0.075, 0.130
"""m from the knee axis: volume is kept fully up to the first, distances are unchanged beyond"""

_NEAR, _FAR = 0.120, 0.240
"""m from the knee axis: direction decides alone up to the first, the bone beyond the second

It is nearer above the kneecap, where nothing folds and wide turns would lift the front of the
thigh.
"""

_CORE_HEIGHT = 0.065

_CORE_PLANES = ((0.6, 0.16), (0.35, -0.10))
"""(level, depth) of share and of slide in the core

Planes level - y / _CORE_HEIGHT + x / depth that fit the rim's values best.
"""

_PATELLA_NEAR, _PATELLA_FAR = 0.015, 0.065

_ANKLE_HALF_HEIGHT, _FOOT_SLOPE = 0.045, 0.45


def _on_circle(values: FloatArray) -> FloatArray:
    """Interpolates a row of the table above at every half degree, smoothed."""
    offsets = np.arange(-60, 61) * 0.5
    kernel = np.exp(-0.5 * (offsets / _SMOOTHING_DEG) ** 2)
    padded = np.concatenate(
        [np.zeros(60), np.interp(_HALF_DEGREES, _DIRECTIONS, values), np.zeros(60)]
    )
    return np.asarray(np.convolve(padded, kernel / kernel.sum(), mode="valid"), np.float64)


_HALF_DEGREES = np.arange(-180.0, 180.5, 0.5)

_ANGLES = np.radians(_HALF_DEGREES)

_SHARE_TABLE, _SLIDE_TABLE = _on_circle(_SHARES), _on_circle(_SLIDES)

_SLOPE_TABLE = np.gradient(_SHARE_TABLE, np.radians(0.5))


def smooth_step(t: ArrayLike) -> FloatArray:
    """Smooth step: 0 below 0, 1 above 1, twice differentiable (6 t^5 - 15 t^4 + 10 t^3)."""
    t = np.clip(np.asarray(t, float), 0, 1)
    return t * t * t * (t * (6 * t - 15) + 10)


@dataclass(frozen=True, slots=True)
class LegAxes:
    """Joints and kneecap of a straight leg in the frame of its femur, and its knee's size."""

    knee: tuple[float, float, float]
    """m"""
    ankle: tuple[float, float, float]
    """m"""
    patella: tuple[float, float, float]
    """m, middle of the bone"""
    size: float
    """size of the knee over the template's: scales all lengths of the map"""


@dataclass(frozen=True, slots=True, eq=False)
class SoftWeights:
    """What the map uses of each point; it depends on the straight leg only."""

    axes: LegAxes
    knee_share: FloatArray
    """(p,) 0 moves with the femur, 1 with the tibia"""
    knee_slope: FloatArray
    """(p,) d share / d direction, 1/rad, positive where flexion opens the wedge

    It is faded out where volume is not kept.
    """
    knee_slide: FloatArray
    """(p,) share of the translation of the tibia's origin"""
    patella_share: FloatArray
    """(p,) 1 moves with the patella, whatever the other shares are"""
    ankle_share: FloatArray
    """(p,) 0 moves with the tibia, 1 with the foot"""

    @classmethod
    def at(cls, points: FloatArray, axes: LegAxes) -> "SoftWeights":
        """Weights of points (p, 3) in the frame of the femur of the straight leg."""
        share, slope, slide = _knee_weights((points - np.array(axes.knee)) / axes.size)
        depth, height, _ = ((points - np.array(axes.ankle)) / axes.size).T
        # instep and heel belong to the foot although they reach up to the ankle's height
        ankle = smooth_step(0.5 - (height - _FOOT_SLOPE * np.abs(depth)) / (2 * _ANKLE_HALF_HEIGHT))
        return cls(
            axes,
            _snapped(share),
            slope,
            slide,
            _patella_weight((points - np.array(axes.patella)) / axes.size),
            _snapped(ankle),
        )


def _snapped(share: FloatArray) -> FloatArray:
    """Rounds shares within 1e-6 of 0 or 1: most points are then carried by one matrix."""
    return np.where(share < 1e-6, 0.0, np.where(share > 1 - 1e-6, 1.0, share))


def _knee_weights(from_knee: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Share of the flexion, its slope, and share of the slide at points (p, 3).

    Points are relative to the knee, in template meters.
    """
    x, y, _ = from_knee.T
    radius, direction = np.hypot(x, y), np.arctan2(x, -y)
    core = 1 - smooth_step((radius - _CORE) / (_RIM - _CORE))
    closer = 1 - 0.4 * smooth_step((direction - np.radians(70)) / np.radians(40))
    far = smooth_step((radius - closer * _NEAR) / (closer * (_FAR - _NEAR)))
    bone = (y < 0).astype(float)
    share, slide = (
        polar
        + (bone - polar) * far
        + (np.clip(level - y / _CORE_HEIGHT + x / depth, 0, 1) - polar) * core
        for polar, (level, depth) in zip(
            (np.interp(direction, _ANGLES, table) for table in (_SHARE_TABLE, _SLIDE_TABLE)),
            _CORE_PLANES,
            strict=True,
        )
    )
    keeps = smooth_step((_VOLUME_FAR - radius) / (_VOLUME_FAR - _VOLUME_NEAR)) * smooth_step(
        radius / _RIM
    )
    return share, -np.interp(direction, _ANGLES, _SLOPE_TABLE) * keeps, slide


def _patella_weight(from_patella: FloatArray) -> FloatArray:
    """1 on and in front of the kneecap, falling to 0 around it and towards the joint."""
    x, y, z = from_patella.T
    reach = np.sqrt((np.minimum(x, 0.0) / 0.5) ** 2 + y**2 + z**2)
    return smooth_step((_PATELLA_FAR - reach) / (_PATELLA_FAR - _PATELLA_NEAR))


def deform(
    points: FloatArray,
    weights: SoftWeights,
    *,
    femur: FloatArray,
    tibia: FloatArray,
    patella: FloatArray,
    foot: FloatArray,
) -> FloatArray:
    """Carries points (p, 3) of the straight leg, in its femur's frame, with the soft tissue.

    Each matrix (4, 4) is the motion of a bone: it maps the frame of ``points`` with the leg
    straight to the current world.
    """
    knee, ankle = transforms.inverse(femur) @ tibia, transforms.inverse(tibia) @ foot
    out = np.array(points, float)
    lower = np.flatnonzero(weights.ankle_share)
    out[lower] = _turned(
        out[lower],
        weights.ankle_share[lower],
        weights.ankle_share[lower],
        np.array(weights.axes.ankle),
        ankle,
    )
    below = weights.knee_share == 1
    out[below] = transforms.apply(knee, out[below])
    middle = np.flatnonzero((weights.knee_share > 0) & ~below)
    bulged = _keeping_volume(
        out[middle], weights.knee_slope[middle], weights.axes, flexion_of(knee)
    )
    out[middle] = _turned(
        bulged,
        weights.knee_share[middle],
        weights.knee_slide[middle],
        np.array(weights.axes.knee),
        knee,
    )
    front = np.flatnonzero(weights.patella_share)
    share = weights.patella_share[front, None]
    # a straight line between two places that are close to each other: the soft map turns nearly
    # with the kneecap
    out[front] += share * (
        transforms.apply(transforms.inverse(femur) @ patella, points[front]) - out[front]
    )
    return transforms.apply(femur, out)


def flexion_of(knee: FloatArray) -> float:
    """Flexion in rad of a knee whose tibia turned by ``knee`` (4, 4).

    It is the twist about z, negative sense.
    """
    w, _, _, z = transforms.quaternion_from_rotation(knee[:3, :3])
    return float(-2 * np.arctan2(z, w))


def _keeping_volume(
    points: FloatArray, slope: FloatArray, axes: LegAxes, flexion: float
) -> FloatArray:
    """Moves points from or toward the knee axis to keep volume.

    Compression or opening of their wedge decides by how much.
    """
    opening = np.maximum(1 + flexion * slope, 0.08)
    factor = opening ** -np.where(points[:, 0] < axes.knee[0], _EXPONENT_BEHIND, _EXPONENT_FRONT)
    moved = points.copy()
    moved[:, :2] = axes.knee[:2] + (points[:, :2] - axes.knee[:2]) * factor[:, None]
    return moved


def _turned(
    points: FloatArray, share: FloatArray, slide: FloatArray, center: FloatArray, motion: FloatArray
) -> FloatArray:
    """Turns points (p, 3) about ``center`` by a share (p,) of a rigid ``motion`` (4, 4).

    They are also shifted by a share of the center's translation.
    """
    quaternion = transforms.quaternion_from_rotation(motion[:3, :3])
    w, axis = 1 + share * (quaternion[0] - 1), quaternion[1:]
    norm = 1 / np.sqrt(w * w + share * share * (axis @ axis))
    w, v = w * norm, share * norm
    once = _cross(axis, points - center)
    turn = _cross(axis, once) * (v * v)[:, None] + once * (w * v)[:, None]
    return points + 2 * turn + slide[:, None] * (transforms.apply(motion, center[None])[0] - center)


def _cross(axis: FloatArray, points: FloatArray) -> FloatArray:
    """Cross product axis (3,) x points (p, 3), as one product."""
    return points @ transforms.cross_matrix(axis).T


NEAR, FAR = 0.004, 0.024
"""m from the nearest bone: tissue follows it up to the first, and swings freely from the second"""

FARTHEST_SWING = (FAR - NEAR) / 1.875 / 2
"""m: half of the shift at which layers would touch

1.875 is the steepest slope of the step between.
"""

_EDGE = 0.004
"""m: greatest distance of samples of a bone

No place of its surface is then farther than NEAR from a sample.
"""


def swing_of(bone: str) -> str:
    """Name under which poses hold the swing of a bone's soft tissue.

    The swing is a translation in world, by which the free tissue is shifted.
    """
    return f"swing_of_{bone}"


class TissueMobility:
    """Mobility of the soft tissue of one straight leg, in the frame of its femur."""

    def __init__(self, surfaces: Sequence[tuple[FloatArray, np.ndarray]]) -> None:
        """Samples the rigid parts: ``surfaces`` are (vertices (p, 3), triangles (t, 3)).

        Without any, all tissue swings freely.
        """
        samples = [
            trimesh.remesh.subdivide_to_size(vertices, triangles, _EDGE)[0]
            for vertices, triangles in surfaces
        ]
        self._bones = KDTree(np.concatenate([np.empty((0, 3)), *samples]))

    def at(self, points: FloatArray) -> FloatArray:
        """Mobility (p,) from 0 to 1 of points (p, 3)."""
        distance = self._bones.query(points, distance_upper_bound=FAR)[0]
        return smooth_step((np.minimum(distance, FAR) - NEAR) / (FAR - NEAR))
