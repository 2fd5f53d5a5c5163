"""Non-rigid motion from a few followed points: moving least squares, rigid variant, in space.

Schaefer et al. 2006 and Zhu and Gortler 2007, as used by Maier et al. 2022, section 2.6: every point of space moves by the rotation and
translation that fit the control points best under weights 1/distance^2. At a control point the limit is that point's own motion.
:func:`displaced` is the general form for any number of points; :func:`three_points` prepares the closed form of three points that
the device uses (legsim/kernels/mls.cl).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from legsim import transforms
from legsim.arrays import Float32Array, FloatArray, frozen, frozen_owned
from legsim.errors import LegsimError
from legsim.motions import ControlPointMotion
from legsim.signals import SegmentPoses

# breaks the tie where the points leave a rotation open (fewer than three, or on a line): towards turning as little as possible
_TIE_BREAK = 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class AttachedPoint:
    """A point that a sensor carries with it: a joint whose place relative to the sensor is known."""

    sensor: str
    position_sensor: FloatArray
    """(3,) m in the sensor frame"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_sensor", frozen(f"point at sensor {self.sensor!r}", self.position_sensor, (3,)))

    @classmethod
    def at_start(cls, sensor: str, world_from_sensor: ArrayLike, point_world: ArrayLike) -> "AttachedPoint":
        """The point (3,) of world that the sensor, at its pose (4, 4) of the same moment, carries."""
        return cls(sensor, transforms.apply(transforms.inverse(world_from_sensor), np.reshape(point_world, (1, 3)))[0])


def follow(poses: SegmentPoses, points: Sequence[AttachedPoint]) -> ControlPointMotion:
    """Where the points go as the sensors' ``poses`` (under the sensors' names) say; at rest they are as in the first view."""
    moved = np.stack([transforms.apply(poses.of(point.sensor), point.position_sensor[None])[:, 0] for point in points], 1)
    return ControlPointMotion(poses.times, moved[0], moved)


def drawn_to(motion: ControlPointMotion, center: int, alpha: float) -> ControlPointMotion:
    """The same motion with all points drawn to one of them, (1 - alpha) x + alpha x_center: joints that lie off the detector.

    The paper takes alpha = 0.8 and the knee as the center for its deformation of the projections.

    Raises:
        LegsimError: alpha outside [0, 1), where points would fall together.
    """
    if not 0 <= alpha < 1:
        raise LegsimError(f"control points can be drawn to the knee by 0 <= alpha < 1; got {alpha:g}")
    reference, moved = ((1 - alpha) * p + alpha * p[..., center, None, :] for p in (motion.reference, motion.moved))
    return ControlPointMotion(motion.times, reference, moved)


def displaced(points: ArrayLike, reference: ArrayLike, moved: ArrayLike) -> FloatArray:
    """Where points (n, d) go when control points (m, d) go from ``reference`` to ``moved``; d is 2 or 3, m any number.

    By a singular value decomposition a point, the determinant fixed to +1. Where the control points leave the rotation open (one or
    two of them, or all on a line) the smallest one is taken. Exactly the identity where nothing moves.
    """
    points, reference, moved = (np.asarray(a, float) for a in (points, reference, moved))
    arms = reference - points[:, None]
    weights = _weights((arms**2).sum(-1))
    center = np.einsum("nm,nmd->nd", weights, arms)
    shift = np.einsum("nm,md->nd", weights, moved - reference)
    centered = arms - center[:, None]
    centered_moved = centered + (moved - reference) - shift[:, None]
    rotation = _best_rotations(np.einsum("nm,nmi,nmj->nij", weights, centered_moved, centered))
    rotation[(centered_moved == centered).all((-2, -1))] = np.eye(points.shape[1])
    # v - p* is -center; written as a displacement, so that p = q gives v itself and not v up to rounding
    return points + shift - np.einsum("nij,nj->ni", rotation - np.eye(points.shape[1]), center)


def _weights(squared: FloatArray) -> FloatArray:
    """(n, m) 1/distance^2, normalized to the sum 1; all on one point where the distance is nothing."""
    nearest = squared.min(-1, keepdims=True)
    ratio = np.divide(nearest, squared, out=np.ones_like(squared), where=squared > 0)
    # beside a control point that is hit exactly, the others have no weight (nearest = 0)
    return ratio / ratio.sum(-1, keepdims=True)


def _best_rotations(covariances: FloatArray) -> FloatArray:
    """(n, d, d) rotations that turn the resting points into the moved ones best, for sums of moved resting^T."""
    size = covariances.shape[-1]
    scale = np.sqrt((covariances**2).sum((-2, -1)))[:, None, None]
    steady = covariances + (_TIE_BREAK * scale + np.finfo(float).tiny) * np.eye(size)
    u, _, vt = np.linalg.svd(steady)
    u[:, :, -1] *= np.where(np.linalg.det(u @ vt) < 0, -1.0, 1.0)[:, None]
    return u @ vt


@dataclass(frozen=True, slots=True, eq=False)
class ThreePoints:
    """What kernels/mls.cl reads, for one motion of three control points under given affine maps of each view."""

    rest: Float32Array
    """(18,) control points at rest, less the anchor, and the basis of their plane"""
    views: Float32Array
    """(v, 24) mapped moved points and basis, cosines and sines of the edges"""


def three_points(
    motion: ControlPointMotion, maps: ArrayLike, *, anchor: ArrayLike = (0.0, 0.0, 0.0), least_bend: float = 1e-3
) -> ThreePoints:
    """The closed form's numbers for the device.

    Args:
        motion: of exactly three points.
        maps: (v, 3, 4), applied to where a point went: projection matrices, or the identity.
        anchor: (3,) m in world, what the device's positions are relative to; near the grid, for single precision.
        least_bend: the knee's distance from the line between the outer points, over that line's length, below which, in any view, the plane
            of the three is not believed: the twist about the leg is then taken to be the smallest that carries one line to the other.

    Raises:
        LegsimError: another number of points, points that coincide, or a wrong number of maps.
    """
    _check_three(motion)
    maps = frozen("maps", maps, (len(motion.times), 3, 4))
    everything = np.concatenate([motion.reference[None], motion.moved])
    bases = _plane_bases(everything) if _bend(everything).min() >= least_bend else _transported_bases(everything)
    edges = np.einsum("vli,vji->vlj", _edges(everything), bases[:, :2])
    rest, moved = edges[0], edges[1:]
    cosines = (rest * moved).sum(-1)
    sines = rest[:, 0] * moved[..., 1] - rest[:, 1] * moved[..., 0]
    mapped_points = np.einsum("vij,vlj->vli", maps[:, :, :3], motion.moved) + maps[:, None, :, 3]
    mapped_bases = np.einsum("vij,vlj->vli", maps[:, :, :3], bases[1:])
    views = np.concatenate([mapped_points.reshape(-1, 9), mapped_bases.reshape(-1, 9), cosines, sines], -1)
    resting = np.concatenate([(motion.reference - np.asarray(anchor, float)).ravel(), bases[0].ravel()])
    return ThreePoints(frozen_owned(resting.astype(np.float32)), frozen_owned(views.astype(np.float32)))


def _check_three(motion: ControlPointMotion) -> None:
    if len(motion.reference) != 3:
        raise LegsimError(f"the closed form of moving least squares is for 3 control points; there are {len(motion.reference)}")
    everything = np.concatenate([motion.reference[None], motion.moved])
    closest = np.sqrt((_edges(everything) ** 2).sum(-1)).min()
    if closest < 1e-6:
        raise LegsimError("two control points of the moving least squares fall together; give three different joints")


def _edges(points: FloatArray) -> FloatArray:
    """(v, 3, 3): the edge opposite to each of three points, in the order 2-1, 0-2, 1-0."""
    return np.roll(points, -2, axis=1) - np.roll(points, -1, axis=1)


def _bend(points: FloatArray) -> FloatArray:
    """(v,) height of the triangle over its longest edge, divided by that edge."""
    edges = _edges(points)
    longest2 = (edges**2).sum(-1).max(-1)
    return np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1) / longest2


def _plane_bases(points: FloatArray) -> FloatArray:
    """(v, 3, 3) rows e1 along the second edge, e2, and the normal; the same sense of rotation in every view."""
    edges = _edges(points)
    first = edges[:, 1] / np.linalg.norm(edges[:, 1], axis=-1, keepdims=True)
    normal = np.cross(edges[:, 0], edges[:, 1])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.stack([first, np.cross(normal, first), normal], 1)


def _transported_bases(points: FloatArray) -> FloatArray:
    """(v, 3, 3) as :func:`_plane_bases`, but turned from the first one by the smallest rotation that carries e1 along."""
    edges = _edges(points)
    first = edges[:, 1] / np.linalg.norm(edges[:, 1], axis=-1, keepdims=True)
    second = np.linalg.svd(first[0][None])[2][1]
    resting = np.stack([first[0], second, np.cross(first[0], second)])
    return np.stack([resting @ _smallest_rotation(first[0], direction).T for direction in first])


def _smallest_rotation(a: FloatArray, b: FloatArray) -> FloatArray:
    """(3, 3) that turns unit vector a to b about their common normal."""
    axis = np.cross(a, b)
    skew = transforms.cross_matrix(axis)
    return np.eye(3) + skew + skew @ skew / max(1 + float(a @ b), 1e-12)
