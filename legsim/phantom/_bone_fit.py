"""Bones of an imaged leg laid on the leg model's own, where both have the same shape.

Landmarks use little of a bone's surface, and are good to a fraction of a voxel. Where the imaged
bones are the model's (this package's phantom as a scanner would see it), all of their surface says
more exactly how they stand. Bones of another shape have no such pose: landmarks place them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from legsim.core import transforms
from legsim.core.values import FloatArray
from legsim.phantom.landmarks import BoneSurface

_MOST_SAMPLES = 15_000
"""triangles of an imaged bone that are compared"""

_FACING = 0.7
"""least cosine between normals of places that are compared: excludes the ends of cut bones"""

_FARTHEST = 0.010
"""m between places that are compared"""

_PASSES = 20

_SETTLED = 1e-5
"""m and rad of the last pass"""

_FLEXION_STEP = 1e-4
"""rad of the numerical derivative"""

_LEAST_MATCHED = 0.85
"""of the imaged surface that has a counterpart on bones of one shape"""

_ALIKE = 0.8e-3
"""m: greatest root mean square distance of bones of one shape; voxels of 3 mm leave 0.4 mm"""


@dataclass(frozen=True, slots=True, eq=False)
class BoneFit:
    """Where a leg of the model lies on an imaged one."""

    placed: FloatArray
    """image world from the model's world (4, 4)"""
    flexion: float
    """rad of the knee"""
    apart: float
    """m: root mean square distance of the surfaces where they are compared"""
    matched: float
    """share of the imaged surface that is compared"""

    @property
    def same_shape(self) -> bool:
        """Whether the bones have one shape, so that the fit is their pose."""
        return self.matched >= _LEAST_MATCHED and self.apart <= _ALIKE


def fit(
    imaged: Mapping[str, BoneSurface],
    model: Mapping[str, BoneSurface],
    moved: Callable[[float], Mapping[str, FloatArray]],
    placed: FloatArray,
    flexion: float,
) -> BoneFit:
    """Least distances along the model's normals (iterated closest points, Chen and Medioni 1992).

    Args:
        imaged: surfaces in the image's world, by bone.
        model: surfaces in the model's world at its reference pose, by bone.
        moved: motions (4, 4) in the model's world of its bones from that pose, by bone, at a knee
            flexion.
        placed: image world from the model's world (4, 4), a first guess.
        flexion: rad, a first guess.
    """
    pairs = [
        (
            name,
            _Samples.of(bone, 1 + len(bone.triangles) // _MOST_SAMPLES),
            _Target.of(model[name]),
        )
        for name, bone in imaged.items()
    ]
    total = sum(samples.areas.sum() for _, samples, _ in pairs)
    apart, matched = np.inf, 0.0
    for _ in range(_PASSES):
        now, bent = moved(flexion), moved(flexion + _FLEXION_STEP)
        rows = [_compared(s, t, placed, now[name], bent[name]) for name, s, t in pairs]
        slopes, distances, areas = (np.concatenate(column) for column in zip(*rows, strict=True))
        matched = float(areas.sum() / total)
        if matched < _LEAST_MATCHED / 2:
            break
        apart = float(np.sqrt(np.average(distances**2, weights=areas)))
        root = np.sqrt(areas)
        step = -np.linalg.lstsq(root[:, None] * slopes, root * distances, rcond=None)[0]
        turn = transforms.rotation_from_vector(step[3:6])
        placed, flexion = placed @ transforms.rigid(turn, step[:3]), flexion + float(step[6])
        if np.abs(step).max() < _SETTLED:
            break
    return BoneFit(placed, flexion, apart, matched)


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """Middles (n, 3) of triangles, their unit normals (n, 3) and areas (n,)."""

    points: FloatArray
    normals: FloatArray
    areas: FloatArray

    @classmethod
    def of(cls, surface: BoneSurface, stride: int = 1) -> "_Samples":
        a, b, c = np.moveaxis(surface.corners()[::stride], 1, 0)
        normals = np.cross(b - a, c - a)
        doubled = np.linalg.norm(normals, axis=1)
        kept = doubled > 0
        middles = (a + b + c)[kept] / 3
        return cls(middles, normals[kept] / doubled[kept, None], doubled[kept] / 2)


@dataclass(frozen=True, slots=True, eq=False)
class _Target:
    """Places (n, 3) on the model's surface, close together, and the unit normals there."""

    tree: KDTree
    points: FloatArray
    normals: FloatArray

    @classmethod
    def of(cls, surface: BoneSurface) -> "_Target":
        fine = _Samples.of(surface.divided())
        return cls(KDTree(fine.points), fine.points, fine.normals)


def _compared(
    samples: _Samples, target: _Target, placed: FloatArray, now: FloatArray, bent: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Slopes (n, 7) of the distances (n,) along the model's normals, and areas (n,).

    The seven are a shift and a turn of the model's world, and the knee's flexion. ``now`` and
    ``bent`` are the bone's motions at the flexion and a step beyond.
    """
    still = transforms.apply(transforms.inverse(placed), samples.points)
    points = transforms.apply(transforms.inverse(now), still)
    far, places = target.tree.query(points, distance_upper_bound=_FARTHEST)
    places = np.asarray(places)
    inverse = transforms.inverse(placed @ now)
    facing = samples.normals @ inverse[:3, :3].T
    near = np.flatnonzero(np.isfinite(far))
    near = near[np.einsum("ni,ni->n", facing[near], target.normals[places[near]]) > _FACING]
    still, points, normals = still[near], points[near], target.normals[places[near]]
    distances = np.einsum("ni,ni->n", normals, points - target.points[places[near]])
    after = transforms.apply(transforms.inverse(bent), still)
    by_flexion = np.einsum("ni,ni->n", normals, after - points) / _FLEXION_STEP
    turned = normals @ now[:3, :3].T
    slopes = np.concatenate([-turned, -np.cross(still, turned), by_flexion[:, None]], axis=1)
    return slopes, distances, samples.areas[near]
