"""Acquisition: projections of the moving and of the resting phantom."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from legsim.core.values import FloatArray
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.kinematics.skeleton import SegmentPoses
from legsim.opencl.device import Device
from legsim.phantom.leg_phantom import LegPhantom
from legsim.phantom.meshes import Phantom
from legsim.scan import detector as scan_detector
from legsim.scan import projector
from legsim.scan.detector import Detector
from legsim.scan.spectrum import Spectrum

_VIEWS_AT_ONCE = 31


@dataclass(frozen=True, slots=True)
class Imaging:
    """Beam and detector; the default is one energy and a perfect detector."""

    spectrum: Spectrum | None = None
    """None: the phantom's own attenuations, which are at one energy"""
    water_precorrection: bool = False
    detector: Detector = field(default_factory=Detector)


def project(
    phantom: Phantom,
    geometry: ConeBeamGeometry,
    device: Device,
    how: Imaging,
    rng: np.random.Generator,
    *,
    rays_per_pixel: int = 1,
    posed: Callable[[int], Sequence[FloatArray]] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Projections:
    """Projections of a phantom as the detector reads them.

    ``posed`` and ``progress`` are as in :func:`legsim.scan.projector.project`. A pixel is the mean
    line integral of ``rays_per_pixel`` x ``rays_per_pixel`` rays, evenly over its area: a single
    ray through its middle would alias every edge.
    """
    if rays_per_pixel == 1:
        arriving = _arriving(phantom, geometry, device, how, posed, progress)
    else:
        # a few views at a time, so that the finer images take little memory
        parts = []
        for first in range(0, len(geometry), _VIEWS_AT_ONCE):
            views = range(first, min(first + _VIEWS_AT_ONCE, len(geometry)))
            fine = geometry[views.start : views.stop].finer(rays_per_pixel)
            seen = _arriving(
                phantom,
                fine,
                device,
                how,
                None if posed is None else lambda view, first=first: posed(first + view),
                None,
            )
            parts.append(seen.coarser(rays_per_pixel).line_integrals)
            if progress is not None:
                progress(views.stop, len(geometry))
        arriving = Projections(geometry, np.concatenate(parts))
    read = scan_detector.detect(arriving, how.detector, rng)
    if how.spectrum is None or not how.water_precorrection:
        return read
    return replace(read, line_integrals=how.spectrum.as_of_water(read.line_integrals))


def _arriving(
    phantom: Phantom,
    geometry: ConeBeamGeometry,
    device: Device,
    how: Imaging,
    posed: Callable[[int], Sequence[FloatArray]] | None,
    progress: Callable[[int, int], None] | None,
) -> Projections:
    """Projections with one ray per pixel, before the detector."""
    if how.spectrum is None:
        return projector.project(phantom, geometry, device, posed=posed, progress=progress)
    return projector.project_spectrum(
        phantom, geometry, device, how.spectrum, posed=posed, progress=progress
    )


def expose(
    phantom: LegPhantom,
    poses: SegmentPoses,
    geometry: ConeBeamGeometry,
    device: Device,
    how: Imaging,
    rng: np.random.Generator,
    *,
    rays_per_pixel: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Projections:
    """Projections of the phantom posed by ``poses`` at every view."""

    def posed(view: int) -> tuple[FloatArray, ...]:
        return phantom.posed(poses.world_from_segment[view], poses.segment_names)

    return project(
        phantom.phantom,
        geometry,
        device,
        how,
        rng,
        rays_per_pixel=rays_per_pixel,
        posed=posed,
        progress=progress,
    )
