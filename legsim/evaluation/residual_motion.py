"""Residual motion: errors of a correction in physical units, by structure of the knee.

A correction says where the material that rests at a point is in each view; the phantom knows it.
The distance of the two (mm) is motion that was not undone. The rotation that fits it best (degrees)
is a bone's excess rotation. Its projection (pixels) is what the images see of it. Images cannot
tell where the scene is, nor its size: the projection once more, after the constant similarity that
brings the bones nearest, is what blurs a volume. Deformed images have no depth: they have pixels
only.
"""

from dataclasses import dataclass, replace

import numpy as np

from legsim.core import transforms
from legsim.core.values import FloatArray, frozen
from legsim.deformation import models, moving_least_squares
from legsim.deformation.models import ControlPointMotion, Motion
from legsim.evaluation import image_gauge
from legsim.evaluation.image_gauge import Seen
from legsim.geometry.cone_beam import ConeBeamGeometry


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """Material points of one bone, or of the skin, and their true paths."""

    name: str
    rigid: bool
    """whether it has a rotation: a bone has one, the skin has none"""
    paths: FloatArray
    """(v, p, 3) m in world at each view; the first view is the reference"""

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "paths", frozen(f"paths of {self.name}", self.paths, (None, None, 3))
        )

    def at_rest(self) -> "Structure":
        """Returns the same points without motion."""
        return replace(self, paths=np.broadcast_to(self.paths[0], self.paths.shape))


@dataclass(frozen=True, slots=True)
class Residual:
    """RMS over the views and points of one structure."""

    structure: str
    mm: float | None
    """None where images were deformed: depth is lost"""
    degrees: float | None
    """None for the skin, and where images were deformed"""
    pixels: float
    pixels_after_similarity: float | None = None
    """after one constant similarity, which is that of least RMS of all bones together

    None without bones, and in results of older versions.
    """


def of_motion(
    motion: Motion | None, structures: tuple[Structure, ...], geometry: ConeBeamGeometry
) -> tuple[Residual, ...]:
    """Residual when the back-projection follows ``motion``; None follows nothing."""

    def seen(points: FloatArray) -> FloatArray:
        return geometry.project(_believed(motion, points, len(geometry)))[0]

    return tuple(
        _of_motion(motion, structure, *pixels)
        for structure, pixels in zip(structures, _pixels(seen, structures, geometry), strict=True)
    )


def _believed(motion: Motion | None, resting: FloatArray, views: int) -> FloatArray:
    return (
        np.broadcast_to(resting, (views, *resting.shape))
        if motion is None
        else motion.carry(resting)
    )


def _of_motion(
    motion: Motion | None, structure: Structure, pixels: float, after: float | None
) -> Residual:
    believed = _believed(motion, structure.paths[0], len(structure.paths))
    distance = np.linalg.norm(believed - structure.paths, axis=-1)
    turns = (
        [_turn(a, b) for a, b in zip(believed, structure.paths, strict=True)]
        if structure.rigid
        else []
    )
    return Residual(
        structure.name,
        1e3 * _rms(distance),
        float(np.degrees(_rms(np.array(turns)))) if turns else None,
        pixels,
        after,
    )


def _pixels(
    seen: Seen, structures: tuple[Structure, ...], geometry: ConeBeamGeometry
) -> list[tuple[float, float | None]]:
    """RMS in pixels of each structure, as it is and after the bones' best similarity."""
    true = [geometry.project(structure.paths)[0] for structure in structures]
    bones = [k for k, structure in enumerate(structures) if structure.rigid]
    similarity = (
        image_gauge.best_similarity(
            seen,
            np.concatenate([structures[k].paths[0] for k in bones]),
            np.concatenate([true[k] for k in bones], 1),
        )
        if bones
        else None
    )
    found = []
    for structure, at in zip(structures, true, strict=True):
        resting = structure.paths[0]
        found.append(
            (
                _distance(seen(resting), at),
                None
                if similarity is None
                else _distance(seen(transforms.apply(similarity, resting)), at),
            )
        )
    return found


def _distance(pixels: FloatArray, true: FloatArray) -> float:
    return _rms(np.linalg.norm(pixels - true, axis=-1))


def _turn(believed: FloatArray, true: FloatArray) -> float:
    """Angle in rad between two placements (p, 3) of the same points."""
    return float(transforms.rotation_angle(transforms.best_rigid(believed, true)[:3, :3]))


def of_warp(
    motion: ControlPointMotion, structures: tuple[Structure, ...], geometry: ConeBeamGeometry
) -> tuple[Residual, ...]:
    """Residual when images were deformed by followed points.

    The deformation is :func:`legsim.correction.image_warp.warp_images`.
    """
    resting, moved = models.image_points(geometry, motion)

    def seen(points: FloatArray) -> FloatArray:
        return np.stack(
            [
                moving_least_squares.warp_points(at, p, q)
                for at, p, q in zip(geometry.project(points)[0], resting, moved, strict=True)
            ]
        )

    return tuple(
        Residual(structure.name, None, None, *pixels)
        for structure, pixels in zip(structures, _pixels(seen, structures, geometry), strict=True)
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def overall_mm(
    residuals: tuple[Residual, ...], bones: tuple[str, ...] = ("femur", "tibia")
) -> float | None:
    """RMS (mm) of the named bones together; None where one of them has no mm."""
    found = [r.mm for r in residuals if r.structure in bones]
    return (
        _rms(np.array([mm for mm in found if mm is not None]))
        if found and None not in found
        else None
    )
