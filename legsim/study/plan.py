"""What a study will run, and the memory and disk it needs."""

import math
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from legsim.config import RunConfig
from legsim.core import memory as core_memory
from legsim.core.errors import LegsimError, file_error
from legsim.core.memory import in_words
from legsim.report.published_tables import counted
from legsim.run import c_arm, methods, named_files, sensors, volumes
from legsim.study import aiding, config
from legsim.study import jobs as study_jobs
from legsim.study.config import Aiding, Ladder, StudyConfig
from legsim.study.engine import Task
from legsim.study.jobs import AidedJob, LadderJob, ScanJob, SensorJob, seed_of
from legsim.study.results import NoiseLevel

_FLOAT = 4


@dataclass(frozen=True, slots=True)
class Plan:
    """Every task of a study, in an order that satisfies their needs."""

    scans: tuple[ScanJob, ...]
    ladders: tuple[LadderJob, ...]
    sensors: tuple[SensorJob, ...] = ()
    aided: tuple[AidedJob, ...] = ()

    def tasks(self) -> tuple[Task, ...]:
        """Runs wait for the first one of their scan, whose projections they share."""
        first: dict[tuple[str, str], str] = {}
        for job in self.scans:
            first.setdefault((job.subject, job.posture), job.name)
        ladders = [Task(job.name, study_jobs.ladder, (job,)) for job in self.ladders]
        sensors = [Task(job.name, study_jobs.sensor, (job,)) for job in self.sensors]
        scans = [
            Task(
                job.name,
                study_jobs.scan,
                (job,),
                _needs(job.name, first[job.subject, job.posture]),
            )
            for job in self.scans
        ]
        aided = [Task(job.name, study_jobs.aided, (job,)) for job in self.aided]
        return (*ladders, *sensors, *aided, *scans)

    def disk(self) -> int:
        """Bytes that all runs take."""
        return sum(
            _volumes(job.settings) * _volume_bytes(job.settings)
            + _field_bytes(job.settings)
            + _shared_bytes(job)
            for job in self.scans
        )

    def memory(self) -> int:
        """Bytes that one run holds at most: the volumes that are compared, projections as images
        and filtered.
        """
        return max(
            _BASE_BYTES
            + _WORKING_VOLUMES * _volume_bytes(job.settings)
            + _EXPOSURES_HELD * _exposures_bytes(job.settings)
            + _field_bytes(job.settings)
            for job in self.scans
        )


def _needs(name: str, first: str) -> tuple[str, ...]:
    return () if name == first else (first,)


# measured on a CPU, where the device's memory is the process's own: the greatest peak_mib of
# manifest.json, and du; the estimate behind it, in MiB
# table1_one_leg, in a fresh process: 1398 held, 1728 estimated
# table1_paper, in a fresh process: 3747 held, 4812 estimated; by a worker's sixth scan 4280, of the
# version before, whose comparison alone took 1200 more
# a study of 2 clean and 4 noisy runs: 823 of disk, 817 estimated
_BASE_BYTES = 1024 * 2**20
"""interpreter, libraries, OpenCL runtime, phantom, and what an allocator keeps between scans"""

_WORKING_VOLUMES = 5

_EXPOSURES_HELD = 2

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
    grid = c_arm.volume_grid(settings.grid, np.zeros(3))
    return (
        3
        * _FLOAT
        * settings.scan.views
        * math.prod(grid.coarse(1e-3 * settings.methods.node_mm).shape_zyx)
    )


def _shared_bytes(job: ScanJob) -> int:
    """Of what a noisy run takes from the clean one: the exposures, unless each has photons of its
    own, the reference, and the rest.
    """
    own = job.clean
    images = (
        _exposures_bytes(job.settings) + _volume_bytes(job.settings)
        if own or job.settings.scan.detector.photons
        else 0
    )
    return images + (_TABLES_BYTES if own else 0)


def plan(
    study: StudyConfig,
    base: Path,
    out: Path,
    *,
    device: str | None = None,
    store: Path | None = None,
) -> Plan:
    """Every run of the study; nothing is computed, but every setting, recording and method is
    looked up.

    Args:
        store: folder of finished stages, of this and of other studies; None for the study's own.

    Raises:
        LegsimError: a recording, a method, a sensor or a setting is not there.
    """
    found = Plan(
        _scans(study, base, out, device, out / "store" if store is None else store),
        () if study.ladder is None else _ladders(study, study.ladder, base, out),
        () if study.ladder is None else _sensors(study, study.ladder, base, out),
        () if study.aiding is None else _aided(study, study.aiding, base, out),
    )
    called = [task.name for task in found.tasks()]
    twice = next((name for name in called if called.count(name) > 1), None)
    if twice is not None:
        raise LegsimError(
            f"two runs of the study would be called {twice}; name every subject and posture once, "
            "each differently"
        )
    for job in (*found.scans, *found.ladders, *found.aided):
        named_files.fingerprint(job.settings)
        volumes.check(job.settings)
    for job in (*found.scans, *found.aided):
        sensors.check(job.settings.imu)
    for job in found.aided:
        aiding.check(job.settings, job.aiding.aids)
    for job in found.sensors:
        sensors.check(job.under("none"))
    for job in (*found.ladders, *found.sensors):
        names = [sensor.name for sensor in job.settings.imu.sensors]
        if job.ladder.sensor not in names:
            raise LegsimError(
                f"ladder.sensor: there is no sensor {job.ladder.sensor!r}; name one of "
                f"{', '.join(names)}"
            )
    return found


def _scans(
    study: StudyConfig, base: Path, out: Path, device: str | None, store: Path
) -> tuple[ScanJob, ...]:
    """The clean run of every scan, followed by its noisy ones."""
    levels: list[tuple[NoiseLevel | None, int]] = [(None, 0)] if study.methods else []
    levels += [(level, r) for n in study.noise for level in n.noise() for r in range(n.repetitions)]
    jobs = []
    for subject, posture in study.scans():
        for noise, repetition in levels:
            seed = None if noise is None else seed_of(subject, posture, repetition)
            settings = config.run_settings(study, base, subject, posture, noise, seed)
            settings = _drawn_anew(settings, subject, posture) if noise is None else settings
            jobs.append(ScanJob(out, subject, posture, noise, repetition, settings, device, store))
        for sensor, repetition in _volumes_of_sensors(study):
            seed = seed_of(subject, posture, repetition)
            settings = config.run_settings(study, base, subject, posture, None, seed, sensor)
            jobs.append(
                ScanJob(out, subject, posture, None, repetition, settings, device, store, sensor)
            )
    return tuple(jobs)


def _drawn_anew(settings: RunConfig, subject: str, posture: str) -> RunConfig:
    """The same settings with a seed of the scan's own, where sensors or starts are drawn.

    Else the seed stays as it is, and so do the beads that marker-based places by it.
    """
    imu = settings.imu
    drawn = imu.noise.kind != "none" or imu.lost_share > 0 or sensors.vibrate(imu)
    if not drawn and settings.methods.start == "truth":
        return settings
    return settings.model_copy(update={"seed": settings.seed + seed_of(subject, posture, 0)})


def _volumes_of_sensors(study: StudyConfig) -> list[tuple[str, int]]:
    """Sensor and repetition of the runs that compare sensors in images."""
    if study.aiding is None:
        return []
    asked = study.aiding
    return [(sensor, r) for sensor in asked.volume_sensors for r in range(asked.volume_repetitions)]


def _aided(study: StudyConfig, asked: Aiding, base: Path, out: Path) -> tuple[AidedJob, ...]:
    return tuple(
        AidedJob(
            out,
            subject,
            posture,
            sensor,
            asked,
            config.run_settings(study, base, subject, posture, None, None, sensor),
        )
        for subject, posture in study.scans()
        for sensor in asked.sensors
    )


def _ladders(study: StudyConfig, ladder: Ladder, base: Path, out: Path) -> tuple[LadderJob, ...]:
    return tuple(
        LadderJob(out, subject, posture, convention, ladder, settings)
        for subject, posture, settings in _climbed(study, ladder, base)
        for convention in ladder.conventions
    )


def _sensors(study: StudyConfig, ladder: Ladder, base: Path, out: Path) -> tuple[SensorJob, ...]:
    return tuple(
        SensorJob(out, subject, posture, sensor, ladder, settings)
        for subject, posture, settings in _climbed(study, ladder, base)
        for sensor in ladder.sensors
    )


def _climbed(
    study: StudyConfig, ladder: Ladder, base: Path
) -> Iterator[tuple[str, str, RunConfig]]:
    """Subject, posture and settings of each scan that a ladder climbs."""
    own = ladder.subjects or ladder.postures
    subjects, postures = ladder.subjects or study.subjects, ladder.postures or study.postures
    scans = tuple((s, p) for s in subjects for p in postures) if own else study.scans()
    for subject, posture in scans:
        settings = config.run_settings(study, base, subject, posture, None, None)
        yield subject, posture, _drawn_anew(settings, subject, posture)


def _without_images(planned: Plan) -> str:
    """Counts the tasks that reconstruct nothing."""
    counts = [counted(len(planned.ladders), "noise ladder")]
    counts += [counted(len(planned.sensors), "sensor")] if planned.sensors else []
    counts += [counted(len(planned.aided), "aided sensor")] if planned.aided else []
    return ", ".join(counts)


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
        raise file_error(
            out, f"cannot be made ({error.strerror})", "choose another folder with --out"
        ) from error
    if not planned.scans:
        return f"{_without_images(planned)}; no reconstruction"
    # runs share files: each counts once
    taken = sum(
        {
            status.st_ino: status.st_size for status in (p.stat() for p in out.glob("runs/*/*"))
        }.values()
    )
    free = shutil.disk_usage(out).free
    disk, held, there = planned.disk(), planned.memory(), core_memory.available()
    if disk > taken + free:
        raise LegsimError(
            f"{out}: the study takes {in_words(disk)}, {in_words(free)} are free there; "
            "choose another folder with --out, fewer scans, or a smaller --preset"
        )
    if there is not None and workers * held > there:
        raise LegsimError(
            f"{workers} at once, the study's runs hold {in_words(workers * held)} of memory, "
            f"{in_words(there)} are free; "
            + (f"use --workers {there // held}" if there >= held else "use a smaller --preset")
        )
    return (
        f"{counted(len(planned.scans), 'run')}, {_without_images(planned)}; "
        f"{in_words(disk)} of disk, "
        f"{in_words(held)} of memory a worker"
    )
