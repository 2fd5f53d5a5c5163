"""Residual motion: errors of a correction in physical units, by structure of the knee.

A correction says where the material that rests at a point is in each view; the phantom knows it.
The distance of the two (mm) is motion that was not undone. The rotation that fits it best (degrees)
is a bone's excess rotation. Its projection (pixels) is what the images see of it. Deformed images
have no depth: they have pixels only.
"""

from dataclasses import dataclass, replace

import numpy as np

from legsim.core import transforms
from legsim.core.values import FloatArray, frozen
from legsim.deformation import models, moving_least_squares
from legsim.deformation.models import ControlPointMotion, Motion
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


def of_motion(
    motion: Motion | None, structures: tuple[Structure, ...], geometry: ConeBeamGeometry
) -> tuple[Residual, ...]:
    """Residual when the back-projection follows ``motion``; None follows nothing."""
    return tuple(_of_motion(motion, structure, geometry) for structure in structures)


def _of_motion(motion: Motion | None, structure: Structure, geometry: ConeBeamGeometry) -> Residual:
    resting = structure.paths[0]
    believed = (
        np.broadcast_to(resting, structure.paths.shape) if motion is None else motion.carry(resting)
    )
    distance = np.linalg.norm(believed - structure.paths, axis=-1)
    turns = (
        [_turn(a, b) for a, b in zip(believed, structure.paths, strict=True)]
        if structure.rigid
        else []
    )
    pixels = np.linalg.norm(
        geometry.project(believed)[0] - geometry.project(structure.paths)[0], axis=-1
    )
    return Residual(
        structure.name,
        1e3 * _rms(distance),
        float(np.degrees(_rms(np.array(turns)))) if turns else None,
        _rms(pixels),
    )


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
    return tuple(_of_warp(resting, moved, structure, geometry) for structure in structures)


def _of_warp(
    resting: FloatArray, moved: FloatArray, structure: Structure, geometry: ConeBeamGeometry
) -> Residual:
    seen_at_rest = geometry.project(structure.paths[0])[0]
    true = geometry.project(structure.paths)[0]
    believed = np.stack(
        [
            moving_least_squares.warp_points(at, p, q)
            for at, p, q in zip(seen_at_rest, resting, moved, strict=True)
        ]
    )
    return Residual(structure.name, None, None, _rms(np.linalg.norm(believed - true, axis=-1)))


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
