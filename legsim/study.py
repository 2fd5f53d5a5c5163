"""Subjects x postures x methods x noise: a graph of runs, its scores, and the report that sets them beside the printed ones."""

import json
import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomli_w

from legsim import (
    __version__,
    acquisition,
    artifacts,
    comparison,
    figures,
    images,
    memory,
    methods,
    motion_paths,
    presentation,
    reconstruction,
    recovery,
    sole_use,
    study_config,
    study_engine,
    study_report,
    study_results,
    study_tasks,
    whole_files,
)
from legsim.config import RunConfig
from legsim.errors import LegsimError, at
from legsim.report import Picture
from legsim.scanned_leg import OnProgress
from legsim.scene import NamedVolume
from legsim.side_by_side import counted
from legsim.study_config import Ladder, StudyConfig
from legsim.study_engine import OnStep, Outcome, Task
from legsim.study_results import NoiseLevel, StageCost, StudyResults
from legsim.study_tasks import LadderJob, ScanJob

_FLOAT = 4
_GIB = 2.0**30


@dataclass(frozen=True, slots=True)
class Plan:
    """Every task of a study, in an order that satisfies their needs."""

    scans: tuple[ScanJob, ...]
    ladders: tuple[LadderJob, ...]

    def tasks(self) -> tuple[Task, ...]:
        """Noisy runs wait for the clean one of their scan, whose projections they share."""
        clean = {(job.subject, job.posture): job.name for job in self.scans if job.noise is None}
        ladders = [Task(job.name, study_tasks.ladder, (job,)) for job in self.ladders]
        scans = [
            Task(job.name, study_tasks.scan, (job,), () if job.noise is None else (clean[job.subject, job.posture],)) for job in self.scans
        ]
        return (*ladders, *scans)

    def disk(self) -> int:
        """Bytes that all runs take."""
        return sum(
            _volumes(job.settings) * _volume_bytes(job.settings) + _field_bytes(job.settings) + _shared_bytes(job) for job in self.scans
        )

    def memory(self) -> int:
        """Bytes that one run holds at most: every method's volume and those that are compared, projections as images and filtered."""
        return max(
            _BASE_BYTES
            + (1 + _volumes(job.settings) + _WORKING_VOLUMES) * _volume_bytes(job.settings)
            + _EXPOSURES_HELD * _exposures_bytes(job.settings)
            + _field_bytes(job.settings)
            for job in self.scans
        )


# measured on a CPU, where the device's memory is the process's own, as the greatest peak_mib of manifest.json and as du shows:
#   quick, clean run of 6 methods   1340 MiB held, 1478 told;   the study of 2 clean and 4 noisy runs   823 MiB of disk, 817 told
#   quick, noisy run of 1 method    1195 MiB held, 1297 told
#   table1, clean run of 7 methods  1978 MiB held, 2073 told
#   table1_paper, the same larger   8916 MiB held, 9114 told
_BASE_BYTES = 640 * 2**20
"""interpreter, libraries, OpenCL runtime, phantom"""
_WORKING_VOLUMES = 4
_EXPOSURES_HELD = 4
_TABLES_BYTES = 25 * 2**20
"""recording, reports, poses and signals of a clean run"""


def _volumes(settings: RunConfig) -> int:
    return len(set(settings.methods.run) - {methods.REFERENCE})


def _volume_bytes(settings: RunConfig) -> int:
    return _FLOAT * settings.grid.voxels**3


def _exposures_bytes(settings: RunConfig) -> int:
    """Of the moving and the resting scan."""
    return 2 * _FLOAT * settings.scan.views * settings.scan.rows * settings.scan.columns


def _field_bytes(settings: RunConfig) -> int:
    """Of the true motion at the nodes of a coarse grid, three displacements a node and view."""
    if "oracle-nonrigid" not in settings.methods.run:
        return 0
    grid = acquisition.volume_grid(settings.grid, np.zeros(3))
    return 3 * _FLOAT * settings.scan.views * math.prod(motion_paths.nodes_over(grid, 1e-3 * settings.methods.node_mm).shape_zyx)


def _shared_bytes(job: ScanJob) -> int:
    """Of what a noisy run takes from the clean one: the exposures, unless each has photons of its own, the reference, and the rest."""
    own = job.noise is None
    images = _exposures_bytes(job.settings) + _volume_bytes(job.settings) if own or job.settings.scan.detector.photons else 0
    return images + (_TABLES_BYTES if own else 0)


def plan(study: StudyConfig, base: Path, out: Path, *, device: str | None = None, store: Path | None = None) -> Plan:
    """Every run of the study; nothing is computed, but every setting, recording and method is looked up.

    Args:
        store: folder of finished stages, of this and of other studies; None for the study's own.

    Raises:
        LegsimError: a recording, a method, a sensor or a setting is not there.
    """
    found = Plan(
        _scans(study, base, out, device, out / "store" if store is None else store),
        () if study.ladder is None else _ladders(study, study.ladder, base, out),
    )
    called = [task.name for task in found.tasks()]
    twice = next((name for name in called if called.count(name) > 1), None)
    if twice is not None:
        raise LegsimError(f"two runs of the study would be called {twice}; name every subject and posture once, each differently")
    for job in (*found.scans, *found.ladders):
        recovery.fingerprint(job.settings.motion)
        reconstruction.check(job.settings)
    for job in found.ladders:
        names = [sensor.name for sensor in job.settings.imu.sensors]
        if job.ladder.sensor not in names:
            raise LegsimError(f"ladder.sensor: there is no sensor {job.ladder.sensor!r}; name one of {', '.join(names)}")
    return found


def _scans(study: StudyConfig, base: Path, out: Path, device: str | None, store: Path) -> tuple[ScanJob, ...]:
    """The clean run of every scan, followed by its noisy ones."""
    levels: list[tuple[NoiseLevel | None, int]] = [(None, 0)] if study.methods else []
    levels += [(level, r) for n in study.noise for level in n.noise() for r in range(n.repetitions)]
    jobs = []
    for subject in study.subjects:
        for posture in study.postures:
            for noise, repetition in levels:
                seed = None if noise is None else study_tasks.seed_of(subject, posture, repetition)
                settings = study_config.run_settings(study, base, subject, posture, noise, seed)
                jobs.append(ScanJob(out, subject, posture, noise, repetition, settings, device, store))
    return tuple(jobs)


def _ladders(study: StudyConfig, ladder: Ladder, base: Path, out: Path) -> tuple[LadderJob, ...]:
    jobs = []
    for subject in ladder.subjects or study.subjects:
        for posture in ladder.postures or study.postures:
            settings = study_config.run_settings(study, base, subject, posture, None, None)
            jobs += [LadderJob(out, subject, posture, convention, ladder, settings) for convention in ladder.conventions]
    return tuple(jobs)


def needs(planned: Plan, out: Path, workers: int = 0) -> str:
    """What the study will take, for a person to read before it begins.

    Args:
        workers: on this machine; 0 where others do the work.

    Raises:
        LegsimError: the disk or the memory does not suffice.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise at(out, f"cannot be made ({error.strerror})", "choose another folder with --out") from error
    if not planned.scans:
        return f"{counted(len(planned.ladders), 'noise ladder')}; no reconstruction"
    # runs share files: each counts once
    taken = sum({status.st_ino: status.st_size for status in (p.stat() for p in out.glob("runs/*/*"))}.values())
    free = shutil.disk_usage(out).free
    disk, held, there = planned.disk(), planned.memory(), memory.available()
    if disk > taken + free:
        raise LegsimError(
            f"{out}: the study takes {disk / _GIB:.1f} GiB, {free / _GIB:.1f} GiB are free there; "
            "choose another folder with --out, fewer scans, or a smaller --preset"
        )
    if there is not None and workers * held > there:
        raise LegsimError(
            f"{workers} at once, the study's runs hold {workers * held / _GIB:.1f} GiB of memory, {there / _GIB:.1f} GiB are free; "
            + (f"use --workers {there // held}" if there >= held else "use a smaller --preset")
        )
    return (
        f"{counted(len(planned.scans), 'run')}, {counted(len(planned.ladders), 'noise ladder')}; {disk / _GIB:.1f} GiB of disk, "
        f"{held / _GIB:.1f} GiB of memory a worker"
    )


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

    With one worker and no scheduler the runs are made here, one after the other; else on a Dask cluster.

    Raises:
        LegsimError: another study runs into the same folder.
    """
    with sole_use.of_folder(out):
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
    whole_files.write_text(out / "study.toml", tomli_w.dumps(study.model_dump(mode="json", exclude_none=True)))
    tasks = planned.tasks()
    if scheduler is None and workers == 1:
        outcome = study_engine.run_here(tasks, on_step, on_progress=on_progress)
    else:
        outcome = study_engine.run_on_cluster(tasks, on_step, scheduler=scheduler, workers=workers, shared_folder=out)
    results = gathered(study, planned, outcome, out, command)
    study_results.save(out / study_results.RESULTS_FILE, results)
    ended = [job for job in planned.scans if job.name in outcome.results]
    study_report.write(out, results, _one_scan(ended, out), _one_scan_under_noise(ended, out))
    return results


def _one_scan(ended: Sequence[ScanJob], out: Path) -> tuple[Picture, ...]:
    """Slices and overlays of every method, of the first subject's last posture."""
    shown = _shown(ended)
    if shown is None:
        return ()
    scan = f"{shown.subject}, {shown.posture}"
    captions = {
        "slices": f"{scan}: axial slices 5 cm below and above the knee center, and the sagittal slice through it, one column a method.",
        "overlay": f"{scan}: the motion-free volume in red and each method in green; where they agree it is yellow.",
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
        [] if shown is None else [j for j in ended if j.noise and (j.subject, j.posture, j.repetition) == (shown.subject, shown.posture, 0)]
    )
    if shown is None or not levels:
        return ()
    method = next(methods.label(name) for name in levels[0].settings.methods.run if name != methods.REFERENCE)
    columns = [("motion-free", shown.folder / f"volume-{methods.REFERENCE}.mha")]
    columns += [("no noise", shown.folder / f"volume-{method}.mha")]
    columns += [(job.noise.label.replace(" (", "\n("), job.folder / f"volume-{method}.mha") for job in levels if job.noise]
    volumes = [NamedVolume(name, images.load_volume(path)) for name, path in columns if path.is_file()]
    figure = figures.slices(volumes, presentation.slice_planes(volumes[0].volume.grid.center))
    caption = f"{shown.subject}, {shown.posture}: {method} from clean and from noisy sensors, by level of noise and reading of its size."
    file = "pictures/noise-slices.png"
    (out / "pictures").mkdir(exist_ok=True)
    whole_files.write_bytes(out / file, figures.png(figure))
    return (Picture(caption, (out / file).read_bytes(), caption, file),)


def _shown(ended: Sequence[ScanJob]) -> ScanJob | None:
    """The scan whose pictures the report shows: the first subject's last posture."""
    clean = [job for job in ended if job.noise is None]
    return next((job for job in reversed(clean) if job.subject == clean[0].subject), None)


def gathered(study: StudyConfig, planned: Plan, outcome: Outcome, out: Path, command: str) -> StudyResults:
    """Scores in the order of the plan, whoever ended first."""
    scores = [score for job in planned.scans for score in outcome.results.get(job.name, ())]
    cells = [score for job in planned.ladders for score in outcome.results.get(job.name, ())]
    failures = tuple(f"{name}: {why}" for name, why in outcome.failures.items())
    provenance = (("command", command), ("legsim", __version__), *_about(planned, out))
    costs = stage_costs([job.folder for job in planned.scans])
    missed = [comparison.registration_error(job.folder) for job in planned.scans if job.noise is None]
    errors = tuple(error for error in missed if error is not None)
    return StudyResults(study.name, study.title, tuple(scores), tuple(cells), provenance, failures, costs, errors)


def lines(results: StudyResults, out: Path) -> list[str]:
    """What to print at the end."""
    return [
        f"{len(results.scores)} scores, {len(results.ladder)} cells of the noise ladder",
        f"report: {out / 'report.html'}",
        f"numbers: {out / study_results.RESULTS_FILE}",
    ]


def _about(planned: Plan, out: Path) -> tuple[tuple[str, str], ...]:
    """Size of the scans, and what the first run says of itself."""
    if not planned.scans:
        return ()
    scan, grid = planned.scans[0].settings.scan, planned.scans[0].settings.grid
    size = f"{scan.views} views of {scan.columns}x{scan.rows} pixels, {grid.voxels}^3 voxels of {grid.voxel_mm:g} mm"
    manifest = planned.scans[0].folder / "manifest.json"
    said = json.loads(manifest.read_text("utf-8")) if manifest.is_file() else {}
    return (("size", size), *((name, str(said[name])) for name in ("commit", "device") if said.get(name)))


def stage_costs(folders: list[Path]) -> tuple[StageCost, ...]:
    """Mean seconds and greatest memory of every stage; what runs share is counted once."""
    finished = {(one.stage, one.key): one for folder in folders for one in artifacts.finished_stages(folder)}
    costs = []
    for stage in dict.fromkeys(name for name, _ in finished):
        alike = [one for one in finished.values() if one.stage == stage]
        peak = max((one.peak_mib for one in alike if one.peak_mib is not None), default=None)
        costs.append(StageCost(stage, len(alike), float(np.mean([one.seconds for one in alike])), peak))
    return tuple(costs)
