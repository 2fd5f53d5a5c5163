"""Subjects x postures x methods x noise: a graph of runs, its scores, and the report that sets them
beside the published ones.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tomli_w

from legsim import __version__, figures
from legsim.core.files import write_bytes, write_text
from legsim.core.progress import OnProgress
from legsim.geometry import image_files
from legsim.geometry.volume import NamedVolume
from legsim.report.page import Picture
from legsim.run import methods
from legsim.run.folder import check_kind, finished_stages, head, registration_error
from legsim.run.lock import FolderLock
from legsim.scene.slices import VolumeSlices
from legsim.study import engine, report
from legsim.study import results as study_results
from legsim.study.config import StudyConfig
from legsim.study.engine import OnStep, Outcome
from legsim.study.jobs import ScanJob
from legsim.study.plan import Plan
from legsim.study.results import RESULTS_FILE, StageCost, StudyResults


def run(
    study: StudyConfig,
    planned: Plan,
    out: Path,
    *,
    command: str,
    workers: int = 1,
    scheduler: str | None = None,
    on_step: OnStep,
    on_progress: OnProgress,
) -> StudyResults:
    """Runs what is missing, and writes results.json and the report.

    With one worker and no scheduler the runs are made here, one after the other; else on a Dask
    cluster.

    Raises:
        LegsimError: another study runs into the same folder, or it holds a run's or a replay's
            results.
    """
    with FolderLock(out):
        check_kind(out, "study")
        return _run(study, planned, out, command, workers, scheduler, on_step, on_progress)


def _run(
    study: StudyConfig,
    planned: Plan,
    out: Path,
    command: str,
    workers: int,
    scheduler: str | None,
    on_step: OnStep,
    on_progress: OnProgress,
) -> StudyResults:
    write_text(out / "study.toml", tomli_w.dumps(study.model_dump(mode="json", exclude_none=True)))
    tasks = planned.tasks()
    if scheduler is None and workers == 1:
        outcome = engine.run_here(tasks, on_step, on_progress=on_progress)
    else:
        outcome = engine.run_on_cluster(
            tasks, on_step, scheduler=scheduler, workers=workers, shared_folder=out
        )
    results = gathered(study, planned, outcome, out, command)
    study_results.save(out / RESULTS_FILE, results)
    ended = [job for job in planned.scans if job.name in outcome.results]
    report.write(out, results, _one_scan(ended, out), _one_scan_under_noise(ended, out))
    return results


def _one_scan(ended: Sequence[ScanJob], out: Path) -> tuple[Picture, ...]:
    """Slices and overlays of every method, of the first subject's last posture."""
    shown = _shown(ended)
    if shown is None:
        return ()
    scan = f"{shown.subject}, {shown.posture}"
    captions = {
        "slices": (
            f"{scan}: axial slices 5 cm below and above the knee center, and the sagittal "
            "slice through it, one column a method."
        ),
        "overlay": (
            f"{scan}: the motion-free volume in red and each method in green; where they "
            "agree it is yellow."
        ),
    }
    files = {stem: shown.folder / "pictures" / f"{stem}.png" for stem in captions}
    return tuple(
        Picture(caption, files[stem].read_bytes(), caption, files[stem].relative_to(out).as_posix())
        for stem, caption in captions.items()
        if files[stem].is_file()
    )


def _one_scan_under_noise(ended: Sequence[ScanJob], out: Path) -> tuple[Picture, ...]:
    """Slices of the first method that noise was tried on, by level, of the same scan."""
    shown = _shown(ended)
    levels = (
        []
        if shown is None
        else [
            j
            for j in ended
            if j.noise and (j.subject, j.posture, j.repetition) == (shown.subject, shown.posture, 0)
        ]
    )
    if shown is None or not levels:
        return ()
    method = next(
        methods.label(name) for name in levels[0].settings.methods.run if name != methods.REFERENCE
    )
    columns = [("motion-free", shown.folder / f"volume-{methods.REFERENCE}.mha")]
    columns += [("no noise", shown.folder / f"volume-{method}.mha")]
    columns += [
        (job.noise.label.replace(" (", "\n("), job.folder / f"volume-{method}.mha")
        for job in levels
        if job.noise
    ]
    figure = figures.slices(
        [
            VolumeSlices.of(NamedVolume(name, image_files.load_volume(path)))
            for name, path in columns
            if path.is_file()
        ]
    )
    caption = (
        f"{shown.subject}, {shown.posture}: {method} from clean and from noisy sensors, by "
        "level of noise and reading of its size."
    )
    file = "pictures/noise-slices.png"
    (out / "pictures").mkdir(exist_ok=True)
    write_bytes(out / file, figures.png(figure))
    return (Picture(caption, (out / file).read_bytes(), caption, file),)


def _shown(ended: Sequence[ScanJob]) -> ScanJob | None:
    """The scan whose pictures the report shows: the first subject's last posture."""
    clean = [job for job in ended if job.clean]
    return next((job for job in reversed(clean) if job.subject == clean[0].subject), None)


def gathered(
    study: StudyConfig, planned: Plan, outcome: Outcome, out: Path, command: str
) -> StudyResults:
    """Scores in the order of the plan, whoever ended first."""
    scores = [score for job in planned.scans for score in outcome.results.get(job.name, ())]
    cells = [score for job in planned.ladders for score in outcome.results.get(job.name, ())]
    sensors = [score for job in planned.sensors for score in outcome.results.get(job.name, ())]
    aided = [score for job in planned.aided for score in outcome.results.get(job.name, ())]
    failures = tuple(f"{name}: {why}" for name, why in outcome.failures.items())
    provenance = (("command", command), ("legsim", __version__), *_about(planned, out))
    costs = stage_costs([job.folder for job in planned.scans])
    clean = [job for job in planned.scans if job.clean]
    missed = [registration_error(job.folder) for job in clean]
    errors = tuple(error for error in missed if error is not None)
    return StudyResults(
        study.name,
        study.title,
        tuple(scores),
        tuple(cells),
        provenance,
        failures,
        costs,
        errors,
        tuple(sensors),
        tuple(aided),
    )


def lines(results: StudyResults, out: Path) -> list[str]:
    """What to print at the end."""
    return [
        f"{len(results.scores)} scores, {len(results.ladder)} cells of the noise ladder"
        + (f", {len(results.aided)} motions of aided sensors" if results.aided else ""),
        f"report: {out / 'report.html'}",
        f"numbers: {out / RESULTS_FILE}",
    ]


def _about(planned: Plan, out: Path) -> tuple[tuple[str, str], ...]:
    """Size of the scans, and what the first run says of itself."""
    if not planned.scans:
        return ()
    scan, grid = planned.scans[0].settings.scan, planned.scans[0].settings.grid
    size = (
        f"{scan.views} views of {scan.columns}x{scan.rows} pixels, {grid.voxels}^3 voxels of "
        f"{grid.voxel_mm:g} mm"
    )
    said = head(planned.scans[0].folder)
    return (
        ("size", size),
        *((name, str(said[name])) for name in ("commit", "device") if said.get(name)),
    )


def stage_costs(folders: list[Path]) -> tuple[StageCost, ...]:
    """Mean seconds and greatest memory of every stage; what runs share is counted once."""
    finished = {(one.stage, one.key): one for folder in folders for one in finished_stages(folder)}
    costs = []
    for stage in dict.fromkeys(name for name, _ in finished):
        alike = [one for one in finished.values() if one.stage == stage]
        peak = max((one.peak_mib for one in alike if one.peak_mib is not None), default=None)
        costs.append(
            StageCost(stage, len(alike), float(np.mean([one.seconds for one in alike])), peak)
        )
    return tuple(costs)
