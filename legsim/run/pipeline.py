"""The whole chain on one screen: a recording becomes a moving leg, the leg a scan, the scan
volumes, the volumes a table.

:func:`run` lists the stages; each is skipped where the run folder's manifest vouches for its files.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from legsim import __version__, config, view
from legsim.config import RunConfig
from legsim.core.files import key_of, write_text
from legsim.core.progress import OnProgress
from legsim.correction.initialization import Starts
from legsim.correction.method import Scan
from legsim.deformation.models import RigidMotion
from legsim.evaluation.scores import MethodResult
from legsim.geometry.cone_beam import Projections
from legsim.imu.signals import ImuSignals
from legsim.opencl.device import Device, open_device
from legsim.report import page, scan_page
from legsim.run import c_arm, scores, sensors, stages, volumes
from legsim.run.folder import RunFolder, commit
from legsim.run.stages import (
    ScanSetup,
    StageContext,
    motion_key,
    read_sensors,
    regions,
    scan_key,
    set_up,
)
from legsim.run.store import StageCache
from legsim.run.volumes import Reconstructed
from legsim.scene import build


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
        return (
            "method",
            *measures,
            *(f"{r.structure} mm" for r in self.methods[0].residuals),
            "bones px",
            "seconds",
        )

    def rows(self) -> list[tuple[str, ...]]:
        """Method, SSIM by region, RMSE by region, what was not undone by structure and at the bones
        in the images, seconds.
        """
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
        names = {
            "report": "report.html",
            "recording": "recording.rrd",
            "pictures": "pictures",
            "numbers": "metrics.json",
        }
        return [f"{what}: {self.folder / name}" for what, name in names.items()] + [
            f"to look around: legsim view {self.folder}"
        ]


def run(
    settings: RunConfig,
    out: Path,
    *,
    device: str | None = None,
    on_progress: OnProgress,
    store: StageCache | None = None,
    presented: bool = True,
) -> RunResult:
    """One scan, from the recording to report and recording in ``out``.

    Stages that ``store`` holds are taken from there. Without ``presented`` the run ends at the
    numbers: no report, no recording.
    """
    volumes.check(settings)  # what no method can be run with is told before anything is computed
    how = c_arm.imaging(settings.scan)  # so is a spectrum
    opened = open_device(device)
    folder = RunFolder(out, _about(settings, opened), store)
    write_text(out / "config.toml", config.dump(settings))
    body = set_up(settings, folder, on_progress)
    signals = read_sensors(
        settings, body.recovery, body.splines, body.sensors, folder, motion_key(settings)
    )
    starts = stages.starts(settings, body, signals, opened)
    moving, still = stages.scan(settings, body, how, folder, opened, on_progress)
    scan = Scan(moving, signals, starts.starts)
    grid = c_arm.volume_grid(settings.grid, body.geometry.rotation_center())
    stage = StageContext(settings, folder, opened, scan_key(settings), on_progress)
    corrected = volumes.reconstruct_methods(stage, body, scan, still, grid)
    results = scores.score_methods(
        stage, body, corrected, lambda: regions(settings, body, grid, opened), grid
    )
    if presented:
        _present(settings, body, signals, moving, corrected, results, starts, folder, on_progress)
    return RunResult(out, results)


def _about(settings: RunConfig, device: Device) -> dict[str, Any]:
    dumped = config.dump(settings)
    return {
        "legsim": __version__,
        "commit": commit(),
        "config_hash": key_of(dumped),
        "seed": settings.seed,
        "device": device.label,
        "sensors": sensors.noise_sentence(settings.imu, view_rate_hz=settings.scan.rate_hz),
        "start": settings.methods.start,
    }


def _present(
    settings: RunConfig,
    body: ScanSetup,
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
    key = key_of(scan_key(settings), settings.model_dump(), folder.hash_of("metrics.json"))
    if folder.done("presentation", key):
        return
    with folder.stage("presentation", key, files):
        on_progress("recording and report", 0, 2)
        replayed = build.replay_scene(
            body.recovery, body.splines, body.sensors, signals, body.phantom
        )
        scene = build.scan_scene(
            replayed, body.phantom, body.poses, moving, [c.volume for c in corrected]
        )
        view.write_scan(folder.path / "recording.rrd", scene)
        on_progress("recording and report", 1, 2)
        truth = RigidMotion.from_poses(body.times, body.poses.of("tibia_l"))
        rigid = [(c.volume.name, c.motion) for c in corrected if isinstance(c.motion, RigidMotion)]
        drawn = scan_page.scan_figures(scene, truth, rigid, body.poses.of("tibia_l")[0, :3, 3])
        pictures = scan_page.write_pictures(folder.path / "pictures", drawn)
        provenance = [(what, str(value)) for what, value in folder.about.items()] + [
            ("command", f"legsim run config.toml --out {folder.path.name}")
        ]
        summary = _summary(
            settings, results, (*starts.notes, *(note for c in corrected for note in c.notes))
        )
        content = scan_page.scan_report(body.recovery, results, pictures, summary, provenance)
        write_text(folder.path / "report.html", page.render(content))
        on_progress("recording and report", 2, 2)


def _summary(
    settings: RunConfig, results: tuple[MethodResult, ...], notes: Sequence[str]
) -> list[str]:
    """The report's first sentences."""
    scan, grid = settings.scan, settings.grid
    lines = [
        f"{scan.views} views of {scan.columns}x{scan.rows} pixels over "
        f"{(scan.views - 1) * scan.increment_deg:.1f} degrees in "
        f"{(scan.views - 1) / scan.rate_hz:.1f} s; {grid.voxels}^3 voxels of {grid.voxel_mm:g} mm."
    ]
    shown = {r.method: r for r in results}
    if {"uncorrected", "rigid"} <= shown.keys():
        before, after = (shown[name].metrics.regions[0] for name in ("uncorrected", "rigid"))
        lines.append(
            f"Motion lowers SSIM to {before.ssim:.3f} and raises RMSE to {before.rmse:.3f}; "
            f"following the {settings.methods.sensor} sensor "
            f"rigidly brings {after.ssim:.3f} and {after.rmse:.3f}."
        )
    lines += [
        c_arm.sentence(scan, settings.phantom),
        sensors.noise_sentence(settings.imu, view_rate_hz=scan.rate_hz),
        *notes,
    ]
    if settings.imu.noise.kind == "none" and settings.methods.start == "truth":
        lines.append(
            "With clean signals and a true start these are ceilings, not what a real sensor would "
            "reach."
        )
    if "oracle-nonrigid" in shown:
        lines.append(
            "The phantom's soft tissue follows the bones by its own skinning, which moving least "
            "squares between joints only resembles: "
            "how the two differ is part of the error of the non-rigid methods, and a real leg "
            "would differ from both."
        )
    return lines
