"""The stages of a run up to the scan, and what all stages share."""

import json
from dataclasses import dataclass
from functools import partial

import numpy as np

from legsim import __version__
from legsim.config import RunConfig
from legsim.core.errors import LegsimError
from legsim.core.files import key_of, write_text
from legsim.core.progress import OnProgress
from legsim.core.values import FloatArray
from legsim.correction import initialization
from legsim.correction.initialization import FiducialScan, Starts
from legsim.evaluation.regions import Region, leg_regions
from legsim.geometry import files as geometry_files
from legsim.geometry import image_files
from legsim.geometry.cone_beam import ConeBeamGeometry, Projections
from legsim.geometry.volume import VolumeGrid
from legsim.imu import simulation
from legsim.imu.signals import ImuSignals
from legsim.imu.simulation import Sensor
from legsim.kinematics import joint_splines
from legsim.kinematics.joint_splines import JointSplines
from legsim.kinematics.moving_leg import MovingLeg
from legsim.kinematics.skeleton import SegmentPoses
from legsim.mocap import opensim
from legsim.opencl.device import Device
from legsim.phantom import leg_phantom, tissue_swing, voxelize
from legsim.phantom.leg_phantom import LegPhantom
from legsim.run import c_arm as run_c_arm
from legsim.run import motion as run_motion
from legsim.run import sensors as run_sensors
from legsim.run.c_arm import c_arm, seen_by_every_view, view_times
from legsim.run.files import load_imu, save_imu, save_joint_centers, save_poses
from legsim.run.folder import RunFolder
from legsim.run.sensors import sense, skin_mount
from legsim.scan import acquisition
from legsim.scan.acquisition import Imaging

_NOISE, _STARTS, _PHOTONS = 1, 2, 4
"""streams of the run's seed"""


def motion_key(settings: RunConfig) -> str:
    return key_of(
        __version__, settings.motion.model_dump(), run_motion.fingerprint(settings.motion)
    )


def scan_key(settings: RunConfig) -> str:
    return key_of(
        motion_key(settings),
        settings.scan.model_dump(),
        settings.phantom.model_dump(),
        run_c_arm.fingerprint(settings.scan, settings.seed),
    )


def write_kinematics(recovered: MovingLeg, folder: RunFolder, key: str) -> None:
    files = ["coordinates.mot", "joint_centres.csv", "poses.npz", "kinematics.json"]
    if folder.done("kinematics", key):
        return
    with folder.stage("kinematics", key, files):
        poses = recovered.leg.segment_poses(recovered.trajectories)
        centers = recovered.leg.joint_centers(poses)
        opensim.save(folder.path / "coordinates.mot", recovered.trajectories)
        save_joint_centers(
            folder.path / "joint_centres.csv", centers.times, centers.names, centers.positions_world
        )
        save_poses(folder.path / "poses.npz", poses)
        write_text(
            folder.path / "kinematics.json", json.dumps(recovered.summary(), indent=1) + "\n"
        )


def read_sensors(
    settings: RunConfig,
    recovered: MovingLeg,
    splines: JointSplines,
    placed: tuple[Sensor, ...],
    folder: RunFolder,
    motion_key: str,
) -> ImuSignals:
    """The IMU signals over the whole recording, at the sensors' own rate."""
    drawn = () if settings.imu.noise.kind == "none" else (settings.seed, settings.scan.rate_hz)
    key = key_of(motion_key, settings.imu.model_dump(), drawn)
    if folder.done("imu", key):
        return load_imu(folder.path / "imu.csv")
    with folder.stage("imu", key, ["imu.csv"]):
        clean = sense(recovered, splines, placed, settings.imu)
        drawing = np.random.default_rng([settings.seed, _NOISE])
        signals = run_sensors.noisy(
            clean, settings.imu, view_rate_hz=settings.scan.rate_hz, rng=drawing
        )
        save_imu(folder.path / "imu.csv", signals)
    return signals


def _photons(settings: RunConfig, exposure: int) -> np.random.Generator:
    """By the recording's content too: scans of one study share a seed, and must not share their
    noise.
    """
    recording = int(run_motion.fingerprint(settings.motion)[0][:16], 16)
    return np.random.default_rng([settings.seed, _PHOTONS, exposure, recording])


@dataclass(frozen=True, slots=True, eq=False)
class ScanSetup:
    """The moving person, as every stage after the first needs it."""

    recovery: MovingLeg
    splines: JointSplines
    sensors: tuple[Sensor, ...]
    poses: SegmentPoses
    """of the segments at the views"""
    phantom: LegPhantom
    geometry: ConeBeamGeometry

    def __post_init__(self) -> None:
        if not np.array_equal(self.poses.times, self.geometry.times):
            raise LegsimError(
                "a scanned leg's poses are those at the views: give them at the times of the "
                "geometry"
            )

    @property
    def times(self) -> FloatArray:
        """(v,) s of the views."""
        return self.geometry.times


def set_up(settings: RunConfig, folder: RunFolder, on_progress: OnProgress) -> ScanSetup:
    """Solves the recording for joint angles and poses the phantom's skeleton at every view."""
    on_progress("joint angles", 0, 1)
    recovered = run_motion.solve(settings.motion)
    write_kinematics(recovered, folder, motion_key(settings))
    splines = JointSplines(recovered.trajectories)
    times = view_times(settings.scan, recovered.trajectories.times)
    poses = joint_splines.segment_poses_at(recovered.leg, splines, times)
    isocenter = recovered.leg.joint_centers(poses).of("knee_l")[0]
    geometry = c_arm(settings.scan, times, isocenter)
    wanted = settings.phantom
    if wanted.tissue_swing.amplitude > 0:
        poses = tissue_swing.with_swing(
            poses, recovered.leg, splines, skin_mount(wanted.tissue_swing)
        )
    phantom = leg_phantom.load_leg_phantom(
        scales=recovered.leg.scales,
        detail=wanted.detail,
        energy_kev=wanted.energy_kev,
        swinging=wanted.tissue_swing.amplitude > 0,
    )
    phantom = phantom.one_leg("l") if wanted.legs == "left" else phantom
    on_progress("joint angles", 1, 1)
    return ScanSetup(
        recovered, splines, run_sensors.sensors(settings.imu), poses, phantom, geometry
    )


def scan(
    settings: RunConfig,
    body: ScanSetup,
    how: Imaging,
    folder: RunFolder,
    device: Device,
    on_progress: OnProgress,
) -> tuple[Projections, Projections]:
    """Projections of the moving phantom, and of the one that keeps the first view's pose; each with
    noise of its own.
    """
    key = scan_key(settings)
    if not folder.done("geometry", key):
        with folder.stage("geometry", key, ["geometry.json", "geometry_rtk.xml"]):
            geometry_files.save_geometry(folder.path / "geometry.json", body.geometry)
            geometry_files.save_geometry(folder.path / "geometry_rtk.xml", body.geometry)
    exposures = []
    for exposure, (name, poses) in enumerate(
        (("projections", body.poses), ("projections-static", body.poses.held_at(0)))
    ):
        path = folder.path / f"{name}.mha"
        if not folder.done(name, key):
            with folder.stage(name, key, [path.name]):
                shown = "projecting" if poses is body.poses else "projecting, at rest"
                drawing = _photons(settings, exposure)
                exposed = acquisition.expose(
                    body.phantom,
                    poses,
                    body.geometry,
                    device,
                    how,
                    drawing,
                    rays_per_pixel=settings.scan.rays_per_pixel,
                    progress=partial(on_progress, shown),
                )
                image_files.save_projections(path, exposed)
        exposures.append(image_files.load_projections(path, body.geometry))
    return exposures[0], exposures[1]


def starts(settings: RunConfig, body: ScanSetup, signals: ImuSignals, device: Device) -> Starts:
    """Where each sensor's integration begins, as methods.start says."""
    if settings.methods.start == "truth":
        return initialization.from_truth(
            body.recovery.leg, body.splines, body.sensors, float(body.times[0])
        )
    true_poses = simulation.sensor_poses(body.recovery.leg, body.splines, body.sensors, body.times)
    return initialization.from_fiducials(
        signals,
        body.sensors,
        FiducialScan(body.geometry, body.poses, body.phantom, device),
        true_poses,
        settings.methods.fiducials,
        scheme=settings.methods.scheme,
        rng=np.random.default_rng([settings.seed, _STARTS]),
    )


def regions(
    settings: RunConfig, body: ScanSetup, grid: VolumeGrid, device: Device
) -> tuple[Region, ...]:
    """Whole leg, shank and thigh of the scanned leg, from the phantom's truth at the reference
    pose.
    """
    vertices = body.phantom.posed(body.poses.world_from_segment[0], body.poses.segment_names)
    left = [k for k, part in enumerate(body.phantom.phantom.parts) if part.name.endswith("_l")]
    leg = body.phantom.phantom.only(left).with_vertices(tuple(vertices[k] for k in left))
    labels = voxelize.labels(leg, grid, device)
    knee = float(body.recovery.leg.joint_centers(body.poses).of("knee_l")[0, 1])
    return leg_regions(
        labels,
        grid,
        knee,
        seen_by_every_view(settings.scan, grid),
        1e-3 * settings.evaluation.air_margin_mm,
    )


@dataclass(frozen=True, slots=True, eq=False)
class StageContext:
    """Where a stage works."""

    settings: RunConfig
    folder: RunFolder
    device: Device
    scan_key: str
    """of all that decides the projections"""
    on_progress: OnProgress
