"""What a study has found: a score a method and scan, a deviation a cell of the noise ladder; kept
as results.json.
"""

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from legsim.core import files
from legsim.core.errors import file_error
from legsim.evaluation.registration import RegistrationError
from legsim.evaluation.residual_motion import Residual
from legsim.evaluation.scores import scores_from
from legsim.evaluation.similarity import Scores
from legsim.imu.calibration import CalibrationKind
from legsim.imu.noise import Convention

SCHEMA = 1

RESULTS_FILE = "results.json"


@dataclass(frozen=True, slots=True)
class NoiseLevel:
    """A cell of the paper's ladder: the BMI160's RMS over 10^f_a and 10^f_g, read in one
    convention.
    """

    convention: Convention
    f_a: float | None
    """exponent of the accelerometer; None leaves it clean"""
    f_g: float | None
    """of the gyroscope"""

    @property
    def label(self) -> str:
        """For tables and pictures, with the convention."""
        return f"f_a = {_exponent(self.f_a)}, f_g = {_exponent(self.f_g)} ({self.convention})"

    @property
    def stem(self) -> str:
        """For names of files."""
        return f"{self.convention}-fa{_exponent(self.f_a)}-fg{_exponent(self.f_g)}".replace(" ", "")


def _exponent(value: float | None) -> str:
    return "no noise" if value is None else f"{value:g}"


@dataclass(frozen=True, slots=True)
class ScanScore:
    """How well one method did in one scan."""

    subject: str
    posture: str
    """stem of the recording, such as squat_30"""
    method: str
    noise: NoiseLevel | None
    """None: clean sensors"""
    repetition: int
    metrics: Scores
    residuals: tuple[Residual, ...]
    seconds: float
    """estimation, with the images of beads that a method alone has, and reconstruction"""
    folder: str
    """of the run, relative to the study's"""
    sensor: str = ""
    """of the catalogue, with all its errors; empty: the study's own settings"""

    @property
    def clean(self) -> bool:
        """Whether it is of the study's own sensors, without added noise."""
        return self.noise is None and not self.sensor


@dataclass(frozen=True, slots=True)
class LadderScore:
    """How far noise alone carries the estimated motion from the noise-free estimate."""

    subject: str
    posture: str
    noise: NoiseLevel
    repetition: int
    translation_mm: float
    """RMSE over the views, mean of three axes"""
    rotation_deg: float


@dataclass(frozen=True, slots=True)
class SensorScore:
    """How far one sensor's errors carry the estimated motion from the exact estimate."""

    subject: str
    posture: str
    sensor: str
    calibration: CalibrationKind
    repetition: int
    translation_mm: float
    """RMSE over the views, mean of three axes"""
    rotation_deg: float


@dataclass(frozen=True, slots=True)
class AidedScore:
    """How far a sensor, with what aids it, misses the motion of the bone that carries it.

    RMS over views and points of the bone.
    """

    subject: str
    posture: str
    sensor: str
    aid: str
    repetition: int
    px_after_similarity: float
    """after the one constant similarity that images cannot see"""
    px: float
    mm: float
    degrees: float
    followed: bool
    """whether a motion was followed; else the scan was left as it is"""
    start: str = ""
    """as methods.start of the settings; empty where it is not known"""


@dataclass(frozen=True, slots=True)
class StageCost:
    """What one stage of the runs took."""

    stage: str
    runs: int
    """that computed it"""
    seconds: float
    """mean"""
    peak_mib: float | None
    """the most memory that a process held during it; None where the system does not report it"""


@dataclass(frozen=True, slots=True)
class StudyResults:
    """All of a study."""

    name: str
    title: str
    scores: tuple[ScanScore, ...]
    ladder: tuple[LadderScore, ...]
    provenance: tuple[tuple[str, str], ...]
    """(what, value): command, version, device, size of the scans, seconds ..."""
    failures: tuple[str, ...] = ()
    """one line per run that did not end well"""
    costs: tuple[StageCost, ...] = ()
    registration_errors: tuple[RegistrationError, ...] = ()
    """by how much the registration misses a known motion of the motion-free volume, one per scan"""
    sensors: tuple[SensorScore, ...] = ()
    aided: tuple[AidedScore, ...] = ()


def condition(posture: str) -> str:
    """Block of the published table: "30" or "60" for the held squats, else the posture's own
    name.
    """
    return {"squat_30": "30", "squat_60": "60"}.get(posture, posture)


def save(path: Path, results: StudyResults) -> None:
    """Writes results.json."""
    files.write_text(path, json.dumps({"schema": SCHEMA, **asdict(results)}, indent=1) + "\n")


def load(path: Path) -> StudyResults:
    """The inverse of :func:`save`.

    Raises:
        LegsimError: no such file, or not a study's results.
    """
    try:
        content = json.loads(path.read_text("utf-8"), parse_float=_number, parse_constant=_number)
        return StudyResults(
            content["name"],
            content["title"],
            tuple(score_from(entry) for entry in content["scores"]),
            tuple(ladder_score_from(entry) for entry in content["ladder"]),
            tuple((what, value) for what, value in content["provenance"]),
            tuple(content["failures"]),
            tuple(StageCost(**entry) for entry in content["costs"]),
            tuple(RegistrationError(**entry) for entry in content["registration_errors"]),
            tuple(SensorScore(**entry) for entry in content.get("sensors", ())),
            tuple(AidedScore(**entry) for entry in content.get("aided", ())),
        )
    except FileNotFoundError:
        raise file_error(path, "no such file", "give the folder of a study") from None
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise file_error(
            path, f"is not a study's results ({error!r})", "run the study again"
        ) from None


def _number(text: str) -> float:
    """A number, or NaN, which is an aid's error where there is none; no score is infinite."""
    number = float(text)
    if math.isinf(number):
        raise ValueError(f"{text} is infinite")
    return number


def score_from(entry: dict[str, Any]) -> ScanScore:
    """A score from what ``dataclasses.asdict`` made of it."""
    noise = entry["noise"]
    return ScanScore(
        **{
            **entry,
            "noise": None if noise is None else NoiseLevel(**noise),
            "metrics": scores_from(entry["metrics"]),
            "residuals": tuple(Residual(**r) for r in entry["residuals"]),
        }
    )


def ladder_score_from(entry: dict[str, Any]) -> LadderScore:
    """A cell of the ladder from what ``dataclasses.asdict`` made of it."""
    return LadderScore(**{**entry, "noise": NoiseLevel(**entry["noise"])})


def methods_of(scores: Sequence[ScanScore]) -> tuple[str, ...]:
    """Names of the methods, in the order of the scores."""
    return tuple(dict.fromkeys(score.method for score in scores))


def regions(scores: Iterable[ScanScore]) -> tuple[str, ...]:
    """Names of all regions; the first is the whole leg."""
    return tuple(dict.fromkeys(m.region for score in scores for m in score.metrics.regions))


def protocol(scores: Iterable[ScanScore]) -> str:
    """How the volumes of the scores were compared; each way once.

    Methods that change the images are named: their volumes are resampled beside reconstructed ones.
    """
    ways: dict[str, list[str]] = {}
    for score in scores:
        ways.setdefault(score.metrics.protocol, []).append(score.method)
    usual = max(ways, key=lambda way: len(ways[way]), default="")
    return " ".join(
        way if way == usual else f"{', '.join(dict.fromkeys(ways[way]))}: {way}"
        for way in sorted(ways, key=lambda way: way != usual)
    )
