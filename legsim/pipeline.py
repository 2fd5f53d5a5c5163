"""The whole chain on one screen: a recording becomes a moving leg, the leg a scan, the scan volumes, the volumes a table.

:func:`run` lists the stages; each is skipped where the run folder's manifest vouches for its files.
"""

import json
import subprocess
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from legsim import (
    __version__,
    acquisition,
    artifacts,
    config,
    correction,
    evaluation,
    fdk,
    figures,
    geometry_files,
    images,
    imu,
    leg_phantom,
    methods,
    opencl,
    presentation,
    recovery,
    report,
    soft_tissue,
    storage,
    transforms,
    view,
    voxelizer,
)
from legsim.artifacts import RunFolder, key_of
from legsim.config import RunConfig
from legsim.correction import Scan
from legsim.evaluation import Metrics, Region, RegionMetrics, Registration
from legsim.geometry import ConeBeamGeometry, Projections, VolumeGrid
from legsim.imu import JointSplines, Sensor
from legsim.leg_phantom import LegPhantom
from legsim.mls import AttachedPoint
from legsim.opencl import Device
from legsim.presentation import MethodResult
from legsim.recovery import Recovery
from legsim.scene import NamedVolume
from legsim.signals import ImuSignals, RigidMotion, SegmentPoses
from legsim.soft_tissue import SoftTissue

OnProgress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run ends with."""

    folder: Path
    methods: tuple[MethodResult, ...]

    @property
    def region_names(self) -> tuple[str, ...]:
        """Regions in the order of the table."""
        return tuple(r.region for r in self.methods[0].metrics.regions)

    def rows(self) -> list[tuple[str, ...]]:
        """Method, SSIM by region, RMSE by region, residual, seconds."""
        return [
            (
                m.method,
                *(f"{r.ssim:.3f}" for r in m.metrics.regions),
                *(f"{r.rmse:.3f}" for r in m.metrics.regions),
                "-" if m.residual_mm is None else f"{m.residual_mm:.2f}",
                f"{m.seconds:.1f}",
            )
            for m in self.methods
        ]

    def places(self) -> list[str]:
        """Where to look."""
        names = {"report": "report.html", "recording": "recording.rrd", "pictures": "pictures", "numbers": "metrics.json"}
        return [f"{what}: {self.folder / name}" for what, name in names.items()] + [f"to look around: legsim view {self.folder}"]


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """The moving person, as every stage after the first needs it."""

    recovery: Recovery
    splines: JointSplines
    sensors: tuple[Sensor, ...]
    times: np.ndarray
    """(v,) s of the views"""
    poses: SegmentPoses
    """of the segments at the views"""
    phantom: LegPhantom
    geometry: ConeBeamGeometry


def run(settings: RunConfig, out: Path, *, device: str | None = None, on_progress: OnProgress) -> RunResult:
    """One scan, from the recording to report and recording in ``out``."""
    opened = opencl.open_device(device)
    folder = RunFolder(out, _about(settings, opened))
    artifacts.write_text(out / "config.toml", config.dump(settings))
    body = _body(settings, folder, on_progress)
    signals = _sense(settings, body, folder)
    moving, still = _scan(settings, body, folder, opened, on_progress)
    scan = Scan(moving, signals, tuple(imu.true_start(body.recovery.leg, body.splines, s, float(body.times[0])) for s in body.sensors))
    grid = acquisition.volume_grid(settings.grid, body.geometry.rotation_center())
    volumes, motions = _reconstruct(settings, body, scan, still, grid, folder, opened, on_progress)
    regions = _regions(settings, body, grid, opened)
    results = _compare(settings, body, volumes, motions, regions, folder, on_progress)
    _present(settings, body, signals, moving, volumes, motions, results, folder, on_progress)
    return RunResult(out, results)


def _about(settings: RunConfig, device: Device) -> dict[str, Any]:
    dumped = config.dump(settings)
    return {
        "legsim": __version__,
        "commit": _commit(),
        "config_hash": key_of(dumped),
        "seed": settings.seed,
        "device": device.label,
    }


def _commit() -> str:
    """The commit of a checkout, empty for an installed package."""
    asked = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    if not (Path(__file__).parents[1] / ".git").exists():
        return ""
    answer = subprocess.run(asked, capture_output=True, text=True, check=False)
    return answer.stdout.strip()


def _motion_key(settings: RunConfig) -> str:
    return key_of(__version__, settings.motion.model_dump(), recovery.fingerprint(settings.motion))


def _scan_key(settings: RunConfig) -> str:
    return key_of(_motion_key(settings), settings.scan.model_dump(), settings.phantom.model_dump())


def _body(settings: RunConfig, folder: RunFolder, on_progress: OnProgress) -> _Body:
    """Solves the recording for joint angles and poses the phantom's skeleton at every view."""
    on_progress("joint angles", 0, 1)
    recovered = recovery.recover(settings.motion)
    _write_kinematics(recovered, folder, _motion_key(settings))
    splines = JointSplines(recovered.trajectories)
    times = acquisition.view_times(settings.scan, recovered.trajectories.times)
    poses = imu.segment_poses_at(recovered.leg, splines, times)
    isocenter = recovered.leg.joint_centers(poses).of("knee_l")[0]
    geometry = acquisition.c_arm(settings.scan, times, isocenter)
    phantom = leg_phantom.load(scales=recovered.leg.scales, detail=settings.phantom.detail, energy_kev=settings.phantom.energy_kev)
    on_progress("joint angles", 1, 1)
    return _Body(recovered, splines, sensors(settings.imu), times, poses, phantom, geometry)


def sensors(settings: config.ImuConfig) -> tuple[Sensor, ...]:
    """The configured sensors in SI units."""
    return tuple(
        Sensor(
            s.name,
            s.segment,
            1e-3 * s.distance_mm,
            1e-3 * np.array(s.offset_mm),
            transforms.rotation_from_vector(np.radians(s.rotation_deg)),
        )
        for s in settings.sensors
    )


def _write_kinematics(recovered: Recovery, folder: RunFolder, key: str) -> None:
    files = ["coordinates.mot", "joint_centres.csv", "poses.npz", "kinematics.json"]
    if folder.done("kinematics", key):
        return
    with folder.stage("kinematics", key, files):
        poses = recovered.leg.segment_poses(recovered.trajectories)
        centers = recovered.leg.joint_centers(poses)
        storage.save(folder.path / "coordinates.mot", recovered.trajectories)
        artifacts.save_joint_centers(folder.path / "joint_centres.csv", centers.times, centers.names, centers.positions_world)
        artifacts.save_poses(folder.path / "poses.npz", poses)
        artifacts.write_text(folder.path / "kinematics.json", json.dumps(recovered.summary(), indent=1) + "\n")


def _sense(settings: RunConfig, body: _Body, folder: RunFolder) -> ImuSignals:
    """The IMU signals over the whole recording, at the sensors' own rate."""
    key = key_of(_motion_key(settings), settings.imu.model_dump())
    if folder.done("imu", key):
        return artifacts.load_imu(folder.path / "imu.csv")
    with folder.stage("imu", key, ["imu.csv"]):
        signals = sense(body.recovery, body.splines, body.sensors, settings.imu)
        artifacts.save_imu(folder.path / "imu.csv", signals)
    return signals


def sense(recovered: Recovery, splines: JointSplines, placed: tuple[Sensor, ...], settings: config.ImuConfig) -> ImuSignals:
    """What the sensors read from the first to the last sample of the recording, swinging on soft tissue and by their own clock.

    ``clock_offset_s`` is the sensors' clock less the recording's, which is the C-arm's: the times of the signals are shifted by it, and
    whoever takes them for the C-arm's looks up the movement that much too early. Poses and views stay in the recording's time.
    """
    first, last = recovered.trajectories.times[[0, -1]]
    times = first + np.arange(int(np.floor((last - first) * settings.rate_hz + 1e-6)) + 1) / settings.rate_hz
    signals = imu.simulate(recovered.leg, splines, placed, np.minimum(times, last))
    tissue = settings.soft_tissue
    if tissue.amplitude > 0:
        signals = soft_tissue.swing(signals, SoftTissue(tissue.frequency_hz, tissue.damping, tissue.amplitude)).signals
    return replace(signals, times=signals.times + settings.clock_offset_s)


def _scan(settings: RunConfig, body: _Body, folder: RunFolder, device: Device, on_progress: OnProgress) -> tuple[Projections, Projections]:
    """Projections of the moving phantom, and of the one that keeps the first view's pose."""
    key = _scan_key(settings)
    if not folder.done("geometry", key):
        with folder.stage("geometry", key, ["geometry.json", "geometry_rtk.xml"]):
            geometry_files.save(folder.path / "geometry.json", body.geometry)
            geometry_files.save(folder.path / "geometry_rtk.xml", body.geometry)
    exposures = []
    for name, poses in (("projections", body.poses), ("projections-static", body.poses.held_at(0))):
        path = folder.path / f"{name}.mha"
        if not folder.done(name, key):
            with folder.stage(name, key, [path.name]):
                shown = "projecting" if poses is body.poses else "projecting, at rest"
                exposed = acquisition.expose(body.phantom, poses, body.geometry, device, partial(on_progress, shown))
                images.save_projections(path, exposed)
        exposures.append(images.load_projections(path, body.geometry))
    return exposures[0], exposures[1]


def _reconstruct(
    settings: RunConfig,
    body: _Body,
    scan: Scan,
    still: Projections,
    grid: VolumeGrid,
    folder: RunFolder,
    device: Device,
    on_progress: OnProgress,
) -> tuple[tuple[NamedVolume, ...], dict[str, RigidMotion]]:
    """A volume a method, the motion-free one first; and the rigid motions that were estimated."""
    truth = correction.rigid_motion(body.times, body.poses.of("tibia_l"))
    setup = methods.Setup(settings.methods.scheme, settings.methods.sensor, _carried_joints(body, scan), device, truth)
    names = list(dict.fromkeys([methods.REFERENCE, *settings.methods.run]))
    corrections = {name: methods.build(name, setup) for name in names if name != methods.REFERENCE}
    volumes, motions = [], {}
    for name in names:
        label = methods.label(name)
        key = key_of(
            _scan_key(settings),
            settings.imu.model_dump(),
            settings.methods.scheme,
            settings.methods.sensor,
            settings.grid.model_dump(),
            methods.fingerprint(name),
        )
        path, motion_path = folder.path / f"volume-{label}.mha", folder.path / f"motion-{label}.npz"
        if not folder.done(f"volume-{label}", key):
            files = [path.name]
            with folder.stage(f"volume-{label}", key, files):
                found = correction.Correction(label, still, None) if name == methods.REFERENCE else corrections[name](scan)
                if found.motion is not None:
                    artifacts.save_motion(motion_path, found.motion)
                    files.append(motion_path.name)
                volume = fdk.reconstruct(
                    found.projections, grid, device, motion=found.motion, progress=partial(on_progress, f"reconstructing {label}")
                )
                images.save_volume(path, volume)
        volumes.append(NamedVolume(label, images.load_volume(path)))
        motion = artifacts.load_motion(motion_path) if folder.has(motion_path.name) else None
        if isinstance(motion, RigidMotion):
            motions[label] = motion
    return tuple(volumes), motions


def _carried_joints(body: _Body, scan: Scan) -> tuple[AttachedPoint, ...]:
    """Left hip by the thigh's sensor, knee and ankle by the shank's: the first of the sensors on each segment."""
    centers = body.recovery.leg.joint_centers(body.poses)
    carried = []
    for joint, segment in (("hip_l", "femur_l"), ("knee_l", "tibia_l"), ("ankle_l", "tibia_l")):
        sensor = next((s.name for s in body.sensors if s.segment == segment), None)
        if sensor is not None:
            carried.append(AttachedPoint.at_start(sensor, scan.start(sensor).world_from_sensor, centers.of(joint)[0]))
    return tuple(carried)


def _regions(settings: RunConfig, body: _Body, grid: VolumeGrid, device: Device) -> tuple[Region, ...]:
    """Whole leg, shank and thigh of the scanned leg, from the phantom's truth at the reference pose."""
    vertices = body.phantom.posed(body.poses.world_from_segment[0], body.poses.segment_names)
    left = [k for k, part in enumerate(body.phantom.phantom.parts) if part.name.endswith("_l")]
    leg = body.phantom.phantom.only(left).with_vertices(tuple(vertices[k] for k in left))
    labels = voxelizer.labels(leg, grid, device)
    knee = float(body.recovery.leg.joint_centers(body.poses).of("knee_l")[0, 1])
    return evaluation.leg_regions(labels, grid, knee, acquisition.field_of_view(settings.scan), 1e-3 * settings.evaluation.air_margin_mm)


def _compare(
    settings: RunConfig,
    body: _Body,
    volumes: tuple[NamedVolume, ...],
    motions: dict[str, RigidMotion],
    regions: tuple[Region, ...],
    folder: RunFolder,
    on_progress: OnProgress,
) -> tuple[MethodResult, ...]:
    """Every volume against the motion-free one; written to metrics.json."""
    path = folder.path / "metrics.json"
    key = key_of(
        _motion_key(settings), settings.evaluation.model_dump(), [(v.name, folder.hash_of(f"volume-{v.name}.mha")) for v in volumes]
    )
    if folder.done("metrics", key):
        return tuple(_result(entry) for entry in json.loads(path.read_text("utf-8"))["methods"])
    with folder.stage("metrics", key, [path.name]):
        results = []
        for k, named in enumerate(volumes):
            on_progress("comparing", k, len(volumes))
            metrics = evaluation.evaluate(named.volume, volumes[0].volume, regions, register=settings.evaluation.register_volumes)
            residual = _residual_of(body.poses, named.name, motions)
            results.append(MethodResult(named.name, metrics, residual, folder.seconds(f"volume-{named.name}")))
        on_progress("comparing", len(volumes), len(volumes))
        content = {"scaling": "each volume to 0..1 inside the regions", "methods": [asdict(r) for r in results]}
        artifacts.write_text(path, json.dumps(content, indent=1) + "\n")
    return tuple(results)


def _result(entry: dict[str, Any]) -> MethodResult:
    """From an entry of metrics.json."""
    regions = tuple(RegionMetrics(**r) for r in entry["metrics"]["regions"])
    registration = entry["metrics"]["registration"]
    metrics = Metrics(regions, None if registration is None else Registration(**registration))
    return MethodResult(entry["method"], metrics, entry["residual_mm"], entry["seconds"])


def _residual_of(poses: SegmentPoses, method: str, motions: dict[str, RigidMotion]) -> float | None:
    if method == "uncorrected":
        return residual_mm(poses, None)
    return residual_mm(poses, motions[method]) if method in motions else None


def residual_mm(poses: SegmentPoses, motion: RigidMotion | None) -> float:
    """RMS (mm) over views and both bones of the left knee of the motion that was not undone; None undoes nothing.

    The points are the knee center, carried by the tibia, and the same point carried by the femur, each with three neighbors 5 cm
    off along the axes, so that rotation counts.
    """
    around = np.vstack([np.zeros(3), 0.05 * np.eye(3)])
    undone = RigidMotion.identity(poses.times) if motion is None else motion
    knee = poses.of("tibia_l")[0, :3, 3]
    remaining = [
        evaluation.residual_displacement(
            undone.moved_from_reference, RigidMotion.from_poses(poses.times, poses.of(bone)).moved_from_reference, knee + around
        )
        for bone in ("tibia_l", "femur_l")
    ]
    return float(1e3 * np.sqrt(np.mean(np.square(remaining))))


def _present(
    settings: RunConfig,
    body: _Body,
    signals: ImuSignals,
    moving: Projections,
    volumes: tuple[NamedVolume, ...],
    motions: dict[str, RigidMotion],
    results: tuple[MethodResult, ...],
    folder: RunFolder,
    on_progress: OnProgress,
) -> None:
    """The recording, the pictures and the report."""
    files = ["recording.rrd", "report.html"]
    key = key_of(_scan_key(settings), settings.model_dump(), folder.hash_of("metrics.json"))
    if folder.done("presentation", key):
        return
    with folder.stage("presentation", key, files):
        on_progress("recording and report", 0, 2)
        replayed = presentation.replay_scene(body.recovery, body.splines, body.sensors, signals, body.phantom)
        scene = presentation.scan_scene(replayed, body.phantom, body.poses, moving, volumes)
        view.write_scan(folder.path / "recording.rrd", scene)
        on_progress("recording and report", 1, 2)
        truth = RigidMotion.from_poses(body.times, body.poses.of("tibia_l"))
        drawn = presentation.scan_figures(scene, truth, list(motions.items()), body.poses.of("tibia_l")[0, :3, 3])
        pictures = presentation.write_pictures(folder.path / "pictures", drawn)
        provenance = [(what, str(value)) for what, value in folder.about.items()] + [
            ("command", f"legsim run config.toml --out {folder.path.name}")
        ]
        summary = _summary(settings, results)
        content = presentation.scan_report(body.recovery, results, pictures, summary, provenance, ())
        artifacts.write_text(folder.path / "report.html", report.render(content))
        on_progress("recording and report", 2, 2)


def _summary(settings: RunConfig, results: tuple[MethodResult, ...]) -> list[str]:
    """The report's first sentences."""
    scan, grid = settings.scan, settings.grid
    lines = [
        f"{scan.views} views of {scan.columns}x{scan.rows} pixels over {(scan.views - 1) * scan.increment_deg:.1f} degrees in "
        f"{(scan.views - 1) / scan.rate_hz:.1f} s; {grid.voxels}^3 voxels of {grid.voxel_mm:g} mm."
    ]
    shown = {r.method: r for r in results}
    if {"uncorrected", "rigid"} <= shown.keys():
        before, after = (shown[name].metrics.regions[0] for name in ("uncorrected", "rigid"))
        lines.append(
            f"Motion lowers SSIM to {before.ssim:.3f} and raises RMSE to {before.rmse:.3f}; following the {settings.methods.sensor} sensor "
            f"rigidly brings {after.ssim:.3f} and {after.rmse:.3f}."
        )
    lines.append("IMU signals are free of noise and poses start from the truth: these are ceilings, not what a real sensor would reach.")
    return lines


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """What a replay ends with."""

    printed: tuple[str, ...]

    def lines(self) -> tuple[str, ...]:
        """What to print."""
        return self.printed


def replay(settings: RunConfig, out: Path, *, filtered: bool, image: Path | None, on_progress: OnProgress) -> ReplayResult:
    """Kinematics, IMU signals and a recording of one motion file; nothing is scanned."""
    folder = RunFolder(out, {"legsim": __version__, "commit": _commit(), "config_hash": key_of(config.dump(settings))})
    on_progress("joint angles", 0, 1)
    recovered = recovery.recover(settings.motion, filter_coordinates=filtered)
    _write_kinematics(recovered, folder, key_of(_motion_key(settings), filtered))
    on_progress("joint angles", 1, 1)
    on_progress("sensors", 0, 1)
    splines, placed = JointSplines(recovered.trajectories), sensors(settings.imu)
    signals = sense(recovered, splines, placed, settings.imu)
    key = key_of(_motion_key(settings), filtered, settings.imu.model_dump())
    with folder.stage("imu", key, ["imu.csv"]):
        artifacts.save_imu(out / "imu.csv", signals)
    on_progress("sensors", 1, 1)
    on_progress("recording", 0, 1)
    scene = presentation.replay_scene(recovered, splines, placed, signals, leg_phantom.load(scales=recovered.leg.scales))
    with folder.stage("recording", key, ["recording.rrd"]):
        view.write_replay(out / "recording.rrd", scene)
    if image is not None:
        middle = float(np.mean(recovered.trajectories.times[[0, -1]]))
        with artifacts.whole(image) as partial:
            partial.write_bytes(figures.png(figures.still(scene, middle)))
    on_progress("recording", 1, 1)
    return ReplayResult(tuple(presentation.replay_report_lines(recovered, out)))
