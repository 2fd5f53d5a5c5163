"""Metal beads on the skin around the knee: a scan that shows them, and their shadows in it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen, positive, whole_counts
from legsim.correction.bead_tracking import track
from legsim.correction.path_measurements import SHADOW_ERROR_PX, BeadShadows
from legsim.geometry.cone_beam import Projections
from legsim.kinematics.skeleton import SEGMENTS, SegmentPoses
from legsim.opencl.device import Device
from legsim.phantom import materials
from legsim.phantom.leg_phantom import LegPhantom
from legsim.phantom.meshes import Part, Phantom, sphere
from legsim.scan import acquisition
from legsim.scan.acquisition import Imaging

_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True, slots=True, eq=False)
class BeadScan:
    """Input of the tracking."""

    projections: Projections
    """projections with the beads in them"""
    guesses: FloatArray
    """(b, 3) m in world, approximate positions of the beads at the first view

    Clicks in two views would give them.
    """
    radius: float
    """m"""
    error_px: float = SHADOW_ERROR_PX
    """standard deviation along u and v of the shadows that are tracked"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "guesses", frozen("BeadScan.guesses", self.guesses, (None, 3)))
        positive("BeadScan.radius", self.radius)
        positive("BeadScan.error_px", self.error_px)


@dataclass(frozen=True, slots=True)
class Beads:
    """Metal beads on the skin around the knee, tantalum; they are in no reconstruction."""

    count: int = 12
    radius: float = 1e-3
    """m"""
    reach: float = 0.070
    """m, farthest above and below the knee"""
    guess_error: float = 2e-3
    """m, standard deviation per axis of the positions from which the search starts"""
    heights: tuple[float, float] | None = None
    """m above the knee of the first and the last bead; None: as far below and above as they reach

    One bead alone is at the first.
    """

    def __post_init__(self) -> None:
        (count,) = whole_counts("Beads.count", (self.count,))
        positive("Beads.count", count)
        positive("Beads.radius", self.radius)
        positive("Beads.guess_error", self.guess_error, zero=True)

    @classmethod
    def on_one_side(cls, count: int = 2, *, below: bool = True, radius: float = 1e-3) -> "Beads":
        """Beads on one segment alone: below the knee, or above it, and off the joint's folds."""
        near, far = (-0.035, -0.060) if below else (0.035, 0.060)
        return cls(count, radius, heights=(far, near))


def shadows_of(beads: BeadShadows | BeadScan) -> BeadShadows:
    """The shadows, tracked where they are still in the images.

    Raises:
        LegsimError: something else.
    """
    if not isinstance(beads, (BeadScan, BeadShadows)):
        raise LegsimError(
            "beads are a BeadScan or BeadShadows(pixels of (view, bead, 2)), not "
            f"{type(beads).__name__}"
        )
    if isinstance(beads, BeadScan):
        pixels = track(beads.projections, beads.guesses, radius=beads.radius)
        return BeadShadows(pixels, beads.error_px)
    return beads


def bead_positions(phantom: LegPhantom, beads: Beads, side: str = "l") -> FloatArray:
    """Places beads (b, 3) m on the skin in world of the reference pose.

    They lie on a spiral around the knee.
    """
    turns = _GOLDEN_ANGLE * np.arange(beads.count)
    heights = np.linspace(*(beads.heights or (-beads.reach, beads.reach)), beads.count)
    return phantom.skin_points(side, heights=heights, directions=turns)


def bead_paths(
    phantom: LegPhantom, poses: SegmentPoses, beads: Beads, side: str = "l"
) -> FloatArray:
    """Places (v, b, 3) m of the beads in world at each of the poses; they move with the skin."""
    placed = bead_positions(phantom, beads, side)
    # poses beyond the phantom's segments are swings of its soft tissue, which is at rest
    # in the reference pose
    start = [
        phantom.reference_world_from_segment[SEGMENTS.index(n)] if n in SEGMENTS else np.eye(4)
        for n in poses.segment_names
    ]
    return phantom.paths(
        placed,
        f"soft_{side}",
        start=start,
        poses=poses.world_from_segment,
        segment_names=poses.segment_names,
    )


def add_beads(
    projections: Projections,
    phantom: LegPhantom,
    poses: SegmentPoses,
    beads: Beads,
    device: Device,
    *,
    side: str = "l",
    energy_kev: float,
    rng: np.random.Generator,
    rays_per_pixel: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> BeadScan:
    """Adds beads that move with the skin to the ``projections`` of the same poses.

    Give ``rays_per_pixel`` as of the projections: a shadow little wider than a pixel, drawn by
    single rays through the pixels' middles, is found 0.1 pixel off, by where in a pixel it falls. A
    bead's whole attenuation is added, not the excess over the tissue it displaces, which is less
    than a hundredth of it.
    """
    at_views = bead_paths(phantom, poses, beads, side)
    surface, triangles = sphere(beads.radius)
    value = materials.attenuation("tantalum", energy_kev)
    parts = [
        Part(f"bead_{k}", "tantalum", value, center + surface, triangles)
        for k, center in enumerate(at_views[0])
    ]
    shadows = acquisition.project(
        Phantom(tuple(parts)),
        projections.geometry,
        device,
        Imaging(),
        rng,
        rays_per_pixel=rays_per_pixel,
        posed=lambda view: [center + surface for center in at_views[view]],
        progress=progress,
    )
    guesses = at_views[0] + beads.guess_error * rng.standard_normal(at_views[0].shape)
    return BeadScan(
        Projections(projections.geometry, projections.line_integrals + shadows.line_integrals),
        guesses,
        beads.radius,
    )
