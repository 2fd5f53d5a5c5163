"""The start of a sensor's integration as a real scan would find it: fiducials in the first views and the signals between them.

Maier et al. 2022, section 2.4, put together: the pose from the first view, the velocity from one or more later ones.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from legsim import initialization, pose_estimation
from legsim.arrays import frozen
from legsim.errors import LegsimError
from legsim.geometry import ConeBeamGeometry
from legsim.initialization import DetectorBounds, Fiducials, PoseFit, VelocityFit
from legsim.pose_estimation import Scheme
from legsim.signals import ImuSignals, SensorStart


@dataclass(frozen=True, slots=True, eq=False)
class FoundStart:
    """A start and how it was found."""

    start: SensorStart
    poses: tuple[PoseFit, ...]
    """of each view that was used"""
    velocity: VelocityFit


def from_fiducials(
    signals: ImuSignals,
    sensor: str,
    geometry: ConeBeamGeometry,
    pixels: ArrayLike,
    fiducials: Fiducials,
    *,
    scheme: Scheme = "accurate",
    detector: DetectorBounds = "bounded",
) -> FoundStart:
    """Pose and velocity of a sensor at the first view.

    Args:
        signals: of the sensors, covering the views that are used; their clock need not meet the views'.
        sensor: which of them.
        geometry: of the scan.
        pixels: (k, 4, 2) the fiducials in the first k views, as :func:`legsim.initialization.pose_from_fiducials` reads them. Two views are
            the paper's way; more average what the detection left.
        fiducials: how far the points are apart.
        scheme: of the integration between the views; the one that will be used over the scan.
        detector: "unbounded" lets points lie beside the detector.

    Raises:
        LegsimError: fewer than two views, more than the scan has, or fiducials that are hidden or lost.
    """
    pixels = frozen("fiducial pixels", pixels, (None, 4, 2))
    if not 2 <= len(pixels) <= len(geometry):
        raise LegsimError(f"a start needs the fiducials of 2 to {len(geometry)} views; got {len(pixels)}")
    poses = tuple(initialization.pose_from_fiducials(geometry, k, seen, fiducials, detector=detector) for k, seen in enumerate(pixels))
    at, first = geometry.times[: len(pixels)], poses[0].world_from_sensor
    standing = SensorStart(first, np.zeros(3))
    free = pose_estimation.estimate(signals.times, *signals.sensor(sensor), standing, at, scheme=scheme)
    seen_positions = np.stack([pose.world_from_sensor[:3, 3] for pose in poses])
    velocity = initialization.velocity_from_views(at, seen_positions, free[:, :3, 3])
    corrected = first.copy()
    corrected[:3, 3] += velocity.start_shift
    return FoundStart(SensorStart(corrected, velocity.velocity), poses, velocity)
