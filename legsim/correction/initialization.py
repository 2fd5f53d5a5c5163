"""Start of each sensor's integration: from the truth, or from fiducials in the first views.

Maier et al. 2022, section 2.4: the pose from the first view, the velocity from one or more later
ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from legsim.core import transforms
from legsim.core.errors import LegsimError
from legsim.core.values import FloatArray, frozen
from legsim.correction import blob_detection
from legsim.correction import fiducials as correction_fiducials
from legsim.correction.fiducials import (
    FIDUCIAL_NAMES,
    DetectorBounds,
    Fiducials,
    PoseFit,
    VelocityFit,
    pose_from_fiducials,
    project_fiducials,
    velocity_from_views,
)
from legsim.correction.path_measurements import SHADOW_ERROR_PX, FiducialShadows
from legsim.geometry.cone_beam import ConeBeamGeometry
from legsim.imu import calibration, simulation, strapdown
from legsim.imu.sensors import Sensor
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.imu.strapdown import Scheme
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.leg import Leg
from legsim.kinematics.skeleton import SegmentPoses
from legsim.opencl.device import Device
from legsim.phantom.leg_phantom import LegPhantom
from legsim.scan import acquisition
from legsim.scan.acquisition import Imaging

_LEAST_CONTRAST = 0.2
"""line integral; a bead of tantalum of 1 mm reaches 4"""

_SEARCH_PX = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Starts:
    """Start of each sensor's integration, with notes for the report."""

    starts: tuple[SensorStart, ...]
    notes: tuple[str, ...]


def from_truth(leg: Leg, splines: JointSplines, placed: Sequence[Sensor], time: float) -> Starts:
    """Takes the exact pose and velocity of each sensor at the first view."""
    return Starts(
        tuple(simulation.true_start(leg, splines, sensor, time) for sensor in placed),
        ("Poses start from the truth.",),
    )


def leveled(starts: Starts, signals: ImuSignals) -> Starts:
    """Levels every start by its sensor's specific force at rest, where there is one.

    Raises:
        LegsimError: a sensor that felt no gravity at rest; the line names it.
    """
    if signals.rest_force is None:
        return starts
    tilted = []
    for name, start, force in zip(
        signals.sensor_names, starts.starts, signals.rest_force, strict=True
    ):
        try:
            tilted.append(calibration.leveled(start, force))
        except LegsimError as error:
            raise LegsimError(f"start of sensor {name}: {error}") from error
    note = "The tilt of the starts is from the specific force at rest before the scan."
    return Starts(tuple(tilted), (*starts.notes, note))


@dataclass(frozen=True, slots=True)
class FiducialOptions:
    """Four metal points in each sensor, and how they are found in the first views."""

    fiducials: Fiducials = field(default_factory=Fiducials)
    views: int = 2
    """number of first views used; 2 is as published, more average the errors of detection"""
    detector: DetectorBounds = "bounded"
    """"unbounded": the paper's virtual detector, which also sees points beyond the real one"""
    found: Literal["exact", "images"] = "exact"
    """"exact" projects the points; "images" renders them as beads and finds their shadows"""
    error_px: float = 0.0
    """standard deviation along u and v added to exact points"""
    bead_radius: float = 1e-3
    """m, of the rendered beads, tantalum"""


@dataclass(frozen=True, slots=True, eq=False)
class FiducialScan:
    """The first views of a scan, in which the sensors' fiducials are found."""

    geometry: ConeBeamGeometry
    poses: SegmentPoses
    """poses of the sensors, under their names, and of the segments, at those views"""
    phantom: LegPhantom
    device: Device | None = None
    """renders the fiducials where they are found in images"""
    rays_per_pixel: int = 1
    """along each side of a pixel, of such images"""


def from_fiducials(
    signals: ImuSignals,
    placed: Sequence[Sensor],
    scan: FiducialScan,
    sensor_poses: SegmentPoses,
    options: FiducialOptions,
    *,
    scheme: Scheme,
    rng: np.random.Generator,
) -> Starts:
    """Finds starts from the fiducials in the first ``options.views`` views, as a scanner would.

    ``sensor_poses`` (true) are where the fiducials appear; in images they are where the search
    starts.

    Raises:
        LegsimError: fiducials off a bounded detector, or hidden; the line names the sensor.
    """
    fiducials = options.fiducials
    if options.views > len(scan.geometry):
        raise LegsimError(
            f"methods.fiducials.views is {options.views}, but the scan has {len(scan.geometry)} "
            "views; ask for fewer"
        )
    starts, notes = [], [_how(options)]
    for sensor in placed:
        poses = sensor_poses.of(sensor.name)[: options.views]
        geometry = scan.geometry[: options.views]
        notes.append(
            _visible(sensor.name, correction_fiducials.on_detector(geometry, poses, fiducials))
        )
        pixels = _seen(sensor, poses, scan, options, fiducials, rng)
        try:
            found = start_from_fiducials(
                signals,
                sensor.name,
                scan.geometry,
                pixels,
                fiducials,
                scheme=scheme,
                detector=options.detector,
            )
        except LegsimError as error:
            raise LegsimError(f"start of sensor {sensor.name}: {error}") from error
        starts.append(found.start)
        notes.append(conditioning(sensor.name, found))
    return Starts(tuple(starts), tuple(notes))


def fiducial_shadows(
    sensor: Sensor,
    poses: FloatArray,
    scan: FiducialScan,
    options: FiducialOptions,
    rng: np.random.Generator,
) -> FiducialShadows:
    """Shadows of one sensor's fiducials in all views; NaN off a bounded detector.

    ``poses`` (v, 4, 4) are the sensor's true ones, where the fiducials appear.
    """
    fiducials = options.fiducials
    pixels = _seen(sensor, poses, scan, options, fiducials, rng)
    if options.detector == "bounded":
        shown = correction_fiducials.on_detector(scan.geometry, poses, fiducials)
        pixels = np.where(shown[..., None], pixels, np.nan)
    error = max(SHADOW_ERROR_PX, options.error_px if options.found == "exact" else 0.0)
    return FiducialShadows(pixels, fiducials.points_sensor, error)


def _how(options: FiducialOptions) -> str:
    way = (
        "found as shadows in the images"
        if options.found == "images"
        else f"projected with {options.error_px:g} px of error"
    )
    return (
        f"Poses start from four fiducials {1e3 * options.fiducials.axis_length:g} mm apart in "
        "each sensor, "
        f"{way}, in the first {options.views} views "
        f"of a detector that is {options.detector}."
    )


def _visible(name: str, on_detector: np.ndarray) -> str:
    """Describes which fiducials of one sensor (views, 4) fall off the real detector."""
    outside = [
        fiducial
        for fiducial, seen in zip(FIDUCIAL_NAMES, np.asarray(on_detector.all(0)), strict=True)
        if not seen
    ]
    return f"Sensor {name}: fiducials off the real detector: {', '.join(outside) or 'none'}."


def _seen(
    sensor: Sensor,
    poses: FloatArray,
    scan: FiducialScan,
    options: FiducialOptions,
    fiducials: Fiducials,
    rng: np.random.Generator,
) -> FloatArray:
    """Pixels (k, 4, 2) of one sensor's fiducials in the first k views."""
    exact = np.stack(
        [project_fiducials(scan.geometry, k, pose, fiducials) for k, pose in enumerate(poses)]
    )
    if options.found == "exact":
        return exact + options.error_px * rng.standard_normal(exact.shape)
    if scan.device is None:
        raise LegsimError("fiducials are found in images that a device renders; give device=")
    geometry, shift = scan.geometry[: len(poses)], 0
    if options.detector == "unbounded":
        geometry, shift = _widened(geometry, exact)
    centers = transforms.apply(sensor.segment_from_sensor, fiducials.points_sensor)
    radius = options.bead_radius
    beaded = scan.phantom.with_spheres("fiducial", centers, segment=sensor.segment, radius=radius)
    images = acquisition.project(
        beaded.phantom,
        geometry,
        scan.device,
        Imaging(),
        rng,
        rays_per_pixel=scan.rays_per_pixel,
        posed=lambda view: beaded.posed(
            scan.poses.world_from_segment[view], scan.poses.segment_names
        ),
    ).line_integrals
    sizes = blob_detection.shadow_radii(geometry, poses[:, None, :3, 3], radius)[:, 0]
    offset = np.array([0.0, shift])
    return np.stack(
        [
            blob_detection.locate(
                image,
                at + offset,
                radius_px=size,
                search_px=_SEARCH_PX,
                least_contrast=_LEAST_CONTRAST,
                row_ratio=geometry.row_pitch() / geometry.pixel_pitch,
            )
            - offset
            for image, at, size in zip(images, exact, sizes, strict=True)
        ]
    )


def _widened(geometry: ConeBeamGeometry, pixels: FloatArray) -> tuple[ConeBeamGeometry, int]:
    """Widens the detector by rows below and above, so that all ``pixels`` lie on it.

    Also returns by how many the rows are shifted.
    """
    rows, columns = geometry.shape_vu
    margin = 40
    below = max(0, int(np.ceil(margin - pixels[..., 1].min())))
    above = max(0, int(np.ceil(pixels[..., 1].max() + margin - rows)))
    shifted = np.array([[1.0, 0, 0], [0, 1, below], [0, 0, 1]]) @ geometry.matrices
    return replace(geometry, matrices=shifted, shape_vu=(rows + below + above, columns)), below


@dataclass(frozen=True, slots=True, eq=False)
class FoundStart:
    """A start and how it was found."""

    start: SensorStart
    poses: tuple[PoseFit, ...]
    """fit of each view that was used"""
    velocity: VelocityFit


def conditioning(name: str, found: FoundStart) -> str:
    """Describes the effect of one pixel of detection error.

    Short axes and few views raise it.
    """
    pose, shift = found.poses[0], found.poses[0].position_error(1.0)
    return (
        f"Sensor {name}: a detection error of 1 px is {np.degrees(pose.tilt_error(1.0)):.2g} deg "
        f"of start tilt, {1e3 * shift:.2g} mm of "
        f"place and, by {len(found.poses)} views, "
        f"{found.velocity.error_per_position_error * shift:.2g} m/s of start velocity."
    )


def start_from_fiducials(
    signals: ImuSignals,
    sensor: str,
    geometry: ConeBeamGeometry,
    pixels: ArrayLike,
    fiducials: Fiducials,
    *,
    scheme: Scheme = "accurate",
    detector: DetectorBounds = "bounded",
) -> FoundStart:
    """Estimates pose and velocity of a sensor at the first view.

    Args:
        signals: of the sensors, covering the views that are used; their samples need not coincide
            with the views.
        sensor: which of them.
        geometry: of the scan.
        pixels: (k, 4, 2) the fiducials in the first k views, as
            :func:`legsim.correction.fiducials.pose_from_fiducials` reads them. Two views are as
            published; more average the errors of detection.
        fiducials: how far the points are apart.
        scheme: of the integration between the views; the one that will be used over the scan.
        detector: "unbounded" allows points off the detector.

    Raises:
        LegsimError: fewer than two views, more than the scan has, or fiducials that are hidden or
            lost.
    """
    pixels = frozen("fiducial pixels", pixels, (None, 4, 2))
    if not 2 <= len(pixels) <= len(geometry):
        raise LegsimError(
            f"a start needs the fiducials of 2 to {len(geometry)} views; got {len(pixels)}"
        )
    poses = tuple(
        pose_from_fiducials(geometry, k, seen, fiducials, detector=detector)
        for k, seen in enumerate(pixels)
    )
    at, first = geometry.times[: len(pixels)], poses[0].world_from_sensor
    standing = SensorStart(first, np.zeros(3))
    free = strapdown.integrate(*signals.samples(sensor), standing, at, scheme=scheme)
    seen_positions = np.stack([pose.world_from_sensor[:3, 3] for pose in poses])
    velocity = velocity_from_views(at, seen_positions, free[:, :3, 3])
    corrected = first.copy()
    corrected[:3, 3] += velocity.start_shift
    return FoundStart(SensorStart(corrected, velocity.velocity), poses, velocity)
