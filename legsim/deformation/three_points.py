"""Closed form of moving least squares for three control points, as the kernels take it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from legsim.core.errors import LegsimError
from legsim.core.values import Float32Array, FloatArray, frozen, frozen_owned
from legsim.deformation.models import ControlPointMotion
from legsim.deformation.moving_least_squares import NEARLY_STRAIGHT, smallest_turned, straightness


@dataclass(frozen=True, slots=True, eq=False)
class ThreePoints:
    """What kernels/moving_least_squares.cl reads of three control points under one map per view."""

    rest: Float32Array
    """(18,) control points at rest, less the anchor, and the basis of their plane"""
    views: Float32Array
    """(v, 24) mapped moved points and basis, cosines and sines of the edges"""


def three_points(
    motion: ControlPointMotion,
    maps: ArrayLike,
    *,
    anchor: ArrayLike = (0.0, 0.0, 0.0),
    least_bend: float = 1e-3,
) -> ThreePoints:
    """The closed form's numbers for the device.

    Args:
        motion: of exactly three points.
        maps: (v, 3, 4), applied to where a point went: projection matrices, or the identity.
        anchor: (3,) m in world, what the device's positions are relative to; near the grid, for
            single precision.
        least_bend: the knee's distance from the line between the outer points, over that line's
            length, below which, in any view, the plane of the three is not used: the twist about
            the leg is then the smallest that carries one line to the other.

    Raises:
        LegsimError: another number of points, points that coincide, or a wrong number of maps.
    """
    _check_three(motion)
    maps = frozen("maps", maps, (len(motion.times), 3, 4))
    everything = np.concatenate([motion.reference[None], motion.moved])
    bases = (
        _plane_bases(everything)
        if _bend(everything).min() >= least_bend
        else _transported_bases(everything)
    )
    edges = np.einsum("vli,vji->vlj", _edges(everything), bases[:, :2])
    rest, moved = edges[0], edges[1:]
    cosines = (rest * moved).sum(-1)
    sines = rest[:, 0] * moved[..., 1] - rest[:, 1] * moved[..., 0]
    mapped_points = np.einsum("vij,vlj->vli", maps[:, :, :3], motion.moved) + maps[:, None, :, 3]
    mapped_bases = np.einsum("vij,vlj->vli", maps[:, :, :3], bases[1:])
    views = np.concatenate(
        [mapped_points.reshape(-1, 9), mapped_bases.reshape(-1, 9), cosines, sines], -1
    )
    resting = np.concatenate(
        [(motion.reference - np.asarray(anchor, float)).ravel(), bases[0].ravel()]
    )
    return ThreePoints(
        frozen_owned(resting.astype(np.float32)), frozen_owned(views.astype(np.float32))
    )


def _check_three(motion: ControlPointMotion) -> None:
    if len(motion.reference) != 3:
        raise LegsimError(
            "the closed form of moving least squares is for 3 control points; there are "
            f"{len(motion.reference)}; sample the motion on a coarse grid first (on_grid)"
        )
    everything = np.concatenate([motion.reference[None], motion.moved])
    closest = np.sqrt((_edges(everything) ** 2).sum(-1)).min()
    if closest < 1e-6:
        raise LegsimError(
            "two control points of the moving least squares fall together; give three different "
            "joints"
        )


def _edges(points: FloatArray) -> FloatArray:
    """(v, 3, 3): the edge opposite to each of three points, in the order 2-1, 0-2, 1-0."""
    return np.roll(points, -2, axis=1) - np.roll(points, -1, axis=1)


def _bend(points: FloatArray) -> FloatArray:
    """(v,) height of the triangle over its longest edge, divided by that edge."""
    edges = _edges(points)
    longest2 = (edges**2).sum(-1).max(-1)
    return np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1) / longest2


def _plane_bases(points: FloatArray) -> FloatArray:
    """(v, 3, 3) rows: e1 along the second edge, e2, normal; one sense of rotation in all views.

    Points nearly on a line keep the side of the first: :data:`NEARLY_STRAIGHT`.
    """
    edges = _edges(points)
    first = edges[:, 1] / np.linalg.norm(edges[:, 1], axis=-1, keepdims=True)
    normal = np.cross(edges[:, 0], edges[:, 1])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    start = np.broadcast_to(first[0], first.shape)
    turned = smallest_turned(start, first, np.broadcast_to(normal[0], normal.shape))
    straight = straightness(points)
    twisted = (turned * normal).sum(-1) < 0
    normal[twisted & (np.minimum(straight, straight[0]) < NEARLY_STRAIGHT)] *= -1
    return np.stack([first, np.cross(normal, first), normal], 1)


def _transported_bases(points: FloatArray) -> FloatArray:
    """(v, 3, 3) the first basis turned by the smallest rotation that carries e1 along."""
    edges = _edges(points)
    first = edges[:, 1] / np.linalg.norm(edges[:, 1], axis=-1, keepdims=True)
    second = np.linalg.svd(first[0][None])[2][1]
    resting = np.stack([first[0], second, np.cross(first[0], second)])
    start = np.broadcast_to(first[0], first.shape)
    turned = [smallest_turned(start, first, np.broadcast_to(e, first.shape)) for e in resting]
    return np.stack(turned, 1)
