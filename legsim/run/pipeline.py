"""The whole chain of a run, from recording to report.

:func:`run_scan` lists the stages; each is skipped where the run folder's manifest confirms its
files.
"""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from legsim import __version__, config, view
from legsim.config import RunConfig
from legsim.core.errors import LegsimError
from legsim.core.files import key_of, write_text
from legsim.core.progress import OnProgress, silent
from legsim.correction.method import Scan
from legsim.deformation.models import RigidMotion
from legsim.evaluation.scores import MethodResult
from legsim.geometry.volume import NamedVolume
from legsim.imu import plausibility as imu_plausibility
from legsim.opencl import failures
from legsim.opencl.device import Device, open_device
from legsim.report import page, scan_page
from legsim.run import (
    c_arm,
    code,
    methods,
    reconstruction,
    scan_file,
    scores,
    sensors,
    stages,
    volumes,
)
from legsim.run.corrected import Reconstructed
from legsim.run.folder import RunFolder, commit
from legsim.run.stages import StageContext
from legsim.run.store import StageCache
from legsim.scene import build
from legsim.scene.slices import VolumeSlices
from legsim.simulation.setup import ankles_on_sensors, joints_on_sensors, knee_on_thigh
from legsim.simulation.simulated_scan import SimulatedScan


@dataclass(frozen=True, slots=True)
class RunResult:
    """Result of a run."""

    folder: Path
    methods: tuple[MethodResult, ...]
    warnings: tuple[str, ...] = ()
    """about the movement that was scanned, and sensors whose drift hides it"""

    @property
    def region_names(self) -> tuple[str, ...]:
        """Regions in the order of the table."""
        return tuple(r.region for r in self.methods[0].metrics.regions)

    @property
    def protocol(self) -> str:
        """How volumes were scaled and which windows SSIM has, in words."""
        return self.methods[0].metrics.protocol

    def columns(self) -> tuple[str, ...]:
        """Column names of :meth:`rows`."""
        measures = (f"{kind} {region}" for kind in ("SSIM", "RMSE") for region in self.region_names)
        return (
            "method",
            *measures,
            *(f"{r.structure} mm" for r in self.methods[0].residuals),
            "bones px",
            "px after similarity",
            "seconds",
        )

    def rows(self) -> list[tuple[str, ...]]:
        """Formats the scores of each method.

        They are method, SSIM by region, RMSE by region, residual motion by structure and at the
        bones in the images (as it is, and after the best constant similarity), seconds.
        """
        return [
            (
                m.method,
                *(f"{r.ssim:.3f}" for r in m.metrics.regions),
                *(f"{r.rmse:.3f}" for r in m.metrics.regions),
                *("-" if r.mm is None else f"{r.mm:.2f}" for r in m.residuals),
                f"{m.residual_px:.2f}",
                f"{m.residual_px_after_similarity:.2f}",
                f"{m.seconds:.1f}",
            )
            for m in self.methods
        ]

    def places(self) -> list[str]:
        """Lists the places of the results."""
        names = {
            "report": "report.html",
            "recording": "recording.rrd",
            "pictures": "pictures",
            "numbers": "metrics.json",
        }
        return [f"{what}: {self.folder / name}" for what, name in names.items()] + [
            f"to look around: {shlex.join(['legsim', 'view', str(self.folder)])}"
        ]


def run_scan(
    settings: RunConfig,
    out: Path | str,
    *,
    device: str | None = None,
    on_progress: OnProgress = silent,
    store: StageCache | None = None,
    presented: bool = True,
) -> RunResult:
    """Runs one scan, from the recording to report and recording in the folder ``out``.

    Finished stages are kept: a second run there computes only what changed.

    Args:
        settings: of the run, as :func:`legsim.config.load_settings` gives them.
        out: folder of the results; made where it is missing.
        device: part of an OpenCL device's name, or "cpu" or "gpu"; None for the fastest.
        on_progress: is called with the name of the stage, steps done and total steps.
        store: finished stages that runs share.
        presented: False ends the run at the numbers: no report, no recording.

    Raises:
        LegsimError: settings, files or a device that the run cannot work with.

    >>> result = run_scan(load_settings(preset="demo"), "out")
    """
    if not isinstance(settings, RunConfig):
        raise LegsimError(
            f"settings of a run are what load_settings gives, not {type(settings).__name__}"
        )
    # wrong settings are reported before anything is computed
    volumes.check(settings)
    sensors.check(settings.imu)
    reconstruction.check_views(settings.reconstruction, c_arm.c_arm(settings.scan))
    opened, out = open_device(device), Path(out)
    with failures.reported(opened.label), RunFolder(out, _about(settings, opened), store) as folder:
        write_text(out / "config.toml", config.dump(settings))
        folder.write_manifest()  # of these settings, even where no stage runs
        return _run(StageContext(settings, folder, opened, on_progress), presented=presented)


def _run(stage: StageContext, *, presented: bool) -> RunResult:
    settings, folder = stage.settings, stage.folder
    setup = stages.set_up(stage)
    signals = stages.read_sensors(
        settings,
        setup.person,
        folder,
        stages.motion_key(settings),
        rest_at=float(setup.times[0]),
    )
    readings = imu_plausibility.objections(signals)
    stages.refuse_implausible(settings, setup.person.name, readings)
    starts = stages.starts(settings, setup, signals, stage.device)
    moving, at_rest = stages.exposures(stage, setup)
    joints = joints_on_sensors(
        setup,
        volumes.followed_sides(settings),
        points_per_segment=settings.methods.points_per_segment,
    )
    seen = Scan(moving, signals, starts.starts, joints, ankles_on_sensors(setup))
    scan = SimulatedScan(setup, seen, at_rest, stage.device)
    scan_file.write(folder.path, settings, scan.seen, setup.sensors, knee_on_thigh(setup))
    grid = c_arm.volume_grid(settings.grid, setup.geometry.rotation_center())
    corrected = volumes.reconstruct_methods(stage, scan, grid)
    results = scores.score_methods(stage, scan, corrected, grid)
    doubts = methods.undetermined(
        settings.methods.run, scan.seen, settings.methods.sensor, volumes.sensor_priors(settings)
    )
    if presented:
        notes = (*starts.notes, *(note for c in corrected for note in c.notes))
        notes = (*notes, *scores.resampled(settings.evaluation, corrected))
        _present(stage, scan, corrected, results, (*notes, *(f"In doubt: {d}." for d in doubts)))
    return RunResult(folder.path, results, (*setup.person.warnings, *readings, *doubts))


def _about(settings: RunConfig, device: Device) -> dict[str, Any]:
    dumped = config.dump(settings)
    return {
        "legsim": __version__,
        "commit": commit(),
        "config_hash": key_of(dumped),
        "seed": settings.seed,
        "device": device.described,
        "sensors": sensors.noise_sentence(settings.imu, view_rate_hz=settings.scan.rate_hz),
        "start": settings.methods.start,
    }


def _present(
    stage: StageContext,
    scan: SimulatedScan,
    corrected: tuple[Reconstructed, ...],
    results: tuple[MethodResult, ...],
    notes: Sequence[str],
) -> None:
    """Writes the recording, the pictures and the report."""
    settings, folder, setup = stage.settings, stage.folder, scan.setup
    lines = _summary(settings, results, notes)

    def write() -> tuple[str, ...]:
        stage.on_progress("recording and report", 0, 2)
        scene = build.scan_scene(
            scan, [VolumeSlices.of(NamedVolume(c.name, c.load())) for c in corrected]
        )
        view.write_scan(folder.path / "recording.rrd", scene)
        stage.on_progress("recording and report", 1, 2)
        shank = setup.poses.of(setup.named("tibia"))
        truth = RigidMotion.from_poses(setup.times, shank)
        rigid = [(c.name, c.motion) for c in corrected if isinstance(c.motion, RigidMotion)]
        drawn = scan_page.scan_figures(scene, truth, rigid, shank[0, :3, 3])
        pictures = scan_page.write_pictures(folder.path / "pictures", drawn)
        provenance = [(what, str(value)) for what, value in folder.about.items()] + [
            ("command", shlex.join(["legsim", "run", "config.toml", "--out", folder.path.name]))
        ]
        content = scan_page.scan_report(
            setup.person,
            results,
            pictures,
            lines,
            provenance,
            side=setup.side,
            views=setup.times,
        )
        write_text(folder.path / "report.html", page.render(content))
        stage.on_progress("recording and report", 2, 2)
        return "recording.rrd", "report.html", *(picture.file for picture in pictures)

    key = key_of(
        stage.scan_key,
        code.fingerprint("presentation"),
        settings.model_dump(),
        folder.hash_of("metrics.json"),
        folder.hash_of("imu.csv"),
        lines,
    )
    folder.cached("presentation", key, write)


def _summary(
    settings: RunConfig, results: tuple[MethodResult, ...], notes: Sequence[str]
) -> list[str]:
    """First sentences of the report."""
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
            f"rigidly brings {after.ssim:.3f} and {after.rmse:.3f}. {results[0].metrics.protocol}"
        )
    lines += [
        c_arm.sentence(scan, settings.phantom),
        sensors.noise_sentence(settings.imu, view_rate_hz=scan.rate_hz),
        *(on_skin := sensors.skin_sentences(settings.imu)),
        *notes,
    ]
    if settings.imu.noise.kind == "none" and settings.methods.start == "truth" and not on_skin:
        lines.append(
            "With clean signals and a true start these are ceilings, not what a real sensor would "
            "reach."
        )
    if "oracle-nonrigid" in shown:
        lines.append(
            "The phantom's soft tissue follows the bones by its own skinning, which moving least "
            "squares between joints only approximates: their difference is part of the error of "
            "the non-rigid methods, and a real leg would differ from both."
        )
    return lines
