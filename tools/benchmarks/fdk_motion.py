"""What weights leave of known motion: errors with weights of the scanner's own path and of the path
that the object saw.
"""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from unittest import mock

import numpy as np
import trimesh
from scipy.ndimage import gaussian_filter

from legsim.deformation import moving_least_squares
from legsim.deformation.models import ControlPointMotion, RigidMotion
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import VolumeGrid
from legsim.opencl.device import open_device
from legsim.phantom.meshes import Part, Phantom
from legsim.reconstruction import fdk
from legsim.reconstruction.weights import ShortScanWarning
from legsim.scan import projector
from tools.benchmarks import fdk as bench_fdk

COUNT, SIDE, SMOOTH = 80, 0.2, 3.0
"""voxels along a side, m, and the voxels by which errors are smoothed: slow ones, without edges and
streaks
"""


def bent(geometry: ConeBeamGeometry, motion: ControlPointMotion) -> Projections:
    """The benchmark's phantom as meshes whose vertices follow the motion, by the projector."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    # of nested solids the innermost decides: the sum of all that are added up to there
    values = (20.0, 45.0, 25.0, 48.0, 30.0)
    shapes = ((np.array(radii), np.array(center)) for center, radii, _ in bench_fdk.PHANTOM)
    parts = tuple(
        Part(f"{k}", "made", value, 1e-3 * (ball.vertices * radii + center), ball.faces)
        for k, (value, (radii, center)) in enumerate(zip(values, shapes, strict=True))
    )
    return projector.project(
        Phantom(parts),
        geometry,
        open_device(),
        posed=lambda view: tuple(
            moving_least_squares.warp_points(part.vertices, motion.reference, motion.moved[view])
            for part in parts
        ),
    )


@contextmanager
def _scanners_own_weights() -> Iterator[None]:
    with mock.patch.object(fdk, "object_geometry", lambda geometry, *_: geometry):
        yield


def table(views: int = 248, binning: int = 4) -> Iterator[str]:
    """Lines of markdown: slow errors in the plane of the sources and in the whole field of view,
    rms in % of the greatest contrast.
    """
    geometry, device = bench_fdk.scan(views, binning), open_device()
    grid = VolumeGrid.cubic(COUNT, SIDE / COUNT, (0.0, 0.0, 0.0))
    expected, counts = bench_fdk.truth(grid)
    share = gaussian_filter(counts.astype(float), SMOOTH)
    middle = np.zeros_like(counts)
    middle[:, COUNT // 2 - 3 : COUNT // 2 + 4] = True

    def errors(projections: Projections, motion: RigidMotion | ControlPointMotion | None) -> str:
        volume = fdk.fdk(projections, grid, device=device, motion=motion).attenuation
        slow = gaussian_filter(np.where(counts, volume - expected, 0.0), SMOOTH) / np.maximum(
            share, 1e-3
        )
        inside = counts & (share > 0.5)
        return " | ".join(
            f"{100 * float(np.sqrt(np.mean(slow[where] ** 2))) / float(expected.max()):.2f}"
            for where in (inside & middle, inside)
        )

    swaying, bending = bench_fdk.sway(views), bench_fdk.bending(views)
    cases: list[tuple[str, Callable[[], Projections], RigidMotion | ControlPointMotion | None]] = [
        ("at rest", lambda: bench_fdk.projected(geometry), None),
        (
            "rigid sway, 6 mm and 2°",
            lambda: replace(
                bench_fdk.projected(geometry.moved(swaying.moved_from_reference)), geometry=geometry
            ),
            swaying,
        ),
        ("hip, knee and ankle apart by 8 mm", lambda: bent(geometry, bending), bending),
    ]
    yield (
        "| slow errors, % | weights of the scanner's path: middle | all | of the path the "
        "object saw: middle | all |"
    )
    yield "|---|---|---|---|---|"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ShortScanWarning)
        for name, seen, motion in cases:
            projections = seen()
            with _scanners_own_weights():
                before = errors(projections, motion)
            yield f"| {name} | {before} | {errors(projections, motion)} |"
