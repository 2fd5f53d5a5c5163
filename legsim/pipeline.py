"""The whole chain on one screen: a recording becomes a moving leg, the leg a scan, the scan volumes, the volumes a table.

:func:`run` lists the stages; each is skipped where the run folder's manifest vouches for its files.
"""

import json
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from legsim import (
    __version__,
    acquisition,
    artifacts,
    comparison,
    config,
    evaluation,
    geometry_files,
    images,
    imu,
    leg_phantom,
    opencl,
    presentation,
    reconstruction,
    recovery,
    replay_report,
    report,
    sensing,
    soft_tissue,
    storage,
    transforms,
    view,
    voxelizer,
    whole_files,
    wobble,
)
from legsim.acquisition import Imaging
from legsim.artifacts import RunFolder, key_of
from legsim.config import RunConfig
from legsim.correction import Scan
from legsim.evaluation import Region
from legsim.geometry import Projections, VolumeGrid
from legsim.imu import JointSplines, Sensor
from legsim.opencl import Device
from legsim.presentation import MethodResult
from legsim.reconstruction import Reconstructed
from legsim.recovery import Recovery
from legsim.scanned_leg import OnProgress, ScannedLeg, Stage
from legsim.sensing import FiducialScan, Starts
from legsim.signals import ImuSignals, RigidMotion
from legsim.soft_tissue import SoftTissue
from legsim.stage_store import StageStore

_NOISE, _STARTS, _PHOTONS = 1, 2, 4
"""streams of the run's seed"""


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run ends with."""

    folder: Path
    methods: tuple[MethodResult, ...]

    @property
    def region_names(self) -> tuple[str, ...]:
        """Regions in the order of the table."""
        return tuple(r.region for r in self.methods[0].metrics.regions)

    def columns(self) -> tuple[str, ...]:
        """Heads of :meth:`rows`."""
        measures = (f"{kind} {region}" for kind in ("SSIM", "RMSE") for region in self.region_names)
        return ("method", *measures, *(f"{r.structure} mm" for r in self.methods[0].residuals), "bones px", "seconds")

    def rows(self) -> list[tuple[str, ...]]:
        """Method, SSIM by region, RMSE by region, what was not undone by structure and at the bones in the images, seconds."""
        return [
            (
                m.method,
                *(f"{r.ssim:.3f}" for r in m.metrics.regions),
                *(f"{r.rmse:.3f}" for r in m.metrics.regions),
                *("-" if r.mm is None else f"{r.mm:.2f}" for r in m.residuals),
                f"{m.residual_px:.2f}",
                f"{m.seconds:.1f}",
            )
            for m in self.methods
        ]

    def places(self) -> list[str]:
        """Where to look."""
        names = {"report": "report.html", "recording": "recording.rrd", "pictures": "pictures", "numbers": "metrics.json"}
        return [f"{what}: {self.folder / name}" for what, name in names.items()] + [f"to look around: legsim view {self.folder}"]


def run(
    settings: RunConfig,
    out: Path,
    *,
    device: str | None = None,
    on_progress: OnProgress,
    store: StageStore | None = None,
    presented: bool = True,
) -> RunResult:
    """One scan, from the recording to report and recording in ``out``.

    Stages that ``store`` holds are taken from there. Without ``presented`` the run ends at the numbers: no report, no recording.
    """
    reconstruction.check(settings)  # what no method can be run with is told before anything is computed
    how = acquisition.imaging(settings.scan)  # so is a spectrum
    opened = opencl.open_device(device)
    folder = RunFolder(out, _about(settings, opened), store)
    whole_files.write_text(out / "config.toml", config.dump(settings))
    body = _body(settings, folder, on_progress)
    signals = _sense(settings, body.recovery, body.splines, body.sensors, folder, _motion_key(settings))
    starts = _starts(settings, body, signals, opened)
    moving, still = _scan(settings, body, how, folder, opened, on_progress)
    scan = Scan(moving, signals, starts.starts)
    grid = acquisition.volume_grid(settings.grid, body.geometry.rotation_center())
    stage = Stage(settings, folder, opened, _scan_key(settings), on_progress)
    corrected = reconstruction.reconstruct(stage, body, scan, still, grid)
    results = comparison.compare(stage, body, corrected, lambda: _regions(settings, body, grid, opened), grid)
    if presented:
        _present(settings, body, signals, moving, corrected, results, starts, folder, on_progress)
    return RunResult(out, results)


def _about(settings: RunConfig, device: Device) -> dict[str, Any]:
    dumped = config.dump(settings)
    return {
        "legsim": __version__,
        "commit": _commit(),
        "config_hash": key_of(dumped),
        "seed": settings.seed,
        "device": device.label,
        "sensors": sensing.noise_sentence(settings.imu, view_rate_hz=settings.scan.rate_hz),
        "start": settings.methods.start,
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
    return key_of(
        _motion_key(settings),
        settings.scan.model_dump(),
        settings.phantom.model_dump(),
        acquisition.fingerprint(settings.scan, settings.seed),
    )


def _body(settings: RunConfig, folder: RunFolder, on_progress: OnProgress) -> ScannedLeg:
    """Solves the recording for joint angles and poses the phantom's skeleton at every view."""
    on_progress("joint angles", 0, 1)
    recovered = recovery.recover(settings.motion)
    _write_kinematics(recovered, folder, _motion_key(settings))
    splines = JointSplines(recovered.trajectories)
    times = acquisition.view_times(settings.scan, recovered.trajectories.times)
    poses = imu.segment_poses_at(recovered.leg, splines, times)
    isocenter = recovered.leg.joint_centers(poses).of("knee_l")[0]
    geometry = acquisition.c_arm(settings.scan, times, isocenter)
    wanted = settings.phantom
    if wanted.wobble.amplitude > 0:
        poses = wobble.swinging(poses, recovered.leg, splines, _tissue(wanted.wobble))
    phantom = leg_phantom.load(
        scales=recovered.leg.scales, detail=wanted.detail, energy_kev=wanted.energy_kev, swinging=wanted.wobble.amplitude > 0
    )
    phantom = phantom.one_leg("l") if wanted.legs == "left" else phantom
    on_progress("joint angles", 1, 1)
    return ScannedLeg(recovered, splines, sensors(settings.imu), poses, phantom, geometry)


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


def _tissue(settings: config.SoftTissueConfig) -> SoftTissue:
    return SoftTissue(settings.frequency_hz, settings.damping, settings.amplitude)


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
        whole_files.write_text(folder.path / "kinematics.json", json.dumps(recovered.summary(), indent=1) + "\n")


def _sense(
    settings: RunConfig, recovered: Recovery, splines: JointSplines, placed: tuple[Sensor, ...], folder: RunFolder, motion_key: str
) -> ImuSignals:
    """The IMU signals over the whole recording, at the sensors' own rate."""
    drawn = () if settings.imu.noise.kind == "none" else (settings.seed, settings.scan.rate_hz)
    key = key_of(motion_key, settings.imu.model_dump(), drawn)
    if folder.done("imu", key):
        return artifacts.load_imu(folder.path / "imu.csv")
    with folder.stage("imu", key, ["imu.csv"]):
        clean = sense(recovered, splines, placed, settings.imu)
        drawing = np.random.default_rng([settings.seed, _NOISE])
        signals = sensing.noisy(clean, settings.imu, view_rate_hz=settings.scan.rate_hz, rng=drawing)
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
    if settings.soft_tissue.amplitude > 0:
        signals = soft_tissue.swing(signals, _tissue(settings.soft_tissue)).signals
    return replace(signals, times=signals.times + settings.clock_offset_s)


def _scan(
    settings: RunConfig, body: ScannedLeg, how: Imaging, folder: RunFolder, device: Device, on_progress: OnProgress
) -> tuple[Projections, Projections]:
    """Projections of the moving phantom, and of the one that keeps the first view's pose; each with noise of its own."""
    key = _scan_key(settings)
    if not folder.done("geometry", key):
        with folder.stage("geometry", key, ["geometry.json", "geometry_rtk.xml"]):
            geometry_files.save(folder.path / "geometry.json", body.geometry)
            geometry_files.save(folder.path / "geometry_rtk.xml", body.geometry)
    exposures = []
    for exposure, (name, poses) in enumerate((("projections", body.poses), ("projections-static", body.poses.held_at(0)))):
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
                images.save_projections(path, exposed)
        exposures.append(images.load_projections(path, body.geometry))
    return exposures[0], exposures[1]


def _photons(settings: RunConfig, exposure: int) -> np.random.Generator:
    """By the recording's content too: scans of one study share a seed, and must not share their noise."""
    recording = int(recovery.fingerprint(settings.motion)[0][:16], 16)
    return np.random.default_rng([settings.seed, _PHOTONS, exposure, recording])


def _starts(settings: RunConfig, body: ScannedLeg, signals: ImuSignals, device: Device) -> Starts:
    """Where each sensor's integration begins, as methods.start says."""
    if settings.methods.start == "truth":
        return sensing.true_starts(body.recovery.leg, body.splines, body.sensors, float(body.times[0]))
    true_poses = imu.sensor_poses(body.recovery.leg, body.splines, body.sensors, body.times)
    return sensing.found_starts(
        signals,
        body.sensors,
        FiducialScan(body.geometry, body.poses, body.phantom, device),
        true_poses,
        settings.methods.fiducials,
        scheme=settings.methods.scheme,
        rng=np.random.default_rng([settings.seed, _STARTS]),
    )


def _regions(settings: RunConfig, body: ScannedLeg, grid: VolumeGrid, device: Device) -> tuple[Region, ...]:
    """Whole leg, shank and thigh of the scanned leg, from the phantom's truth at the reference pose."""
    vertices = body.phantom.posed(body.poses.world_from_segment[0], body.poses.segment_names)
    left = [k for k, part in enumerate(body.phantom.phantom.parts) if part.name.endswith("_l")]
    leg = body.phantom.phantom.only(left).with_vertices(tuple(vertices[k] for k in left))
    labels = voxelizer.labels(leg, grid, device)
    knee = float(body.recovery.leg.joint_centers(body.poses).of("knee_l")[0, 1])
    return evaluation.leg_regions(
        labels, grid, knee, acquisition.seen_by_every_view(settings.scan, grid), 1e-3 * settings.evaluation.air_margin_mm
    )


def _present(
    settings: RunConfig,
    body: ScannedLeg,
    signals: ImuSignals,
    moving: Projections,
    corrected: tuple[Reconstructed, ...],
    results: tuple[MethodResult, ...],
    starts: Starts,
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
        scene = presentation.scan_scene(replayed, body.phantom, body.poses, moving, [c.volume for c in corrected])
        view.write_scan(folder.path / "recording.rrd", scene)
        on_progress("recording and report", 1, 2)
        truth = RigidMotion.from_poses(body.times, body.poses.of("tibia_l"))
        rigid = [(c.volume.name, c.motion) for c in corrected if isinstance(c.motion, RigidMotion)]
        drawn = presentation.scan_figures(scene, truth, rigid, body.poses.of("tibia_l")[0, :3, 3])
        pictures = presentation.write_pictures(folder.path / "pictures", drawn)
        provenance = [(what, str(value)) for what, value in folder.about.items()] + [
            ("command", f"legsim run config.toml --out {folder.path.name}")
        ]
        summary = _summary(settings, results, (*starts.notes, *(note for c in corrected for note in c.notes)))
        content = presentation.scan_report(body.recovery, results, pictures, summary, provenance)
        whole_files.write_text(folder.path / "report.html", report.render(content))
        on_progress("recording and report", 2, 2)


def _summary(settings: RunConfig, results: tuple[MethodResult, ...], notes: Sequence[str]) -> list[str]:
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
    lines += [acquisition.sentence(scan, settings.phantom), sensing.noise_sentence(settings.imu, view_rate_hz=scan.rate_hz), *notes]
    if settings.imu.noise.kind == "none" and settings.methods.start == "truth":
        lines.append("With clean signals and a true start these are ceilings, not what a real sensor would reach.")
    if "oracle-nonrigid" in shown:
        lines.append(
            "The phantom's soft tissue follows the bones by its own skinning, which moving least squares between joints only resembles: "
            "how the two differ is part of the error of the non-rigid methods, and a real leg would differ from both."
        )
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
    about = {
        "legsim": __version__,
        "commit": _commit(),
        "config_hash": key_of(config.dump(settings)),
        "sensors": sensing.noise_sentence(settings.imu, view_rate_hz=settings.scan.rate_hz),
    }
    folder = RunFolder(out, about)
    on_progress("joint angles", 0, 1)
    recovered = recovery.recover(settings.motion, filter_coordinates=filtered)
    motion_key = key_of(_motion_key(settings), filtered) if filtered else _motion_key(settings)
    _write_kinematics(recovered, folder, motion_key)
    on_progress("joint angles", 1, 1)
    on_progress("sensors", 0, 1)
    splines, placed = JointSplines(recovered.trajectories), sensors(settings.imu)
    signals = _sense(settings, recovered, splines, placed, folder, motion_key)
    on_progress("sensors", 1, 1)
    on_progress("recording", 0, 1)
    scene = presentation.replay_scene(recovered, splines, placed, signals, leg_phantom.load(scales=recovered.leg.scales))
    provenance = (*folder.about.items(), ("command", f"legsim replay {settings.motion.file} --out {out}"))
    key = key_of(motion_key, provenance)
    known = folder.done("replay", key)
    posture = replay_report.still(scene) if image is not None or not known else b""
    if not known:
        with folder.stage("replay", key, ["recording.rrd", "report.html"]):
            view.write_replay(out / "recording.rrd", scene)
            page = replay_report.content(recovered, scene, posture, provenance)
            whole_files.write_text(out / "report.html", report.render(page))
    if image is not None:
        whole_files.write_bytes(image, posture)
    on_progress("recording", 1, 1)
    return ReplayResult(tuple(presentation.replay_report_lines(recovered, out)))
