"""The second scan of the marker-based method: the same one with metal beads on the skin around the
knee.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from legsim.config import BeadsConfig
from legsim.core.values import FloatArray, frozen
from legsim.geometry.cone_beam import Projections
from legsim.kinematics.skeleton import SEGMENTS, SegmentPoses
from legsim.opencl.device import Device
from legsim.phantom import materials
from legsim.phantom.leg_phantom import LegPhantom
from legsim.phantom.meshes import Part, Phantom, sphere
from legsim.scan import projector

_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True, slots=True, eq=False)
class BeadScan:
    """What the tracking starts from."""

    projections: Projections
    """with the beads in them"""
    guesses: FloatArray
    """(b, 3) m in world, roughly where the beads are at the first view, as clicks in two views
    would give them
    """
    radius: float
    """m"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "guesses", frozen("BeadScan.guesses", self.guesses, (None, 3)))


def bead_positions(phantom: LegPhantom, settings: BeadsConfig) -> FloatArray:
    """(b, 3) on the left leg's skin in world of the phantom's reference pose, on a spiral around
    the knee.
    """
    reach = 1e-3 * settings.reach_mm
    turns = _GOLDEN_ANGLE * np.arange(settings.count)
    return phantom.skin_points(
        "l", heights=np.linspace(-reach, reach, settings.count), directions=turns
    )


def add_beads(
    projections: Projections,
    phantom: LegPhantom,
    poses: SegmentPoses,
    settings: BeadsConfig,
    device: Device,
    *,
    energy_kev: float,
    rng: np.random.Generator,
    progress: Callable[[int, int], None] | None = None,
) -> BeadScan:
    """Beads that ride on the skin, added to the ``projections`` of the same poses.

    A bead's whole attenuation is added, not the excess over the tissue it displaces, which is less
    than a hundredth of it.
    """
    placed = bead_positions(phantom, settings)
    # what is no segment of the phantom's is a swing of its soft tissue, which rests in the
    # reference pose
    start = [
        phantom.reference_world_from_segment[SEGMENTS.index(n)] if n in SEGMENTS else np.eye(4)
        for n in poses.segment_names
    ]
    at_views = phantom.paths(
        placed,
        "soft_l",
        start=start,
        poses=poses.world_from_segment,
        segment_names=poses.segment_names,
    )
    radius = 0.5e-3 * settings.diameter_mm
    surface, triangles = sphere(radius)
    value = materials.attenuation("tantalum", energy_kev)
    parts = [
        Part(f"bead_{k}", "tantalum", value, center + surface, triangles)
        for k, center in enumerate(at_views[0])
    ]
    shadows = projector.project(
        Phantom(tuple(parts)),
        projections.geometry,
        device,
        posed=lambda view: [center + surface for center in at_views[view]],
        progress=progress,
    )
    guesses = at_views[0] + 1e-3 * settings.guess_error_mm * rng.standard_normal(at_views[0].shape)
    return BeadScan(
        Projections(projections.geometry, projections.line_integrals + shadows.line_integrals),
        guesses,
        radius,
    )
