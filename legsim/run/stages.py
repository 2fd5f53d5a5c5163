"""The stages of a run up to the scan, and the parts common to all stages."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from legsim import __version__
from legsim.config import FiducialsConfig, MethodsConfig, RoughConfig, RunConfig
from legsim.core.errors import LegsimError
from legsim.core.files import key_of, write_text
from legsim.core.progress import OnProgress
from legsim.core.values import to_nanometers
from legsim.correction import initialization, rough_start
from legsim.correction.fiducials import Fiducials
from legsim.correction.initialization import FiducialOptions, FiducialScan, Starts
from legsim.correction.rough_start import StartErrors
from legsim.geometry import files as geometry_files
from legsim.geometry import image_files
from legsim.geometry.cone_beam import Projections
from legsim.imu import simulation
from legsim.imu.files import load_imu, load_rest, save_imu, save_rest
from legsim.imu.signals import ImuSignals, SensorStart
from legsim.kinematics import osim_export, osim_scaled_file
from legsim.kinematics.leg_model import LegModel
from legsim.kinematics.moving_leg import MovingLeg
from legsim.kinematics.osim_leg import OsimLeg
from legsim.mocap import opensim, trc
from legsim.opencl.device import Device
from legsim.run import c_arm as run_c_arm
from legsim.run import code, named_files
from legsim.run import motion as run_motion
from legsim.run import sensors as run_sensors
from legsim.run.files import save_joint_centers, save_marker_errors, save_poses
from legsim.run.folder import RunFolder
from legsim.simulation.setup import PhantomOptions, ScanSetup, prepare_scan
from legsim.simulation.simulated_scan import expose

NOISE, STARTS, _PHOTONS, VIBRATION = 1, 2, 4, 5
"""random streams of the run's seed"""


@dataclass(frozen=True, slots=True, eq=False)
class StageContext:
    """Settings and folder of a stage."""

    settings: RunConfig
    folder: RunFolder
    device: Device
    on_progress: OnProgress

    @property
    def scan_key(self) -> str:
        """Key of all that decides the projections."""
        settings = self.settings
        swings = settings.phantom.tissue_swing.amplitude > 0
        return key_of(
            motion_key(settings),
            code.fingerprint("projections", *(("tissue_swing",) if swings else ())),
            self.device.arithmetic,
            settings.scan.model_dump(),
            settings.phantom.model_dump(),
            named_files.of_scan(settings),
        )


def motion_key(settings: RunConfig) -> str:
    """Key of all that decides the kinematics."""
    return key_of(
        __version__,
        code.fingerprint("kinematics"),
        settings.motion.model_dump(exclude={"implausible"}),
        run_motion.fingerprint(settings.motion),
    )


def write_kinematics(person: MovingLeg, folder: RunFolder, key: str) -> None:
    """Writes coordinates, joint centers, segment poses, marker residuals and the OpenSim model.

    The OpenSim model is legsim's own leg.
    """

    def write() -> tuple[str, ...]:
        path = folder.path
        poses = person.leg.segment_poses(person.trajectories)
        centers = person.leg.joint_centers(poses)
        opensim.save(path / "coordinates.mot", person.leg.complete(person.trajectories))
        save_joint_centers(
            path / "joint_centres.csv", centers.times, centers.names, centers.positions_world
        )
        save_poses(path / "poses.npz", poses)
        write_text(path / "kinematics.json", json.dumps(person.summary(), indent=1) + "\n")
        more: list[str] = []
        from_zero = person.from_zero()
        if from_zero is not None:
            opensim.save(path / "coordinates_from_zero.mot", from_zero)
            more.append("coordinates_from_zero.mot")
        if isinstance(person.leg, LegModel):
            fit, name = person.fit, Path(person.name).stem
            sites, labels = (None, None) if fit is None else (fit.sites, fit.labels())
            model = osim_export.text(person.leg, sites, name=name, labels=labels)
            write_text(path / "scaled_model.osim", model)
            more.append("scaled_model.osim")
        if isinstance(person.leg, OsimLeg) and person.leg.model.factors:
            scaled = person.leg.model
            write_text(path / "scaled_model.osim", osim_scaled_file.text(scaled))
            write_text(path / "scale_factors.xml", osim_scaled_file.scale_set(scaled.factors))
            more += ["scaled_model.osim", "scale_factors.xml"]
        if person.fit is not None:
            trc.save(path / "model_markers.trc", person.fit.modelled)
            save_marker_errors(path / "marker_errors.sto", person.fit.measured, person.fit.modelled)
            more += ["model_markers.trc", "marker_errors.sto"]
        return "coordinates.mot", "joint_centres.csv", "poses.npz", "kinematics.json", *more

    folder.cached("kinematics", key, write)


def record(settings: RunConfig, person: MovingLeg, *, rest_at: float) -> ImuSignals:
    """Simulates what the sensors read over the whole recording, by the draws of the run's seed.

    A calibration rests in the pose of the time ``rest_at`` (s).
    """
    return run_sensors.record(
        person,
        settings.imu,
        view_rate_hz=settings.scan.rate_hz,
        rest_at=rest_at,
        rng=np.random.default_rng([settings.seed, NOISE]),
        shaking=np.random.default_rng([settings.seed, VIBRATION]),
    )


def read_sensors(
    settings: RunConfig, person: MovingLeg, folder: RunFolder, key: str, *, rest_at: float
) -> ImuSignals:
    """Simulates the IMU signals over the whole recording, at the sensors' own rate.

    ``key`` is that of the kinematics. A calibration rests in the pose of the time ``rest_at`` (s).
    """
    imu = settings.imu
    chance = imu.noise.kind != "none" or imu.lost_share > 0
    drawn = (settings.seed, settings.scan.rate_hz) if chance else ()
    rested = () if imu.noise.calibration == "none" else (rest_at,)
    if run_sensors.vibrate(imu):
        drawn = (*drawn, settings.seed)
    signals: list[ImuSignals] = []

    def write() -> tuple[str, ...]:
        read = record(settings, person, rest_at=rest_at)
        signals.append(read)
        save_imu(folder.path / "imu.csv", read)
        if read.rest_force is None:
            return ("imu.csv",)
        save_rest(folder.path / "imu_rest.csv", read)
        return "imu.csv", "imu_rest.csv"

    own = run_sensors.fingerprint(imu)
    decided_by = key_of(key, code.fingerprint("imu"), imu.model_dump(), drawn, rested, own)
    if folder.cached("imu", decided_by, write):
        return signals[0]
    read = replace(load_imu(folder.path / "imu.csv"), sensors=run_sensors.sensors(imu))
    if imu.noise.calibration == "none":
        return read
    rest = load_rest(folder.path / "imu_rest.csv", read.sensor_names)
    return replace(read, rest_force=rest)


def set_up(stage: StageContext) -> ScanSetup:
    """Solves the recording for joint angles and places the person in the C-arm."""
    settings = stage.settings
    stage.on_progress("joint angles", 0, 1)
    person = run_motion.solve(settings.motion)
    write_kinematics(person, stage.folder, motion_key(settings))
    setup = place(settings, person)
    stage.on_progress("joint angles", 1, 1)
    return setup


def place(settings: RunConfig, person: MovingLeg) -> ScanSetup:
    """Places a person in the C-arm, if that is a movement that a leg makes."""
    refuse_implausible(settings, person.name, person.implausible)
    wanted, scan = settings.phantom, settings.scan
    return prepare_scan(
        person,
        run_c_arm.c_arm(scan),
        side=scan.side,
        center=None if scan.center == "knee" else 1e-3 * np.array(scan.center),
        sensors=run_sensors.sensors(settings.imu),
        phantom=PhantomOptions(
            wanted.legs,
            wanted.detail,
            wanted.energy_kev,
            run_sensors.skin_mount(wanted.tissue_swing),
            Path(wanted.file) if wanted.file else None,
        ),
    )


def refuse_implausible(settings: RunConfig, recording: str, objections: tuple[str, ...]) -> None:
    """Refuses to scan a movement that no leg makes, unless the settings say otherwise.

    Raises:
        LegsimError: there are objections; the line holds the first.
    """
    if objections and settings.motion.implausible == "refuse":
        more = f" (and {len(objections) - 1} more, in kinematics.json)" if objections[1:] else ""
        raise LegsimError(
            f"{recording}: {objections[0]}{more}; check the recording and its marker map, or scan "
            "it all the same with --force"
        )


def exposures(stage: StageContext, setup: ScanSetup) -> tuple[Projections, Projections]:
    """Projects the moving phantom, and the one that keeps the first view's pose.

    Each has noise of its own.
    """
    folder, key = stage.folder, stage.scan_key

    def write_geometry() -> tuple[str, ...]:
        for name in ("geometry.json", "geometry_rtk.xml"):
            geometry_files.save_geometry(folder.path / name, setup.geometry)
        return "geometry.json", "geometry_rtk.xml"

    folder.cached("geometry", key, write_geometry)
    made = []
    for exposure, (name, moving) in enumerate(
        (("projections", True), ("projections-static", False))
    ):

        def write(name: str = name, moving: bool = moving, exposure: int = exposure):
            drawing = _photons(stage.settings, exposure)
            images = expose(setup, moving, stage.device, drawing, stage.on_progress)
            image_files.save_projections(folder.path / f"{name}.mha", images)
            return (f"{name}.mha",)

        folder.cached(name, key, write)
        made.append(image_files.load_projections(folder.path / f"{name}.mha", setup.geometry))
    return made[0], made[1]


def _photons(settings: RunConfig, exposure: int) -> np.random.Generator:
    """Random generator that also depends on the recording's content.

    Scans of one study share a seed, not their noise.
    """
    recording = int(run_motion.fingerprint(settings.motion)[0][:16], 16)
    return np.random.default_rng([settings.seed, _PHOTONS, exposure, recording])


def starts(
    settings: RunConfig, setup: ScanSetup, signals: ImuSignals, device: Device | None = None
) -> Starts:
    """Starts of each sensor's integration, by methods.start; leveled after a rest.

    Places and velocities are as scan.toml holds them, to the last bit. The device renders fiducials
    that are found in images.
    """
    found = initialization.leveled(_starts(settings, setup, signals, device), signals)
    return replace(found, starts=tuple(_as_written(start) for start in found.starts))


def _as_written(start: SensorStart) -> SensorStart:
    pose = np.array(start.world_from_sensor)
    pose[:3, 3] = to_nanometers(pose[:3, 3])
    return SensorStart(pose, to_nanometers(start.velocity))


def start_errors(methods: MethodsConfig) -> StartErrors:
    """How far starts may be off, by methods.start; fiducials are trusted no more than a hand."""
    if methods.start == "truth":
        return rough_start.EXACT
    wanted = methods.rough
    return StartErrors(
        float(np.radians(wanted.tilt_deg)),
        float(np.radians(wanted.heading_deg)),
        1e-3 * wanted.velocity_mm_per_s,
        1e-3 * wanted.place_mm,
    )


def fiducial_scan(setup: ScanSetup, device: Device | None) -> FiducialScan:
    """The scan in which fiducials are found, its pixels as of the scan itself."""
    return FiducialScan(
        setup.geometry, setup.poses, setup.phantom, device, setup.c_arm.rays_per_pixel
    )


def fiducial_options(wanted: FiducialsConfig) -> FiducialOptions:
    """Builds the configured fiducials in SI units."""
    return FiducialOptions(
        Fiducials(1e-3 * wanted.axis_length_mm),
        wanted.views,
        wanted.detector,
        wanted.found,
        wanted.error_px,
        0.5e-3 * wanted.bead_mm,
    )


def _rough_sentence(rough: RoughConfig) -> str:
    return (
        f"Poses start roughly: {rough.tilt_deg:g} deg of tilt, {rough.heading_deg:g} deg of "
        f"heading and {rough.place_mm:g} mm per axis off (standard deviations), with no speed."
    )


def _starts(
    settings: RunConfig, setup: ScanSetup, signals: ImuSignals, device: Device | None
) -> Starts:
    person = setup.person
    exact = initialization.from_truth(
        person.leg, person.splines, setup.sensors, float(setup.times[0])
    )
    if settings.methods.start == "truth":
        return exact
    if settings.methods.start == "rough":
        rng = np.random.default_rng([settings.seed, STARTS])
        return Starts(
            rough_start.rough(exact.starts, start_errors(settings.methods), rng),
            (_rough_sentence(settings.methods.rough),),
        )
    return initialization.from_fiducials(
        signals,
        setup.sensors,
        fiducial_scan(setup, device),
        simulation.sensor_poses(person.leg, person.splines, setup.sensors, setup.times),
        fiducial_options(settings.methods.fiducials),
        scheme=settings.methods.scheme,
        rng=np.random.default_rng([settings.seed, STARTS]),
    )
