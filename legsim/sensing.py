"""What the configured sensors read, with or without noise, and where their integration starts: from the truth, or from fiducials."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from legsim import blobs, imu, initialization, projector, sensor_start, transforms
from legsim.arrays import FloatArray
from legsim.config import FiducialsConfig, ImuConfig, NoiseConfig
from legsim.errors import LegsimError
from legsim.geometry import ConeBeamGeometry
from legsim.imu import JointSplines, Sensor
from legsim.imu_noise import ImuNoise, add_noise
from legsim.initialization import Fiducials
from legsim.leg import Leg
from legsim.leg_phantom import LegPhantom
from legsim.opencl import Device
from legsim.pose_estimation import Scheme
from legsim.sensor_start import FoundStart
from legsim.signals import ImuSignals, SegmentPoses, SensorStart

_LEAST_CONTRAST = 0.2
"""line integral; a bead of tantalum of 1 mm reaches 4"""
_SEARCH_PX = 4.0


def noise_of(settings: NoiseConfig, *, imu_rate_hz: float, view_rate_hz: float) -> ImuNoise | None:
    """The configured noise; None for clean sensors."""
    if settings.kind == "none":
        return None
    if settings.kind == "density":
        plain = ImuNoise.from_density(
            acceleration_ug_per_sqrt_hz=settings.acceleration_ug_per_sqrt_hz,
            angular_velocity_deg_per_s_per_sqrt_hz=settings.angular_velocity_deg_per_s_per_sqrt_hz,
        )
    elif settings.kind == "rms":
        plain = ImuNoise.from_rms(
            acceleration_mg=settings.acceleration_mg,
            angular_velocity_deg_per_s=settings.angular_velocity_deg_per_s,
            bandwidth_hz=settings.bandwidth_hz,
        )
    else:
        plain = ImuNoise.paper(
            acceleration_exponent=None if settings.f_a == "none" else settings.f_a,
            angular_velocity_exponent=None if settings.f_g == "none" else settings.f_g,
            imu_rate_hz=imu_rate_hz,
            projection_rate_hz=view_rate_hz,
            convention=settings.convention,
        )
    return plain.with_bias(
        acceleration_mg=settings.acceleration_bias_mg, angular_velocity_deg_per_s=settings.angular_velocity_bias_deg_per_s
    )


def noisy(signals: ImuSignals, settings: ImuConfig, *, view_rate_hz: float, rng: np.random.Generator) -> ImuSignals:
    """The signals as the configured sensors read them."""
    noise = noise_of(settings.noise, imu_rate_hz=settings.rate_hz, view_rate_hz=view_rate_hz)
    return signals if noise is None else add_noise(signals, noise, rng)


def noise_sentence(settings: ImuConfig, *, view_rate_hz: float) -> str:
    """What the noise is, in SI units on single samples, with the convention it was read by."""
    noise = noise_of(settings.noise, imu_rate_hz=settings.rate_hz, view_rate_hz=view_rate_hz)
    if noise is None:
        return "IMU signals are free of noise."
    force, turn = noise.sample_rms(settings.rate_hz)
    ladder = f", f_a = {settings.noise.f_a}, f_g = {settings.noise.f_g}" if settings.noise.kind == "paper" else ""
    return (
        f"IMU signals carry white noise ({settings.noise.kind}{ladder}; {noise.convention} convention) of {force:.3g} m/s^2 and "
        f"{np.degrees(turn):.3g} deg/s RMS a sample, and biases of {settings.noise.acceleration_bias_mg:g} mg and "
        f"{settings.noise.angular_velocity_bias_deg_per_s:g} deg/s between sensors."
    )


@dataclass(frozen=True, slots=True, eq=False)
class Starts:
    """Where each sensor's integration begins, and what is to be said of it."""

    starts: tuple[SensorStart, ...]
    notes: tuple[str, ...]


def true_starts(leg: Leg, splines: JointSplines, placed: Sequence[Sensor], time: float) -> Starts:
    """Exact pose and velocity of each sensor at the first view."""
    return Starts(tuple(imu.true_start(leg, splines, sensor, time) for sensor in placed), ("Poses start from the truth.",))


@dataclass(frozen=True, slots=True, eq=False)
class FiducialScan:
    """The first views of a scan in which the sensors' fiducials are looked for."""

    geometry: ConeBeamGeometry
    poses: SegmentPoses
    """of the sensors, under their names, and of the segments, at those views"""
    phantom: LegPhantom
    device: Device


def found_starts(
    signals: ImuSignals,
    placed: Sequence[Sensor],
    scan: FiducialScan,
    sensor_poses: SegmentPoses,
    settings: FiducialsConfig,
    *,
    scheme: Scheme,
    rng: np.random.Generator,
) -> Starts:
    """Starts from the fiducials in the first ``settings.views`` views, as a scanner would find them.

    ``sensor_poses`` (true) say where the fiducials are to be seen; where they are found in images they say where to look.

    Raises:
        LegsimError: fiducials off a bounded detector, or hidden; the line names the sensor.
    """
    fiducials = Fiducials(1e-3 * settings.axis_length_mm)
    if settings.views > len(scan.geometry):
        raise LegsimError(f"methods.fiducials.views is {settings.views}, but the scan has {len(scan.geometry)} views; ask for fewer")
    starts, notes = [], [_how(settings)]
    for sensor in placed:
        poses = sensor_poses.of(sensor.name)[: settings.views]
        geometry = scan.geometry[: settings.views]
        notes.append(_visible(sensor.name, initialization.on_detector(geometry, poses, fiducials)))
        pixels = _seen(sensor, poses, scan, settings, fiducials, rng)
        try:
            found = sensor_start.from_fiducials(
                signals, sensor.name, scan.geometry, pixels, fiducials, scheme=scheme, detector=settings.detector
            )
        except LegsimError as error:
            raise LegsimError(f"start of sensor {sensor.name}: {error}") from error
        starts.append(found.start)
        notes.append(_conditioning(sensor.name, found))
    return Starts(tuple(starts), tuple(notes))


def _how(settings: FiducialsConfig) -> str:
    way = "found as shadows in the images" if settings.found == "images" else f"projected with {settings.error_px:g} px of error"
    return (
        f"Poses start from four fiducials {settings.axis_length_mm:g} mm apart in each sensor, {way}, in the first {settings.views} views "
        f"of a detector that is {settings.detector}."
    )


def _conditioning(name: str, found: FoundStart) -> str:
    """What one pixel of detection error costs: the price of short axes and of few views."""
    pose, shift = found.poses[0], found.poses[0].position_error(1.0)
    return (
        f"Sensor {name}: a detection error of 1 px is {np.degrees(pose.tilt_error(1.0)):.2g} deg of start tilt, {1e3 * shift:.2g} mm of "
        f"place and, by {len(found.poses)} views, {found.velocity.error_per_position_error * shift:.2g} m/s of start velocity."
    )


def _visible(name: str, on_detector: np.ndarray) -> str:
    """Which fiducials of one sensor (views, 4) fall beside the real detector."""
    beside = [fiducial for fiducial, seen in zip(initialization.FIDUCIAL_NAMES, np.asarray(on_detector.all(0)), strict=True) if not seen]
    return f"Sensor {name}: fiducials off the real detector: {', '.join(beside) or 'none'}."


def _seen(
    sensor: Sensor, poses: FloatArray, scan: FiducialScan, settings: FiducialsConfig, fiducials: Fiducials, rng: np.random.Generator
) -> FloatArray:
    """(k, 4, 2) pixels of one sensor's fiducials in the first k views."""
    exact = np.stack([initialization.project_fiducials(scan.geometry, k, pose, fiducials) for k, pose in enumerate(poses)])
    if settings.found == "exact":
        return exact + settings.error_px * rng.standard_normal(exact.shape)
    geometry, shift = scan.geometry[: len(poses)], 0
    if settings.detector == "unbounded":
        geometry, shift = _widened(geometry, exact)
    centers = transforms.apply(sensor.segment_from_sensor, fiducials.points_sensor)
    radius = 0.5e-3 * settings.bead_mm
    beaded = scan.phantom.with_spheres("fiducial", centers, segment=sensor.segment, radius=radius)
    images = projector.project(
        beaded.phantom,
        geometry,
        scan.device,
        posed=lambda view: beaded.posed(scan.poses.world_from_segment[view], scan.poses.segment_names),
    ).line_integrals
    sizes = blobs.shadow_radii(geometry, poses[:, None, :3, 3], radius)[:, 0]
    offset = np.array([0.0, shift])
    return np.stack(
        [
            blobs.locate(image, at + offset, radius_px=size, search_px=_SEARCH_PX, least_contrast=_LEAST_CONTRAST) - offset
            for image, at, size in zip(images, exact, sizes, strict=True)
        ]
    )


def _widened(geometry: ConeBeamGeometry, pixels: FloatArray) -> tuple[ConeBeamGeometry, int]:
    """A detector with more rows below and above, so that all ``pixels`` lie on it, and by how many the rows are shifted."""
    rows, columns = geometry.shape_vu
    margin = 40
    below = max(0, int(np.ceil(margin - pixels[..., 1].min())))
    above = max(0, int(np.ceil(pixels[..., 1].max() + margin - rows)))
    shifted = np.array([[1.0, 0, 0], [0, 1, below], [0, 0, 1]]) @ geometry.matrices
    return replace(geometry, matrices=shifted, shape_vu=(rows + below + above, columns)), below
