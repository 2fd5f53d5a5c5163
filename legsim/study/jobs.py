"""The kinds of work of a study, as functions that any process can call: one scan with its
methods, one posture's noise ladder, one sensor of the catalogue.

Each leaves its scores in a file with a key, a hash of all that decides them, and takes them from
there when it is asked again.
"""

import zlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from legsim import __version__
from legsim.config import ImuConfig, NoiseConfig, RunConfig, noise_keys
from legsim.core import memory
from legsim.core.files import key_of
from legsim.core.progress import OnProgress
from legsim.evaluation import similarity
from legsim.imu import drift, simulation
from legsim.imu.calibration import CalibrationKind
from legsim.imu.noise import Convention, ImuNoise
from legsim.opencl.device import open_device
from legsim.run import c_arm, code, methods, named_files, pipeline, stages
from legsim.run import motion as run_motion
from legsim.run import sensors as run_sensors
from legsim.run.store import StageCache
from legsim.study import aiding, kept, results
from legsim.study.config import Aiding, Ladder, exponent
from legsim.study.results import (
    AidedScore,
    LadderScore,
    NoiseLevel,
    ScanScore,
    SensorScore,
)


@dataclass(frozen=True, slots=True)
class ScanJob:
    """One scan of one person with the methods that its settings name, under one draw of noise."""

    study_folder: Path
    subject: str
    posture: str
    noise: NoiseLevel | None
    repetition: int
    settings: RunConfig
    device: str | None
    store: Path
    """folder of finished stages"""
    sensor: str = ""
    """of the catalogue, where the study compares such; empty: the settings' own"""

    @property
    def name(self) -> str:
        """Unique in the study; the run's folder below runs/."""
        level = "" if self.noise is None else f"-{self.noise.stem}-{self.repetition}"
        if self.sensor:
            level = f"-{_stem(self.sensor)}-{self.repetition}"
        return f"{self.subject}-{self.posture}{level}".replace("/", "_")

    @property
    def clean(self) -> bool:
        """Whether it has the study's own sensors, without added noise."""
        return self.noise is None and not self.sensor

    @property
    def folder(self) -> Path:
        return self.study_folder / "runs" / self.name


@dataclass(frozen=True, slots=True)
class LadderJob:
    """All cells of the noise ladder for one recording in one convention."""

    study_folder: Path
    subject: str
    posture: str
    convention: Convention
    ladder: Ladder
    settings: RunConfig

    @property
    def name(self) -> str:
        """Unique in the study."""
        return f"ladder-{self.subject}-{self.posture}-{self.convention}".replace("/", "_")


@dataclass(frozen=True, slots=True)
class SensorJob:
    """One sensor of the catalogue on one recording, under every calibration."""

    study_folder: Path
    subject: str
    posture: str
    sensor: str
    ladder: Ladder
    settings: RunConfig

    @property
    def name(self) -> str:
        """Unique in the study."""
        return f"sensor-{self.subject}-{self.posture}-{_stem(self.sensor)}".replace("/", "_")

    def under(self, calibration: CalibrationKind) -> ImuConfig:
        """Settings of the sensor that is integrated, under one calibration."""
        imu = self.settings.imu
        chosen = tuple(s for s in imu.sensors if s.name == self.ladder.sensor)
        read = {key: getattr(imu.noise, key) for key in noise_keys(self.sensor)}
        changes = {"kind": self.sensor, "calibration": calibration}
        noise = NoiseConfig().model_copy(update={**read, **changes})
        return imu.model_copy(update={"sensors": chosen, "noise": noise})


@dataclass(frozen=True, slots=True)
class AidedJob:
    """One sensor on one recording, with all that aids it."""

    study_folder: Path
    subject: str
    posture: str
    sensor: str
    aiding: Aiding
    settings: RunConfig

    @property
    def name(self) -> str:
        """Unique in the study."""
        return f"aided-{self.subject}-{self.posture}-{_stem(self.sensor)}".replace("/", "_")


def _stem(sensor: str) -> str:
    """A sensor's name that a file may have."""
    return Path(sensor).stem if sensor.endswith(".toml") else sensor


def seed_of(subject: str, posture: str, repetition: int) -> int:
    """Of the noise of one scan: other scans and repetitions draw other noise, whatever else a study
    holds.
    """
    return zlib.crc32(f"{subject}/{posture}/{repetition}".encode())


def scan(job: ScanJob, on_progress: OnProgress | None = None) -> tuple[ScanScore, ...]:
    """Scores of every method in one scan; the run stays in the study's folder."""
    settings = job.settings
    names = [(name, methods.fingerprint(name)) for name in settings.methods.run]
    key = key_of(
        __version__,
        code.fingerprint("study"),
        open_device(job.device).arithmetic,
        settings.model_dump(),
        named_files.fingerprint(settings),
        names,
        similarity.PROTOCOL,
    )

    def run() -> list[dict[str, Any]]:
        return [asdict(score) for score in _scan(job, on_progress or _quiet)]

    path = job.study_folder / "scores" / f"{job.name}.json"
    if not (job.folder / "manifest.json").is_file():
        # the report shows the run's folder: where somebody deleted it, it is filled again from the
        # store
        path.unlink(missing_ok=True)
    return tuple(results.score_from(entry) for entry in kept.entries(path, key, run))


def _scan(job: ScanJob, on_progress: OnProgress) -> list[ScanScore]:
    memory.give_back()  # what the scan before has left
    result = pipeline.run_scan(
        job.settings,
        job.folder,
        device=job.device,
        on_progress=on_progress,
        store=StageCache(job.store),
        presented=job.clean,
    )
    place = job.folder.relative_to(job.study_folder).as_posix()
    return [
        ScanScore(
            job.subject,
            job.posture,
            m.method,
            job.noise,
            job.repetition,
            m.metrics,
            m.residuals,
            m.seconds,
            place,
            job.sensor,
        )
        for m in result.methods
    ]


def ladder(job: LadderJob, on_progress: OnProgress | None = None) -> tuple[LadderScore, ...]:
    """RMSE of translation and rotation in every cell and repetition."""
    asked = job.ladder
    key = key_of(
        __version__,
        code.fingerprint("ladder"),
        job.settings.model_dump(),
        named_files.fingerprint(job.settings),
        asked.model_dump(),
        job.convention,
    )

    def run() -> list[dict[str, Any]]:
        return [asdict(score) for score in _ladder(job, on_progress or _quiet)]

    entries = kept.entries(job.study_folder / "scores" / f"{job.name}.json", key, run)
    return tuple(results.ladder_score_from(entry) for entry in entries)


def _ladder(job: LadderJob, on_progress: OnProgress) -> list[LadderScore]:
    settings, asked = job.settings, job.ladder
    recovered = run_motion.solve(settings.motion)
    chosen = tuple(s for s in settings.imu.sensors if s.name == asked.sensor)
    clean = run_sensors.sense(
        recovered,
        settings.imu.model_copy(update={"sensors": chosen}),
        shaking=_shaking(settings),
    )
    views = c_arm.c_arm(settings.scan).view_times(recovered.trajectories.times)
    start = simulation.true_start(
        recovered.leg, recovered.splines, clean.sensors[0], float(views[0])
    )
    seeds = [(seed_of(job.subject, job.posture, r), 1) for r in range(asked.repetitions)]
    scores = []
    for row, f_a in enumerate(map(exponent, asked.f_a)):
        on_progress("noise ladder", row, len(asked.f_a))
        for f_g in map(exponent, asked.f_g):
            noise = ImuNoise.paper(
                acceleration_exponent=f_a,
                angular_velocity_exponent=f_g,
                imu_rate_hz=settings.imu.rate_hz,
                projection_rate_hz=settings.scan.rate_hz,
                convention=job.convention,
            )
            level = NoiseLevel(job.convention, f_a, f_g)
            found = drift.deviations(clean, start, views, noise, settings.methods.scheme, seeds)
            scores += [
                LadderScore(
                    job.subject,
                    job.posture,
                    level,
                    r,
                    1e3 * d.translation,
                    float(np.degrees(d.rotation)),
                )
                for r, d in enumerate(found)
            ]
    on_progress("noise ladder", len(asked.f_a), len(asked.f_a))
    return scores


def _shaking(settings: RunConfig) -> np.random.Generator:
    """Draws the vibration of the skin, the same for every reading of a scan."""
    return np.random.default_rng([settings.seed, stages.VIBRATION])


def sensor(job: SensorJob, on_progress: OnProgress | None = None) -> tuple[SensorScore, ...]:
    """RMSE of translation and rotation under every calibration and in every repetition."""
    asked = job.ladder
    key = key_of(
        __version__,
        code.fingerprint("ladder"),
        job.settings.model_dump(),
        named_files.fingerprint(job.settings),
        asked.model_dump(exclude={"sensors"}),
        job.sensor,
        run_sensors.fingerprint(job.under("none")),
    )

    def run() -> list[dict[str, Any]]:
        return [asdict(score) for score in _sensor(job, on_progress or _quiet)]

    entries = kept.entries(job.study_folder / "scores" / f"{job.name}.json", key, run)
    return tuple(SensorScore(**entry) for entry in entries)


def _sensor(job: SensorJob, on_progress: OnProgress) -> list[SensorScore]:
    settings, asked = job.settings, job.ladder
    person = run_motion.solve(settings.motion)
    views = c_arm.c_arm(settings.scan).view_times(person.trajectories.times)
    exact = run_sensors.sense(person, job.under("none"), shaking=_shaking(settings))
    start = simulation.true_start(person.leg, person.splines, exact.sensors[0], float(views[0]))
    reference = drift.estimate(exact, start, views, settings.methods.scheme)
    seeds = [(seed_of(job.subject, job.posture, r), 1) for r in range(asked.repetitions)]
    scores = []
    for step, calibration in enumerate(asked.calibrations):
        on_progress("sensors", step, len(asked.calibrations))
        read = run_sensors.records(
            person,
            job.under(calibration),
            view_rate_hz=settings.scan.rate_hz,
            rest_at=float(views[0]),
            rngs=map(np.random.default_rng, seeds),
            shaking=_shaking(settings),
        )
        for r, signals in enumerate(read):
            found = drift.estimate(signals, start, views, settings.methods.scheme)
            away = drift.deviation(found, reference)
            millimeters, degrees = 1e3 * away.translation, float(np.degrees(away.rotation))
            who = (job.subject, job.posture, job.sensor, calibration, r)
            scores.append(SensorScore(*who, millimeters, degrees))
    on_progress("sensors", len(asked.calibrations), len(asked.calibrations))
    return scores


def aided(job: AidedJob, on_progress: OnProgress | None = None) -> tuple[AidedScore, ...]:
    """Errors of the motion by every aid and in every repetition."""
    settings = job.settings
    key = key_of(
        __version__,
        code.fingerprint("aided"),
        settings.model_dump(exclude={"methods": {"run"}}),
        named_files.fingerprint(settings),
        job.aiding.aids,
        job.aiding.repetitions,
    )
    seeds = [seed_of(job.subject, job.posture, r) for r in range(job.aiding.repetitions)]

    def run() -> list[dict[str, Any]]:
        found = aiding.measure(settings, job.aiding.aids, seeds, on_progress or _quiet)
        who = (job.subject, job.posture, job.sensor)
        return [
            asdict(AidedScore(*who, aid, repetition, *left, settings.methods.start))
            for repetition, of_draw in enumerate(found)
            for aid, left in of_draw.items()
        ]

    entries = kept.entries(job.study_folder / "scores" / f"{job.name}.json", key, run)
    return tuple(AidedScore(**entry) for entry in entries)


def _quiet(*_: object) -> None:
    """Progress that nobody watches."""
